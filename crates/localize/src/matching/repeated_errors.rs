//! How much of the points' errors repeats from image to image? Markings, map and image processing err alike for
//! neighbouring points and in successive images (docs/methods.md 5.9).
//!
//! Such errors are not averaged away. Their share is the covariance of the errors of points that lie in the same cell of
//! the field in successive images, after pose and tilt have explained what they can. Independent errors have none.

use crate::frames::{Pose, wrap_angle};
use crate::math;

/// Side of a cell, metres: errors repeat along a marking about as far.
const CELL: f32 = 1.0;
/// Shift of the cells' edges: markings lie at even coordinates.
const CELL_OFFSET: f32 = 0.383;
/// Cells per axis; the field is larger than no power of two below.
const CELLS: usize = 32;
/// Distance and turn over which errors become independent, metres and radians.
const DISTANCE: f32 = 1.0;
const TURN: f32 = 0.7;
/// Most images that count as one. A robot at rest repeats all errors, but it may be pushed, and must notice.
const IMAGES_MAX: f32 = 60.0;
/// Share by which an image changes the learned values: three seconds.
const RATE: f32 = 0.01;
/// Standard deviations of chance that do not count as repetition.
const SIGNIFICANCE_SIGMAS: f32 = 2.0;
/// Distance beyond which a point is an outlier, standard deviations.
const OUTLIER_SIGMAS: f32 = 3.0;

/// Error of a point that pose and tilt do not explain.
#[derive(Debug, Clone, Copy)]
pub(super) struct Remainder {
    /// The place of the marking nearest to the point, metres, field frame. The point's own place would sort points by the
    /// sign of their error where a marking runs along the edge of two cells.
    pub(super) at: [f32; 2],
    /// Distance from the marking in standard deviations.
    pub(super) sigmas: f32,
    /// Normal of the marking.
    pub(super) normal: [f32; 2],
}

/// Sums over the points of a cell.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct CellSums {
    /// Σ error · normal.
    error: [f32; 2],
    /// Σ normal · normalᵀ: xx, xy, yy.
    normals: [f32; 3],
}

impl CellSums {
    /// Σ of n_i · n_j squared over pairs of points: their number if all belong to one straight marking.
    fn pairs(&self, other: &CellSums) -> f32 {
        let ([a, b, c], [d, e, f]) = (self.normals, other.normals);
        a * d + 2.0 * b * e + c * f
    }
}

/// What of the points' errors repeats.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Repetition {
    /// Share of their variance that repeats, 0 to 1.
    pub share: f32,
    /// Points of one image that have a repeated error in common, at least 1.
    pub cluster: f32,
}

impl Repetition {
    /// Variance of the mean error of an image over that of independent errors.
    pub fn image_factor(self) -> f32 {
        1.0 + self.share * (self.cluster - 1.0)
    }

    /// The same for one of many images of a drive: images close together repeat their errors.
    pub fn sequence_factor(self, from: Pose, to: Pose) -> f32 {
        // Noise with the correlation ρ between images averages like white noise of (1 + ρ)/(1 − ρ) times its variance.
        let correlation = Repetition::correlation(from, to);
        let images = ((1.0 + correlation) / (1.0 - correlation).max(1e-3)).min(IMAGES_MAX);
        1.0 + self.share * (self.cluster * images - 1.0)
    }

    /// Correlation of the repeated errors of two images.
    pub fn correlation(from: Pose, to: Pose) -> f32 {
        let distance = math::hypot(to.x - from.x, to.y - from.y) / DISTANCE
            + wrap_angle(to.theta - from.theta).abs() / TURN;
        math::exp(-distance)
    }

    /// Variance of the repeated part of an image's mean error over that of independent errors.
    pub(super) fn floor_factor(self) -> f32 {
        self.share * self.cluster
    }
}

/// Learned share of the errors' variance that repeats.
#[derive(Debug, Clone)]
pub(super) struct RepeatedErrors {
    cells: Vec<CellSums>,
    previous: Vec<CellSums>,
    used: Vec<u16>,
    previous_used: Vec<u16>,
    /// Means: Σ of products of successive errors, of pairs between images and within one, of squares, of points.
    products: f32,
    pairs: f32,
    own_pairs: f32,
    squares: f32,
    points: f32,
    images: f32,
    pose: Option<Pose>,
}

impl RepeatedErrors {
    pub(super) fn new() -> Self {
        let cells = vec![CellSums::default(); CELLS * CELLS];
        RepeatedErrors {
            previous: cells.clone(),
            cells,
            used: Vec::new(),
            previous_used: Vec::new(),
            products: 0.0,
            pairs: 0.0,
            own_pairs: 0.0,
            squares: 0.0,
            points: 0.0,
            images: 0.0,
            pose: None,
        }
    }

    /// What the images so far say.
    pub(super) fn repetition(&self) -> Repetition {
        let points = self.points.max(1.0);
        let all = (self.squares / points).max(1e-6);
        // Products of independent errors have the variance all² for each pair.
        let images = self.images.clamp(1.0, 2.0 / RATE);
        let chance = SIGNIFICANCE_SIGMAS * all * (self.pairs / images).sqrt();
        let repeated = (self.products - chance) / self.pairs.max(1.0);
        Repetition {
            share: (repeated / all).clamp(0.0, 1.0),
            cluster: (self.own_pairs / points).max(1.0),
        }
    }

