//! From what does a new pipeline go on while the robot drives? From the last pose, and from what was learned about exposure and the map.
//!
//! All else is learned anew, so a log that holds this state at a cycle can be computed again from there on.

use anyhow::{Context, Result, ensure};
use localize::localizer::HalfState;
use localize::map_correction::MapFit;
use localize::{Pose, Stamp};
use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};
use vision::exposure::ExposureState;

/// The state that one pipeline hands over to the next.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct WarmStart {
    /// None if no single pose was tracked in the latest image.
    pub(crate) pose: Option<StampedPose>,
    /// What was known about the pose's half of the field. None if the pose was given: then its half counts as known.
    pub(crate) half: Option<HalfState>,
    /// None without a camera.
    pub(crate) exposure: Option<ExposureState>,
    /// None while the map as given is in use.
    pub(crate) map: Option<MapFit>,
}

/// The pose of an image.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct StampedPose {
    stamp_ns: i64,
    /// x, y (metres), theta (radians) on the field.
    pose: [f32; 3],
    /// Of the pose, row by row.
    covariance: [[f32; 3]; 3],
}

impl StampedPose {
    pub(crate) fn new(stamp: Stamp, pose: Pose, covariance: &Matrix3<f32>) -> Self {
        StampedPose {
            stamp_ns: stamp.0,
            pose: [pose.x, pose.y, pose.theta],
            covariance: covariance.transpose().into(),
        }
    }

    pub(crate) fn parts(&self) -> (Stamp, Pose, Matrix3<f32>) {
        let [x, y, theta] = self.pose;
        (
            Stamp(self.stamp_ns),
            Pose::new(x, y, theta),
            Matrix3::from(self.covariance).transpose(),
        )
    }
}

impl WarmStart {
    /// As TOML, which keeps every bit.
    pub(crate) fn to_toml(&self) -> String {
        // Numbers, texts and tables: nothing that TOML lacks.
        toml::to_string(self).unwrap_or_default()
    }

    /// From [`WarmStart::to_toml`]. Errors if the text is another one, or a pose is not finite.
    pub(crate) fn from_toml(text: &str) -> Result<Self> {
        let state: WarmStart = toml::from_str(text).context("invalid state of a warm start")?;
        let numbers = state.pose.iter().flat_map(|pose| {
            let covariance = pose.covariance.iter().flatten();
            pose.pose.iter().chain(covariance)
        });
        let half = state.half.iter().flat_map(|h| [&h.log_odds, &h.withheld]);
        ensure!(
            numbers.chain(half).all(|number| number.is_finite()),
            "a warm start from a pose that is not finite"
        );
        Ok(state)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn warm_start_keeps_every_bit_as_toml() {
        let third = 1.0f32 / 3.0;
        let covariance = Matrix3::new(third, 0.1, 0.2, 0.3, 1e-9, 0.7, -0.0, 5e-7, 0.6);
        let pose = Pose::new(third, -0.1, 3.0e-8);
        let state = WarmStart {
            pose: Some(StampedPose::new(Stamp(i64::MAX), pose, &covariance)),
            half: Some(HalfState {
                log_odds: -third,
                withheld: -0.25,
                established: false,
                compass_doubted: true,
            }),
            exposure: None,
            map: None,
        };
        let read = WarmStart::from_toml(&state.to_toml()).expect("read");
        assert_eq!(read, state);
        let (stamp, again, kept) = read.pose.expect("a pose").parts();
        assert_eq!((stamp, again, kept), (Stamp(i64::MAX), pose, covariance));
        assert_eq!(
            WarmStart::from_toml(&WarmStart::default().to_toml()).expect("read"),
            WarmStart::default()
        );
        for number in ["-0.1", "-0.25"] {
            let infinite = state.to_toml().replace(number, "inf");
            assert_ne!(infinite, state.to_toml());
            WarmStart::from_toml(&infinite).expect_err("not finite");
        }
        WarmStart::from_toml("pose = 3").expect_err("not a state");
    }
}
