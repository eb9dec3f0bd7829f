//! From an image to features: what a picture under the mirror tells about the ground around the robot.

pub mod camera;
pub mod ground_map;
pub mod mirror;
pub mod optics;
pub mod robot;

pub use camera::CameraConfig;
pub use ground_map::GroundMap;
pub use mirror::Profile;
pub use optics::{Mount, Ray, RayTable};
pub use robot::RobotConfig;
