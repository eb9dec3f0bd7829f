//! What happens in a simulation? A scenario read from TOML; its paths are relative to the file.

mod bounds;
mod load;
mod places;

use std::path::PathBuf;

use localize::frames::{At, Pose};
use localize::world::TeamColour;
use serde::{Deserialize, Serialize};
use vision::Mount;

pub use load::ScenarioError;

use crate::environment::EnvironmentConfig;
use crate::image_sensor::ImageSensorConfig;
use crate::light::LightConfig;
use crate::people::PeopleConfig;
use crate::rocking::RockingConfig;
use crate::sector::Sector;
use crate::world::BallState;

/// A scenario file. Lengths in metres, times in seconds from the start, angles in the unit of their names.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scenario {
    /// Path of the robot file.
    pub robot: PathBuf,
    /// Path of the field file. If absent: that of the robot file.
    pub field: Option<PathBuf>,
    /// Seed of all random numbers. Equal seeds give equal simulations.
    #[serde(default)]
    pub seed: u64,
    /// Duration, seconds.
    pub duration: f64,
    /// Images per second.
    #[serde(default = "default_frame_rate_hz")]
    pub frame_rate_hz: f64,
    /// Initial pose of our robot. No robot starts inside another one, or outside the barrier around the carpet.
    pub start: Placement,
    /// Path of our robot.
    #[serde(default)]
    pub path: PathConfig,
    /// The ball.
    #[serde(default)]
    pub ball: BallConfig,
    /// The other robots.
    #[serde(default)]
    pub others: OthersConfig,
    /// Our other robots, each with its own vision and localization. They use the same robot file. Only `sim`, Python's
    /// `simulate` and experiments run several robots; all else refuses a scenario with them.
    #[serde(default)]
    pub squad: Vec<TeammateConfig>,
    /// Radio link between our robots.
    #[serde(default)]
    pub radio: RadioConfig,
    /// Deviations of the wheels from the robot file.
    #[serde(default)]
    pub wheels: WheelConfig,
    /// True mounting of camera and mirror, unknown to vision.
    #[serde(default)]
    pub mount: Mount,
    /// True focal length divided by that of the robot file.
    #[serde(default = "default_focal_scale")]
    pub focal_scale: f64,
    /// Settings, optics and sensor of the camera.
    #[serde(default, rename = "film")]
    pub image_sensor: ImageSensorConfig,
    /// Light on the field.
    #[serde(default)]
    pub light: LightConfig,
    /// The floor, windows and cables of the hall.
    #[serde(default, rename = "hall")]
    pub environment: EnvironmentConfig,
    /// People on and beside the field.
    #[serde(default)]
    pub people: PeopleConfig,
    /// Tilt of our robot's body.
    #[serde(default)]
    pub rocking: RockingConfig,
    /// Instant displacements of our robot.
    #[serde(default)]
    pub kidnaps: Vec<Kidnap>,
    /// Changes of the camera's and mirror's mounting during play.
    #[serde(default)]
    pub knocks: Vec<Knock>,
    /// Impulses on our robot.
    #[serde(default)]
    pub pushes: Vec<Push>,
    /// Kicks of the ball from outside the game.
    #[serde(default)]
    pub kicks: Vec<BallKick>,
    /// Black sectors of the image.
    #[serde(default)]
    pub occlusions: Vec<Occlusion>,
    /// Sensor faults.
    #[serde(default)]
    pub faults: Vec<Fault>,
}

fn default_frame_rate_hz() -> f64 {
    30.0
}

fn default_focal_scale() -> f64 {
    1.0
}

/// Position and heading on the field.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Placement {
    /// Position along the field's x axis, metres.
    pub x: f32,
    /// Position along the field's y axis, metres.
    pub y: f32,
    /// Heading, degrees counter-clockwise from the field's x axis.
    #[serde(default)]
    pub theta_deg: f32,
}

impl Placement {
    /// The pose on the field.
    pub fn pose(self) -> Pose {
        Pose::new(self.x, self.y, self.theta_deg.to_radians())
    }
}

