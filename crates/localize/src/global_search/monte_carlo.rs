//! Monte Carlo localization (nubot2013 4): odometry moves particles, line points weight them.
//!
//! The random generator is part of the filter's state and starts from `MonteCarloConfig::seed`. Equal seeds and equal
//! inputs give equal particles.

use rand::rngs::Xoshiro256PlusPlus;
use rand::{RngExt, SeedableRng};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::field::Field;
use crate::frames::{Pose, wrap_angle};
use crate::global_search::branch_and_bound::HeadingPrior;
use crate::matching::distance_field::DistanceField;
use crate::math;
use crate::random::standard_normal;
use crate::sample::LinePoint;

/// Settings of the particle filter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct MonteCarloConfig {
    /// Number of particles (nubot2013 4: 600).
    pub particles: usize,
    /// Number of particles after convergence; equal to `particles` keeps it constant, as the paper does.
    pub particles_min: usize,
    /// σ of eq. 2, metres.
    pub point_std: f32,
    /// Deviation at which a point's error is cut off, in σ. The paper's exponential is unbounded, so that one outlier
    /// could outweigh a hundred points.
    pub deviation_max: f32,
    /// Smallest effective share of the particles after weighting; the likelihood is tempered until it is reached. 0 is
    /// the paper's plain product (eq. 3).
    pub effective_share_min: f32,
    /// Standard deviation of the motion per metre and radian driven.
    pub motion_noise: f32,
    /// Standard deviation of the noise added to resampled positions, metres.
    pub jitter: f32,
    /// Standard deviation of the noise added to resampled headings, degrees.
    pub jitter_deg: f32,
    /// Converged if the standard deviation of the positions is below this, metres.
    pub converged_std: f32,
    /// Converged if also the standard deviation of the headings is below this, degrees.
    pub converged_std_deg: f32,
    /// Smallest share of inliers of the converged pose; below it the particles are redrawn.
    pub inlier_share_min: f32,
    /// Iterations on a single image, which no odometry connects to others.
    pub iterations_max: usize,
    /// Seed of the random generator: equal seeds and samples give equal particles.
    pub seed: u64,
}

impl Default for MonteCarloConfig {
    fn default() -> Self {
        MonteCarloConfig {
            particles: 600,
            particles_min: 600,
            point_std: 0.5,
            deviation_max: 2.5,
            effective_share_min: 0.3,
            motion_noise: 0.1,
            jitter: 0.05,
            jitter_deg: 2.0,
            converged_std: 0.3,
            converged_std_deg: 8.0,
            inlier_share_min: 0.5,
            iterations_max: 100,
            seed: 1,
        }
    }
}

/// Side of a cell of the sensor model's look-up table, metres.
const CELL: f32 = 0.05;

/// Particles weighted at once: eight vector registers of f32.
const LANES: usize = 64;

/// Mean and standard deviations of the particles.
#[derive(Debug, Clone, Copy)]
struct ParticleStatistics {
    mean: Pose,
    /// Metres.
    position_std: f32,
    /// Radians.
    heading_std: f32,
}

/// A set of particles over one field.
#[derive(Debug, Clone)]
pub struct MonteCarlo {
    config: MonteCarloConfig,
    /// (d/σ)²/2 of eq. 2, in units of 1/255 of its cut-off value.
    table: Vec<u8>,
    columns: usize,
    rows: usize,
    half_x: f32,
    half_y: f32,
    particles: Vec<Pose>,
    resampled: Vec<Pose>,
    /// Logarithms of the weights before `temper`, weights after it.
    weights: Vec<f32>,
    /// Seeded by the configuration.
    rng: Xoshiro256PlusPlus,
}

