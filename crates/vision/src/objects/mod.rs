//! Object detection: radial scan of the carpet's boundary, robots, ball, goals, virtual sensors.

pub mod ball;
pub(crate) mod ball_candidates;
mod ball_fit;
mod bright_foot;
pub(crate) mod carpet_end;
mod carpet_hull;
mod coarse_batch;
mod coarse_network;
mod covariance;
mod foot_edges;
pub mod goals;
pub(crate) mod ground_contact;
mod network;
mod network_layers;
pub(crate) mod obstacle_candidates;
mod obstacle_edges;
pub(crate) mod own_body;
mod own_parts;
mod patch;
mod patch_network;
pub(crate) mod pixel_stage;
pub(crate) mod radial_scan;
pub(crate) mod ray_obstacles;
pub mod rejection;
pub mod robots;
pub(crate) mod view_angles;
pub mod virtual_sensors;
