//! Markers for RViz and Foxglove.

use super::bytes::Bytes;
use super::definition::messages;
use super::geometry::{ColorRGBA, Duration, Header, Point, Pose, Vector3};
use super::sensor::CompressedImage;

messages! {
    /// Place in a texture.
    visualization_msgs/UVCoordinate { u: f32, v: f32 }
    /// A mesh inside the message.
    visualization_msgs/MeshFile { filename: String, data: Bytes }
    /// A drawn object.
    visualization_msgs/Marker {
        header: Header,
        ns: String,
        id: i32,
        r#type: i32,
        action: i32,
        pose: Pose,
        scale: Vector3,
        color: ColorRGBA,
        lifetime: Duration,
        frame_locked: bool,
        points: Vec<Point>,
        colors: Vec<ColorRGBA>,
        texture_resource: String,
        texture: CompressedImage,
        uv_coordinates: Vec<UVCoordinate>,
        text: String,
        mesh_resource: String,
        mesh_file: MeshFile,
        mesh_use_embedded_materials: bool,
    }
    /// Drawn objects.
    visualization_msgs/MarkerArray { markers: Vec<Marker> }
}
