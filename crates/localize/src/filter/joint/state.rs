//! State layout of the joint filter (docs/methods.md 8.1).
//!
//! | index | constant | state | unit |
//! | --- | --- | --- | --- |
//! | 0 to 2 | [`POSE`] | pose on the field: x, y, θ | m, rad |
//! | 3 to 5 | [`WHEEL_INCREMENT`] | motion since the last wheel sample, robot frame at that sample | m, rad |
//! | 6, 7 | [`TWIST`] | velocity, robot frame | m/s |
//! | 8 | [`YAW_RATE`] | yaw rate, third component of the twist | rad/s |
//! | 9, 10 | [`TILT`] | up direction in the inertial unit's frame: x, y | 1 |
//! | 11 to 13 | [`GYRO_BIAS`] | gyro bias about x, y, z | rad/s |
//! | 14 to 22 | [`ODOMETRY_CORRECTION`] | matrix from measured to true motion of the wheels, row by row | 1, m/rad, rad/m |
//! | 23, 24 | [`ACCELEROMETER_BIAS`] | accelerometer bias along x, y | m/s² |
//! | 25, 26 | [`IMU_MOUNT`] | tilt of the unit against the camera | rad |
//! | 27 to 29 | [`SLIP`] | velocity of the wheel rims over the ground | m/s, rad/s |
//! | 30 | [`GYRO_SCALE`] | true over measured rate about z | 1 |
//! | 31 | [`LATENCY`] | time from an image's exposure to its stamp | s |
//!
//! The states from [`GYRO_BIAS`] on describe the sensors. They survive a new pose.

/// Index of x, y, θ.
pub(super) const POSE: usize = 0;
/// Index of the increment's x, y, θ.
pub(super) const WHEEL_INCREMENT: usize = 3;
/// Index of the velocity's x and y, followed by the yaw rate.
pub(super) const TWIST: usize = 6;
/// Index of the yaw rate.
pub(super) const YAW_RATE: usize = 8;
/// Index of the up direction's x and y.
pub(super) const TILT: usize = 9;
/// Index of the gyro bias about x, y and z.
pub(super) const GYRO_BIAS: usize = 11;
/// Index of the matrix that takes the measured motion (x, y, θ) to the true one, row by row.
pub(super) const ODOMETRY_CORRECTION: usize = 14;
/// Index of the accelerometer bias along x and y.
pub(super) const ACCELEROMETER_BIAS: usize = 23;
/// Index of the mount's tilt.
pub(super) const IMU_MOUNT: usize = 25;
/// Index of the slip velocity's x, y, θ.
pub(super) const SLIP: usize = 27;
/// Index of the gyro scale.
pub(super) const GYRO_SCALE: usize = 30;
/// Index of the camera latency.
pub(super) const LATENCY: usize = 31;
/// Number of states.
pub(super) const STATES: usize = 32;
/// Row length of the covariance, padded to whole vector registers.
pub(super) const ROW_STRIDE: usize = 32;

/// Mean.
pub(super) type State = [f32; STATES];
/// Covariance. Entries beyond `STATES` in a row are zero.
pub(super) type Covariance = [[f32; ROW_STRIDE]; STATES];
/// Nonzero entries of a matrix row: column and value.
pub(super) type SparseRow<'a> = &'a [(usize, f32)];
