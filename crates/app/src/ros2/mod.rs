//! How do ROS 2 programs see Mirrorball? Cycles as messages of ROS 2, in bags and from a node.

pub(crate) mod bag;
mod cdr;
pub(crate) mod config;
mod convert;
mod frames;
mod markers;
mod messages;
#[cfg(feature = "ros2")]
mod node;
mod odometry_frame;
mod primitives;

#[cfg(feature = "ros2")]
pub(crate) use node::{GivenPose, NodeContext, Ros2Counts, RosNode};
