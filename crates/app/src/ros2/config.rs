//! `[ros2]` of network.toml: where the node is, and which topics it has.

use std::net::Ipv4Addr;

use anyhow::{Result, ensure};
use serde::{Deserialize, Serialize};

use super::frames::Frames;

/// Largest domain of DDS whose ports are below those of clients.
const DOMAIN_MAX: u16 = 232;

/// A node of ROS 2 (docs/ros.md). Needs a build with the feature `ros2`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct Ros2Config {
    /// DDS domain, 0 to 232: ROS_DOMAIN_ID of the other programs.
    pub domain: u16,
    /// Namespace of the node, its services, and topics whose names have no slash in front.
    pub namespace: String,
    /// Name of the node.
    pub node: String,
    /// Address of the network interface that is announced and multicast on; the default is the loopback.
    pub interface: Ipv4Addr,
    /// Other programs may drive. DDS authenticates nobody: everyone in the domain may.
    pub accept_commands: bool,
    /// Other programs may set the pose.
    pub accept_pose: bool,
    /// Other programs may change settings while the robot plays.
    pub accept_parameters: bool,
    /// Validity of a velocity command, milliseconds, 1 to 100; then the wheels stop.
    pub valid_max_ms: f32,
    /// Maximum speed, over the ground in m/s and about the vertical in rad/s, 0 to 1e6; faster commands are rejected.
    pub speed_max: f32,
    /// Quality of compressed images, 1 to 100.
    pub jpeg_quality: u8,
    /// Names of the frames.
    pub frames: Frames,
    /// Topics that are published.
    pub outputs: OutputTopics,
    /// Topics that are read.
    pub inputs: InputTopics,
}

/// Topics that are published. Empty: not published.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct OutputTopics {
    /// nav_msgs/Odometry of the wheels. Not published if odometry is an input.
    pub odometry: String,
    /// geometry_msgs/PoseWithCovarianceStamped: the estimate. Nothing while lost.
    pub pose: String,
    /// tf2_msgs/TFMessage.
    pub tf: String,
    /// tf2_msgs/TFMessage, for late subscribers.
    pub tf_static: String,
    /// sensor_msgs/Imu, as received.
    pub imu: String,
    /// sensor_msgs/Image, RGB.
    pub image: String,
    /// sensor_msgs/CompressedImage, JPEG.
    pub compressed_image: String,
    /// sensor_msgs/PointCloud2, robot frame.
    pub line_points: String,
    /// visualization_msgs/MarkerArray: robot, ball, robots.
    pub markers: String,
    /// visualization_msgs/MarkerArray: the markings, for late subscribers.
    pub field: String,
    /// vision_msgs/Detection3DArray: ball and robots, robot frame.
    pub detections: String,
    /// diagnostic_msgs/DiagnosticArray: localization and devices.
    pub diagnostics: String,
    /// rosgraph_msgs/Clock with the time of each image, for programs with use_sim_time.
    pub clock: String,
}

/// Topics that are read. Empty: not read.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct InputTopics {
    /// geometry_msgs/Twist: velocity commands, with `accept_commands`.
    pub cmd_vel: String,
    /// geometry_msgs/TwistStamped: the same, with a time.
    pub cmd_vel_stamped: String,
    /// geometry_msgs/PoseWithCovarianceStamped: a given pose, with `accept_pose`. The service `set_pose` does the same.
    pub initial_pose: String,
    /// nav_msgs/Odometry of another program's base, in place of a base of hardware.toml.
    pub odometry: String,
    /// sensor_msgs/Imu of another program, robot axes.
    pub imu: String,
    /// sensor_msgs/Image of another program's camera, in place of a camera of hardware.toml.
    pub image: String,
}

impl Default for Ros2Config {
    fn default() -> Self {
        Ros2Config {
            domain: 0,
            namespace: "/".to_owned(),
            node: "mirrorball".to_owned(),
            interface: Ipv4Addr::LOCALHOST,
            accept_commands: false,
            accept_pose: false,
            accept_parameters: false,
            valid_max_ms: 100.0,
            speed_max: 15.0,
            jpeg_quality: 80,
            frames: Frames::default(),
            outputs: OutputTopics::default(),
            inputs: InputTopics::default(),
        }
    }
}

impl Default for OutputTopics {
    fn default() -> Self {
        OutputTopics {
            odometry: "odom".to_owned(),
            pose: "pose".to_owned(),
            tf: "/tf".to_owned(),
            tf_static: "/tf_static".to_owned(),
            imu: "imu".to_owned(),
            image: "".to_owned(),
            compressed_image: "".to_owned(),
            line_points: "line_points".to_owned(),
            markers: "markers".to_owned(),
            field: "field".to_owned(),
            detections: "detections".to_owned(),
            diagnostics: "/diagnostics".to_owned(),
            clock: "".to_owned(),
        }
    }
}

impl Default for InputTopics {
    fn default() -> Self {
        InputTopics {
            cmd_vel: "cmd_vel".to_owned(),
            cmd_vel_stamped: "".to_owned(),
            initial_pose: "/initialpose".to_owned(),
            odometry: "".to_owned(),
            imu: "".to_owned(),
            image: "".to_owned(),
        }
    }
}

