//! The message types of ROS 2 that Mirrorball writes or reads, field by field as in their .msg files.

mod bytes;
mod definition;
mod geometry;
#[cfg(feature = "ros2")]
mod input;
mod sensor;
mod visualization;

pub(crate) use bytes::{Byte, Bytes};
pub(crate) use definition::{RosType, schema_text};
pub(crate) use geometry::*;
#[cfg(feature = "ros2")]
pub(crate) use input::*;
pub(crate) use sensor::*;
pub(crate) use visualization::*;
