//! What if the set-up were another one? One variant of field, camera mount, centre, compass and units.

use localize::field::FieldConfig;
use localize::frames::{At, RobotFrame};
use localize::math;
use localize::robot::CameraConfig;
use localize::sample::LinePoint;
use localize::setup_check::{Keyframe, WheelMotion};
use nalgebra::{Matrix3, Vector3};
use vision::optics::ray_tracing::Tracer;
use vision::{Mount, Profile};

use super::measurements::MeasuredKeyframe;
use crate::setup::Setup;

/// A set-up that differs from the configured one.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SetupVariant {
    /// The field.
    pub(super) field: FieldConfig,
    /// The robot's left and right exchanged.
    pub(super) mirrored: bool,
    /// Quarter turns of the camera about the vertical axis.
    pub(super) quarter_turns: u8,
    /// Shift of the mirror's centre in the image, pixels.
    pub(super) centre_shift: [f32; 2],
    /// Another height of the camera, metres.
    pub(super) height: Option<f32>,
    /// Another focal length, pixels.
    pub(super) focal_px: Option<f32>,
    /// Turn of the camera beyond quarters, radians.
    pub(super) camera_turn: f32,
    /// Factor of the wheels' path: 1, or another unit to metres.
    pub(super) path_unit_scale: f32,
    /// Heading of the robot at the first keyframe in the axes of the wheels' motion, radians, where these do not turn with the robot.
    pub(super) fixed_axes: Option<f32>,
    /// Matrix of the wheels' motion on top of the configured one.
    pub(super) wheel_matrix: Matrix3<f32>,
    /// Sense of rotation of the compass: -1 for one that counts clockwise.
    pub(super) compass_sign: f32,
    /// Turn of the compass, radians.
    pub(super) compass_turn: f32,
    /// Factor of the compass's readings: 1, or degrees to radians.
    pub(super) compass_unit_scale: f32,
    /// Factor of the wheels' turns: 1, or degrees to radians.
    pub(super) rotation_unit_scale: f32,
}

impl SetupVariant {
    /// The configured set-up.
    pub(super) fn configured(setup: &Setup) -> Self {
        SetupVariant {
            field: setup.field.config.clone(),
            mirrored: false,
            quarter_turns: 0,
            centre_shift: [0.0; 2],
            height: None,
            focal_px: None,
            camera_turn: 0.0,
            path_unit_scale: 1.0,
            fixed_axes: None,
            wheel_matrix: Matrix3::identity(),
            compass_sign: 1.0,
            compass_turn: 0.0,
            compass_unit_scale: 1.0,
            rotation_unit_scale: 1.0,
        }
    }

    /// The keyframes as this set-up would have measured them.
    pub(super) fn apply(&self, setup: &Setup, measured: &[MeasuredKeyframe]) -> Vec<Keyframe> {
        let wheels = self.wheels(setup);
        let mut heading = self.fixed_axes;
        measured
            .iter()
            .map(|measured| Keyframe {
                stamp: measured.stamp,
                points: self.points(setup, measured),
                motion: measured.odometry.as_ref().map(|rows| {
                    let moved = rows
                        .iter()
                        .map(|row| <[f32; 3]>::from(wheels * self.motion(*row, &mut heading)));
                    WheelMotion::from_increments(&moved.collect::<Vec<_>>())
                }),
                compass: measured.compass.map(|heading| {
                    self.compass_sign * heading * self.compass_unit_scale + self.compass_turn
                }),
            })
            .collect()
    }

    /// A row of the odometry in metres, metres and radians, axes of the robot. `heading`: of the robot in the row's axes, where these
    /// are fixed.
    fn motion(&self, [dx, dy, turn]: [f32; 3], heading: &mut Option<f32>) -> Vector3<f32> {
        let turn = turn * self.rotation_unit_scale;
        let (sin, cos) = math::sin_cos(heading.map_or(0.0, |heading| heading + 0.5 * turn));
        *heading = heading.map(|heading| heading + turn);
        let (x, y) = (dx * self.path_unit_scale, dy * self.path_unit_scale);
        Vector3::new(cos * x + sin * y, cos * y - sin * x, turn)
    }

