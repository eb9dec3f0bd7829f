//! Object detection: radial scan of the carpet's boundary, robots, ball, goals, virtual sensors.

pub mod ball;
mod covariance;
pub mod goals;
pub(crate) mod ground_contact;
pub(crate) mod radial_scan;
pub(crate) mod ray_obstacles;
pub mod robots;
pub mod virtual_sensors;
