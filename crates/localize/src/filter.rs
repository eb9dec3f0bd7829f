//! Where is the robot between sights, and how sure? An EKF over odometry and matched poses.
//!
//! The state holds, besides the pose, the two scales of the odometry (metres and radians that the robot really moves
//! per metre and radian reported): wheels wear and slip, and a bias of some per cent is the rule. With them the
//! prediction loses its bias after a few metres (nubot2013 4 and minho2016 IV.C fuse without).

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};
use serde::{Deserialize, Serialize};

use crate::frame::{Pose, wrap_angle};
use crate::matching::{Expected, Match};

/// How far odometry is believed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FilterConfig {
    /// Random part of the way driven, metres per square root of a metre (slip on carpet).
    pub way_noise: f32,
    /// Random part of the heading per way driven, degrees per square root of a metre.
    pub heading_per_way_noise_deg: f32,
    /// Random part of the turn, radians per square root of a radian.
    pub turn_noise: f32,
    /// Unreported motion (pushes), metres per square root of a second.
    pub drift: f32,
    /// Unreported turning, degrees per square root of a second.
    pub drift_deg: f32,
    /// Standard deviation of odometry's scale before it was ever compared with sight; 0 trusts its scale.
    pub scale_std: f32,
    /// How fast the scales wander, per square root of a second (carpet direction, wear, load).
    pub scale_drift: f32,
    /// How fast the noise above is learnt from how far sights deviate from expectations, per frame; 0 keeps it as
    /// stated. 0.02 learns within some seconds.
    pub noise_learning: f32,
    /// Part of a matched pose's error that the next frames repeat (map, field, uneven light), metres: added to every
    /// frame's result, so that a thousand frames do not promise a tenth of a millimetre.
    pub sight_std: f32,
    /// The same of its heading, degrees.
    pub sight_std_deg: f32,
}

impl Default for FilterConfig {
    fn default() -> Self {
        FilterConfig {
            way_noise: 0.02,
            heading_per_way_noise_deg: 0.7,
            turn_noise: 0.03,
            drift: 0.01,
            drift_deg: 0.6,
            scale_std: 0.05,
            scale_drift: 0.002,
            noise_learning: 0.02,
            sight_std: 0.0015,
            sight_std_deg: 0.04,
        }
    }
}

const STATES: usize = 5;
type State = SVector<f32, STATES>;
type Covariance = SMatrix<f32, STATES, STATES>;

/// Scales outside these are broken encoders, not wear.
const SCALE_RANGE: (f32, f32) = (0.7, 1.4);

/// Noise is learnt within these factors (variance) of what the configuration says.
const NOISE_RANGE: (f32, f32) = (0.05, 20.0);

/// A pose with its uncertainty, and the scales of the odometry that moves it.
#[derive(Debug, Clone, PartialEq)]
pub struct Belief {
    /// x, y, θ, scale of the way, scale of the turn.
    state: State,
    covariance: Covariance,
    /// Variance of the odometry's noise over what the configuration says, learnt.
    noise: f32,
}

