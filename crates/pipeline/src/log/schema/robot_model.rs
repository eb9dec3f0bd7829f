//! How does a viewer show the robot and its camera? As a model in the robot frame, a transform, and a calibration.

use foxglove::messages::{
    ArrowPrimitive, CameraCalibration, CylinderPrimitive, FrameTransform, FrameTransforms,
    Quaternion, SceneEntity, SceneUpdate,
};
use localize::frames::{At, RobotFrame};
use localize::robot::{CameraSection, DEFAULT_MIRROR_RIM_HEIGHT};
use localize::{Pose, Stamp};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion};

use super::scene::{ROBOT_FRAME, ROBOT_SIDE, color, robot_transform, upright, vector};
use super::{CAMERA_FRAME, timestamp};

// A symbol of the league's robots: the mirror is at its height, the rest is drawn.
const BODY_HEIGHT: f32 = 0.4;
const MAST_DIAMETER: f64 = 0.05;
const MIRROR_DIAMETER: f64 = 0.16;
const MIRROR_HEIGHT: f32 = 0.05;

const BODY: [f64; 4] = [0.15, 0.15, 0.18, 0.9];
const MAST: [f64; 4] = [0.6, 0.6, 0.65, 1.0];
const HEADING: [f64; 4] = [0.2, 0.5, 1.0, 1.0];

/// Our robot as viewers show it.
pub(crate) struct RobotModel {
    camera: Option<CameraSection>,
}

impl RobotModel {
    pub(crate) fn new(camera: Option<CameraSection>) -> Self {
        RobotModel { camera }
    }

    /// Body, mast, mirror and an arrow forward, attached to the robot frame.
    pub(crate) fn scene(&self, stamp: Stamp) -> SceneUpdate {
        let mast_height = DEFAULT_MIRROR_RIM_HEIGHT - MIRROR_HEIGHT;
        let mast = [MAST_DIAMETER, MAST_DIAMETER, f64::from(mast_height)];
        let mirror = [MIRROR_DIAMETER, MIRROR_DIAMETER, f64::from(MIRROR_HEIGHT)];
        let body = [ROBOT_SIDE, ROBOT_SIDE, f64::from(BODY_HEIGHT)];
        let entity = SceneEntity {
            timestamp: timestamp(stamp),
            frame_id: ROBOT_FRAME.to_owned(),
            id: "robot".to_owned(),
            frame_locked: true,
            cylinders: vec![
                cylinder(BODY_HEIGHT / 2.0, body, 1.0, BODY),
                cylinder(mast_height / 2.0, mast, 1.0, MAST),
                cylinder(mast_height + MIRROR_HEIGHT / 2.0, mirror, 0.2, MAST),
            ],
            arrows: vec![ArrowPrimitive {
                pose: upright(origin(), BODY_HEIGHT),
                shaft_length: 0.3,
                shaft_diameter: 0.06,
                head_length: 0.15,
                head_diameter: 0.15,
                color: color(HEADING),
            }],
            ..SceneEntity::default()
        };
        SceneUpdate {
            deletions: Vec::new(),
            entities: vec![entity],
        }
    }

    /// field → robot while the pose is known, robot → camera if its height is known.
    pub(crate) fn transforms(&self, pose: Option<Pose>, stamp: Stamp) -> FrameTransforms {
        let camera = self.camera.as_ref().and_then(|camera| {
            Some(FrameTransform {
                timestamp: timestamp(stamp),
                parent_frame_id: ROBOT_FRAME.to_owned(),
                child_frame_id: CAMERA_FRAME.to_owned(),
                translation: vector([0.0, 0.0, f64::from(camera.height?)]),
                rotation: Some(robot_from_camera(camera)),
            })
        });
        let robot = pose.map(|pose| robot_transform(pose, stamp));
        FrameTransforms {
            transforms: robot.into_iter().chain(camera).collect(),
        }
    }