    /// The ground point that this mount gives where the configured one gives `at`.
    pub(super) fn turn(&self, at: At<RobotFrame>) -> At<RobotFrame> {
        let (sin, cos) = (math::sin(self.camera_turn), math::cos(self.camera_turn));
        let At { x, y, .. } = at;
        let (x, y) = match self.quarter_turns % 4 {
            0 => (x, y),
            1 => (-y, x),
            2 => (-x, -y),
            _ => (y, -x),
        };
        let (x, y) = (cos * x - sin * y, sin * x + cos * y);
        At::new(x, if self.mirrored { -y } else { y })
    }

    fn points(&self, setup: &Setup, measured: &MeasuredKeyframe) -> Vec<LinePoint> {
        let [du, dv] = self.centre_shift;
        let shifted = (du, dv) != (0.0, 0.0);
        let turn = |point: LinePoint| LinePoint {
            at: self.turn(point.at),
            ..point
        };
        let retraced = (self.height.is_some() || self.focal_px.is_some()).then_some(());
        let pixels = measured.pixels.iter().zip(&measured.points);
        if let Some((camera, profile)) = retraced.and_then(|()| traced_camera(setup)) {
            let camera = CameraConfig {
                centre_px: [camera.centre_px[0] + du, camera.centre_px[1] + dv],
                height: self.height.or(camera.height),
                focal_px: self.focal_px.or(camera.focal_px),
                ..camera.clone()
            };
            // A camera above its mirror sees nothing.
            let Ok(tracer) = Tracer::new(&camera, profile, &Mount::default()) else {
                return Vec::new();
            };
            return pixels
                .filter_map(|(&[u, v], point)| {
                    let ray = tracer.ray(f64::from(u), f64::from(v))?;
                    let at = ray.at_height(0.0)?;
                    Some(turn(LinePoint { at, ..*point }))
                })
                .collect();
        }
        let map = setup.camera.as_ref().filter(|_| shifted);
        let Some((_, map)) = map else {
            return measured.points.iter().copied().map(turn).collect();
        };
        pixels
            .filter_map(|(&[u, v], point)| {
                let at = map.interpolate(u - du, v - dv)?;
                Some(turn(LinePoint { at, ..*point }))
            })
            .collect()
    }

    /// Matrix from the measured motion (metres, metres, radians) to the true one.
    pub(super) fn wheels(&self, setup: &Setup) -> Matrix3<f32> {
        let configured = setup
            .robot
            .odometry
            .map_or_else(Matrix3::identity, |odometry| {
                let matrix = odometry.matrix;
                Matrix3::from_fn(|row, column| matrix[row][column])
            });
        self.wheel_matrix * configured
    }

    /// Height and focal length of the camera. None unless the map was traced from a mirror's profile.
    pub(super) fn optics(&self, setup: &Setup) -> Option<(f32, f32)> {
        let (camera, _) = traced_camera(setup)?;
        Some((
            self.height.or(camera.height)?,
            self.focal_px.or(camera.focal_px)?,
        ))
    }

    /// `[camera]` of this set-up.
    pub(super) fn camera(&self, camera: &CameraConfig) -> CameraConfig {
        // The ground points of the configured camera are turned, then mirrored (docs/methods.md 16).
        let side = if camera.flipped { -1.0 } else { 1.0 };
        let turn = 90.0 * f32::from(self.quarter_turns) + self.camera_turn.to_degrees();
        let forward = camera.forward_deg - side * turn;
        CameraConfig {
            centre_px: [
                camera.centre_px[0] + self.centre_shift[0],
                camera.centre_px[1] + self.centre_shift[1],
            ],
            forward_deg: forward.rem_euclid(360.0),
            flipped: camera.flipped != self.mirrored,
            height: self.height.or(camera.height),
            focal_px: self.focal_px.or(camera.focal_px),
            ..camera.clone()
        }
    }
}

/// The camera and the mirror whose ideal mount gave the ground map.
fn traced_camera(setup: &Setup) -> Option<(&CameraConfig, &Profile)> {
    let (camera, _) = setup.camera.as_ref()?;
    Some((camera, setup.traced_mirror.as_ref()?))
}
