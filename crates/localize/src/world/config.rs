//! Settings of the world model: motion and detection of objects, and the life of their tracks.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::config::{SettingError, WORLD_BOUNDS, check_bounds};
use crate::flight::FlightConfig;

/// The world model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct WorldConfig {
    /// The ball.
    pub ball: ObjectTrackConfig,
    /// Robots of both teams and legs of people. Defaults differ: acceleration_noise 1.5, deceleration 0, kick_rate 0,
    /// initial_speed_std 1.5 and separation_min 0.35.
    pub robots: ObjectTrackConfig,
    /// Gap between images after which all tracks are deleted, seconds.
    pub gap_max: f32,
    /// Largest speed of the robot itself, m/s. It bounds the motion without odometry and pose.
    pub own_speed_max: f32,
    /// Standard deviation of the wheel odometry, as a share of the motion.
    pub odometry_std: f32,
    /// Standard deviation of the remaining tilt after the image's tilt estimate, degrees.
    pub tilt_std_deg: f32,
    /// Standard deviation added to that of each detection, metres (calibration, shading of the ball).
    pub position_std: f32,
    /// The ball in the air.
    pub flight: FlightConfig,
    /// Range uncertainty of an airborne object, as a share of its ground point's distance. The object is nearer than
    /// its ground point.
    pub airborne_range_share: f32,
    /// Radius of a robot, metres: it occludes objects behind it.
    pub robot_radius: f32,
}

/// Motion and detection of a kind of object.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ObjectTrackConfig {
    /// Process noise of the velocity, m/s per square root of a second. A larger value follows changes of direction
    /// faster and smooths less.
    pub acceleration_noise: f32,
    /// Deceleration, m/s²: of a rolling ball; 0 for robots.
    pub deceleration: f32,
    /// Mean number of sudden changes of the velocity (kicks, catches, collisions) a second.
    pub kick_rate: f32,
    /// Standard deviation of such a change, each axis, m/s.
    pub kick_speed_std: f32,
    /// Standard deviation of a new track's velocity, m/s.
    pub initial_speed_std: f32,
    /// Largest squared Mahalanobis distance of a detection from its track. The default is 99.9 % of 2 degrees of
    /// freedom.
    pub gate: f32,
    /// Share of the images that detect a visible object close to the robot.
    pub detection_probability: f32,
    /// Distance at which that share is half as large, metres. Farther away, a missing detection says less.
    pub half_detection_range: f32,
    /// Time for which one image's detection or miss of an object predicts the next image's, seconds.
    pub detection_correlation_time: f32,
    /// Share of the images that detect something at the position of a track where nothing is. A larger value confirms
    /// tracks later.
    pub false_alarm_probability: f32,
    /// Time for which one image's false detection predicts the next image's, seconds.
    pub false_alarm_correlation_time: f32,
    /// Probability of existence of a new track whose score is 1.
    pub birth_probability: f32,
    /// Probability of existence from which a track is output.
    pub confirm_probability: f32,
    /// Probability of existence below which a track is deleted.
    pub delete_probability: f32,
    /// Longest time without a detection before a track is deleted, seconds.
    pub unseen_max: f32,
    /// Largest standard deviation of a track's position before it is deleted, metres.
    pub position_std_max: f32,
    /// Distance below which two tracks are one object, metres.
    pub separation_min: f32,
}

impl Default for WorldConfig {
    fn default() -> Self {
        WorldConfig {
            ball: ObjectTrackConfig::default(),
            robots: ObjectTrackConfig::robots(),
            gap_max: 1.0,
            own_speed_max: 4.0,
            // Measured scale errors of wheels lie below 3 % (nubot2013 4).
            odometry_std: 0.03,
            // A third of the measured tilt: the estimate from lines on all sides leaves about this.
            tilt_std_deg: 0.15,
            position_std: 0.02,
            // A ball at a height of 0.4 m, seen from a mirror at 0.8 m, appears twice as far away.
            flight: FlightConfig::default(),
            airborne_range_share: 0.5,
            robot_radius: 0.25,
        }
    }
}

impl ObjectTrackConfig {
    fn robots() -> Self {
        ObjectTrackConfig {
            // Robots brake and turn within a second.
            acceleration_noise: 1.5,
            deceleration: 0.0,
            kick_rate: 0.0,
            initial_speed_std: 1.5,
            separation_min: 0.35,
            ..ObjectTrackConfig::default()
        }
    }
}

impl Default for ObjectTrackConfig {
    fn default() -> Self {
        ObjectTrackConfig {
            acceleration_noise: 1.0,
            // A ball that rolls on carpet.
            deceleration: 0.35,
            kick_rate: 0.3,
            // Shots of the league reach 10 m/s, passes and catches change less.
            kick_speed_std: 3.0,
            // Shots of the league reach 10 m/s; the ball is slow most of the time.
            initial_speed_std: 3.0,
            gate: 13.8,
            // Between the counts in seven simulated scenarios and independent images, see docs/methods.md 11.3.
            detection_probability: 0.8,
            half_detection_range: 10.0,
            detection_correlation_time: 0.05,
            false_alarm_probability: 0.2,
            false_alarm_correlation_time: 0.035,
            birth_probability: 0.4,
            confirm_probability: 0.6,
            delete_probability: 0.05,
            unseen_max: 2.0,
            position_std_max: 1.0,
            // A false track next to the true one must not survive it.
            separation_min: 0.2,
        }
    }
}

impl WorldConfig {
    /// Returns an error for the first invalid value.
    pub fn check(&self) -> Result<(), SettingError> {
        check_bounds("world", self, WORLD_BOUNDS)
    }
}