    /// The pinhole camera itself; its rays still meet the mirror. None without a focal length.
    pub(crate) fn calibration(&self, stamp: Stamp) -> Option<CameraCalibration> {
        let camera = self.camera.as_ref()?;
        let focal = f64::from(camera.focal_px?);
        let [u, v] = camera.centre_px?.map(f64::from);
        Some(CameraCalibration {
            timestamp: timestamp(stamp),
            frame_id: CAMERA_FRAME.to_owned(),
            width: camera.width_px as u32,
            height: camera.height_px as u32,
            distortion_model: String::new(),
            d: Vec::new(),
            k: vec![focal, 0.0, u, 0.0, focal, v, 0.0, 0.0, 1.0],
            r: vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            p: vec![focal, 0.0, u, 0.0, 0.0, focal, v, 0.0, 0.0, 0.0, 1.0, 0.0],
        })
    }
}

/// Rotation of the camera frame: it looks up into one mirror, or down if its image is not mirrored.
fn robot_from_camera(camera: &CameraSection) -> Quaternion {
    // Only directions count, not the axis in the image.
    let [[xu, yu], [xv, yv]] = camera
        .with_axis([0.0; 2], None)
        .image_from_robot()
        .map(|row| row.map(f64::from));
    let up = (xu * yv - yu * xv).signum();
    let axes = Matrix3::new(xu, xv, 0.0, yu, yv, 0.0, 0.0, 0.0, up);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    Quaternion {
        x: rotation.i,
        y: rotation.j,
        z: rotation.k,
        w: rotation.w,
    }
}

fn origin() -> At<RobotFrame> {
    At::new(0.0, 0.0)
}

fn cylinder(middle: f32, size: [f64; 3], bottom_scale: f64, shade: [f64; 4]) -> CylinderPrimitive {
    CylinderPrimitive {
        pose: upright(origin(), middle),
        size: vector(size),
        bottom_scale,
        top_scale: 1.0,
        color: color(shade),
    }
}

#[cfg(test)]
mod tests {
    use localize::math;

    use super::*;

    fn model(forward_deg: f32, flipped: bool) -> RobotModel {
        RobotModel::new(Some(CameraSection {
            width_px: 640,
            height_px: 480,
            focal_px: Some(500.0),
            centre_px: Some([321.0, 241.0]),
            height: Some(0.42),
            forward_deg,
            flipped,
            outer_radius_px: None,
        }))
    }

    /// Where a point of the robot frame appears, by the messages alone.
    fn project(model: &RobotModel, point: [f64; 3]) -> [f64; 2] {
        let transforms = model.transforms(None, Stamp(0)).transforms;
        let (from, at) = (
            transforms[0].rotation.expect("a rotation"),
            transforms[0].translation.expect("a translation"),
        );
        let rotation = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(
            from.w, from.x, from.y, from.z,
        ));
        let offset = nalgebra::Vector3::new(point[0] - at.x, point[1] - at.y, point[2] - at.z);
        let seen = rotation.inverse() * offset;
        let k = model.calibration(Stamp(0)).expect("a calibration").k;
        [k[0] * seen.x / seen.z + k[2], k[4] * seen.y / seen.z + k[5]]
    }

    #[test]
    fn a_point_of_the_mirror_in_front_appears_where_the_mount_says() {
        let front = [0.05, 0.0, 0.92];
        let left = [0.0, 0.05, 0.92];
        // 0.05 m at 0.5 m above the pinhole.
        for (forward_deg, wanted_front, wanted_left) in [
            (90.0, [321.0, 191.0], [371.0, 241.0]),
            (0.0, [371.0, 241.0], [321.0, 291.0]),
        ] {
            let model = model(forward_deg, true);
            for (point, wanted) in [(front, wanted_front), (left, wanted_left)] {
                let found = project(&model, point);
                let distance = math::hypot(found[0] - wanted[0], found[1] - wanted[1]);
                assert!(distance < 1e-3, "{found:?} {wanted:?}");
            }
        }
    }

    #[test]
    fn a_robot_without_a_pose_still_has_its_camera() {
        let names = |pose| -> Vec<String> {
            let transforms = model(90.0, true).transforms(pose, Stamp(0)).transforms;
            transforms
                .into_iter()
                .map(|each| each.child_frame_id)
                .collect()
        };
        assert_eq!(names(None), ["camera"]);
        assert_eq!(names(Some(Pose::new(0.0, 0.0, 0.0))), ["robot", "camera"]);
        let nothing = RobotModel::new(None);
        assert!(nothing.transforms(None, Stamp(0)).transforms.is_empty());
        assert!(nothing.calibration(Stamp(0)).is_none());
    }
}
