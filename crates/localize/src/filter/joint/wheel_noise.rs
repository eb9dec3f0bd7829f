//! How noisy are the wheels: along the motion, across it, and in rotation? (docs/methods.md 8.8)
//!
//! Each direction has three noise terms: of time, of length, and of length squared. Each is the configured one times a
//! factor that innovations teach: those of images, and with an inertial unit those of the wheels against it.

use nalgebra::{Matrix3, Matrix3x4, Vector2, Vector3, Vector4};

use crate::filter::FilterConfig;
use crate::filter::config::WheelNoise;
use crate::filter::log_variance::{LogVariance, NormalizedComponent};
use crate::matching::{Matrix5, Vector5};

/// Noise terms of a direction: per time, per length, per length squared.
pub(super) const TERMS: usize = 3;
/// What innovations teach: the wheels' terms, and the variance of the images, which may be stated too large or too small.
const FACTORS: usize = TERMS + 1;
/// The images among them.
const IMAGES: usize = TERMS;
/// Along the motion, across it, rotation.
pub(super) const DIRECTIONS: usize = 3;

/// Standard deviation of the log factor of the images' variance. What it explains is not taken for the wheels' noise.
const IMAGE_STD: f32 = 0.25;
/// Random walk of the log variances per square root of a second.
const DRIFT: f32 = 0.05;
/// Squared normalised innovation beyond which an image counts as an outlier: 0.05 % of χ²₃.
const SQUARED_MAX: f32 = 18.0;
/// Longest time between images that teach, seconds. Beyond it the motion has changed its direction.
const CONTRIBUTION_TIME_MAX: f32 = 0.3;

/// Derivative of the pose estimate by a log factor: a gain that is wrong shows in later innovations too.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Derivative {
    /// Of the variance along the direction.
    variance: f32,
    /// Of (x, y, θ).
    pose: Vector3<f32>,
}

const NO_DERIVATIVE: Derivative = Derivative {
    variance: 0.0,
    pose: Vector3::new(0.0, 0.0, 0.0),
};

/// Learned wheel noise.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct WheelNoiseEstimate {
    /// None keeps the configured noise.
    learned: Option<[LogVariance<FACTORS>; DIRECTIONS]>,
    /// Derivatives of the predicted pose by each log factor.
    derivatives: [[Derivative; FACTORS]; DIRECTIONS],
    /// Direction of the last motion on the field.
    along: Vector2<f32>,
    /// Time since the last image, seconds.
    elapsed: f32,
}

impl WheelNoiseEstimate {
    pub(super) fn new(config: &FilterConfig) -> Self {
        let std = config.noise_learning_std;
        WheelNoiseEstimate {
            learned: (std > 0.0)
                .then(|| [LogVariance::with_common_prior(std, IMAGE_STD); DIRECTIONS]),
            derivatives: [[NO_DERIVATIVE; FACTORS]; DIRECTIONS],
            along: Vector2::x(),
            elapsed: 0.0,
        }
    }

    /// The same factors for a filter at a new pose.
    pub(super) fn without_derivatives(&self) -> Self {
        WheelNoiseEstimate {
            derivatives: [[NO_DERIVATIVE; FACTORS]; DIRECTIONS],
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
            let [time, length, squared] = variances;
            learned[direction].update([time, length, squared, 0.0], component);
        }
    }

    /// Adds what an increment contributes to the pose's variance: its terms times `share`.
    pub(super) fn add_variances(&mut self, direction: usize, variances: [f32; TERMS], share: f32) {
        for (derivative, variance) in self.derivatives[direction].iter_mut().zip(variances) {
            derivative.variance += share * variance;
        }
    }

    /// Sets the direction of the motion on the field.
    pub(super) fn set_direction(&mut self, along: Vector2<f32>) {
        self.along = along;
    }

    /// Takes the innovation ν of an image with covariance Σ, as Σ⁻¹ν and Σ⁻¹ over (x, y, θ, a, b).
    ///
    /// `predicted`: S⁻¹; `remaining`: 1 − K over the pose, the share of its error that remains.
    pub(super) fn update_by_image(
        &mut self,
        normalized: &Vector5,
        information: &Matrix5,
        predicted: &Matrix5,
        remaining: &Matrix3<f32>,
    ) {
        let elapsed = std::mem::take(&mut self.elapsed);
        let Some(learned) = &mut self.learned else {
            return;
        };
        if elapsed > CONTRIBUTION_TIME_MAX {
            self.derivatives = [[NO_DERIVATIVE; FACTORS]; DIRECTIONS];
            return;
        }
        let normalized = normalized.fixed_rows::<3>(0).into_owned();
        let information = information.fixed_view::<3, 3>(0, 0).into_owned();
        let predicted = predicted.fixed_view::<3, 3>(0, 0).into_owned();
        // An outlier is clipped.
        let covariance = information.try_inverse().unwrap_or_else(Matrix3::zeros);
        let squared = normalized.dot(&(covariance * normalized));
        let normalized = normalized * (SQUARED_MAX / squared.max(SQUARED_MAX)).sqrt();
        let (c, s) = (self.along.x, self.along.y);
        let axes = [[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]].map(Vector3::from);
        let directions = learned.iter_mut().zip(&mut self.derivatives);
        for ((learned, derivatives), axis) in directions.zip(axes) {
            let along = axis.dot(&normalized);
            let certainty = axis.dot(&(information * axis));
            // Σ = S + R along the axis, with the variance R of the image.
            let image = (1.0 / certainty.max(f32::MIN_POSITIVE)
                - 1.0 / axis.dot(&(predicted * axis)))
            .max(0.0);
            let mut of_variance = Vector4::from(derivatives.map(|derivative| derivative.variance));
            of_variance[IMAGES] += image;
            let of_pose = Matrix3x4::from_columns(&derivatives.map(|derivative| derivative.pose));
            // ν depends on λ through the estimate, with dν = −dx, and Σ through the variance.
            let score = of_variance * (0.5 * (along * along - certainty))
                + of_pose.transpose() * normalized;
            let fisher = of_variance * of_variance.transpose() * (0.5 * certainty * certainty)
                + of_pose.transpose() * information * of_pose;
            learned.update_sums(score, fisher);
            // x⁺ = x + K ν and P⁺ = (1 − K) P, so that dK = ((1 − K) dP − K dR) Σ⁻¹ and
            // dP⁺ = (1 − K) dP (1 − K)ᵀ + K dR Kᵀ.
            let kept = axis.dot(&(remaining * axis)).clamp(0.0, 1.0);
            let gain = 1.0 - kept;
            for derivative in derivatives.iter_mut() {
                derivative.pose =
                    remaining * (derivative.pose + axis * (derivative.variance * along));
                derivative.variance *= kept * kept;
            }
            derivatives[IMAGES].pose -= axis * (gain * image * along);
            derivatives[IMAGES].variance += gain * gain * image;
        }
    }
}
