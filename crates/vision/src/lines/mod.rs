//! Line points in the robot frame: peaks along scan lines, validated, each rejection with its reason.

pub mod detection;
mod result;
pub(crate) mod validator;
pub(crate) mod wall_bases;
