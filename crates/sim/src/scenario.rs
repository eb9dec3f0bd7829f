//! What happens on the field, and how does it look? A scenario read from TOML; all paths relative to its file.

mod load;

use std::path::PathBuf;

use localize::frames::Pose;
use localize::world::TeamColour;
use serde::{Deserialize, Serialize};
use vision::Mount;

pub use load::ScenarioError;

use crate::image_sensor::FilmConfig;
use crate::light::LightConfig;

/// A scenario file. Lengths in metres, times in seconds after the start, angles as their names say.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scenario {
    /// The robot file.
    pub robot: PathBuf,
    /// The field file; the robot's own if absent.
    pub field: Option<PathBuf>,
    /// Where chance starts from.
    #[serde(default)]
    pub seed: u64,
    /// How long it lasts, seconds.
    pub duration: f64,
    /// Images per second.
    #[serde(default = "default_frame_rate_hz")]
    pub frame_rate_hz: f64,
    /// Where our robot stands at first.
    pub start: Placement,
    /// Where our robot drives.
    #[serde(default)]
    pub path: PathConfig,
    /// The ball.
    #[serde(default)]
    pub ball: BallConfig,
    /// The other robots.
    #[serde(default)]
    pub others: OthersConfig,
    /// Our other robots, each with eyes and a sense of place of its own; the robot file is the same.
    #[serde(default)]
    pub squad: Vec<TeammateConfig>,
    /// How words among our robots travel.
    #[serde(default)]
    pub radio: RadioConfig,
    /// What the wheels do that the robot file does not say.
    #[serde(default)]
    pub wheels: WheelConfig,
    /// How camera and mirror really sit, as opposed to what vision believes.
    #[serde(default)]
    pub mount: Mount,
    /// The real focal length over the one of the robot file.
    #[serde(default = "default_focal_scale")]
    pub focal_scale: f64,
    /// Exposure, gain, white balance, vignetting and noise.
    #[serde(default)]
    pub film: FilmConfig,
    /// Light on the field.
    #[serde(default)]
    pub light: LightConfig,
    /// Our robot is taken away.
    #[serde(default)]
    pub kidnaps: Vec<Kidnap>,
    /// Our robot is pushed.
    #[serde(default)]
    pub pushes: Vec<Push>,
    /// Something black hangs in the view.
    #[serde(default)]
    pub occlusions: Vec<Occlusion>,
    /// Sensors that fail.
    #[serde(default)]
    pub faults: Vec<Fault>,
}

fn default_frame_rate_hz() -> f64 {
    30.0
}

fn default_focal_scale() -> f64 {
    1.0
}

/// A place and a heading on the field.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Placement {
    /// Metres.
    pub x: f32,
    /// Metres.
    pub y: f32,
    /// Degrees counter-clockwise from the field's x axis.
    #[serde(default)]
    pub theta_deg: f32,
}

impl Placement {
    /// As a pose on the field.
    pub fn pose(self) -> Pose {
        Pose::new(self.x, self.y, self.theta_deg.to_radians())
    }
}

/// How our robot drives: along waypoints, by a list of velocities, or not at all.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PathConfig {
    /// Points to pass, in turn; a heading is reached on the way there.
    pub waypoints: Vec<Placement>,
    /// After the last waypoint, start over.
    pub repeat: bool,
    /// Top speed on the path, m/s.
    pub speed: f32,
    /// Top rate of turn on the path, degrees/s.
    pub turn_rate_deg: f32,
    /// Velocities in the robot frame, each valid until the next; used where there are no waypoints.
    pub commands: Vec<TimedTwist>,
}

impl Default for PathConfig {
    fn default() -> Self {
        PathConfig {
            waypoints: Vec::new(),
            repeat: true,
            speed: 1.5,
            turn_rate_deg: 60.0,
            commands: Vec::new(),
        }
    }
}

/// A velocity in the robot frame from a time on.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TimedTwist {
    /// From when, seconds.
    pub time: f64,
    /// Forward, m/s.
    #[serde(default)]
    pub vx: f32,
    /// To the left, m/s.
    #[serde(default)]
    pub vy: f32,
    /// Counter-clockwise, degrees/s.
    #[serde(default)]
    pub turn_deg: f32,
}

/// One of our robots besides the first.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TeammateConfig {
    /// Where it stands at first.
    pub start: Placement,
    /// Where it drives.
    #[serde(default)]
    pub path: PathConfig,
    /// How its camera and mirror really sit.
    #[serde(default)]
    pub mount: Mount,
}

/// How words among robots travel: some are lost, none arrives at once.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RadioConfig {
    /// Words a second of each robot.
    pub rate_hz: f64,
    /// Share of the words that are lost on the way to each robot.
    pub loss: f32,
    /// Shortest and longest time under way, seconds; words overtake each other.
    pub delay: [f64; 2],
}

