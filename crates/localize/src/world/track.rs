//! One tracked object: its motion, and whether it exists (docs/methods.md 11.2).

use nalgebra::{Matrix3, Matrix4, Vector2};

use super::config::ObjectTrackConfig;
use super::existence::Existence;
use super::motion::{Gating, ObjectMotion};
use super::observation::{Measurement, OdometryFrame, TeamColour};
use crate::frames::At;
use crate::stamp::Stamp;

/// One object in the odometry frame.
#[derive(Debug, Clone)]
pub(super) struct ObjectTrack {
    id: u32,
    motion: ObjectMotion,
    existence: Existence,
    last_seen: Stamp,
    /// Detections with a cyan marker minus those with a magenta one.
    cyan_votes: i32,
}

impl ObjectTrack {
    /// A track from its first detection.
    pub(super) fn new(
        id: u32,
        stamp: Stamp,
        measurement: &Measurement,
        config: &ObjectTrackConfig,
    ) -> Self {
        ObjectTrack {
            id,
            motion: ObjectMotion::new(measurement, config),
            existence: Existence::newborn(stamp, measurement.score, config),
            last_seen: stamp,
            cyan_votes: vote(measurement.team),
        }
    }

    /// Predicts its motion; the robot's own motion ended at `robot`, with the covariance (x, y, θ) in the axes of the odometry frame.
    pub(super) fn predict(
        &mut self,
        seconds: f32,
        robot: At<OdometryFrame>,
        covariance: &Matrix3<f32>,
        config: &ObjectTrackConfig,
    ) {
        self.motion.predict(seconds, config);
        self.motion.add_motion_noise(robot, covariance);
    }

    /// The deviation of a measurement from it.
    pub(super) fn gating(&self, measurement: &Measurement, config: &ObjectTrackConfig) -> Gating {
        self.motion.gating(measurement, config)
    }

    /// Updates motion and existence with a measurement.
    pub(super) fn update(
        &mut self,
        stamp: Stamp,
        measurement: &Measurement,
        config: &ObjectTrackConfig,
    ) {
        if !self.motion.update(measurement, config) {
            return;
        }
        self.last_seen = stamp;
        self.cyan_votes = (self.cyan_votes + vote(measurement.team)).clamp(-100, 100);
        let range = measurement.in_robot_frame.distance();
        self.existence
            .detected(stamp, range, measurement.score, config);
    }

    /// The object's place, `range` metres away, was visible but nothing detected there.
    pub(super) fn mark_missed(&mut self, stamp: Stamp, range: f32, config: &ObjectTrackConfig) {
        self.existence.missed(stamp, range, config);
    }

    /// False if the track is to be deleted.
    pub(super) fn is_kept(&self, stamp: Stamp, config: &ObjectTrackConfig) -> bool {
        let unseen = self.last_seen.seconds_until(stamp) as f32;
        let uncertain =
            self.position_variance(config) > config.position_std_max * config.position_std_max;
        // A new detection may have a larger variance than an undetected track.
        let uncertain = uncertain && unseen > 0.0;
        let finite = self.motion.state().iter().all(|value| value.is_finite());
        self.probability() >= config.delete_probability
            && unseen <= config.unseen_max
            && !uncertain
            && finite
    }

    /// True if the track is part of the output.
    pub(super) fn is_confirmed(&self, config: &ObjectTrackConfig) -> bool {
        self.probability() >= config.confirm_probability
    }

    pub(super) fn id(&self) -> u32 {
        self.id
    }

    pub(super) fn at(&self) -> At<OdometryFrame> {
        let state = self.motion.state();
        At::new(state.x, state.y)
    }

    pub(super) fn velocity(&self) -> Vector2<f32> {
        let state = self.motion.state();
        Vector2::new(state.z, state.w)
    }

    /// Of position and velocity.
    pub(super) fn covariance(&self, config: &ObjectTrackConfig) -> Matrix4<f32> {
        self.motion.covariance(config)
    }

    /// The larger variance of its position's axes, m².
    pub(super) fn position_variance(&self, config: &ObjectTrackConfig) -> f32 {
        let covariance = self.covariance(config);
        covariance[(0, 0)].max(covariance[(1, 1)])
    }

    pub(super) fn probability(&self) -> f32 {
        self.existence.probability()
    }

    pub(super) fn last_seen(&self) -> Stamp {
        self.last_seen
    }

    pub(super) fn team(&self) -> Option<TeamColour> {
        match self.cyan_votes {
            1.. => Some(TeamColour::Cyan),
            0 => None,
            ..0 => Some(TeamColour::Magenta),
        }
    }
}

fn vote(team: Option<TeamColour>) -> i32 {
    match team {
        Some(TeamColour::Cyan) => 1,
        Some(TeamColour::Magenta) => -1,
        None => 0,
    }
}
