//! Sensor processing: attitude from the IMU, collision detection, calibration of compass, wheels and inertial unit.

pub mod attitude;
pub mod collision;
pub mod compass_calibration;
pub mod imu_calibration;
pub mod latency_calibration;
pub mod pose_pairs;
pub mod wheel_calibration;
pub mod wheel_geometry;
