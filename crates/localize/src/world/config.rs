//! What may be set about following objects? How they move, how reliably they are seen, when they are given up.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::config::{SettingError, WORLD_BOUNDS, check_bounds};

/// The world model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct WorldConfig {
    /// The ball.
    pub ball: ObjectConfig,
    /// Robots of both teams, and the legs of people; unless set wander is 1.5, deceleration 0, speed_std 1.5 and apart_min 0.35.
    pub robots: ObjectConfig,
    /// A gap between frames, seconds, after which everything is forgotten.
    pub gap_max: f32,
    /// Fastest own motion, m/s: how far it may have driven where neither wheels nor poses tell.
    pub own_speed_max: f32,
    /// Error of the wheels' motion, share of it: it moves what stands still by as much.
    pub odometry_std: f32,
    /// Own lean that the frame's estimate leaves, degrees.
    pub tilt_std_deg: f32,
    /// Error of any sighting beside the stated one (calibration, a ball's shading), metres.
    pub position_std: f32,
    /// How much nearer than it seems may a thing above the ground be, share of its distance?
    pub airborne_range_share: f32,
    /// Radius of a robot, metres: it hides what is behind it.
    pub robot_radius: f32,
}

/// How a kind of object moves and is seen.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ObjectConfig {
    /// How its velocity wanders when nobody is known to touch it, m/s in a second.
    pub acceleration_noise: f32,
    /// Deceleration, m/s²: a ball rolls out, a robot drives on.
    pub deceleration: f32,
    /// Standard deviation of the velocity of a new one, m/s.
    pub initial_speed_std: f32,
    /// Squared deviation in standard deviations up to which a sighting may be of a track: 99.9 % of 2 degrees of freedom.
    pub gate: f32,
    /// Probability that one within reach is seen in a frame.
    pub detection_probability: f32,
    /// Probability that something else is taken for one at a given place.
    pub false_alarm_probability: f32,
    /// Distance up to which not seeing it is a sign that it is not there, metres.
    pub range_max: f32,
    /// Probability of a new one whose score is 1.
    pub birth_probability: f32,
    /// Probability from which on it is told.
    pub confirm_probability: f32,
    /// Probability below which it is given up.
    pub delete_probability: f32,
    /// It is given up when it was not seen for so many seconds.
    pub unseen_max: f32,
    /// It is given up when its position is known no better than this, metres.
    pub position_std_max: f32,
    /// Two tracks nearer than this are one object, metres.
    pub separation_min: f32,
}

impl Default for WorldConfig {
    fn default() -> Self {
        WorldConfig {
            ball: ObjectConfig::default(),
            robots: ObjectConfig::robots(),
            gap_max: 1.0,
            own_speed_max: 4.0,
            // Measured scale errors of wheels lie below 3 % (nubot2013 4).
            odometry_std: 0.03,
            // A third of what robots were measured to lean: lines all around leave about as much.
            tilt_std_deg: 0.15,
            position_std: 0.02,
            // A ball at 0.4 m seen from a mirror at 0.8 m seems twice as far.
            airborne_range_share: 0.5,
            robot_radius: 0.25,
        }
    }
}

impl ObjectConfig {
    fn robots() -> Self {
        ObjectConfig {
            // They brake and turn within a second.
            acceleration_noise: 1.5,
            deceleration: 0.0,
            initial_speed_std: 1.5,
            separation_min: 0.35,
            ..ObjectConfig::default()
        }
    }
}

impl Default for ObjectConfig {
    fn default() -> Self {
        ObjectConfig {
            acceleration_noise: 1.0,
            // Rolling on carpet.
            deceleration: 0.35,
            // Shots of the league reach 10 m/s; most of the time it is slow.
            initial_speed_std: 3.0,
            gate: 13.8,
            detection_probability: 0.6,
            false_alarm_probability: 0.08,
            range_max: 5.0,
            birth_probability: 0.4,
            confirm_probability: 0.7,
            delete_probability: 0.05,
            unseen_max: 2.0,
            position_std_max: 1.0,
            // Two balls do not lie in one; a false one beside the true one shall not outlive it.
            separation_min: 0.2,
        }
    }
}

impl WorldConfig {
    /// Refuses values that cannot work, and names the first.
    pub fn check(&self) -> Result<(), SettingError> {
        check_bounds("world", self, WORLD_BOUNDS)
    }
}
