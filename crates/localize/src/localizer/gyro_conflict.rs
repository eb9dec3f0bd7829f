//! Images whose turns the gyro contradicts: of a driver that repeats an old one or delivers late ones (docs/methods.md 8.13).
//!
//! A robot that is pushed or held turns as its gyro says, whatever the wheels do. Where image after image turns the pose back, nobody
//! knows which of both is right, and the pose is uncertain by all that the images took back: the difference of their pose from dead
//! reckoning.

use std::f32::consts::PI;

use nalgebra::{Matrix3, Vector3};

use crate::frames::Pose;
use crate::math;

/// Standard deviations by which an image contradicts the turn that the gyro predicted.
const SIGMAS: f32 = 5.0;
/// Motion over which images agree with the prediction again before they are believed, metres or radians.
const AGREED_MOTION: f32 = 2.0;

/// What images took back of the predicted motion since they contradict the gyro.
#[derive(Debug, Clone, Default)]
pub(super) struct GyroConflict {
    /// Metres on the field, and radians.
    taken_back: Vector3<f32>,
    /// Motion by images that agree since.
    agreed_motion: f32,
    last: Option<Pose>,
}

impl GyroConflict {
    /// Takes an image that changed the predicted pose; `heading_std`: of the difference of both headings, radians. `contradicts`: the
    /// image is inconsistent with the prediction.
    pub(super) fn add(
        &mut self,
        predicted: Pose,
        matched: Pose,
        heading_std: f32,
        contradicts: bool,
    ) {
        let change = matched.difference(predicted);
        let motion = self.last.replace(matched).map_or(0.0, |last| {
            let moved = matched.difference(last);
            math::hypot(moved.x, moved.y) + moved.z.abs()
        });
        let is_open = self.taken_back != Vector3::zeros();
        let begins = contradicts && change.z.abs() > SIGMAS * heading_std;
        if !is_open && !begins {
            return;
        }
        // Good images bring back what wrong ones took.
        self.taken_back += change;
        self.agreed_motion = if contradicts {
            0.0
        } else {
            self.agreed_motion + motion
        };
        if self.agreed_motion > AGREED_MOTION {
            self.taken_back = Vector3::zeros();
        }
    }

    /// Covariance of a pose by images that may be wrong.
    pub(super) fn covariance(&self) -> Matrix3<f32> {
        let mut offset = self.taken_back;
        offset.z = offset.z.clamp(-PI, PI);
        Matrix3::from_diagonal(&offset.component_mul(&offset))
    }
}
