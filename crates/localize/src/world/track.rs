//! Where is one object, how does it move, and is it there at all? A Kalman filter and a probability of existence.

use nalgebra::{Matrix2, Matrix4, Vector2};

use super::{Measurement, ObjectConfig, OdometryFrame, TeamColour, TrackState};
use crate::frames::At;
use crate::stamp::Stamp;

/// No sight makes anything surer than this, so that what vanishes is given up within some frames.
const EXISTENCE_MAX: f32 = 0.99;

/// One object in the odometry's frame.
#[derive(Debug, Clone)]
pub(super) struct Track {
    id: u32,
    /// Position and velocity: metres, m/s.
    state: TrackState,
    covariance: Matrix4<f32>,
    /// Odds that it exists.
    existence_odds: f32,
    last_seen: Stamp,
    /// Sightings with cyan less sightings with magenta.
    cyan_votes: i32,
}

impl Track {
    /// An object seen for the first time.
    pub(super) fn new(
        id: u32,
        stamp: Stamp,
        measurement: &Measurement,
        config: &ObjectConfig,
    ) -> Self {
        let mut covariance = Matrix4::zeros();
        covariance
            .fixed_view_mut::<2, 2>(0, 0)
            .copy_from(&measurement.covariance);
        let speed = config.initial_speed_std * config.initial_speed_std;
        (covariance[(2, 2)], covariance[(3, 3)]) = (speed, speed);
        let newborn = config.birth_probability * measurement.score;
        Track {
            id,
            state: TrackState::new(measurement.at.x, measurement.at.y, 0.0, 0.0),
            covariance,
            existence_odds: newborn / (1.0 - newborn),
            last_seen: stamp,
            cyan_votes: vote(measurement.team),
        }
    }

    /// Carries it on: it rolls out, and who knows who touches it.
    pub(super) fn predict(&mut self, seconds: f32, config: &ObjectConfig) {
        let velocity = self.velocity();
        let way = rolling_displacement(velocity, seconds, config.deceleration);
        let speed = velocity.norm();
        let left = (speed - config.deceleration * seconds).max(0.0);
        let slowed = if speed > 0.0 { left / speed } else { 0.0 };
        self.state = TrackState::new(
            self.state.x + way.x,
            self.state.y + way.y,
            self.state.z * slowed,
            self.state.w * slowed,
        );
        let mut transition = Matrix4::identity();
        (transition[(0, 2)], transition[(1, 3)]) = (seconds, seconds);
        self.covariance = transition * self.covariance * transition.transpose();
        // White acceleration: the same for one long step and many short ones.
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

    /// Its position became vaguer by a variance, m²: the ground moved under it.
    pub(super) fn add_position_noise(&mut self, variance: f32) {
        self.covariance[(0, 0)] += variance;
        self.covariance[(1, 1)] += variance;
    }

    /// Squared deviation of a measurement in standard deviations, and the logarithm of the spread it is judged by.
    pub(super) fn mahalanobis_squared(&self, measurement: &Measurement) -> (f32, f32) {
        let spread = self.innovation_covariance(measurement);
        let off = self.innovation(measurement);
        spread
            .try_inverse()
            .map_or((f32::INFINITY, 0.0), |inverse| {
                let squared = (off.transpose() * inverse * off).x;
                (squared, spread.determinant().max(f32::MIN_POSITIVE).ln())
            })
    }

    /// It was seen there.
    pub(super) fn update(
        &mut self,
        stamp: Stamp,
        measurement: &Measurement,
        config: &ObjectConfig,
    ) {
        let Some(inverse) = self.innovation_covariance(measurement).try_inverse() else {
            return;
        };
        let gain = self.covariance.fixed_view::<4, 2>(0, 0) * inverse;
        self.state += gain * self.innovation(measurement);
        let seen = self.covariance.fixed_view::<2, 4>(0, 0).into_owned();
        let reduced = self.covariance - gain * seen;
        self.covariance = (reduced + reduced.transpose()) * 0.5;
        self.last_seen = stamp;
        self.cyan_votes = (self.cyan_votes + vote(measurement.team)).clamp(-100, 100);
        // A score of 0 says nothing, a score of 1 all that a detection can say.
        let certain = config.detection_probability / config.false_alarm_probability;
        self.update_existence(1.0 + measurement.score * (certain - 1.0));
    }

    /// It was not seen, though it could have been.
    pub(super) fn mark_missed(&mut self, config: &ObjectConfig) {
        self.update_existence(
            (1.0 - config.detection_probability) / (1.0 - config.false_alarm_probability),
        );
    }

    fn update_existence(&mut self, ratio: f32) {
        self.existence_odds =
            (self.existence_odds * ratio).min(EXISTENCE_MAX / (1.0 - EXISTENCE_MAX));
    }

    /// Is it worth following on?
    pub(super) fn is_kept(&self, stamp: Stamp, config: &ObjectConfig) -> bool {
        let unseen = self.last_seen.seconds_until(stamp) as f32;
        let vague = self.position_variance() > config.position_std_max * config.position_std_max;
        // A first sighting may be vaguer than what is kept unseen.
        let vague = vague && unseen > 0.0;
        let finite = self.state.iter().all(|value| value.is_finite());
        self.probability() >= config.delete_probability
            && unseen <= config.unseen_max
            && !vague
            && finite
    }

    /// Is it worth telling?
    pub(super) fn is_confirmed(&self, config: &ObjectConfig) -> bool {
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

/// The way of something that slows down until it lies still, metres.
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