/// Path of our robot: waypoints, or a list of velocities, or none.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PathConfig {
    /// Poses to pass in this order; the robot rotates to the heading while it drives.
    pub waypoints: Vec<Placement>,
    /// True restarts after the last waypoint.
    pub repeat: bool,
    /// Top speed on the path, m/s.
    pub speed: f32,
    /// Largest yaw rate on the path, degrees/s.
    pub turn_rate_deg: f32,
    /// Velocities in the robot frame, each valid until the next; used without waypoints.
    pub commands: Vec<TimedTwist>,
    /// True leaves the path while the estimate is ambiguous and follows the motion that would tell its hypotheses apart.
    pub follow_advice: bool,
}

impl Default for PathConfig {
    fn default() -> Self {
        PathConfig {
            waypoints: Vec::new(),
            repeat: true,
            speed: 1.5,
            turn_rate_deg: 60.0,
            commands: Vec::new(),
            follow_advice: false,
        }
    }
}

/// A velocity in the robot frame with its start time.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TimedTwist {
    /// Start time, seconds.
    pub time: f64,
    /// Forward velocity, m/s.
    #[serde(default)]
    pub vx: f32,
    /// Velocity to the left, m/s.
    #[serde(default)]
    pub vy: f32,
    /// Yaw rate, degrees/s counter-clockwise.
    #[serde(default)]
    pub turn_deg: f32,
}

/// One of our robots in addition to the first.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TeammateConfig {
    /// Initial pose.
    pub start: Placement,
    /// Its path.
    #[serde(default)]
    pub path: PathConfig,
    /// True mounting of its camera and mirror.
    #[serde(default)]
    pub mount: Mount,
}

/// Radio link between robots, with loss and delay.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RadioConfig {
    /// Messages per second of each robot.
    pub rate_hz: f64,
    /// Share of messages that are lost, for each receiver.
    pub loss: f32,
    /// Shortest and longest delay, seconds. Messages may arrive out of order.
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

/// The ball: slides, then rolls (a hollow shell), flies and bounces.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BallConfig {
    /// False removes the ball.
    pub present: bool,
    /// Initial position, metres. A ball at rest starts on the field or close to its lines, another one inside the barrier.
    #[serde(deserialize_with = "localize::fixed_array::deserialize")]
    pub position: [f32; 2],
    /// Initial velocity (sliding), m/s.
    #[serde(deserialize_with = "localize::fixed_array::deserialize")]
    pub velocity: [f32; 2],
    /// Diameter, metres.
    pub diameter: f32,
    /// Mass, kilograms.
    pub mass: f32,
    /// Colour, sRGB 0 to 255.
    #[serde(deserialize_with = "localize::fixed_array::deserialize")]
    pub colour: [u8; 3],
    /// Coefficient of restitution at walls and posts.
    pub restitution: f32,
    /// Friction coefficient on the carpet while it slides.
    pub sliding_friction: f32,
    /// Deceleration while it rolls, m/s².
    pub rolling_deceleration: f32,
    /// Initial height of its lowest point above the carpet, metres.
    pub height: f32,
    /// Initial upward velocity, m/s.
    pub vertical_velocity: f32,
    /// Coefficient of restitution on the carpet.
    pub floor_restitution: f32,
    /// Drag coefficient in the air, of its cross-section. 0 gives parabolas.
    pub drag_coefficient: f32,
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
            height: 0.0,
            vertical_velocity: 0.0,
            floor_restitution: 0.65,
            // A smooth ball between the laminar 0.5 and the turbulent 0.2.
            drag_coefficient: 0.3,
        }
    }
}

impl BallConfig {
    /// The ball at the start.
    pub(crate) fn state(&self) -> BallState {
        let [x, y] = self.position;
        BallState {
            at: At::new(x, y),
            velocity: self.velocity,
            height: self.height,
            vertical_velocity: self.vertical_velocity,
        }
    }
}

/// The other robots: some at random poses, some at given ones.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OthersConfig {
    /// Number of opponents (magenta) at random poses.
    pub opponents: usize,
    /// Number of teammates (cyan) at random poses.
    pub mates: usize,
    /// Robots at given poses.
    pub placed: Vec<PlacedRobot>,
    /// Top speed of the other robots, m/s.
    pub speed: f32,
    /// Speed of a kicked ball, m/s.
    pub kick_speed: f32,
    /// Share of the kicks that lift the ball, 0 to 1.
    pub lofted_share: f32,
    /// Angle of lofted kicks above the carpet, degrees.
    pub loft_deg: f32,
}

impl Default for OthersConfig {
    fn default() -> Self {
        OthersConfig {
            opponents: 0,
            mates: 0,
            placed: Vec::new(),
            speed: 2.0,
            kick_speed: 6.0,
            lofted_share: 0.0,
            loft_deg: 40.0,
        }
    }
}