impl MonteCarlo {
    /// Fills the look-up table and seeds the generator; there are no particles yet.
    pub fn new(field: &Field, distances: &DistanceField, config: MonteCarloConfig) -> Self {
        let (half_x, half_y) = field.carpet_half_extent();
        // One ring of cells outside the carpet holds the cut-off value.
        let columns = (2.0 * half_x / CELL).ceil() as usize + 3;
        let rows = (2.0 * half_y / CELL).ceil() as usize + 3;
        let end = 0.5 * config.deviation_max * config.deviation_max;
        let table = (0..columns * rows)
            .map(|k| {
                let (column, row) = (k % columns, k / columns);
                if column == 0 || row == 0 || column == columns - 1 || row == rows - 1 {
                    return u8::MAX;
                }
                let x = (column - 1) as f32 * CELL - half_x;
                let y = (row - 1) as f32 * CELL - half_y;
                let deviation = distances.nearest(x, y).signed_distance / config.point_std;
                (0.5 * deviation * deviation / end * 255.0)
                    .round()
                    .min(255.0) as u8
            })
            .collect();
        MonteCarlo {
            table,
            columns,
            rows,
            half_x,
            half_y,
            particles: Vec::new(),
            resampled: Vec::new(),
            weights: Vec::new(),
            rng: Xoshiro256PlusPlus::seed_from_u64(config.seed),
            config,
        }
    }

    /// The configuration in use.
    pub fn config(&self) -> &MonteCarloConfig {
        &self.config
    }

    /// The particles; empty before the first update.
    pub fn particles(&self) -> &[Pose] {
        &self.particles
    }

    /// Memory of the look-up table, bytes.
    pub fn memory_bytes(&self) -> usize {
        self.table.len()
    }

    /// Removes all particles; the generator's state is kept.
    pub fn reset(&mut self) {
        self.particles.clear();
    }

    /// Draws positions uniformly over the carpet, and headings from the compass (nubot2013 4) or uniformly.
    fn initialise_particles(&mut self, prior: Option<HeadingPrior>) {
        for _ in 0..self.config.particles {
            let x = (self.rng.random::<f32>() * 2.0 - 1.0) * self.half_x;
            let y = (self.rng.random::<f32>() * 2.0 - 1.0) * self.half_y;
            let theta = match prior {
                Some(prior) => prior.heading + prior.std * standard_normal(&mut self.rng),
                None => (self.rng.random::<f32>() * 2.0 - 1.0) * std::f32::consts::PI,
            };
            self.particles.push(Pose::new(x, y, theta));
        }
    }

    /// Motion model P(l | l′, a): moves each particle by odometry (dx, dy, dθ in the robot frame) with its own error.
    pub fn predict(&mut self, motion: [f32; 3]) {
        let [dx, dy, dtheta] = motion;
        let noise = self.config.motion_noise * (math::hypot(dx, dy) + dtheta.abs());
        for particle in &mut self.particles {
            let mut error = || noise * standard_normal(&mut self.rng);
            let (mx, my, mt) = (dx + error(), dy + error(), dtheta + error());
            let (sin, cos) = math::sin_cos(particle.theta + 0.5 * mt);
            *particle = Pose::new(
                particle.x + cos * mx - sin * my,
                particle.y + sin * mx + cos * my,
                particle.theta + mt,
            );
        }
    }

    /// One iteration: weights the particles by the points and resamples; the mean if the particles have converged.
    pub fn update(&mut self, points: &[LinePoint], prior: Option<HeadingPrior>) -> Option<Pose> {
        if self.particles.is_empty() {
            self.initialise_particles(prior);
        }
        self.compute_log_weights(points);
        self.temper();
        self.resample();
        self.converged_mean()
    }

    /// log P(o | l) = Σ −d²/2σ² (eqs 2 and 3), from the table. A point is transformed for `LANES` particles at once.
    fn compute_log_weights(&mut self, points: &[LinePoint]) {
        let end = 0.5 * self.config.deviation_max * self.config.deviation_max;
        let per_cell = 1.0 / CELL;
        // Positions outside are clamped to the ring of cells around the carpet.
        let (right, bottom) = ((self.columns - 1) as f32, (self.rows - 1) as f32);
        self.weights.clear();
        for particles in self.particles.chunks(LANES) {
            let [mut cos, mut sin, mut x0, mut y0] = [[0.0_f32; LANES]; 4];
            for (k, particle) in particles.iter().enumerate() {
                (sin[k], cos[k]) = math::sin_cos(particle.theta);
                x0[k] = (particle.x + self.half_x) * per_cell + 1.0;
                y0[k] = (particle.y + self.half_y) * per_cell + 1.0;
            }
            let mut sums = [0_u32; LANES];
            for point in points {
                let (x, y) = (point.at.x * per_cell, point.at.y * per_cell);
                let mut cells = [0_u32; LANES];
                for k in 0..LANES {
                    let column = (x0[k] + cos[k] * x - sin[k] * y).max(0.0).min(right);
                    let row = (y0[k] + sin[k] * x + cos[k] * y).max(0.0).min(bottom);
                    cells[k] = round_to_u32(row) * self.columns as u32 + round_to_u32(column);
                }
                for (sum, cell) in sums.iter_mut().zip(cells) {
                    *sum += u32::from(self.table[cell as usize]);
                }
            }
            let logs = sums.iter().map(|&sum| -(sum as f32) * end / 255.0);
            self.weights.extend(logs.take(particles.len()));
        }
    }