    /// Variance of the mean error of an image at `pose` over that of independent errors, as one of many of a drive.
    pub(super) fn sequence_factor(&self, pose: Pose) -> f32 {
        let repetition = self.repetition();
        self.pose.map_or(repetition.image_factor(), |last| {
            repetition.sequence_factor(last, pose)
        })
    }

    /// Takes the errors of an image at `pose`.
    pub(super) fn update(&mut self, remainders: impl Iterator<Item = Remainder>, pose: Pose) {
        std::mem::swap(&mut self.cells, &mut self.previous);
        std::mem::swap(&mut self.used, &mut self.previous_used);
        for place in self.used.drain(..) {
            self.cells[usize::from(place)] = CellSums::default();
        }
        let (mut squares, mut points) = (0.0, 0.0);
        for Remainder { at, sigmas, normal } in remainders {
            if sigmas.abs() > OUTLIER_SIGMAS {
                continue;
            }
            let [column, row] =
                at.map(|value| (value / CELL + CELL_OFFSET).floor() as i32 as usize % CELLS);
            let place = row * CELLS + column;
            let cell = &mut self.cells[place];
            if *cell == CellSums::default() {
                self.used.push(place as u16);
            }
            let [nx, ny] = normal;
            cell.error[0] += sigmas * nx;
            cell.error[1] += sigmas * ny;
            cell.normals[0] += nx * nx;
            cell.normals[1] += nx * ny;
            cell.normals[2] += ny * ny;
            squares += sigmas * sigmas;
            points += 1.0;
        }
        let (mut products, mut pairs, mut own_pairs) = (0.0, 0.0, 0.0);
        for place in &self.used {
            let (cell, before) = (
                &self.cells[usize::from(*place)],
                &self.previous[usize::from(*place)],
            );
            products += cell.error[0] * before.error[0] + cell.error[1] * before.error[1];
            pairs += cell.pairs(before);
            own_pairs += cell.pairs(cell);
        }
        self.images += 1.0;
        let rate = (1.0 / self.images).max(RATE);
        for (mean, value) in [
            (&mut self.products, products),
            (&mut self.pairs, pairs),
            (&mut self.own_pairs, own_pairs),
            (&mut self.squares, squares),
            (&mut self.points, points),
        ] {
            *mean += rate * (value - *mean);
        }
        self.pose = Some(pose);
    }
}

#[cfg(test)]
mod tests {
    use rand::rngs::Xoshiro256PlusPlus;
    use rand::{RngExt, SeedableRng};

    use super::*;
    use crate::random::standard_normal;

    /// Points on lines every two metres, of which each piece of 2.5 m repeats an error of `repeated` sigmas.
    fn learn(repeated: f32) -> RepeatedErrors {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(3);
        let signs: Vec<f32> = (0..20)
            .map(|_| if rng.random::<bool>() { 1.0 } else { -1.0 })
            .collect();
        let mut learned = RepeatedErrors::new();
        for image in 0..300 {
            let remainders: Vec<Remainder> = (0..120)
                .map(|k| {
                    let along = 10.0 * rng.random::<f32>() - 5.0;
                    let line = (k % 5) as f32;
                    let own = (1.0 - repeated * repeated).sqrt() * standard_normal(&mut rng);
                    let place = (0.4 * (along + 5.0)) as usize + 4 * (k % 5);
                    Remainder {
                        at: [along, 2.0 * line - 4.5],
                        sigmas: own + repeated * signs[place],
                        normal: [0.0, 1.0],
                    }
                })
                .collect();
            let pose = Pose::new(0.07 * image as f32, 0.0, 0.0);
            learned.update(remainders.into_iter(), pose);
        }
        learned
    }

    #[test]
    fn independent_errors_do_not_repeat() {
        let learned = learn(0.0);
        assert!(
            learned.repetition().share < 0.01,
            "{}",
            learned.repetition().share
        );
        assert!(
            learned.repetition().image_factor() < 1.05,
            "{}",
            learned.repetition().image_factor()
        );
    }

    #[test]
    fn repeated_errors_are_found_with_their_share() {
        let learned = learn(0.7);
        assert!(
            (learned.repetition().share - 0.49).abs() < 0.15,
            "{}",
            learned.repetition().share
        );
        // Two or three points per metre.
        assert!(
            (1.5..3.5).contains(&learned.repetition().cluster),
            "{}",
            learned.repetition().cluster
        );
        let beside = learned.sequence_factor(Pose::new(21.0, 0.0, 0.0));
        assert!(
            beside > 4.0 * learned.repetition().image_factor(),
            "{beside}"
        );
        let far = learned.sequence_factor(Pose::new(30.0, 0.0, 0.0));
        assert!(far < 1.6 * learned.repetition().image_factor(), "{far}");
    }
}
