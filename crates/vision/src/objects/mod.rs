//! Which object is it? Radial scans from the robot outwards, robots, ball, goals, virtual sensors.

pub mod ball;
mod covariance;
pub mod goals;
pub(crate) mod ground_contact;
pub(crate) mod radial_scan;
pub(crate) mod ray_obstacles;
pub mod robots;
pub mod virtual_sensors;
