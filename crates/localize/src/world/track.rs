//! One tracked object: a Kalman filter of position and velocity, and a probability of existence (docs/methods.md 11.2).

use nalgebra::{Matrix2, Matrix3, Matrix4, Matrix4x3, Vector2, Vector4};

use super::config::ObjectTrackConfig;
use super::observation::{Measurement, OdometryFrame, TeamColour};
use crate::frames::At;
use crate::math;
use crate::stamp::Stamp;

/// Position and velocity (x, y, vx, vy): metres, m/s.
type TrackState = Vector4<f32>;

/// Largest probability of existence, so that a vanished object is deleted within some images.
const EXISTENCE_MAX: f32 = 0.99;

/// The deviation of a measurement from a track.
#[derive(Debug, Clone, Copy)]
pub(super) struct Gating {
    /// Squared Mahalanobis distance.
    pub(super) mahalanobis_squared: f32,
    /// Of the innovation covariance (m⁴), natural logarithm.
    pub(super) log_determinant: f32,
}

/// One object in the odometry frame.
#[derive(Debug, Clone)]
pub(super) struct ObjectTrack {
    id: u32,
    /// Position and velocity: metres, m/s.
    state: TrackState,
    covariance: Matrix4<f32>,
    /// Odds that it exists.
    existence_odds: f32,
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
        let mut covariance = Matrix4::zeros();
        covariance
            .fixed_view_mut::<2, 2>(0, 0)
            .copy_from(&measurement.covariance);
        let speed = config.initial_speed_std * config.initial_speed_std;
        (covariance[(2, 2)], covariance[(3, 3)]) = (speed, speed);
        let newborn = config.birth_probability * measurement.score;
        ObjectTrack {
            id,
            state: TrackState::new(measurement.at.x, measurement.at.y, 0.0, 0.0),
            covariance,
            existence_odds: newborn / (1.0 - newborn),
            last_seen: stamp,
            cyan_votes: vote(measurement.team),
        }
    }

    /// Predicts position and velocity with rolling friction and adds process noise.
    pub(super) fn predict(&mut self, seconds: f32, config: &ObjectTrackConfig) {
        let velocity = self.velocity();
        let displacement = rolling_displacement(velocity, seconds, config.deceleration);
        let speed = velocity.norm();
        let remaining_speed = (speed - config.deceleration * seconds).max(0.0);
        let slowdown = if speed > 0.0 {
            remaining_speed / speed
        } else {
            0.0
        };
        self.state = TrackState::new(
            self.state.x + displacement.x,
            self.state.y + displacement.y,
            self.state.z * slowdown,
            self.state.w * slowdown,
        );
        let mut transition = Matrix4::identity();
        (transition[(0, 2)], transition[(1, 3)]) = (seconds, seconds);
        self.covariance = transition * self.covariance * transition.transpose();
        // White acceleration noise: independent of the number of steps.
        let q = config.acceleration_noise * config.acceleration_noise;
        let (position, cross, velocity) = (
            q * seconds.powi(3) / 3.0,
            q * seconds * seconds / 2.0,
            q * seconds,
        );
        for axis in 0..2 {
            self.covariance[(axis, axis)] += position;
            self.covariance[(axis, axis + 2)] += cross;
            self.covariance[(axis + 2, axis)] += cross;
            self.covariance[(axis + 2, axis + 2)] += velocity;
        }
    }

    /// Adds the error of the robot's own motion, which ended at `robot`: its `covariance` (x, y, θ) in the axes of the odometry
    /// frame. A turn moves what is far, and turns velocities.
    pub(super) fn add_motion_noise(&mut self, robot: At<OdometryFrame>, covariance: &Matrix3<f32>) {
        let (x, y) = (self.state.x - robot.x, self.state.y - robot.y);
        let jacobian = Matrix4x3::new(
            1.0,
            0.0,
            -y,
            0.0,
            1.0,
            x,
            0.0,
            0.0,
            -self.state.w,
            0.0,
            0.0,
            self.state.z,
        );
        self.covariance += jacobian * covariance * jacobian.transpose();
    }

    /// The squared Mahalanobis distance of a measurement; infinite if the innovation covariance is singular.
    pub(super) fn gating(&self, measurement: &Measurement) -> Gating {
        let covariance = self.innovation_covariance(measurement);
        let innovation = self.innovation(measurement);
        let Some(inverse) = covariance.try_inverse() else {
            return Gating {
                mahalanobis_squared: f32::INFINITY,
                log_determinant: 0.0,
            };
        };
        Gating {
            mahalanobis_squared: (innovation.transpose() * inverse * innovation).x,
            log_determinant: math::ln(covariance.determinant().max(f32::MIN_POSITIVE)),
        }
    }

    /// Kalman update with a measurement, and update of the existence.
    pub(super) fn update(
        &mut self,
        stamp: Stamp,
        measurement: &Measurement,
        config: &ObjectTrackConfig,
    ) {
        let Some(inverse) = self.innovation_covariance(measurement).try_inverse() else {
            return;
        };
        let gain = self.covariance.fixed_view::<4, 2>(0, 0) * inverse;
        self.state += gain * self.innovation(measurement);
        let position_rows = self.covariance.fixed_view::<2, 4>(0, 0).into_owned();
        let reduced = self.covariance - gain * position_rows;
        self.covariance = (reduced + reduced.transpose()) * 0.5;
        self.last_seen = stamp;
        self.cyan_votes = (self.cyan_votes + vote(measurement.team)).clamp(-100, 100);
        // The likelihood ratio is 1 for a score of 0, and that of a certain detection for a score of 1.
        let ratio_max = config.detection_probability / config.false_alarm_probability;
        self.update_existence(1.0 + measurement.score * (ratio_max - 1.0));
    }

    /// The object was visible but not detected.
    pub(super) fn mark_missed(&mut self, config: &ObjectTrackConfig) {
        self.update_existence(
            (1.0 - config.detection_probability) / (1.0 - config.false_alarm_probability),
        );
    }

    fn update_existence(&mut self, ratio: f32) {
        self.existence_odds =
            (self.existence_odds * ratio).min(EXISTENCE_MAX / (1.0 - EXISTENCE_MAX));
    }

    /// False if the track is to be deleted.
    pub(super) fn is_kept(&self, stamp: Stamp, config: &ObjectTrackConfig) -> bool {
        let unseen = self.last_seen.seconds_until(stamp) as f32;
        let uncertain =
            self.position_variance() > config.position_std_max * config.position_std_max;
        // A new detection may have a larger variance than an undetected track.
        let uncertain = uncertain && unseen > 0.0;
        let finite = self.state.iter().all(|value| value.is_finite());
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
        At::new(self.state.x, self.state.y)
    }

    pub(super) fn velocity(&self) -> Vector2<f32> {
        Vector2::new(self.state.z, self.state.w)
    }

    pub(super) fn covariance(&self) -> &Matrix4<f32> {
        &self.covariance
    }

    /// The larger variance of its position's axes, m².
    pub(super) fn position_variance(&self) -> f32 {
        self.covariance[(0, 0)].max(self.covariance[(1, 1)])
    }

    pub(super) fn probability(&self) -> f32 {
        self.existence_odds / (1.0 + self.existence_odds)
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

    fn innovation(&self, measurement: &Measurement) -> Vector2<f32> {
        Vector2::new(
            measurement.at.x - self.state.x,
            measurement.at.y - self.state.y,
        )
    }

    fn innovation_covariance(&self, measurement: &Measurement) -> Matrix2<f32> {
        self.covariance.fixed_view::<2, 2>(0, 0) + measurement.covariance
    }
}

/// Displacement of an object that decelerates to rest, metres.
pub(super) fn rolling_displacement(
    velocity: Vector2<f32>,
    seconds: f32,
    deceleration: f32,
) -> Vector2<f32> {
    let speed = velocity.norm();
    if speed <= 0.0 {
        return Vector2::zeros();
    }
    let rolling = if deceleration > 0.0 {
        seconds.min(speed / deceleration)
    } else {
        seconds
    };
    velocity / speed * (speed * rolling - deceleration * rolling * rolling / 2.0)
}

fn vote(team: Option<TeamColour>) -> i32 {
    match team {
        Some(TeamColour::Cyan) => 1,
        Some(TeamColour::Magenta) => -1,
        None => 0,
    }
}