/// A robot at a given pose.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlacedRobot {
    /// Position along the field's x axis, metres.
    pub x: f32,
    /// Position along the field's y axis, metres.
    pub y: f32,
    /// Heading, degrees counter-clockwise from the field's x axis.
    #[serde(default)]
    pub theta_deg: f32,
    /// Team colour.
    pub team: TeamColour,
    /// True keeps the robot stationary.
    #[serde(default)]
    pub stands: bool,
}

impl PlacedRobot {
    /// The pose on the field.
    pub fn pose(&self) -> Pose {
        Pose::new(self.x, self.y, self.theta_deg.to_radians())
    }
}

/// Deviations of wheels and odometry from the robot file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WheelConfig {
    /// Friction coefficient of the wheels on the carpet. A smaller value causes more slip.
    pub traction: f32,
    /// Slip stiffness: force of a wheel per slip speed below the friction limit, N per m/s.
    pub grip: f32,
    /// True radius of each wheel divided by that of the robot file. The last value applies to all further wheels.
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

/// Instant displacement of our robot to another pose.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Kidnap {
    /// Time, seconds.
    pub time: f64,
    /// New position along the field's x axis, metres.
    pub x: f32,
    /// New position along the field's y axis, metres.
    pub y: f32,
    /// New heading, degrees counter-clockwise from the field's x axis.
    #[serde(default)]
    pub theta_deg: f32,
}

/// A change of the mounting: something hits camera or mirror.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Knock {
    /// Time, seconds.
    pub time: f64,
    /// True mounting from then on, in place of the scenario's.
    pub mount: Mount,
}

/// An impulse on our robot.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Push {
    /// Time, seconds.
    pub time: f64,
    /// Impulse along the field's x and y axes, N s.
    #[serde(deserialize_with = "localize::fixed_array::deserialize")]
    pub impulse: [f32; 2],
}

/// A new velocity of the ball, and a new position if given.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BallKick {
    /// Time, seconds.
    pub time: f64,
    /// New position along the field's x and y axes, metres. If absent, the ball is kicked where it is.
    #[serde(default)]
    #[serde(deserialize_with = "localize::fixed_array::deserialize_optional")]
    pub position: Option<[f32; 2]>,
    /// New height of its lowest point, metres; used with a position.
    #[serde(default)]
    pub height: f32,
    /// Velocity along the field's x and y axes, m/s.
    #[serde(deserialize_with = "localize::fixed_array::deserialize")]
    pub velocity: [f32; 2],
    /// Upward velocity, m/s.
    #[serde(default)]
    pub vertical_velocity: f32,
}

impl BallKick {
    /// The ball after the kick.
    pub(crate) fn apply(&self, ball: BallState) -> BallState {
        let (at, height) = match self.position {
            Some([x, y]) => (At::new(x, y), self.height),
            None => (ball.at, ball.height),
        };
        BallState {
            at,
            height,
            velocity: self.velocity,
            vertical_velocity: self.vertical_velocity,
        }
    }
}

/// A black sector of the image.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Occlusion {
    /// Start time, seconds.
    pub start: f64,
    /// End time, seconds.
    pub stop: f64,
    /// Direction of the centre, degrees counter-clockwise from the robot's x axis.
    pub direction_deg: f32,
    /// Full width, degrees.
    pub width_deg: f32,
}

impl Occlusion {
    /// The sector that is black.
    pub fn sector(&self) -> Sector {
        Sector::from_degrees(self.direction_deg, self.width_deg)
    }
}

/// A temporary sensor fault.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fault {
    /// Kind of fault.
    pub kind: FaultKind,
    /// Start time, seconds.
    pub start: f64,
    /// End time, seconds.
    pub stop: f64,
    /// Index of the wheel, from 0 (only for wheel_stuck).
    #[serde(default)]
    pub wheel: usize,
}

/// Kind of sensor fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FaultKind {
    /// No images.
    FramesDropped,
    /// The camera repeats the last image before the fault.
    FramesFrozen,
    /// No compass samples.
    CompassSilent,
    /// The compass repeats the last heading before the fault.
    CompassFrozen,
    /// No odometry.
    OdometrySilent,
    /// One wheel's encoder does not count.
    WheelStuck,
    /// No IMU samples.
    ImuSilent,
}
