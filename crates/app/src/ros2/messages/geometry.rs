//! Time, frames, poses, velocities and transforms.

use super::definition::messages;

messages! {
    /// Seconds and nanoseconds since 1970, or of simulated time.
    builtin_interfaces/Time { sec: i32, nanosec: u32 }
    /// A length of time.
    builtin_interfaces/Duration { sec: i32, nanosec: u32 }
    /// Stamp and frame of a message.
    std_msgs/Header { stamp: Time, frame_id: String }
    /// Red, green, blue, opacity: 0 to 1.
    std_msgs/ColorRGBA { r: f32, g: f32, b: f32, a: f32 }
    /// Metres.
    geometry_msgs/Point { x: f64, y: f64, z: f64 }
    /// Direction, size or velocity.
    geometry_msgs/Vector3 { x: f64, y: f64, z: f64 }
    /// Rotation.
    geometry_msgs/Quaternion { x: f64, y: f64, z: f64, w: f64 }
    /// A rotation from the header's frame.
    geometry_msgs/QuaternionStamped { header: Header, quaternion: Quaternion }
    /// Position and orientation.
    geometry_msgs/Pose { position: Point, orientation: Quaternion }
    /// Covariance of x, y, z and rotations about x, y, z.
    geometry_msgs/PoseWithCovariance { pose: Pose, covariance: [[f64; 6]; 6] }
    /// A pose in a frame.
    geometry_msgs/PoseWithCovarianceStamped { header: Header, pose: PoseWithCovariance }
    /// Velocity, m/s and rad/s.
    geometry_msgs/Twist { linear: Vector3, angular: Vector3 }
    /// Covariance as of a pose.
    geometry_msgs/TwistWithCovariance { twist: Twist, covariance: [[f64; 6]; 6] }
    /// Where a frame lies in another one.
    geometry_msgs/Transform { translation: Vector3, rotation: Quaternion }
    /// `child_frame_id` in the header's frame.
    geometry_msgs/TransformStamped { header: Header, child_frame_id: String, transform: Transform }
    /// Several transforms.
    tf2_msgs/TFMessage { transforms: Vec<TransformStamped> }
    /// Pose in the header's frame, velocity in `child_frame_id`.
    nav_msgs/Odometry {
        header: Header,
        child_frame_id: String,
        pose: PoseWithCovariance,
        twist: TwistWithCovariance,
    }
    /// Simulated time.
    rosgraph_msgs/Clock { clock: Time }
}
