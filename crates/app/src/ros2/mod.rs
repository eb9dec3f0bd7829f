//! How do ROS 2 programs see Mirrorball? Cycles as messages of ROS 2, in bags and from a node.

pub(crate) mod bag;
mod cdr;
mod convert;
mod markers;
mod messages;
mod odometry_frame;
mod primitives;
