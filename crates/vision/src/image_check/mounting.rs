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
const MEMORY: f32 = 240.0;
/// Images of a moving robot before the memory is trusted.
const IMAGES_MIN: u32 = 60;
/// Mean direction of the robot's axis in the remembered images, at most: 0 if it pointed everywhere, 1 if it never turned. It turned by 110° and
/// more below this limit.
const MEAN_DIRECTION_MAX: f32 = 0.5;
/// A part of a robot that did not turn so far is a rod: narrower than so many angles (22°), and in so many neighbouring radii. Walls and the
/// carpet's end stay in place as well.
const ROD_WIDTH_MAX: usize = ANGLES / 16;
const ROD_RADII_MIN: usize = 4;
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
/// An image shows a place of the parts if landmarks differ by this factor less there than at another place.
const RATIO_MIN: f32 = 2.0;
/// Share of the landmarks that must stand out at the turned place, too, from the median of their radius: in what covers most of a radius, or
/// in a dark part of an image that is too bright, each place looks like a dark rod.
const SHOWN_MIN: f32 = 0.8;
/// A turn is believed if so many of the last 32 images show it, and none after them the parts in place.
const CONFIRMATIONS: u32 = 6;

/// What one image says of the camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Verdict {
    /// The robot's parts are where they were, or not known yet.
    InPlace,
    /// Nothing: the robot stands, or its parts fit neither place.
    Undecided,
    /// Degrees counter-clockwise in the image: 90, 180 or 270.
    Turned(u32),
}

/// A turn of the camera in its mount, or of the mirror with it.
#[derive(Debug, Clone, Copy)]
struct Turn {
    /// Counter-clockwise, quarters.
    quarter: usize,
    pivot: Pivot,
}

/// The point of the image that stays in place.
#[derive(Debug, Clone, Copy)]
enum Pivot {
    Mirror,
    Camera,
}

/// What stays in place in the images of one camera.
#[derive(Debug, Clone)]
pub(super) struct MountingCheck {
    pixels: Vec<Option<[u16; 2]>>,
    /// Twice the column and row of the image's centre: a camera turns about its own axis, not about the mirror's.
    twice_centre_px: [i32; 2],
    /// For one to three quarter turns about the image's centre: the sample nearest to where a sample's content was before.
    camera_sources: [Vec<Option<usize>>; 3],
    mean: Vec<f32>,
    variance: Vec<f32>,
    levels: Vec<f32>,
    images: u32,
    /// Mean of (cos 2θ, sin 2θ) over the images: a half of the field that is found later does not change it.
    mean_direction: [f32; 2],
    /// The turn that is suspected, degrees, and which of the last images show it: a bit each, the latest is the lowest.
    suspected_deg: u32,
    votes: u32,
}

impl MountingCheck {
    pub(super) fn new(map: &GroundMap, camera: &CameraConfig) -> Self {
        let [u, v] = camera.centre_px;
        let side = map.width_px.min(map.height_px) as f32;
        let outer = camera.outer_radius_px.unwrap_or(side / 2.0);
        let pixels: Vec<Option<[u16; 2]>> = (0..ANGLES * RADII)
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
        let twice_centre_px = [map.width_px, map.height_px].map(|size| size as i32 - 1);
        let camera_sources = [1, 2, 3].map(|quarter| {
            let source = |pixel: &Option<[u16; 2]>| {
                let [column, row] = turned_px(twice_centre_px, (*pixel)?, 4 - quarter)?;
                let [x, y] = [f32::from(column) - u, v - f32::from(row)];
                nearest_sample(math::hypot(x, y) / outer, math::atan2(y, x))
            };
            pixels.iter().map(source).collect()
        });
        MountingCheck {
            pixels,
            twice_centre_px,
            camera_sources,
            mean: vec![0.0; ANGLES * RADII],
            variance: vec![0.0; ANGLES * RADII],
            levels: vec![0.0; ANGLES * RADII],
            images: 0,
            mean_direction: [1.0, 0.0],
            suspected_deg: 0,
            votes: 0,
        }
    }

    /// The next image does not follow the last: what was suspected before says nothing about it.
    pub(super) fn restart_run(&mut self) {
        self.votes = 0;
    }

