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
    /// Twice the column and row of the image's centre: a camera turns about its own axis, not about the mirror's.
    twice_centre_px: [i32; 2],
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
            twice_centre_px: [map.width_px, map.height_px].map(|size| size as i32 - 1),
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

    /// The turn that enough images in a row have shown, degrees counter-clockwise in the image.
    pub(super) fn turn_deg(&self) -> Option<u32> {
        (self.suspect.1 >= CONFIRMATIONS).then_some(self.suspect.0)
    }

    /// Compares an image with what earlier ones had in common.
    pub(super) fn update(&mut self, image: &ImageView<'_>) {
        for (level, pixel) in self.levels.iter_mut().zip(&self.pixels) {
            if let Some(pixel) = pixel {
                *level = brightest_channel(image, *pixel);
            }
        }
        let turn = self.most_likely_turn(image);
        self.suspect = match (turn, self.suspect) {
            (0, _) => (0, 0),
            (turn, (before, count)) if turn == before => (turn, count + 1),
            (turn, _) => (turn, 1),
        };
        if turn == 0 {
            self.remember();
        }
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
    fn most_likely_turn(&self, image: &ImageView<'_>) -> u32 {
        if self.images < IMAGES_MIN {
            return 0;
        }
        let seen = |index: &usize| self.pixels[*index].is_some();
        let mut variances: Vec<f32> = (0..self.levels.len())
            .filter(seen)
            .map(|index| self.variance[index])
            .collect();
        if variances.is_empty() {
            return 0;
        }
        let middle = variances.len() / 2;
        let (_, median, _) = variances.select_nth_unstable_by(middle, f32::total_cmp);
        // Of a robot at rest everything stays in place.
        if *median < MOVING_STD * MOVING_STD {
            return 0;
        }
        let landmarks: Vec<usize> = self.landmarks();
        if landmarks.len() < LANDMARKS_MIN {
            return 0;
        }
        let difference = |quarter: &usize| self.turned_difference(image, &landmarks, *quarter);
        let Some(best) = (1..4).min_by(|a, b| difference(a).total_cmp(&difference(b))) else {
            return 0;
        };
        // Rods in four directions look the same after a turn: landmarks that it would change can tell alone.
        let telling: Vec<usize> = landmarks
            .iter()
            .copied()
            .filter(|&index| {
                let other = turned_place(index, best, 0);
                self.pixels[other].is_some()
                    && (self.mean[other] - self.mean[index]).abs() > LANDMARK_CONTRAST
            })
            .collect();
        let fits = |set: &[usize]| {
            let turned = self.turned_difference(image, set, best);
            set.len() >= LANDMARKS_MIN
                && self.difference_in_place(set) > RATIO_MIN * turned.max(DIFFERENCE_NOISE)
        };
        if fits(&landmarks) || fits(&telling) {
            90 * best as u32
        } else {
            0
        }
    }

    /// Mean difference of landmarks from what they were.
    fn difference_in_place(&self, landmarks: &[usize]) -> f32 {
        mean_difference(landmarks, |index| {
            (self.levels[index] - self.mean[index]).abs()
        })
    }

    /// The same after quarter turns about the mirror's axis or about the image's centre, whichever fits better.
    fn turned_difference(&self, image: &ImageView<'_>, landmarks: &[usize], quarter: usize) -> f32 {
        // About the mirror's axis, exact to a sample.
        let about_mirror = mean_difference(landmarks, |index| {
            [ANGLES - 1, 0, 1]
                .map(|beside| turned_place(index, quarter, beside))
                .into_iter()
                .filter(|&turned| self.pixels[turned].is_some())
                .map(|turned| (self.levels[turned] - self.mean[index]).abs())
                .fold(DIFFERENCE_MAX, f32::min)
        });
        let about_camera = mean_difference(landmarks, |index| {
            let place = self.pixels[index].and_then(|pixel| self.turned_px(pixel, quarter));
            place.map_or(DIFFERENCE_MAX, |pixel| {
                (brightest_channel(image, pixel) - self.mean[index]).abs()
            })
        });
        about_mirror.min(about_camera)
    }

    /// Where a pixel is after counter-clockwise quarter turns about the image's centre; None outside the image.
    fn turned_px(&self, pixel: [u16; 2], quarter: usize) -> Option<[u16; 2]> {
        let [cu, cv] = self.twice_centre_px;
        let [mut du, mut dv] = [0, 1].map(|i| 2 * i32::from(pixel[i]) - self.twice_centre_px[i]);
        for _ in 0..quarter {
            (du, dv) = (dv, -du);
        }
        let inside = du.abs() <= cu && dv.abs() <= cv;
        inside.then(|| [(cu + du) / 2, (cv + dv) / 2].map(|at| at as u16))
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

/// The place of a sample after quarter turns about the mirror's axis, and so many angles beside it.
fn turned_place(index: usize, quarter: usize, beside: usize) -> usize {
    let (ring, angle) = (index / ANGLES, index % ANGLES);
    ring * ANGLES + (angle + quarter * ANGLES / 4 + beside) % ANGLES
}

/// Mean of limited differences over some samples.
fn mean_difference(samples: &[usize], difference: impl Fn(usize) -> f32) -> f32 {
    let limited = samples
        .iter()
        .map(|&index| difference(index).min(DIFFERENCE_MAX));
    limited.sum::<f32>() / samples.len().max(1) as f32
}

/// The brightest channel of a pixel, or the brightness of an image in YUV.
fn brightest_channel(image: &ImageView<'_>, [column, row]: [u16; 2]) -> f32 {
    let [r, g, b] = image.native_channels(usize::from(column), usize::from(row));
    let yuv = image.format.is_yuv();
    f32::from(if yuv { r } else { r.max(g).max(b) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::PixelFormat;

    const SIDE: usize = 120;

    /// Rods to three sides about an axis beside the image's centre, on a floor that changes.
    fn picture(view: usize) -> Vec<u8> {
        let axis = [63i32, 56];
        let mut pixels = vec![0; 3 * SIDE * SIDE];
        for (index, pixel) in pixels.chunks_exact_mut(3).enumerate() {
            let (u, v) = (
                (index % SIDE) as i32 - axis[0],
                (index / SIDE) as i32 - axis[1],
            );
            let is_rod = v.abs() <= 3 || u.abs() <= 3 && v < 0;
            let floor = 110 + 60 * ((u / 12 + v / 12 + view as i32 * 5).rem_euclid(3)) as u8;
            pixel.fill(if is_rod { 20 } else { floor.min(240) });
        }
        pixels
    }

    #[test]
    fn a_camera_that_turns_about_its_own_axis_is_noticed_though_rods_look_alike() {
        let map = GroundMap {
            width_px: SIDE,
            height_px: SIDE,
            x: vec![1.0; SIDE * SIDE],
            y: vec![0.0; SIDE * SIDE],
        };
        let camera = CameraConfig {
            width_px: SIDE,
            height_px: SIDE,
            focal_px: None,
            centre_px: [63.0, 56.0],
            height: None,
            forward_deg: 0.0,
            flipped: false,
            outer_radius_px: Some(52.0),
        };
        let mut check = MountingCheck::new(&map, &camera);
        let view = |pixels: &[u8], check: &mut MountingCheck| {
            check.update(&ImageView::packed(SIDE, SIDE, PixelFormat::Rgb8, pixels));
            check.turn_deg()
        };
        for number in 0..IMAGES_MIN as usize + 20 {
            assert_eq!(view(&picture(number), &mut check), None, "{number}");
        }
        let mut turned = Vec::new();
        for number in 100..100 + CONFIRMATIONS as usize {
            let straight = picture(number);
            let mut pixels = vec![0; straight.len()];
            for (row, column) in (0..SIDE).flat_map(|row| (0..SIDE).map(move |at| (row, at))) {
                // Image right becomes image up.
                let (to_row, to_column) = (SIDE - 1 - column, row);
                pixels[3 * (to_row * SIDE + to_column)..][..3]
                    .copy_from_slice(&straight[3 * (row * SIDE + column)..][..3]);
            }
            turned.push(view(&pixels, &mut check));
        }
        assert_eq!(turned.last(), Some(&Some(90)));
    }
}
