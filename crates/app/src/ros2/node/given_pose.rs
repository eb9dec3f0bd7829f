//! How is a pose that another program gives read?

use localize::{Pose, math};
use nalgebra::Matrix3;

use super::super::messages::{PoseWithCovariance, Quaternion};
use super::shared::GivenPose;

/// Covariance of a given pose that states none: 0.5 m and 15°.
const DEFAULT_VARIANCE: [f32; 3] = [0.25, 0.25, 0.068];
/// Smallest variance of a given pose: nobody knows it to the millimetre.
const VARIANCE_MIN: f32 = 1e-4;

/// Rotation about the vertical, radians; not a number without a unit quaternion.
pub(super) fn yaw_of(rotation: &Quaternion) -> f64 {
    let Quaternion { x, y, z, w } = *rotation;
    let norm = x * x + y * y + z * z + w * w;
    if !((norm - 1.0).abs() < 0.1) {
        return f64::NAN;
    }
    math::atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)
}

/// A given pose in the plane. None if it is not finite.
pub(super) fn planar_given(given: &PoseWithCovariance) -> Option<GivenPose> {
    let position = &given.pose.position;
    let pose = [position.x, position.y, yaw_of(&given.pose.orientation)].map(|value| value as f32);
    let places = [0, 1, 5];
    let mut covariance =
        Matrix3::from_fn(|row, column| given.covariance[places[row]][places[column]] as f32);
    let all = pose.iter().chain(covariance.iter());
    if !all
        .clone()
        .all(|value| value.is_finite() && value.abs() < 1e6)
    {
        return None;
    }
    // Symmetric and positive: otherwise only the variances count.
    let symmetric = (covariance + covariance.transpose()) / 2.0;
    covariance = if symmetric.cholesky().is_some() {
        symmetric
    } else {
        Matrix3::from_diagonal(&symmetric.diagonal())
    };
    for (index, default) in DEFAULT_VARIANCE.into_iter().enumerate() {
        let variance = &mut covariance[(index, index)];
        if *variance <= 0.0 {
            *variance = default;
        }
        *variance = variance.max(VARIANCE_MIN);
    }
    let [x, y, theta] = pose;
    Some(GivenPose {
        pose: Pose::new(x, y, theta),
        covariance,
    })
}