    /// The turn that enough of the last images have shown, degrees counter-clockwise in the image.
    pub(super) fn turn_deg(&self) -> Option<u32> {
        (self.votes.count_ones() >= CONFIRMATIONS).then_some(self.suspected_deg)
    }

    /// Compares an image with what earlier ones had in common. `heading`: of the robot on the field, radians; images without are not
    /// remembered, since whether the robot has turned is not known.
    pub(super) fn update(&mut self, image: &ImageView<'_>, heading: Option<f32>) {
        for (level, pixel) in self.levels.iter_mut().zip(&self.pixels) {
            if let Some(pixel) = pixel {
                *level = brightest_channel(image, *pixel);
            }
        }
        let verdict = self.judge(image);
        self.votes <<= 1;
        match verdict {
            Verdict::InPlace => self.votes = 0,
            Verdict::Turned(turn) if self.votes == 0 || turn == self.suspected_deg => {
                self.suspected_deg = turn;
                self.votes |= 1;
            }
            Verdict::Turned(_) | Verdict::Undecided => {}
        }
        // What is suspected must not be learned.
        if let Some(heading) = heading.filter(|_| self.votes == 0) {
            self.remember(heading);
        }
    }

    fn remember(&mut self, heading: f32) {
        self.images = self.images.saturating_add(1);
        let part = (1.0 / MEMORY).max(1.0 / self.images as f32);
        let (sin, cos) = math::sin_cos(2.0 * heading);
        for (mean, value) in self.mean_direction.iter_mut().zip([cos, sin]) {
            *mean += part * (value - *mean);
        }
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

    fn judge(&self, image: &ImageView<'_>) -> Verdict {
        if self.images < IMAGES_MIN {
            return Verdict::InPlace;
        }
        let seen = |index: &usize| self.pixels[*index].is_some();
        let mut variances: Vec<f32> = (0..self.levels.len())
            .filter(seen)
            .map(|index| self.variance[index])
            .collect();
        if variances.is_empty() {
            return Verdict::Undecided;
        }
        // Of a robot at rest everything stays in place.
        if median(&mut variances) < MOVING_STD * MOVING_STD {
            return Verdict::Undecided;
        }
        let landmarks: Vec<usize> = self.landmarks();
        if landmarks.len() < LANDMARKS_MIN {
            return Verdict::Undecided;
        }
        let turns = (1..4).flat_map(|quarter| {
            [Pivot::Mirror, Pivot::Camera].map(|pivot| Turn { quarter, pivot })
        });
        let difference = |turn: &Turn| self.turned_difference(image, &landmarks, *turn);
        let Some(best) = turns.min_by(|a, b| difference(a).total_cmp(&difference(b))) else {
            return Verdict::Undecided;
        };
        let is_better = |one: f32, other: f32| other > RATIO_MIN * one.max(DIFFERENCE_NOISE);
        if is_better(self.difference_in_place(&landmarks), difference(&best)) {
            return Verdict::InPlace;
        }
        // Rods in four directions look the same after a turn: landmarks that it would change tell.
        let is_changed = |index: &usize| {
            self.source(*index, best).is_some_and(|source| {
                self.pixels[source].is_some()
                    && (self.mean[source] - self.mean[*index]).abs() > LANDMARK_CONTRAST
            })
        };
        let telling: Vec<usize> = landmarks.iter().copied().filter(is_changed).collect();
        let turned = self.turned_difference(image, &telling, best);
        if telling.len() >= LANDMARKS_MIN
            && is_better(turned, self.difference_in_place(&telling))
            && self.shown_share(image, &telling, best) >= SHOWN_MIN
        {
            Verdict::Turned(90 * best.quarter as u32)
        } else {
            Verdict::Undecided
        }
    }

    /// The sample where a sample's content was before a turn.
    fn source(&self, index: usize, turn: Turn) -> Option<usize> {
        match turn.pivot {
            Pivot::Mirror => Some(turned_place(index, 4 - turn.quarter, 0)),
            Pivot::Camera => self.camera_sources[turn.quarter - 1][index],
        }
    }

    /// Mean difference of landmarks from what they were.
    fn difference_in_place(&self, landmarks: &[usize]) -> f32 {
        mean_difference(landmarks, |index| {
            (self.levels[index] - self.mean[index]).abs()
        })
    }

    /// The same after a turn.
    fn turned_difference(&self, image: &ImageView<'_>, landmarks: &[usize], turn: Turn) -> f32 {
        mean_difference(landmarks, |index| {
            let level = self.turned_level(image, index, turn);
            level.map_or(DIFFERENCE_MAX, |level| (level - self.mean[index]).abs())
        })
    }

    /// What the image shows of a sample's content after a turn, as near to it as a step of the angle allows. None outside the image.
    fn turned_level(&self, image: &ImageView<'_>, index: usize, turn: Turn) -> Option<f32> {
        match turn.pivot {
            // Exact to a sample.
            Pivot::Mirror => [ANGLES - 1, 0, 1]
                .map(|beside| turned_place(index, turn.quarter, beside))
                .into_iter()
                .filter(|&turned| self.pixels[turned].is_some())
                .map(|turned| self.levels[turned])
                .min_by(|a, b| {
                    let difference = |level: &f32| (level - self.mean[index]).abs();
                    difference(a).total_cmp(&difference(b))
                }),
            Pivot::Camera => self.pixels[index]
                .and_then(|pixel| turned_px(self.twice_centre_px, pixel, turn.quarter))
                .map(|pixel| brightest_channel(image, pixel)),
        }
    }

    /// Share of landmarks that are darker or brighter than the median of their radius after a turn as well as before.
    fn shown_share(&self, image: &ImageView<'_>, landmarks: &[usize], turn: Turn) -> f32 {
        let medians = |values: &[f32]| -> Vec<f32> {
            let rings = values.chunks_exact(ANGLES);
            rings.map(|ring| median(&mut ring.to_vec())).collect()
        };
        let (before, now) = (medians(&self.mean), medians(&self.levels));
        let is_shown = |index: &&usize| {
            let ring = **index / ANGLES;
            let contrast = self.mean[**index] - before[ring];
            self.turned_level(image, **index, turn)
                .is_some_and(|level| {
                    (level - now[ring]) * contrast.signum() > 0.5 * LANDMARK_CONTRAST
                })
        };
        landmarks.iter().filter(is_shown).count() as f32 / landmarks.len().max(1) as f32
    }

    /// Samples that stay the same while others change, and differ from the median of their radius.
    fn landmarks(&self) -> Vec<usize> {
        let mut landmarks = Vec::new();
        for ring in 0..RADII {
            let ring = ring * ANGLES..(ring + 1) * ANGLES;
            let median = median(&mut self.mean[ring.clone()].to_vec());
            landmarks.extend(ring.filter(|&index| {
                self.pixels[index].is_some()
                    && self.variance[index] < STATIC_STD * STATIC_STD
                    && (self.mean[index] - median).abs() > LANDMARK_CONTRAST
            }));
        }
        let [cos, sin] = self.mean_direction;
        let has_turned = math::hypot(cos, sin) <= MEAN_DIRECTION_MAX;
        if has_turned {
            landmarks
        } else {
            rods(&landmarks)
        }
    }
}

/// Those of the landmarks that are narrow and continue over several radii, as rods do. A side of the hall, or of the carpet's end, is wide or
/// has one radius.
fn rods(landmarks: &[usize]) -> Vec<usize> {
    let mut is_narrow = vec![false; ANGLES * RADII];
    for &index in landmarks {
        is_narrow[index] = true;
    }
    for ring in is_narrow.chunks_exact_mut(ANGLES) {
        let wide: Vec<usize> = (0..ANGLES)
            .filter(|&start| (0..ROD_WIDTH_MAX).all(|beside| ring[(start + beside) % ANGLES]))
            .collect();
        for start in wide {
            for beside in 0..ROD_WIDTH_MAX {
                ring[(start + beside) % ANGLES] = false;
            }
        }
    }
    let is_shown = |ring: usize, angle: usize| {
        [ANGLES - 1, 0, 1]
            .iter()
            .any(|beside| is_narrow[ring * ANGLES + (angle + beside) % ANGLES])
    };
    let is_long = |index: usize| {
        let (ring, angle) = (index / ANGLES, index % ANGLES);
        let inward = (0..ring).rev().take_while(|&ring| is_shown(ring, angle));
        let outward = (ring + 1..RADII).take_while(|&ring| is_shown(ring, angle));
        1 + inward.count() + outward.count() >= ROD_RADII_MIN
    };
    let narrow = landmarks.iter().filter(|&&index| is_narrow[index]);
    narrow.copied().filter(|&index| is_long(index)).collect()
}

/// The sample nearest to a radius (share of the mirror's) and an angle; None outside the samples.
fn nearest_sample(radius: f32, angle: f32) -> Option<usize> {
    let [near, far] = RADIUS_RANGE;
    let ring = ((radius - near) / (far - near) * (RADII - 1) as f32).round();
    let turns = angle / std::f32::consts::TAU * ANGLES as f32;
    let inside = (0.0..RADII as f32).contains(&ring);
    inside
        .then(|| ring as usize * ANGLES + (turns.round() as i32).rem_euclid(ANGLES as i32) as usize)
}

/// Where a pixel is after counter-clockwise quarter turns about the image's centre; None outside the image.
fn turned_px([cu, cv]: [i32; 2], pixel: [u16; 2], quarter: usize) -> Option<[u16; 2]> {
    let (mut du, mut dv) = (2 * i32::from(pixel[0]) - cu, 2 * i32::from(pixel[1]) - cv);
    for _ in 0..quarter {
        (du, dv) = (dv, -du);
    }
    let inside = du.abs() <= cu && dv.abs() <= cv;
    inside.then(|| [(cu + du) / 2, (cv + dv) / 2].map(|at| at as u16))
}

/// The place of a sample after quarter turns about the mirror's axis, and so many angles beside it.
fn turned_place(index: usize, quarter: usize, beside: usize) -> usize {
    let (ring, angle) = (index / ANGLES, index % ANGLES);
    ring * ANGLES + (angle + quarter * ANGLES / 4 + beside) % ANGLES
}

/// The upper median of at least one value.
fn median(values: &mut [f32]) -> f32 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f32::total_cmp).1
}

