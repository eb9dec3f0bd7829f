//! Has the camera been turned? The robot's own parts stay in place in its images while the field moves through them.

use crate::image::ImageView;
use crate::optics::ground_map::GroundMap;
use localize::math;
use localize::robot::CameraConfig;

/// Angles and radii at which an image is read; a quarter turn is a whole number of angles.
const ANGLES: usize = 240;
const RADII: usize = 14;
/// The first and last radius, shares of the mirror's.
const RADIUS_RANGE: [f32; 2] = [0.14, 0.9];
/// Images over which a sample's mean and variance are remembered.
const MEMORY: f32 = 60.0;
/// Images of a moving robot before the memory is trusted.
const IMAGES_MIN: u32 = 60;
/// Standard deviation of a sample that does not move, at most, brightness levels.
const STATIC_STD: f32 = 12.0;
/// Standard deviation of the median sample while the robot moves, at least.
const MOVING_STD: f32 = 9.0;
/// Fewest static samples that differ from the median of their radius.
const LANDMARKS_MIN: usize = 10;
/// Difference from the median of its radius at which a static sample is a landmark, brightness levels.
const LANDMARK_CONTRAST: f32 = 20.0;
/// Largest difference of one landmark, and difference that noise explains, brightness levels.
const DIFFERENCE_MAX: f32 = 60.0;
const DIFFERENCE_NOISE: f32 = 6.0;
/// A turn is believed if landmarks differ by this factor less after it than without it, in this number of images.
const RATIO_MIN: f32 = 2.0;
const CONFIRMATIONS: u32 = 6;

/// What stays in place in the images of one camera.
#[derive(Debug, Clone)]
pub(super) struct MountingCheck {
    pixels: Vec<Option<[u16; 2]>>,
    mean: Vec<f32>,
    variance: Vec<f32>,
    levels: Vec<f32>,
    images: u32,
    suspect: (u32, u32),
}

impl MountingCheck {
    pub(super) fn new(map: &GroundMap, camera: &CameraConfig) -> Self {
        let [u, v] = camera.centre_px;
        let side = map.width_px.min(map.height_px) as f32;
        let outer = camera.outer_radius_px.unwrap_or(side / 2.0);
        let pixels = (0..ANGLES * RADII)
            .map(|index| {
                let angle = std::f32::consts::TAU * (index % ANGLES) as f32 / ANGLES as f32;
                let part = (index / ANGLES) as f32 / (RADII - 1) as f32;
                let [near, far] = RADIUS_RANGE;
                let radius = outer * (near + part * (far - near));
                let (sin, cos) = math::sin_cos(angle);
                let at = [u + radius * cos, v - radius * sin].map(f32::round);
                let inside = (0.0..map.width_px as f32).contains(&at[0])
                    && (0.0..map.height_px as f32).contains(&at[1]);
                inside.then(|| at.map(|pixel| pixel as u16))
            })
            .collect();
        MountingCheck {
            pixels,
            mean: vec![0.0; ANGLES * RADII],
            variance: vec![0.0; ANGLES * RADII],
            levels: vec![0.0; ANGLES * RADII],
            images: 0,
            suspect: (0, 0),
        }
    }

    /// The next image does not follow the last: what was suspected before says nothing about it.
    pub(super) fn restart_run(&mut self) {
        self.suspect = (0, 0);
    }

    /// Compares an image with what earlier ones had in common; the turn in degrees, counter-clockwise in the image.
    pub(super) fn update(&mut self, image: &ImageView<'_>) -> Option<u32> {
        for (level, pixel) in self.levels.iter_mut().zip(&self.pixels) {
            if let Some([column, row]) = pixel {
                let [r, g, b] = image.native_channels(usize::from(*column), usize::from(*row));
                let yuv = image.format.is_yuv();
                *level = f32::from(if yuv { r } else { r.max(g).max(b) });
            }
        }
        let turn = self.most_likely_turn();
        self.suspect = match (turn, self.suspect) {
            (0, _) => (0, 0),
            (turn, (before, count)) if turn == before => (turn, count + 1),
            (turn, _) => (turn, 1),
        };
        if turn == 0 {
            self.remember();
        }
        (self.suspect.1 >= CONFIRMATIONS).then_some(self.suspect.0)
    }

    fn remember(&mut self) {
        self.images = self.images.saturating_add(1);
        let part = (1.0 / MEMORY).max(1.0 / self.images as f32);
        for ((mean, variance), level) in self
            .mean
            .iter_mut()
            .zip(&mut self.variance)
            .zip(&self.levels)
        {
            let difference = level - *mean;
            *mean += part * difference;
            *variance = (1.0 - part) * (*variance + part * difference * difference);
        }
    }

    /// 0, 90, 180 or 270.
    fn most_likely_turn(&self) -> u32 {
        if self.images < IMAGES_MIN {
            return 0;
        }
        let seen = |index: &usize| self.pixels[*index].is_some();
        let mut variances: Vec<f32> = (0..self.levels.len())
            .filter(seen)
            .map(|index| self.variance[index])
            .collect();
        variances.sort_unstable_by(f32::total_cmp);
        // Of a robot at rest everything stays in place.
        if variances
            .get(variances.len() / 2)
            .is_none_or(|&median| median < MOVING_STD * MOVING_STD)
        {
            return 0;
        }
        let landmarks: Vec<usize> = self.landmarks();
        if landmarks.len() < LANDMARKS_MIN {
            return 0;
        }
        let difference = |quarter: usize| {
            let sum: f32 = landmarks
                .iter()
                .map(|&index| {
                    let (ring, angle) = (index / ANGLES, index % ANGLES);
                    // A turn is exact to a sample.
                    let turned = [ANGLES - 1, 0, 1].map(|beside| {
                        ring * ANGLES + (angle + quarter * ANGLES / 4 + beside) % ANGLES
                    });
                    turned
                        .into_iter()
                        .filter(|&turned| self.pixels[turned].is_some())
                        .map(|turned| (self.levels[turned] - self.mean[index]).abs())
                        .fold(DIFFERENCE_MAX, f32::min)
                })
                .sum();
            sum / landmarks.len() as f32
        };
        let in_place = difference(0);
        let (best, least) = (1..4).map(|quarter| (quarter, difference(quarter))).fold(
            (0, f32::MAX),
            |best, next| if next.1 < best.1 { next } else { best },
        );
        if in_place > RATIO_MIN * least.max(DIFFERENCE_NOISE) {
            90 * best as u32
        } else {
            0
        }
    }

    /// Samples that stay the same while others change, and differ from the median of their radius.
    fn landmarks(&self) -> Vec<usize> {
        let mut landmarks = Vec::new();
        for ring in 0..RADII {
            let ring = ring * ANGLES..(ring + 1) * ANGLES;
            let mut means = self.mean[ring.clone()].to_vec();
            let (_, median, _) = means.select_nth_unstable_by(ANGLES / 2, f32::total_cmp);
            landmarks.extend(ring.filter(|&index| {
                self.pixels[index].is_some()
                    && self.variance[index] < STATIC_STD * STATIC_STD
                    && (self.mean[index] - *median).abs() > LANDMARK_CONTRAST
            }));
        }
        landmarks
    }
}
