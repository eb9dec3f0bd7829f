//! How noisy are the wheels: along the motion, across it, and in rotation? (docs/methods.md 8.8)
//!
//! Each direction has three noise terms: of time, of length, and of length squared. Each is the configured one times a
//! factor that innovations teach: those of images, and with an inertial unit those of the wheels against it.

use nalgebra::Vector2;

use crate::filter::FilterConfig;
use crate::filter::config::WheelNoise;
use crate::filter::log_variance::{LogVariance, NormalizedComponent};
use crate::matching::{Matrix5, Vector5};

/// Noise terms of a direction: per time, per length, per length squared.
pub(super) const TERMS: usize = 3;
/// Along the motion, across it, rotation.
pub(super) const DIRECTIONS: usize = 3;

/// Random walk of the log variances per square root of a second.
const DRIFT: f32 = 0.1;
/// Longest time between images that teach, seconds. Beyond it the motion has changed its direction.
const CONTRIBUTION_TIME_MAX: f32 = 0.3;

/// Learned wheel noise.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct WheelNoiseEstimate {
    /// None keeps the configured noise.
    learned: Option<[LogVariance<TERMS>; DIRECTIONS]>,
    /// What each term added to the pose's variance since the last image.
    contributions: [[f32; TERMS]; DIRECTIONS],
    /// Direction of the last motion on the field.
    along: Vector2<f32>,
    /// Time since the last image, seconds.
    elapsed: f32,
}

impl WheelNoiseEstimate {
    pub(super) fn new(config: &FilterConfig) -> Self {
        let std = config.noise_learning_std;
        WheelNoiseEstimate {
            learned: (std > 0.0).then(|| [LogVariance::new(std); DIRECTIONS]),
            contributions: [[0.0; TERMS]; DIRECTIONS],
            along: Vector2::x(),
            elapsed: 0.0,
        }
    }

    /// The same factors for a filter at a new pose.
    pub(super) fn without_contributions(&self) -> Self {
        WheelNoiseEstimate {
            contributions: [[0.0; TERMS]; DIRECTIONS],
            ..self.clone()
        }
    }

    pub(super) fn forget(&mut self, seconds: f32) {
        self.elapsed += seconds;
        for learned in self.learned.iter_mut().flatten() {
            learned.forget(seconds, DRIFT);
        }
    }

    /// Variances of the terms of each direction for a wheel increment.
    pub(super) fn variances(&self, noise: &WheelNoise) -> [[f32; TERMS]; DIRECTIONS] {
        let mut variances = [noise.position, noise.position, noise.heading];
        for (variances, learned) in variances.iter_mut().zip(self.learned.iter().flatten()) {
            for (variance, factor) in variances.iter_mut().zip(learned.factors()) {
                *variance *= factor;
            }
        }
        variances
    }

    /// Takes a wheel innovation along `direction`, predicted by an inertial unit. `variances`: of its terms.
    pub(super) fn update_by_wheels(
        &mut self,
        direction: usize,
        variances: [f32; TERMS],
        innovation: f32,
        innovation_variance: f32,
    ) {
        if let Some(learned) = &mut self.learned
            && innovation_variance > 0.0
        {
            let component = NormalizedComponent {
                squared: (innovation / innovation_variance).powi(2),
                information: 1.0 / innovation_variance,
            };
            learned[direction].update(variances, component);
        }
    }

    /// Notes what an increment adds to the pose's variance: its terms times `share`.
    pub(super) fn add_contribution(
        &mut self,
        direction: usize,
        variances: [f32; TERMS],
        share: f32,
    ) {
        for (sum, variance) in self.contributions[direction].iter_mut().zip(variances) {
            *sum += share * variance;
        }
    }

    /// Sets the direction of the motion on the field.
    pub(super) fn set_direction(&mut self, along: Vector2<f32>) {
        self.along = along;
    }

    /// Takes the innovation ν of an image with covariance Σ, as Σ⁻¹ν and Σ⁻¹ over (x, y, θ, a, b).
    pub(super) fn update_by_image(&mut self, normalized: &Vector5, information: &Matrix5) {
        let contributions = std::mem::take(&mut self.contributions);
        let elapsed = std::mem::take(&mut self.elapsed);
        let Some(learned) = &mut self.learned else {
            return;
        };
        if elapsed > CONTRIBUTION_TIME_MAX {
            return;
        }
        let (c, s) = (self.along.x, self.along.y);
        let axes = [[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]];
        for ((learned, contributions), axis) in learned.iter_mut().zip(contributions).zip(axes) {
            let axis = Vector5::from([axis[0], axis[1], axis[2], 0.0, 0.0]);
            let component = NormalizedComponent {
                squared: axis.dot(normalized).powi(2),
                information: axis.dot(&(information * axis)),
            };
            learned.update(contributions, component);
        }
    }
}
