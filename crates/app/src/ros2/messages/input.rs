//! Messages that only the node knows.

use super::bytes::Bytes;
use super::definition::messages;
use super::geometry::{Header, Twist};

messages! {
    /// A velocity in a frame.
    geometry_msgs/TwistStamped { header: Header, twist: Twist }
    /// Pixels, row by row.
    sensor_msgs/Image {
        header: Header,
        height: u32,
        width: u32,
        encoding: String,
        is_bigendian: u8,
        step: u32,
        data: Bytes,
    }
}
