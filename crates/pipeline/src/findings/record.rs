//! What is kept of a cycle?

use std::sync::Arc;

use localize::estimate::Mode;

use crate::cycle::Cycle;
use crate::log::reason_text;
use crate::pose_error::PoseError;

/// What the findings need of a cycle.
#[derive(Debug, Clone)]
pub(super) struct CycleRecord {
    /// Number in its log.
    pub(super) index: u64,
    /// Stamp, seconds.
    pub(super) time: f64,
    /// Field frame, metres and radians.
    pub(super) pose: Option<[f64; 3]>,
    /// Standard deviation of the position, metres.
    pub(super) std: f64,
    /// Error of the position against the truth, metres.
    pub(super) error: Option<f64>,
    /// Squared normalised error of the pose.
    pub(super) nees: Option<f64>,
    pub(super) lost: bool,
    /// Why the pose is not simply tracked; empty if it is.
    pub(super) reason: &'static str,
    pub(super) line_points: f64,
    pub(super) inlier_share: f64,
    /// Root mean square distance of the inliers from the markings, metres.
    pub(super) residual: f64,
    pub(super) carpet_share: Option<f64>,
    pub(super) robots_seen: Option<f64>,
    /// Brightness of the image's centre, of 255.
    pub(super) brightness: Option<f64>,
    /// Exposure times gain; 1 if the camera does not tell.
    pub(super) camera_setting: f64,
    pub(super) collision: bool,
    pub(super) half_known: bool,
    /// Why the image could not be used.
    pub(super) fault: Option<Arc<str>>,
    /// Estimated displacement of the map at 3 m and its standard deviation, metres.
    pub(super) displacement: Option<[f64; 2]>,
}

impl CycleRecord {
    /// `index`: its number in the run.
    pub(super) fn new(index: u64, cycle: &Cycle) -> Self {
        let estimate = &cycle.estimate;
        let covariance = estimate.covariance.map(f64::from);
        let pose = estimate
            .pose
            .map(|pose| [pose.x, pose.y, pose.theta].map(f64::from));
        let error = PoseError::of(cycle);
        let detections = cycle.detections.as_ref();
        let exposure = cycle.exposure.as_ref();
        let setting = exposure.and_then(|exposure| exposure.applied_setting);
        CycleRecord {
            index,
            time: cycle.stamp.seconds(),
            pose,
            std: (covariance[(0, 0)].max(0.0) + covariance[(1, 1)].max(0.0)).sqrt(),
            error: error.map(|error| error.distance()),
            nees: error.and_then(|error| error.nees),
            lost: estimate.mode == Mode::Lost,
            reason: reason_text(estimate),
            line_points: cycle.line_points.len() as f64,
            inlier_share: f64::from(estimate.inlier_share),
            residual: f64::from(estimate.inlier_rms),
            carpet_share: detections.map(|seen| f64::from(seen.carpet_share)),
            robots_seen: detections.map(|seen| seen.robots.len() as f64),
            brightness: exposure.map(|exposure| f64::from(exposure.centre_brightness)),
            camera_setting: setting.map_or(1.0, |setting| {
                f64::from(setting.exposure) * f64::from(setting.gain)
            }),
            collision: estimate.collision,
            half_known: estimate.half_known,
            fault: cycle.image_fault.as_deref().map(Arc::from),
            displacement: estimate
                .map_correction
                .as_ref()
                .map(|map| [map.displacement_at_3_m, map.displacement_std_at_3_m].map(f64::from)),
        }
    }
}
