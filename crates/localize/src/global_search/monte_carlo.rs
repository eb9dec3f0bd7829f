//! Monte Carlo localisation (nubot2013 4): where do particles gather that odometry moves and line points weigh?

use rand::rngs::Xoshiro256PlusPlus;
use rand::{RngExt, SeedableRng};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::field::Field;
use crate::frames::{Pose, wrap_angle};
use crate::global_search::branch_and_bound::HeadingPrior;
use crate::matching::distance_field::DistanceField;
use crate::sample::LinePoint;
use crate::synthetic::drive::standard_normal;

/// The particle filter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct MonteCarloConfig {
    /// Particles (nubot2013 4: 600).
    pub particles: usize,
    /// Fewest particles once they have gathered; equal to `particles` keeps their number as the paper does.
    pub particles_min: usize,
    /// σ of eq. 2, metres.
    pub point_std: f32,
    /// Deviation beyond which a point weighs no further, in σ; the paper's exponential has no end, so that a single
    /// outlier could outweigh a hundred points.
    pub deviation_max: f32,
    /// Share of the particles that must go on to count after weighing: the likelihood is tempered until they do.
    /// 0 takes the paper's plain product (eq. 3).
    pub effective_share_min: f32,
    /// Random part of the motion per metre and radian driven.
    pub motion_noise: f32,
    /// Scatter of resampled particles, metres.
    pub jitter: f32,
    /// The same for headings, degrees.
    pub jitter_deg: f32,
    /// Converged when the particles' position spreads less than this, metres.
    pub converged_std: f32,
    /// And their heading less than this, degrees.
    pub converged_std_deg: f32,
    /// Share of inliers that the gathered pose must have, or the particles are scattered anew.
    pub inlier_share_min: f32,
    /// Cycles on the points of a frame that nothing leads to or from.
    pub iterations_max: usize,
    /// Starts the generator: the same seed and samples give the same particles.
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

/// Side of a cell of the look-up sensor model, metres.
const CELL: f32 = 0.05;

/// Particles weighed side by side: eight vector registers of numbers.
const LANES: usize = 64;

/// A set of particles over one field.
#[derive(Debug, Clone)]
pub struct MonteCarlo {
    config: MonteCarloConfig,
    /// (d/σ)²/2 of eq. 2 in 255ths of its end.
    table: Vec<u8>,
    columns: usize,
    rows: usize,
    half_x: f32,
    half_y: f32,
    particles: Vec<Pose>,
    resampled: Vec<Pose>,
    weights: Vec<f32>,
    rng: Xoshiro256PlusPlus,
}

