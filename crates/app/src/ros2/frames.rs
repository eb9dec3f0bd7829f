//! Names of coordinate frames in ROS 2.

use serde::{Deserialize, Serialize};

/// Names of the frames of REP 105.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct Frames {
    /// The field: origin at its centre, x along its length.
    pub map: String,
    /// Where the odometry began.
    pub odom: String,
    /// The robot: on the ground below the mirror's axis, x forward.
    pub base: String,
    /// The camera.
    pub camera: String,
}

impl Default for Frames {
    fn default() -> Self {
        Frames {
            map: "map".to_owned(),
            odom: "odom".to_owned(),
            base: "base_link".to_owned(),
            camera: "camera".to_owned(),
        }
    }
}
