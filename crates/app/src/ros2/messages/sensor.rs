//! Images, point clouds, inertial and magnetic readings, detections, and the state of devices.

use super::bytes::{Byte, Bytes};
use super::definition::messages;
use super::geometry::{Header, Pose, PoseWithCovariance, Quaternion, Vector3};

messages! {
    /// A JPEG or PNG file.
    sensor_msgs/CompressedImage { header: Header, format: String, data: Bytes }
    /// Specific force and rate.
    sensor_msgs/Imu {
        header: Header,
        orientation: Quaternion,
        orientation_covariance: [f64; 9],
        angular_velocity: Vector3,
        angular_velocity_covariance: [f64; 9],
        linear_acceleration: Vector3,
        linear_acceleration_covariance: [f64; 9],
    }
    /// Magnetic field.
    sensor_msgs/MagneticField {
        header: Header,
        magnetic_field: Vector3,
        magnetic_field_covariance: [f64; 9],
    }
    /// A channel of a point cloud.
    sensor_msgs/PointField { name: String, offset: u32, datatype: u8, count: u32 }
    /// Points as bytes.
    sensor_msgs/PointCloud2 {
        header: Header,
        height: u32,
        width: u32,
        fields: Vec<PointField>,
        is_bigendian: bool,
        point_step: u32,
        row_step: u32,
        data: Bytes,
        is_dense: bool,
    }
    /// What an object may be.
    vision_msgs/ObjectHypothesis { class_id: String, score: f64 }
    /// What an object may be, and where.
    vision_msgs/ObjectHypothesisWithPose { hypothesis: ObjectHypothesis, pose: PoseWithCovariance }
    /// A box around an object.
    vision_msgs/BoundingBox3D { center: Pose, size: Vector3 }
    /// A detected object.
    vision_msgs/Detection3D {
        header: Header,
        results: Vec<ObjectHypothesisWithPose>,
        bbox: BoundingBox3D,
        id: String,
    }
    /// Detected objects.
    vision_msgs/Detection3DArray { header: Header, detections: Vec<Detection3D> }
    /// A value of a device.
    diagnostic_msgs/KeyValue { key: String, value: String }
    /// State of a device: 0 good, 1 warning, 2 error, 3 stale.
    diagnostic_msgs/DiagnosticStatus {
        level: Byte,
        name: String,
        message: String,
        hardware_id: String,
        values: Vec<KeyValue>,
    }
    /// States of devices.
    diagnostic_msgs/DiagnosticArray { header: Header, status: Vec<DiagnosticStatus> }
}