impl Belief {
    /// A pose just found; `scales` of an earlier belief are kept, since the wheels are the same.
    pub fn new(
        pose: Pose,
        covariance: &Matrix3<f32>,
        scales: Option<&Belief>,
        config: &FilterConfig,
    ) -> Self {
        let mut state = State::from([pose.x, pose.y, pose.theta, 1.0, 1.0]);
        let mut full = Covariance::zeros();
        let variance = config.scale_std * config.scale_std;
        for i in 3..STATES {
            full[(i, i)] = variance;
        }
        let mut noise = 1.0;
        if let Some(known) = scales {
            noise = known.noise;
            state
                .fixed_rows_mut::<2>(3)
                .copy_from(&known.state.fixed_rows::<2>(3));
            full.fixed_view_mut::<2, 2>(3, 3)
                .copy_from(&known.covariance.fixed_view::<2, 2>(3, 3));
        }
        full.fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&(covariance + sight_noise(config)));
        Belief {
            state,
            covariance: full,
            noise,
        }
    }

    /// The expected pose.
    pub fn pose(&self) -> Pose {
        Pose::new(self.state[0], self.state[1], self.state[2])
    }

    /// Of (x, y, θ), metres and radians.
    pub fn covariance(&self) -> Matrix3<f32> {
        self.covariance.fixed_view::<3, 3>(0, 0).into_owned()
    }

    /// Estimated scales of the odometry: metres per metre, radians per radian.
    pub fn scales(&self) -> [f32; 2] {
        [self.state[3], self.state[4]]
    }

    /// Largest standard deviation of the position in any direction, metres.
    pub fn position_std(&self) -> f32 {
        let p = &self.covariance;
        let mean = 0.5 * (p[(0, 0)] + p[(1, 1)]);
        let half = 0.5 * (p[(0, 0)] - p[(1, 1)]);
        (mean + half.hypot(p[(0, 1)])).max(0.0).sqrt()
    }

    /// Standard deviation of the heading, radians.
    pub fn heading_std(&self) -> f32 {
        self.covariance[(2, 2)].max(0.0).sqrt()
    }

    /// Moves by what odometry reports (metres, metres, radians in the robot frame at the start) over `seconds`.
    pub fn predict(&mut self, motion: [f32; 3], seconds: f32, config: &FilterConfig) {
        let [dx, dy, turn] = motion;
        let (way_scale, turn_scale) = (self.state[3], self.state[4]);
        let (sin, cos) = (self.state[2] + 0.5 * turn * turn_scale).sin_cos();
        // The way as reported, in the field frame.
        let (wx, wy) = (cos * dx - sin * dy, sin * dx + cos * dy);
        let (mx, my) = (wx * way_scale, wy * way_scale);
        self.state[0] += mx;
        self.state[1] += my;
        self.state[2] = wrap_angle(self.state[2] + turn * turn_scale);
        let mut transition = Covariance::identity();
        transition[(0, 2)] = -my;
        transition[(1, 2)] = mx;
        transition[(0, 3)] = wx;
        transition[(1, 3)] = wy;
        transition[(0, 4)] = -0.5 * my * turn;
        transition[(1, 4)] = 0.5 * mx * turn;
        transition[(2, 4)] = turn;
        let way = dx.hypot(dy);
        let position =
            config.way_noise * config.way_noise * way + config.drift * config.drift * seconds;
        let heading = config.heading_per_way_noise_deg.to_radians().powi(2) * way
            + config.turn_noise * config.turn_noise * turn.abs()
            + config.drift_deg.to_radians().powi(2) * seconds;
        let scale = if config.scale_std > 0.0 {
            config.scale_drift * config.scale_drift * seconds
        } else {
            0.0
        };
        self.covariance = transition * self.covariance * transition.transpose()
            + Covariance::from_diagonal(&State::from([
                position * self.noise,
                position * self.noise,
                heading * self.noise,
                scale,
                scale,
            ]));
    }

    /// What a matcher is told beforehand.
    pub fn expected(&self) -> Expected {
        Expected {
            pose: self.pose(),
            information: self
                .covariance()
                .try_inverse()
                .unwrap_or_else(Matrix3::zeros),
        }
    }

    /// Squared deviation of a match under this belief's expectation in its own standard deviations (3 degrees of
    /// freedom): an update x⁺ − x has covariance P − P⁺.
    pub fn surprise(&self, matched: &Match) -> f32 {
        let expected = self.covariance();
        // Directions that the match left free do not move; a hundredth of P keeps them invertible.
        let update = expected * 1.01 - matched.covariance;
        let innovation = self.innovation(matched.pose);
        update.try_inverse().map_or(0.0, |inverse| {
            innovation.dot(&(inverse * innovation)).max(0.0)
        })
    }

    fn innovation(&self, pose: Pose) -> Vector3<f32> {
        Vector3::new(
            pose.x - self.state[0],
            pose.y - self.state[1],
            wrap_angle(pose.theta - self.state[2]),
        )
    }

    /// Fuses a pose that was found without this belief's expectation, with its covariance.
    pub fn correct(&mut self, pose: Pose, sight: &Matrix3<f32>, config: &FilterConfig) {
        let expected = self.covariance();
        let Some(inverse) = (expected + sight).try_inverse() else {
            return;
        };
        let gain = expected * inverse;
        let step = gain * self.innovation(pose);
        let fused = Pose::new(
            self.state[0] + step[0],
            self.state[1] + step[1],
            self.state[2] + step[2],
        );
        let left = expected - gain * expected;
        self.absorb(fused, &((left + left.transpose()) * 0.5), config);
    }

    /// Takes over the pose and covariance that a match found under this belief's expectation, and draws from it what
    /// it says about the scales.
    pub fn absorb(&mut self, pose: Pose, covariance: &Matrix3<f32>, config: &FilterConfig) {
        let expected = self.covariance();
        let Some(inverse) = expected.try_inverse() else {
            return;
        };
        let gain = self.covariance.fixed_columns::<3>(0) * inverse;
        let innovation = self.innovation(pose);
        // An honest expectation is left by 3 − tr(P⁻¹P⁺) on average; more means noisier odometry than assumed.
        let strain = innovation.dot(&(inverse * innovation));
        let usual = 3.0 - (inverse * covariance).trace();
        self.noise = (self.noise
            * (config.noise_learning * (strain - usual).clamp(-3.0, 9.0)).exp())
        .clamp(NOISE_RANGE.0, NOISE_RANGE.1);
        self.state += gain * innovation;
        self.state[2] = wrap_angle(self.state[2]);
        for i in 3..STATES {
            self.state[i] = self.state[i].clamp(SCALE_RANGE.0, SCALE_RANGE.1);
        }
        let learnt = expected - covariance;
        self.covariance -= gain * learnt * gain.transpose();
        self.covariance = (self.covariance + self.covariance.transpose()) * 0.5;
        let mut pose_part = self.covariance.fixed_view_mut::<3, 3>(0, 0);
        pose_part.copy_from(&(covariance + sight_noise(config)));
    }

    /// Widens the pose's uncertainty by `factor` (variance): something moved the robot that odometry did not report,
    /// which says nothing about the scales.
    pub fn widen(&mut self, factor: f32) {
        let factor = factor.max(1.0);
        for i in 0..STATES {
            for j in 0..STATES {
                self.covariance[(i, j)] *= match (i < 3, j < 3) {
                    (true, true) => factor,
                    (false, false) => 1.0,
                    _ => 0.0,
                };
            }
        }
    }

    /// The same belief seen from the other half of the field.
    pub fn half_turned(&self) -> Self {
        let mut other = self.clone();
        other.state[0] = -self.state[0];
        other.state[1] = -self.state[1];
        other.state[2] = wrap_angle(self.state[2] + std::f32::consts::PI);
        for i in 0..2 {
            for j in 2..STATES {
                other.covariance[(i, j)] = -self.covariance[(i, j)];
                other.covariance[(j, i)] = -self.covariance[(j, i)];
            }
        }
        other
    }
}

fn sight_noise(config: &FilterConfig) -> Matrix3<f32> {
    let position = config.sight_std * config.sight_std;
    let heading = config.sight_std_deg.to_radians().powi(2);
    Matrix3::from_diagonal(&Vector3::new(position, position, heading))
}
