//! Sensor processing: attitude from the IMU, compass calibration, collision detection.

pub mod attitude;
pub mod collision;
pub mod compass_calibration;
