//! What do the IMU, the compass and the wheels measure? Attitude, magnetic calibration, collision detection.

pub mod attitude;
pub mod collision;
pub mod compass_calibration;
