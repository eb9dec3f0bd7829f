//! What the pose filters take in over an interval, and the tilt that they share with the matcher.

use nalgebra::Matrix3;

use crate::frames::{RobotFrame, Tf};
use crate::omni::Twist;

/// Input of a prediction: an interval between two samples.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PredictionInput {
    /// Length, seconds.
    pub dt: f32,
    /// Measurement of the inertial unit. None without a unit.
    pub imu: Option<ImuInterval>,
    /// Commanded twist.
    pub command: Option<Twist>,
    /// Does the acceleration exceed what the motors can do?
    pub shock: bool,
}

/// Measurement of the inertial unit over an interval, robot frame.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ImuInterval {
    /// Mean specific force along x and y, with gravity's share, m/s².
    pub specific_force: [f32; 2],
    /// Mean angular velocity, rad/s.
    pub mean_angular_velocity: [f32; 3],
    /// Rate about z at the end, rad/s.
    pub final_yaw_rate: f32,
    /// Standard deviation of the specific force from reading to reading, m/s².
    pub vibration_std: f32,
    /// Time between readings, seconds.
    pub sample_period: f32,
}

/// Motion measured by the wheels over one of their intervals.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct WheelIncrement {
    /// Forward and left (metres), rotation (radians), robot frame at the start.
    pub motion: [f32; 3],
    /// Length of the interval, seconds. 0 stands for the time since the filter's start.
    pub dt: f32,
    /// Residual of the wheels' least squares, metres.
    pub slip: f32,
    /// Is an inertial unit active, so that collisions can be detected?
    pub imu_active: bool,
}

/// Prior of an image's tilt beyond the one by which its points were compensated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TiltPrior {
    /// From the filter's state, correlated with the pose, and a part that the inertial unit does not measure: independent in
    /// each image, zero with this standard deviation, radians.
    FromState {
        /// Standard deviation of that part.
        unmeasured_std: f32,
    },
    /// Independent in each image: zero with this standard deviation, radians.
    Independent(f32),
}

impl TiltPrior {
    /// All of the tilt is the filter's state.
    pub const STATE: TiltPrior = TiltPrior::FromState {
        unmeasured_std: 0.0,
    };
}

/// An estimated motion of the robot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotionEstimate {
    /// The robot at the end, in its frame at the start.
    pub motion: Tf<RobotFrame, RobotFrame>,
    /// Of (x, y, θ), in the robot frame at the start: metres and radians.
    pub covariance: Matrix3<f32>,
}

/// Tilt of the robot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TiltEstimate {
    /// (a, b), radians (docs/methods.md 3.1).
    pub mean: [f32; 2],
    /// Standard deviation of each component, radians.
    pub std: f32,
}