impl Ros2Config {
    /// Checks the values. An error names the key.
    pub(crate) fn check(&self) -> Result<()> {
        ensure!(
            self.domain <= DOMAIN_MAX,
            "[ros2] invalid domain: {} (expected 0 to {DOMAIN_MAX})",
            self.domain
        );
        ensure!(
            (1.0..=100.0).contains(&self.valid_max_ms),
            "[ros2] invalid valid_max_ms: {} (expected 1 to 100)",
            self.valid_max_ms
        );
        ensure!(
            (0.0..=1e6).contains(&self.speed_max),
            "[ros2] invalid speed_max: {} (expected 0 to 1e6)",
            self.speed_max
        );
        ensure!(
            (1..=100).contains(&self.jpeg_quality),
            "[ros2] invalid jpeg_quality: {} (expected 1 to 100)",
            self.jpeg_quality
        );
        ensure!(
            is_token(&self.node),
            "[ros2] invalid node: {:?} (expected letters, digits and underscores, no digit in front)",
            self.node
        );
        ensure!(
            self.namespace == "/" || is_absolute(&self.namespace),
            "[ros2] invalid namespace: {:?} (expected \"/\" or \"/name\")",
            self.namespace
        );
        let (outputs, inputs) = (&self.outputs, &self.inputs);
        for (key, topic) in [
            ("outputs.odometry", &outputs.odometry),
            ("outputs.pose", &outputs.pose),
            ("outputs.tf", &outputs.tf),
            ("outputs.tf_static", &outputs.tf_static),
            ("outputs.imu", &outputs.imu),
            ("outputs.image", &outputs.image),
            ("outputs.compressed_image", &outputs.compressed_image),
            ("outputs.line_points", &outputs.line_points),
            ("outputs.markers", &outputs.markers),
            ("outputs.field", &outputs.field),
            ("outputs.detections", &outputs.detections),
            ("outputs.diagnostics", &outputs.diagnostics),
            ("outputs.clock", &outputs.clock),
            ("inputs.cmd_vel", &inputs.cmd_vel),
            ("inputs.cmd_vel_stamped", &inputs.cmd_vel_stamped),
            ("inputs.initial_pose", &inputs.initial_pose),
            ("inputs.odometry", &inputs.odometry),
            ("inputs.imu", &inputs.imu),
            ("inputs.image", &inputs.image),
        ] {
            ensure!(
                topic.is_empty() || is_absolute(&self.absolute(topic)),
                "[ros2] invalid {key}: {topic:?} (expected names of letters, digits and underscores with slashes between them)"
            );
        }
        for (key, frame) in [
            ("map", &self.frames.map),
            ("odom", &self.frames.odom),
            ("base", &self.frames.base),
            ("camera", &self.frames.camera),
        ] {
            ensure!(
                !frame.is_empty() && !frame.starts_with('/'),
                "[ros2] invalid frames.{key}: {frame:?} (expected a name without a slash in front)"
            );
        }
        Ok(())
    }

    /// The full name of a topic.
    pub(crate) fn absolute(&self, topic: &str) -> String {
        if topic.starts_with('/') {
            topic.to_owned()
        } else {
            format!("{}/{topic}", self.namespace.trim_end_matches('/'))
        }
    }
}

/// Names between slashes, with a slash in front.
fn is_absolute(name: &str) -> bool {
    name.strip_prefix('/')
        .is_some_and(|rest| rest.split('/').all(is_token))
}

fn is_token(name: &str) -> bool {
    let mut letters = name.chars();
    letters
        .next()
        .is_some_and(|first| first.is_ascii_alphabetic() || first == '_')
        && letters.all(|letter| letter.is_ascii_alphanumeric() || letter == '_')
        && !name.contains("__")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn invalid_names_and_numbers_are_refused_with_their_key() {
        let check = |text: &str| {
            toml::from_str::<Ros2Config>(text)
                .map_err(|error| error.to_string())
                .and_then(|config| config.check().map_err(|error| error.to_string()))
        };
        assert_eq!(check(""), Ok(()));
        assert_eq!(
            check("namespace = \"/robot_1\"\n[inputs]\ncmd_vel = \"\""),
            Ok(())
        );
        for (text, key) in [
            ("domain = 233", "domain"),
            ("valid_max_ms = 101.0", "valid_max_ms"),
            ("valid_max_ms = nan", "valid_max_ms"),
            ("speed_max = -1.0", "speed_max"),
            ("node = \"a b\"", "node"),
            ("namespace = \"robot\"", "namespace"),
            ("outputs.pose = \"a//b\"", "outputs.pose"),
            ("inputs.imu = \"1imu\"", "inputs.imu"),
            ("frames.map = \"/map\"", "frames.map"),
            ("topic = 1", "topic"),
        ] {
            let error = check(text).expect_err(text);
            assert!(error.contains(key), "{text}: {error}");
        }
    }
}
