//! Since when does the ball roll or fly on its present path? Competing paths, each with its start and its kind.
//!
//! An impact or a kick begins a new path. Each image may begin one, so the hypotheses are the starts and kinds of the
//! present path. Each holds the probability of all rays up to now: Bayesian detection of changes (docs/methods.md 17.3).

use super::config::FlightConfig;
use super::motion_fit::{
    Anchor, BallMotionMode, BallMotionState, FitRay, MotionFit, fit_motion, mix,
};
use super::ray::BallRay;
use nalgebra::Matrix3;

use crate::math;
use crate::stamp::Stamp;

/// Most hypotheses after an image. Those of the last images are kept in any case: their first rays tell little.
const HYPOTHESES_MAX: usize = 6;
/// Rays of a path after which only its probability keeps it.
const YOUNG_RAYS: usize = 4;
/// Probability that the path before was wrong, so that a new one begins anywhere.
const ANYWHERE_PROBABILITY: f64 = 0.1;
/// Standard deviation of the place of an impact between two images, metres, and of the speed that carries it on in a gap.
const IMPACT_STD: f64 = 0.12;
const GAP_SPEED_STD: f64 = 3.0;

/// The ball's state by the probabilities of all hypotheses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackedFlight {
    /// Probability that the ball is in the air.
    pub airborne_probability: f32,
    /// State of the most probable path through the air, at the last ray's time.
    pub flight: Option<BallMotionState>,
    /// State of the most probable path on the ground, at the last ray's time.
    pub ground: Option<BallMotionState>,
    /// Rays of the most probable path.
    pub rays: usize,
}

/// A kind of path since a ray.
#[derive(Debug, Clone, Copy)]
struct Hypothesis {
    mode: BallMotionMode,
    /// Number of its first ray, counted from the tracker's first.
    first: usize,
    /// Logarithm of the probability of all rays and of this explanation, up to a common constant.
    log_probability: f64,
    /// Where it began, by the path before it. None if that is unknown or long ago.
    anchor: Option<Anchor>,
    fit: MotionFit,
}

/// Follows one ball from image to image, in a frame that is fixed to the ground.
#[derive(Debug, Clone)]
pub struct FlightTracker {
    config: FlightConfig,
    rays: Vec<FitRay>,
    /// Number of the first stored ray.
    first: usize,
    hypotheses: Vec<Hypothesis>,
}

impl FlightTracker {
    /// A tracker that has seen nothing.
    pub fn new(config: FlightConfig) -> Self {
        FlightTracker {
            config,
            rays: Vec::new(),
            first: 0,
            hypotheses: Vec::new(),
        }
    }

    /// Forgets everything: the frame has changed.
    pub fn reset(&mut self) {
        self.rays.clear();
        self.hypotheses.clear();
        self.first = 0;
    }

    /// Adds the ray of an image; None if it is not finite. Rays out of order are ignored.
    pub fn update(&mut self, ray: &BallRay) -> Option<TrackedFlight> {
        let numbers = [
            ray.origin[0],
            ray.origin[1],
            ray.origin[2],
            ray.azimuth,
            ray.elevation,
        ];
        let stds = [ray.azimuth_std, ray.elevation_std];
        if !(numbers.iter().all(|value| value.is_finite())
            && stds.iter().all(|std| *std > 0.0 && std.is_finite()))
        {
            return None;
        }
        if let Some(last) = self.rays.last() {
            let gap = last.ray.stamp.seconds_until(ray.stamp) as f32;
            if gap <= 0.0 && gap > -self.config.gap_max {
                return None;
            }
            if gap.abs() > self.config.gap_max {
                self.reset();
            }
        }
        self.rays.push(FitRay {
            ray: *ray,
            robot: 0,
            bias_std: [self.config.bearing_bias_std_deg.to_radians(); 2],
        });
        let next = self.first + self.rays.len();
        let parents = std::mem::take(&mut self.hypotheses);
        let stays = math::ln(1.0 - f64::from(self.config.change_probability));
        let mut hypotheses: Vec<Hypothesis> = parents
            .iter()
            .filter_map(|parent| self.extend(parent, stays))
            .collect();
        let newest = &self.rays[self.rays.len() - 1..];
        let origin = [ray.origin[0], ray.origin[1]].map(f64::from);
        let parent = parents
            .iter()
            .max_by(|a, b| a.log_probability.total_cmp(&b.log_probability));
        let anchor = parent.and_then(|parent| self.anchor_after(parent, ray.stamp, origin));
        let changes = match parent {
            Some(parent) => {
                parent.log_probability + math::ln(f64::from(self.config.change_probability))
            }
            None => 0.0,
        };
        let airborne = f64::from(self.config.airborne_probability);
        for (mode, kind) in [
            (BallMotionMode::Ground, 1.0 - airborne),
            (BallMotionMode::Flight, airborne),
        ] {
            let begins = [
                (
                    None,
                    if anchor.is_some() {
                        ANYWHERE_PROBABILITY
                    } else {
                        1.0
                    },
                ),
                (anchor, 1.0 - ANYWHERE_PROBABILITY),
            ];
            for (anchor, probability) in &begins[..1 + usize::from(anchor.is_some())] {
                let alone = match anchor {
                    Some(anchor) => fit_motion(&[], Some(anchor), mode, None, &self.config),
                    None => None,
                };
                let before = alone.map_or(0.0, |alone| alone.log_evidence);
                if let Some(fit) = fit_motion(newest, anchor.as_ref(), mode, None, &self.config) {
                    hypotheses.push(Hypothesis {
                        mode,
                        first: next - 1,
                        log_probability: changes + math::ln(kind * probability) + fit.log_evidence
                            - before,
                        anchor: *anchor,
                        fit,
                    });
                }
            }
        }
        self.hypotheses = kept(hypotheses, next);
        self.drop_old_rays(next);
        self.tracked()
    }