impl Default for RadioConfig {
    fn default() -> Self {
        RadioConfig {
            rate_hz: 15.0,
            loss: 0.2,
            delay: [0.005, 0.05],
        }
    }
}

/// The ball: slides, then rolls (a hollow shell), and bounces.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BallConfig {
    /// False for a field without a ball.
    pub present: bool,
    /// Where it lies at first, metres.
    #[serde(deserialize_with = "localize::fixed_array::deserialize")]
    pub position: [f32; 2],
    /// How it moves at first (sliding), m/s.
    #[serde(deserialize_with = "localize::fixed_array::deserialize")]
    pub velocity: [f32; 2],
    /// Metres.
    pub diameter: f32,
    /// Kilograms.
    pub mass: f32,
    /// Its colour, sRGB 0 to 255.
    pub colour: [u8; 3],
    /// Speed after a bounce off a wall or post over the speed before.
    pub restitution: f32,
    /// Friction on the carpet while it slides.
    pub sliding_friction: f32,
    /// Deceleration while it rolls, m/s².
    pub rolling_deceleration: f32,
}

impl Default for BallConfig {
    fn default() -> Self {
        BallConfig {
            present: true,
            position: [1.0, 0.5],
            velocity: [0.0, 0.0],
            diameter: 0.22,
            mass: 0.43,
            colour: [245, 125, 20],
            restitution: 0.7,
            sliding_friction: 0.35,
            rolling_deceleration: 0.35,
        }
    }
}

/// The other robots: so many at random places, or each as listed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OthersConfig {
    /// Opponents (magenta) at seeded places.
    pub opponents: usize,
    /// Team-mates (cyan) at seeded places.
    pub mates: usize,
    /// Robots at given places.
    pub placed: Vec<PlacedRobot>,
    /// Their top speed, m/s.
    pub speed: f32,
    /// Speed of a kicked ball, m/s.
    pub kick_speed: f32,
}

impl Default for OthersConfig {
    fn default() -> Self {
        OthersConfig {
            opponents: 0,
            mates: 0,
            placed: Vec::new(),
            speed: 2.0,
            kick_speed: 6.0,
        }
    }
}

/// A robot at a given place.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlacedRobot {
    /// Metres.
    pub x: f32,
    /// Metres.
    pub y: f32,
    /// Degrees counter-clockwise from the field's x axis.
    #[serde(default)]
    pub theta_deg: f32,
    /// Whose it is.
    pub team: TeamColour,
    /// True if it only stands there.
    #[serde(default)]
    pub stands: bool,
}

/// Where wheels and odometry differ from the robot file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WheelConfig {
    /// Friction of wheels on the carpet: what they can push at most, over the weight on them.
    pub traction: f32,
    /// Force of a wheel per slip speed, N per m/s: how much it creeps before it loses its grip.
    pub grip: f32,
    /// Each wheel's real radius over the one of the robot file; the last one repeats.
    pub radius_scale: Vec<f32>,
}

impl Default for WheelConfig {
    fn default() -> Self {
        WheelConfig {
            traction: 0.7,
            grip: 2500.0,
            radius_scale: vec![1.0],
        }
    }
}

/// Our robot is put elsewhere, at once.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Kidnap {
    /// When, seconds.
    pub time: f64,
    /// Metres.
    pub x: f32,
    /// Metres.
    pub y: f32,
    /// Degrees counter-clockwise from the field's x axis.
    #[serde(default)]
    pub theta_deg: f32,
}

/// Our robot is hit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Push {
    /// When, seconds.
    pub time: f64,
    /// Impulse on the field, N s along x and y.
    #[serde(deserialize_with = "localize::fixed_array::deserialize")]
    pub impulse: [f32; 2],
}

/// A black sector of the view.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Occlusion {
    /// From when, seconds.
    pub start: f64,
    /// Until when, seconds.
    pub stop: f64,
    /// Its middle, degrees counter-clockwise from the robot's x axis.
    pub direction_deg: f32,
    /// Its whole width, degrees.
    pub width_deg: f32,
}

/// A sensor fails for a while.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fault {
    /// What fails.
    pub kind: FaultKind,
    /// From when, seconds.
    pub start: f64,
    /// Until when, seconds.
    pub stop: f64,
    /// Which wheel, counted from 0 (wheel_stuck alone).
    #[serde(default)]
    pub wheel: usize,
}

/// How a sensor fails.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FaultKind {
    /// No images.
    FramesDropped,
    /// Every image is the last one before the fault.
    FramesFrozen,
    /// No compass samples.
    CompassSilent,
    /// The compass repeats its last heading.
    CompassFrozen,
    /// No odometry.
    OdometrySilent,
    /// One wheel's encoder does not count.
    WheelStuck,
    /// No IMU samples.
    ImuSilent,
}