    /// Turns logarithms into weights, tempered so that the effective number of particles stays large enough.
    fn temper(&mut self) {
        let log_max = self.weights.iter().copied().fold(f32::MIN, f32::max);
        let effective_min = self.config.effective_share_min * self.weights.len() as f32;
        let effective = |power: f32, logs: &[f32]| {
            let (mut sum, mut squares) = (0.0, 0.0);
            for log in logs {
                let weight = math::exp((log - log_max) * power);
                sum += weight;
                squares += weight * weight;
            }
            sum * sum / squares
        };
        let mut power = 1.0;
        for _ in 0..8 {
            if effective(power, &self.weights) >= effective_min {
                break;
            }
            power *= 0.6;
        }
        for log in &mut self.weights {
            *log = math::exp((*log - log_max) * power);
        }
    }

    /// Low-variance resampling: one random number, then equal steps through the cumulated weights.
    fn resample(&mut self) {
        let total: f32 = self.weights.iter().sum();
        let count = self.count();
        let step = total / count as f32;
        let mut mark = self.rng.random::<f32>() * step;
        let mut sum = 0.0;
        let jitter_theta = self.config.jitter_deg.to_radians();
        self.resampled.clear();
        for (particle, weight) in self.particles.iter().zip(&self.weights) {
            sum += weight;
            while mark < sum && self.resampled.len() < count {
                mark += step;
                self.resampled.push(Pose::new(
                    particle.x + self.config.jitter * standard_normal(&mut self.rng),
                    particle.y + self.config.jitter * standard_normal(&mut self.rng),
                    particle.theta + jitter_theta * standard_normal(&mut self.rng),
                ));
            }
        }
        std::mem::swap(&mut self.particles, &mut self.resampled);
    }

    /// Number of particles after resampling; grows with the standard deviation of their positions.
    fn count(&self) -> usize {
        let (most, least) = (self.config.particles, self.config.particles_min);
        if least >= most {
            return most;
        }
        let part = (self.statistics().position_std / (4.0 * self.config.converged_std)).min(1.0);
        least + ((most - least) as f32 * part) as usize
    }

    fn statistics(&self) -> ParticleStatistics {
        let per_particle = 1.0 / self.particles.len().max(1) as f32;
        let (mut x, mut y, mut sin, mut cos) = (0.0, 0.0, 0.0, 0.0);
        for particle in &self.particles {
            x += particle.x * per_particle;
            y += particle.y * per_particle;
            let (s, c) = math::sin_cos(particle.theta);
            sin += s * per_particle;
            cos += c * per_particle;
        }
        let mean = Pose::new(x, y, math::atan2(sin, cos));
        let (mut position, mut heading) = (0.0, 0.0);
        for particle in &self.particles {
            position += ((particle.x - x).powi(2) + (particle.y - y).powi(2)) * per_particle;
            heading += wrap_angle(particle.theta - mean.theta).powi(2) * per_particle;
        }
        ParticleStatistics {
            mean,
            position_std: position.sqrt(),
            heading_std: heading.sqrt(),
        }
    }

    fn converged_mean(&self) -> Option<Pose> {
        let statistics = self.statistics();
        (statistics.position_std < self.config.converged_std
            && statistics.heading_std < self.config.converged_std_deg.to_radians())
        .then_some(statistics.mean)
    }
}

/// The nearest integer to a number of 0 to 2²², in a form that compilers vectorize: added to 2²³, it is the mantissa.
fn round_to_u32(value: f32) -> u32 {
    const SHIFT: f32 = 8_388_608.0;
    (value + SHIFT).to_bits() & 0x007f_ffff
}