    /// The hypothesis that the last ray belongs to the same path.
    fn extend(&self, parent: &Hypothesis, stays: f64) -> Option<Hypothesis> {
        let (mut first, mut before) = (parent.first, parent.fit.log_evidence);
        let mut anchor = parent.anchor;
        let count = self.first + self.rays.len() - first;
        let earlier = self.rays.len() - 1;
        if count > self.config.images_max {
            // The oldest ray is forgotten; the ratio of two fits is then the probability of the newest one.
            first += 1;
            anchor = None;
            let rays = &self.rays[first - self.first..earlier];
            let start = Some(parent.fit.state.state);
            before = fit_motion(rays, None, parent.mode, start, &self.config)?.log_evidence;
        }
        let rays = &self.rays[first - self.first..];
        let seconds = self.rays[earlier - 1]
            .ray
            .stamp
            .seconds_until(self.rays[earlier].ray.stamp);
        let at = parent
            .fit
            .state
            .position(parent.mode, seconds, &self.config);
        let [_, _, _, vx, vy, vz] = parent.fit.state.state;
        let start = Some([at[0], at[1], at[2], vx, vy, vz]);
        let fit = fit_motion(rays, anchor.as_ref(), parent.mode, start, &self.config)?;
        Some(Hypothesis {
            mode: parent.mode,
            first,
            log_probability: parent.log_probability + stays + fit.log_evidence - before,
            anchor,
            fit,
        })
    }

    /// Where a new path begins if `parent` ended between its last ray and now.
    fn anchor_after(&self, parent: &Hypothesis, stamp: Stamp, centre: [f64; 2]) -> Option<Anchor> {
        let state = &parent.fit.state;
        let seconds = state.stamp.seconds_until(stamp);
        let mut at = state.position(parent.mode, seconds, &self.config);
        at[2] = at[2].max(f64::from(self.config.ball_radius));
        let p = &state.covariance;
        let spread = math::hypot(IMPACT_STD, GAP_SPEED_STD * (seconds - 0.04).max(0.0));
        let covariance = Matrix3::from_fn(|row, column| {
            // Position and velocity at the ray before, carried on.
            p[(row, column)]
                + seconds * (p[(row, column + 3)] + p[(row + 3, column)])
                + seconds * seconds * p[(row + 3, column + 3)]
                + if row == column { spread * spread } else { 0.0 }
        });
        Anchor::new(stamp, at, covariance, centre)
    }

    fn drop_old_rays(&mut self, next: usize) {
        let oldest = self.hypotheses.iter().map(|hypothesis| hypothesis.first);
        let oldest = oldest.min().unwrap_or(next);
        self.rays.drain(..oldest - self.first);
        self.first = oldest;
    }

    fn tracked(&self) -> Option<TrackedFlight> {
        let most = |mode: Option<BallMotionMode>| {
            let of_mode = self
                .hypotheses
                .iter()
                .filter(move |hypothesis| mode.is_none_or(|mode| hypothesis.mode == mode));
            of_mode.max_by(|a, b| a.log_probability.total_cmp(&b.log_probability))
        };
        let best = most(None)?;
        let (mut airborne, mut all) = (0.0, 0.0);
        for hypothesis in &self.hypotheses {
            let probability = math::exp(hypothesis.log_probability - best.log_probability);
            all += probability;
            if hypothesis.mode == BallMotionMode::Flight {
                airborne += probability;
            }
        }
        Some(TrackedFlight {
            airborne_probability: (airborne / all) as f32,
            flight: self.mean_state(BallMotionMode::Flight),
            ground: self.mean_state(BallMotionMode::Ground),
            rays: self.first + self.rays.len() - best.first,
        })
    }

    /// Mean and covariance over all paths of a kind, weighted by their probabilities.
    fn mean_state(&self, mode: BallMotionMode) -> Option<BallMotionState> {
        let of_mode: Vec<&Hypothesis> = self
            .hypotheses
            .iter()
            .filter(|hypothesis| hypothesis.mode == mode)
            .collect();
        let states = of_mode
            .iter()
            .map(|hypothesis| (hypothesis.log_probability, hypothesis.fit.state));
        mix(states)
    }
}

/// The most probable hypotheses and the young ones, with the largest probability at 1.
fn kept(mut hypotheses: Vec<Hypothesis>, next: usize) -> Vec<Hypothesis> {
    hypotheses.sort_by(|a, b| {
        b.log_probability
            .total_cmp(&a.log_probability)
            .then(b.first.cmp(&a.first))
    });
    let best = hypotheses
        .first()
        .map_or(0.0, |hypothesis| hypothesis.log_probability);
    let mut place = 0;
    hypotheses.retain_mut(|hypothesis| {
        hypothesis.log_probability -= best;
        place += 1;
        place <= HYPOTHESES_MAX || next - hypothesis.first <= YOUNG_RAYS
    });
    hypotheses
}
