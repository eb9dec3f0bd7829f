//! Which runs on scan lines are field lines? Validation with reasons, line points in the robot frame.

pub mod detection;
pub(crate) mod validator;
pub(crate) mod wall_bases;