impl MonteCarlo {
    /// Fills the look-up table; no particles yet.
    pub fn new(field: &Field, distances: &DistanceField, config: MonteCarloConfig) -> Self {
        let (half_x, half_y) = field.carpet_half_extent();
        // A ring of cells outside: there a deviation counts in full.
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

    /// The particles; none before the first cycle.
    pub fn particles(&self) -> &[Pose] {
        &self.particles
    }

    /// Memory of the look-up table, bytes.
    pub fn memory_bytes(&self) -> usize {
        self.table.len()
    }

    /// Forgets all particles.
    pub fn reset(&mut self) {
        self.particles.clear();
    }

    /// Positions at random over the field, headings by compass (nubot2013 4) or at random.
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

    /// Motion model P(l | l′, a): every particle is moved by odometry (robot frame) with its own error.
    pub fn predict(&mut self, motion: [f32; 3]) {
        let [dx, dy, turn] = motion;
        let noise = self.config.motion_noise * (dx.hypot(dy) + turn.abs());
        for particle in &mut self.particles {
            let mut off = || noise * standard_normal(&mut self.rng);
            let (mx, my, mt) = (dx + off(), dy + off(), turn + off());
            let (sin, cos) = (particle.theta + 0.5 * mt).sin_cos();
            *particle = Pose::new(
                particle.x + cos * mx - sin * my,
                particle.y + sin * mx + cos * my,
                particle.theta + mt,
            );
        }
    }

    /// One cycle: weigh by the points, resample; the mean once the particles have gathered.
    pub fn update(&mut self, points: &[LinePoint], prior: Option<HeadingPrior>) -> Option<Pose> {
        if self.particles.is_empty() {
            self.initialise_particles(prior);
        }
        self.compute_log_weights(points);
        self.temper();
        self.resample();
        self.converged_mean()
    }

    /// log P(o | l) = Σ −d²/2σ² (eqs 2 and 3), from the table; particles side by side, so that a point is moved to the
    /// field for many of them at once.
    fn compute_log_weights(&mut self, points: &[LinePoint]) {
        let end = 0.5 * self.config.deviation_max * self.config.deviation_max;
        let per_cell = 1.0 / CELL;
        // Through the middle of the ring of cells around the carpet, which stands for all that lies outside.
        let (right, bottom) = ((self.columns - 1) as f32, (self.rows - 1) as f32);
        self.weights.clear();
        for particles in self.particles.chunks(LANES) {
            let [mut cos, mut sin, mut x0, mut y0] = [[0.0_f32; LANES]; 4];
            for (k, particle) in particles.iter().enumerate() {
                (sin[k], cos[k]) = particle.theta.sin_cos();
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

    /// Turns logs into weights, tempered so that enough particles go on to count.
    fn temper(&mut self) {
        let top = self.weights.iter().copied().fold(f32::MIN, f32::max);
        let wanted = self.config.effective_share_min * self.weights.len() as f32;
        let effective = |power: f32, logs: &[f32]| {
            let (mut sum, mut squares) = (0.0, 0.0);
            for log in logs {
                let weight = ((log - top) * power).exp();
                sum += weight;
                squares += weight * weight;
            }
            sum * sum / squares
        };
        let mut power = 1.0;
        for _ in 0..8 {
            if effective(power, &self.weights) >= wanted {
                break;
            }
            power *= 0.6;
        }
        for log in &mut self.weights {
            *log = ((*log - top) * power).exp();
        }
    }

    /// Low-variance resampling: one random number, equal steps through the summed weights.
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

    /// Particles of the next cycle: the more they spread, the more of them.
    fn count(&self) -> usize {
        let (most, least) = (self.config.particles, self.config.particles_min);
        if least >= most {
            return most;
        }
        let (_, position, _) = self.statistics();
        let part = (position / (4.0 * self.config.converged_std)).min(1.0);
        least + ((most - least) as f32 * part) as usize
    }

    /// Mean, standard deviation of position (metres) and of heading (radians).
    fn statistics(&self) -> (Pose, f32, f32) {
        let per_one = 1.0 / self.particles.len().max(1) as f32;
        let (mut x, mut y, mut sin, mut cos) = (0.0, 0.0, 0.0, 0.0);
        for particle in &self.particles {
            x += particle.x * per_one;
            y += particle.y * per_one;
            let (s, c) = particle.theta.sin_cos();
            sin += s * per_one;
            cos += c * per_one;
        }
        let mean = Pose::new(x, y, sin.atan2(cos));
        let (mut position, mut heading) = (0.0, 0.0);
        for particle in &self.particles {
            position += ((particle.x - x).powi(2) + (particle.y - y).powi(2)) * per_one;
            heading += wrap_angle(particle.theta - mean.theta).powi(2) * per_one;
        }
        (mean, position.sqrt(), heading.sqrt())
    }

    fn converged_mean(&self) -> Option<Pose> {
        let (mean, position, heading) = self.statistics();
        (position < self.config.converged_std
            && heading < self.config.converged_std_deg.to_radians())
        .then_some(mean)
    }
}

/// The nearest whole number of one between 0 and 2²², in a way that compilers turn into vectors: added to 2²³, it is
/// the mantissa.
fn round_to_u32(value: f32) -> u32 {
    const SHIFT: f32 = 8_388_608.0;
    (value + SHIFT).to_bits() & 0x007f_ffff
}