/// Mean of limited differences over some samples.
fn mean_difference(samples: &[usize], difference: impl Fn(usize) -> f32) -> f32 {
    let limited = samples
        .iter()
        .map(|&index| difference(index).min(DIFFERENCE_MAX));
    limited.sum::<f32>() / samples.len().max(1) as f32
}

/// The brightest channel of a pixel, or the brightness of an image in YUV.
pub(super) fn brightest_channel(image: &ImageView<'_>, [column, row]: [u16; 2]) -> f32 {
    let [r, g, b] = image.native_channels(usize::from(column), usize::from(row));
    let yuv = image.format.is_yuv();
    f32::from(if yuv { r } else { r.max(g).max(b) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::PixelFormat;

    const SIDE: usize = 120;

    /// Rods to three or four sides about an axis beside the image's centre, on a floor that changes.
    fn picture(view: usize, rods: usize) -> Vec<u8> {
        let axis = [63i32, 56];
        let mut pixels = vec![0; 3 * SIDE * SIDE];
        for (index, pixel) in pixels.chunks_exact_mut(3).enumerate() {
            let (u, v) = (
                (index % SIDE) as i32 - axis[0],
                (index / SIDE) as i32 - axis[1],
            );
            let is_rod = rods > 0 && (v.abs() <= 3 || u.abs() <= 3 && (v < 0 || rods == 4));
            let floor = 110 + 60 * ((u / 12 + v / 12 + view as i32 * 5).rem_euclid(3)) as u8;
            pixel.fill(if is_rod { 20 } else { floor.min(240) });
        }
        pixels
    }

    /// Image right becomes image up.
    fn turned(straight: &[u8]) -> Vec<u8> {
        let mut pixels = vec![0; straight.len()];
        for (row, column) in (0..SIDE).flat_map(|row| (0..SIDE).map(move |at| (row, at))) {
            let (to_row, to_column) = (SIDE - 1 - column, row);
            pixels[3 * (to_row * SIDE + to_column)..][..3]
                .copy_from_slice(&straight[3 * (row * SIDE + column)..][..3]);
        }
        pixels
    }

    /// The turn that is named after one more image of a robot whose heading was last known before.
    fn view(pixels: &[u8], check: &mut MountingCheck) -> Option<u32> {
        view_at(pixels, check, None)
    }

    fn view_at(pixels: &[u8], check: &mut MountingCheck, heading: Option<f32>) -> Option<u32> {
        let image = ImageView::packed(SIDE, SIDE, PixelFormat::Rgb8, pixels);
        check.update(&image, heading);
        check.turn_deg()
    }

    /// The check after enough images of a robot that moves and turns.
    fn warm_check(rods: usize) -> MountingCheck {
        warm_check_of(|number| picture(number, rods), 3.0)
    }

    /// The same for any pictures and turns, radians.
    fn warm_check_of(picture: impl Fn(usize) -> Vec<u8>, turned: f32) -> MountingCheck {
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
        let count = IMAGES_MIN as usize + 20;
        for number in 0..count {
            let heading = Some(turned * number as f32 / count as f32);
            let named = view_at(&picture(number), &mut check, heading);
            assert_eq!(named, None, "{number}");
        }
        check
    }

    #[test]
    fn a_camera_that_turns_about_its_own_axis_is_noticed_though_rods_look_alike() {
        for rods in [3, 4] {
            let mut check = warm_check(rods);
            let numbers = 100..100 + CONFIRMATIONS as usize;
            let named: Vec<Option<u32>> = numbers
                .map(|number| view(&turned(&picture(number, rods)), &mut check))
                .collect();
            assert_eq!(named.last(), Some(&Some(90)), "{rods} rods");
        }
    }

    /// A hall with a dark side, far from a robot with a round body that drives without turning.
    fn hall(view: usize) -> Vec<u8> {
        let mut pixels = picture(view, 0);
        for (index, pixel) in pixels.chunks_exact_mut(3).enumerate() {
            let (u, v) = ((index % SIDE) as f32 - 63.0, (index / SIDE) as f32 - 56.0);
            if math::hypot(u, v) > 30.0 {
                pixel.fill(if u > v.abs() { 40 } else { 150 });
            }
        }
        pixels
    }

    #[test]
    fn hall_of_a_robot_that_does_not_turn_is_no_part_of_it() {
        let check = warm_check_of(hall, 0.5);
        // The robot is carried, and turned.
        let named = |mut check: MountingCheck| {
            let numbers = 100..100 + 4 * CONFIRMATIONS as usize;
            numbers
                .filter_map(|number| view(&turned(&hall(number)), &mut check))
                .count()
        };
        assert_eq!(named(check), 0);
        // A hall that turned with the robot would be one.
        assert!(named(warm_check_of(hall, 3.0)) > 0);
    }

    #[test]
    fn too_bright_images_of_which_most_is_covered_show_no_turn() {
        let mut check = warm_check(3);
        for number in 0..30 {
            let mut pixels: Vec<u8> = picture(number, 3)
                .iter()
                .map(|level| level.saturating_mul(6))
                .collect();
            for (index, pixel) in pixels.chunks_exact_mut(3).enumerate() {
                let (u, v) = ((index % SIDE) as f32 - 63.0, (index / SIDE) as f32 - 56.0);
                if math::atan2(v, u) > -1.0 {
                    pixel.fill(18);
                }
            }
            assert_eq!(view(&pixels, &mut check), None, "{number}");
        }
    }

    #[test]
    fn images_that_decide_nothing_end_no_suspicion_and_one_in_place_does() {
        let grey = vec![70; 3 * SIDE * SIDE];
        let turned_picture = |number: usize| turned(&picture(number, 3));
        let mut check = warm_check(3);
        let mut named = None;
        for number in 0..CONFIRMATIONS as usize {
            view(&grey, &mut check);
            named = view(&turned_picture(number), &mut check);
        }
        assert_eq!(named, Some(90));
        assert_eq!(view(&picture(0, 3), &mut check), None);

        let mut check = warm_check(3);
        for number in 0..4 * CONFIRMATIONS as usize {
            view(&picture(number, 3), &mut check);
            assert_eq!(view(&turned_picture(number), &mut check), None);
        }
    }
}
