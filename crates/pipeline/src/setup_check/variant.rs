//! What if the set-up were another one? One variant of field, camera mount, centre, compass and units.

use localize::field::FieldConfig;
use localize::frames::At;
use localize::robot::CameraConfig;
use localize::sample::LinePoint;
use localize::setup_check::{Keyframe, WheelMotion};

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
    /// Turn of the compass, radians, and its sense of rotation.
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
            compass_turn: 0.0,
            compass_unit_scale: 1.0,
            rotation_unit_scale: 1.0,
        }
    }

    /// The keyframes as this set-up would have measured them.
    pub(super) fn apply(&self, setup: &Setup, measured: &[MeasuredKeyframe]) -> Vec<Keyframe> {
        measured
            .iter()
            .map(|measured| Keyframe {
                stamp: measured.stamp,
                points: self.points(setup, measured),
                motion: measured.odometry.as_ref().map(|rows| {
                    let scaled = rows
                        .iter()
                        .map(|&[dx, dy, turn]| [dx, dy, turn * self.rotation_unit_scale]);
                    WheelMotion::from_increments(&scaled.collect::<Vec<_>>())
                }),
                compass: measured
                    .compass
                    .map(|heading| heading * self.compass_unit_scale + self.compass_turn),
            })
            .collect()
    }

    fn points(&self, setup: &Setup, measured: &MeasuredKeyframe) -> Vec<LinePoint> {
        let [du, dv] = self.centre_shift;
        let shifted = (du, dv) != (0.0, 0.0);
        let turn = |point: LinePoint| {
            let At { x, y, .. } = point.at;
            let (x, y) = match self.quarter_turns % 4 {
                0 => (x, y),
                1 => (-y, x),
                2 => (-x, -y),
                _ => (y, -x),
            };
            LinePoint {
                at: At::new(x, if self.mirrored { -y } else { y }),
                ..point
            }
        };
        let map = setup.camera.as_ref().filter(|_| shifted);
        let Some((_, map)) = map else {
            return measured.points.iter().copied().map(turn).collect();
        };
        let pixels = measured.pixels.iter().zip(&measured.points);
        pixels
            .filter_map(|(&[u, v], point)| {
                let at = map.interpolate(u - du, v - dv)?;
                Some(turn(LinePoint { at, ..*point }))
            })
            .collect()
    }

    /// `[camera]` of this set-up.
    pub(super) fn camera(&self, camera: &CameraConfig) -> CameraConfig {
        // The ground points of the configured camera are turned, then mirrored (docs/methods.md 16).
        let side = if camera.flipped { -1.0 } else { 1.0 };
        let forward = camera.forward_deg - side * 90.0 * f32::from(self.quarter_turns);
        CameraConfig {
            centre_px: [
                camera.centre_px[0] + self.centre_shift[0],
                camera.centre_px[1] + self.centre_shift[1],
            ],
            forward_deg: forward.rem_euclid(360.0),
            flipped: camera.flipped != self.mirrored,
            ..camera.clone()
        }
    }
}
