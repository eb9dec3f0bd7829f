//! Pixels around a candidate, in a frame that is the same for every camera, distance and light.
//!
//! Rows lead away from the robot and columns lie across. A step is a fraction of the ball, or a fixed length at an
//! obstacle's foot. Colours are logarithmic and relative to the floor before the candidate, so exposure, colour cast and
//! the carpet's colour cancel (docs/methods.md 4.9). `py/training/patches.py` samples the same patches for training.

use std::sync::LazyLock;

use localize::math;
use wide::bytemuck::cast;
use wide::{f32x4, u32x4};

use crate::image::{ImageView, OUTSIDE};
use crate::objects::view_angles::ViewAngles;

/// Samples of a patch's side.
pub(crate) const SIDE: usize = 12;
/// Samples of a patch.
pub(crate) const SAMPLES: usize = SIDE * SIDE;
/// Channels: brightness, colour difference, saturation; all relative to the floor.
pub(crate) const CHANNELS: usize = 3;
/// Rows and columns of the coarse patch.
pub(crate) const COARSE: [usize; 6] = [0, 2, 4, 7, 9, 11];
/// Samples of a coarse patch.
pub(crate) const COARSE_SAMPLES: usize = COARSE.len() * COARSE.len();

/// Step of a ball's patch, ball radii: the patch spans 4.4 radii.
const BALL_STEP: f32 = 0.4;
/// Step of an obstacle's patch at its foot, metres: the patch is a metre wide.
const OBSTACLE_STEP: f32 = 1.0 / 11.0;
/// Beyond this distance the patch of an obstacle keeps its angles, metres: the networks learned from none that are smaller.
pub(crate) const OBSTACLE_RANGE_MAX: f32 = 6.0;
/// Row of an obstacle's foot.
const FOOT_ROW: f32 = 3.0;
/// Added before the logarithm, levels: noise of dark pixels has little effect.
pub(crate) const LOG_OFFSET: f32 = 8.0;
/// Limit of each channel.
pub(crate) const CHANNEL_MAX: f32 = 2.0;

/// Logarithm of each level.
static LOGARITHMS: LazyLock<[f32; 256]> =
    LazyLock::new(|| std::array::from_fn(|level| math::ln(level as f32 + LOG_OFFSET)));

/// Logarithm of a level, see `LOG_OFFSET`.
pub(crate) fn logarithm(level: u8) -> f32 {
    LOGARITHMS[usize::from(level)]
}

/// Logarithm of each level, for loops that would look the table up for each pixel.
pub(crate) fn logarithms() -> &'static [f32; 256] {
    &LOGARITHMS
}

/// Where a patch lies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PatchFrame {
    /// View angle and azimuth of its origin, radians.
    pub(crate) view_angle: f32,
    pub(crate) azimuth: f32,
    /// View angle per row, radians.
    row_step: f32,
    /// Row of the origin.
    origin_row: f32,
    /// How columns are spaced.
    columns: Columns,
}

/// Spacing of a patch's columns.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Columns {
    /// In azimuth, radians.
    Angular(f32),
    /// In metres across, at a distance in metres.
    Metric(f32, f32),
}

impl PatchFrame {
    /// The patch of a ball whose centre appears at a view angle.
    pub(crate) fn ball(view_angle: f32, azimuth: f32, ball: BallAngles) -> Self {
        PatchFrame {
            view_angle,
            azimuth,
            row_step: BALL_STEP * ball.half_height,
            origin_row: (SIDE - 1) as f32 / 2.0,
            columns: Columns::Angular(BALL_STEP * ball.half_width),
        }
    }

    /// The patch of an obstacle whose foot is at a ground distance, metres.
    pub(crate) fn obstacle(range: f32, azimuth: f32, height: f32) -> Self {
        PatchFrame {
            view_angle: math::atan2(range, height),
            azimuth,
            row_step: obstacle_row_step(range, height),
            origin_row: FOOT_ROW,
            columns: Columns::Metric(OBSTACLE_STEP, range.min(OBSTACLE_RANGE_MAX)),
        }
    }

    /// View angle of a row.
    fn row_angle(&self, row: usize) -> f32 {
        self.view_angle + (row as f32 - self.origin_row) * self.row_step
    }

    /// Direction of each column.
    fn directions(&self) -> Directions<SIDE> {
        let (sin, cos) = math::sin_cos(self.azimuth);
        Directions::new(|column| {
            let place = column as f32 - (SIDE - 1) as f32 / 2.0;
            match self.columns {
                Columns::Angular(step) => math::sin_cos(self.azimuth + place * step),
                // The direction to a point beside the foot: no arc tangent is needed.
                Columns::Metric(step, range) => {
                    let aside = place * step;
                    let length = (range * range + aside * aside).sqrt();
                    (
                        (sin * range + cos * aside) / length,
                        (cos * range - sin * aside) / length,
                    )
                }
            }
        })
    }
}

/// Sines and cosines of the azimuths of some columns, in arrays of their own for vector instructions.
pub(crate) struct Directions<const N: usize> {
    sin: [f32; N],
    cos: [f32; N],
}

impl<const N: usize> Directions<N> {
    /// `direction`: sine and cosine of a column's azimuth.
    pub(crate) fn new(direction: impl FnMut(usize) -> (f32, f32)) -> Self {
        let both: [(f32, f32); N] = std::array::from_fn(direction);
        Directions {
            sin: both.map(|(sin, _)| sin),
            cos: both.map(|(_, cos)| cos),
        }
    }
}

/// View angle per row of an obstacle's patch at a ground distance, radians: as long as a column is wide.
pub(crate) fn obstacle_row_step(range: f32, height: f32) -> f32 {
    OBSTACLE_STEP / math::hypot(range.min(OBSTACLE_RANGE_MAX), height)
}

/// Half the angles that a ball on the ground covers, radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct BallAngles {
    /// In view angle.
    pub(crate) half_height: f32,
    /// In azimuth.
    pub(crate) half_width: f32,
}

impl BallAngles {
    /// Of a ball at a distance, metres.
    pub(crate) fn at(range: f32, ball_radius: f32, viewpoint_height: f32) -> Self {
        let slant = math::hypot(range, viewpoint_height - ball_radius);
        BallAngles {
            half_height: math::asin((ball_radius / slant).min(0.95)),
            half_width: math::asin((ball_radius / range).min(0.95)),
        }
    }
}

/// Colours of a patch's samples, row by row.
#[derive(Debug, Clone)]
pub(crate) struct PatchColours {
    /// Red in the lowest byte, then green and blue; black outside the image.
    rgb: [u32; SAMPLES],
    /// 1 inside the image, 0 outside.
    inside: [f32; SAMPLES],
}

/// Reads a full patch.
pub(crate) fn read_patch(
    image: &ImageView<'_>,
    angles: &ViewAngles,
    frame: &PatchFrame,
) -> PatchColours {
    let directions = frame.directions();
    let ray = angles.ray(frame.azimuth);
    let size_px = [image.width_px, image.height_px];
    let mut pixels = [OUTSIDE; SAMPLES];
    for (row, pixels) in pixels.as_chunks_mut::<SIDE>().0.iter_mut().enumerate() {
        let radius = ray.radius_px(frame.row_angle(row));
        *pixels = pixels_at(angles.centre_px, size_px, radius, &directions);
    }
    let mut rgb = [0; SAMPLES];
    image.read_rgb(&pixels, &mut rgb);
    let inside = pixels.map(|pixel| if pixel == OUTSIDE { 0.0 } else { 1.0 });
    PatchColours { rgb, inside }
}

/// Pixels of a coarse patch, column and row; [`OUTSIDE`] outside the image.
pub(crate) type CoarsePixels = [[u16; 2]; COARSE_SAMPLES];

/// Pixels of a coarse patch: every second sample of the patch.
pub(crate) fn coarse_pixels(
    angles: &ViewAngles,
    frame: &PatchFrame,
    size_px: [usize; 2],
) -> CoarsePixels {
    let directions = frame.directions();
    let ray = angles.ray(frame.azimuth);
    let mut pixels = [OUTSIDE; COARSE_SAMPLES];
    for (row, pixels) in COARSE
        .iter()
        .zip(pixels.as_chunks_mut::<{ COARSE.len() }>().0)
    {
        let radius = ray.radius_px(frame.row_angle(*row));
        let found = pixels_at(angles.centre_px, size_px, radius, &directions);
        *pixels = COARSE.map(|column| found[column]);
    }
    pixels
}

/// Samples of a patch that show the floor before and beside a ball, and before an obstacle; of a coarse patch likewise.
const BALL_FLOOR: [usize; 32] = [
    0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21, 22, 23, 24, 35,
    36, 47, 48, 59, 60, 71,
];
const OBSTACLE_FLOOR: [usize; FOOT_ROW as usize * SIDE] = {
    let mut samples = [0; FOOT_ROW as usize * SIDE];
    let mut index = 0;
    while index < samples.len() {
        samples[index] = index;
        index += 1;
    }
    samples
};
pub(crate) const COARSE_FLOOR: [usize; 10] = [0, 1, 2, 3, 4, 5, 6, 11, 12, 17];
pub(crate) const COARSE_OBSTACLE_FLOOR: [usize; 12] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11];
/// Samples of a coarse patch nearest its origin.
pub(crate) const INNER: usize = 4;
const COARSE_INNER: [usize; INNER] = [14, 15, 20, 21];

/// Pixels of the floor before a ball.
pub(crate) fn floor_pixels(pixels: &CoarsePixels) -> [[u16; 2]; COARSE_FLOOR.len()] {
    COARSE_FLOOR.map(|index| pixels[index])
}

/// Pixels of a coarse patch nearest its origin.
pub(crate) fn inner_pixels(pixels: &CoarsePixels) -> [[u16; 2]; INNER] {
    COARSE_INNER.map(|index| pixels[index])
}

/// Pixels at a radius in some directions, a multiple of [`COLUMNS`] in number.
///
/// Explicit vectors: the compiler computes one pixel after the other, with a branch for those outside the image.
#[inline]
pub(crate) fn pixels_at<const N: usize>(
    centre_px: [f32; 2],
    size_px: [usize; 2],
    radius: f32,
    directions: &Directions<N>,
) -> [[u16; 2]; N] {
    const { assert!(N.is_multiple_of(COLUMNS)) };
    let [centre_u, centre_v] = centre_px.map(f32x4::splat);
    let [width, height] = size_px.map(|size| f32x4::splat(size as f32));
    let radius = f32x4::splat(radius);
    let mut pixels = [OUTSIDE; N];
    let sines = directions.sin.as_chunks().0.iter();
    let cosines = directions.cos.as_chunks().0.iter();
    for ((pixels, &sin), &cos) in pixels.as_chunks_mut().0.iter_mut().zip(sines).zip(cosines) {
        let u = (centre_u + radius * f32x4::from(cos) + 0.5).floor();
        let v = (centre_v - radius * f32x4::from(sin) + 0.5).floor();
        // Not a number fails as well.
        let inside =
            u.simd_ge(f32x4::ZERO) & v.simd_ge(f32x4::ZERO) & u.simd_lt(width) & v.simd_lt(height);
        let [u, v, inside] = [u + LOWEST_BITS, v + LOWEST_BITS, inside].map(cast::<_, u32x4>);
        let words = u & u32x4::splat(0xffff) | v << 16u32 | !inside;
        *pixels = words
            .to_array()
            .map(|word| [word as u16, (word >> 16) as u16]);
    }
    pixels
}

/// Columns at a time.
pub(crate) const COLUMNS: usize = 4;
/// Added to a whole number below 2²³, puts it into the lowest bits.
const LOWEST_BITS: f32 = 8_388_608.0;

/// What a patch shows; decides which samples are floor before it and what samples outside the image mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum PatchKind {
    /// The ball.
    Ball,
    /// A robot or a person.
    Obstacle,
}

/// Room for the floor's samples: whole vector registers of bytes.
const FLOOR_ROOM: usize = 64;

/// Input of a network: channel by channel, row by row.
pub(crate) fn normalize_patch(
    kind: PatchKind,
    colours: &PatchColours,
) -> [f32; CHANNELS * SAMPLES] {
    let floor: &[usize] = match kind {
        PatchKind::Ball => &BALL_FLOOR,
        PatchKind::Obstacle => &OBSTACLE_FLOOR,
    };
    let known = match kind {
        PatchKind::Ball => &[1.0; SAMPLES],
        PatchKind::Obstacle => &colours.inside,
    };
    let logarithms = logarithms();
    // One array for each channel, so that the arithmetic below is vectorised.
    let mut logs = [[0.0f32; SAMPLES]; 3];
    for (index, colour) in colours.rgb.iter().enumerate() {
        let [r, g, b, _] = colour.to_le_bytes();
        logs[0][index] = logarithms[usize::from(r)];
        logs[1][index] = logarithms[usize::from(g)];
        logs[2][index] = logarithms[usize::from(b)];
    }
    // Free places hold the largest level, which no median counts.
    let mut levels = [[u8::MAX; FLOOR_ROOM]; 3];
    for (place, &index) in floor.iter().enumerate() {
        let [r, g, b, _] = colours.rgb[index].to_le_bytes();
        levels[0][place] = r;
        levels[1][place] = g;
        levels[2][place] = b;
    }
    let reference = levels.map(|levels| median_logarithm(&levels, floor.len()));
    let reference_range = range(reference);
    let mut input = [0.0; CHANNELS * SAMPLES];
    let [reds, greens, blues] = &logs;
    let (brightness, rest) = input.split_at_mut(SAMPLES);
    let (relative_range, saturation) = rest.split_at_mut(SAMPLES);
    for index in 0..SAMPLES {
        let here = [reds[index], greens[index], blues[index]];
        let [r, g, b] = [
            here[0] - reference[0],
            here[1] - reference[1],
            here[2] - reference[2],
        ];
        let limit = |value: f32| value.clamp(-CHANNEL_MAX, CHANNEL_MAX) * known[index];
        brightness[index] = limit((r + g + b) / 3.0);
        relative_range[index] = limit(range([r, g, b]));
        saturation[index] = limit(range(here) - reference_range);
    }
    input
}

/// Largest minus smallest channel.
#[inline(always)]
fn range([a, b, c]: [f32; 3]) -> f32 {
    a.max(b).max(c) - a.min(b).min(c)
}

/// Median of the first levels' logarithms; the mean of the middle two of an even number. The others are the largest level.
///
/// The level of a rank is found bit by bit: counting needs no order, and vector instructions count at once.
#[inline(always)]
fn median_logarithm<const ROOM: usize>(levels: &[u8; ROOM], count: usize) -> f32 {
    let below = |level: u8| -> usize {
        let count: u8 = levels.iter().map(|&other| u8::from(other < level)).sum();
        usize::from(count)
    };
    let rank = count / 2;
    let mut upper = 0u8;
    for bit in (0..u8::BITS).rev() {
        let level = upper | 1 << bit;
        if below(level) <= rank {
            upper = level;
        }
    }
    let lower = if count.is_multiple_of(2) && below(upper) == rank {
        let lesser = levels
            .iter()
            .map(|&level| if level < upper { level } else { 0 });
        lesser.fold(0, u8::max)
    } else {
        upper
    };
    (logarithm(lower) + logarithm(upper)) / 2.0
}

#[cfg(test)]
mod tests {
    use super::*;

    impl PatchKind {
        /// True if a sample belongs to the floor before the candidate.
        fn is_floor(self, row: usize, column: usize) -> bool {
            match self {
                PatchKind::Ball => row < 2 || row < SIDE / 2 && (column == 0 || column == SIDE - 1),
                PatchKind::Obstacle => row < FOOT_ROW as usize,
            }
        }
    }

    impl PatchColours {
        /// Colours inside the image by row and column.
        pub(crate) fn of(colour: impl Fn(usize, usize) -> [u8; 3]) -> Self {
            let rgb = std::array::from_fn(|index| {
                let [r, g, b] = colour(index / SIDE, index % SIDE);
                u32::from_le_bytes([r, g, b, 0])
            });
            let inside = [1.0; SAMPLES];
            PatchColours { rgb, inside }
        }
    }

    #[test]
    fn far_patch_of_an_obstacle_keeps_the_angles_of_the_last_distance_that_networks_know() {
        let (last, far) = [OBSTACLE_RANGE_MAX, 2.0 * OBSTACLE_RANGE_MAX]
            .map(|range| PatchFrame::obstacle(range, 0.3, 0.75))
            .into();
        let turned = |frame: PatchFrame| PatchFrame {
            view_angle: last.view_angle,
            ..frame
        };
        assert!(far.view_angle > last.view_angle);
        assert_eq!(turned(far), last);
        let near = PatchFrame::obstacle(OBSTACLE_RANGE_MAX / 2.0, 0.3, 0.75);
        assert!(near.row_step > 1.8 * last.row_step);
    }

    #[test]
    fn pixels_in_lanes_are_the_nearest_ones_inside_the_image() {
        let (centre_px, size_px) = ([20.3, 14.8], [40, 30]);
        let angle = |column: usize| column as f32 * 0.13;
        let directions = Directions::<48>::new(|column| angle(column).sin_cos());
        for radius in [0.0, 7.4, 14.6, 15.3, 19.5, 500.0, f32::NAN, f32::INFINITY] {
            let pixels = pixels_at(centre_px, size_px, radius, &directions);
            for (column, pixel) in pixels.into_iter().enumerate() {
                let (sin, cos) = angle(column).sin_cos();
                let at = [centre_px[0] + radius * cos, centre_px[1] - radius * sin];
                let [u, v] = at.map(|at| (at + 0.5).floor());
                let inside = (0.0..40.0).contains(&u) && (0.0..30.0).contains(&v);
                let nearest = if inside {
                    [u, v].map(|at| at as u16)
                } else {
                    OUTSIDE
                };
                assert_eq!(pixel, nearest, "{radius} {column}");
            }
        }
    }

    /// A disc of one colour on a floor of another.
    fn disc(floor: [u8; 3], ball: [u8; 3]) -> PatchColours {
        PatchColours::of(|row, column| {
            let [row, column] = [row, column].map(|at| at as f32 - 5.5);
            if row * row + column * column < 7.0 {
                ball
            } else {
                floor
            }
        })
    }

    #[test]
    fn normalized_patch_does_not_depend_on_exposure_and_colour_cast() {
        let plain = normalize_patch(PatchKind::Ball, &disc([40, 80, 60], [100, 90, 50]));
        let cast = normalize_patch(PatchKind::Ball, &disc([80, 40, 90], [200, 45, 75]));
        // The third channel is a difference of saturations, which a cast changes.
        for (index, (plain, cast)) in plain.iter().zip(cast).take(2 * SAMPLES).enumerate() {
            // The offset of the logarithm and rounding leave a little.
            assert!((plain - cast).abs() < 0.35, "{index}: {plain} {cast}");
        }
        assert!(plain[0].abs() < 1e-6 && plain[SAMPLES / 2 + SIDE / 2] > 0.1);
    }

    #[test]
    fn samples_outside_the_image_do_not_count_as_obstacle() {
        let mut colours = disc([40, 80, 60], [10, 10, 10]);
        colours.rgb[SAMPLES - SIDE..].fill(0);
        colours.inside[SAMPLES - SIDE..].fill(0.0);
        let input = normalize_patch(PatchKind::Obstacle, &colours);
        assert!(
            input[SAMPLES - SIDE..SAMPLES]
                .iter()
                .all(|&value| value == 0.0)
        );
    }

    #[test]
    fn median_of_levels_is_that_of_their_logarithms() {
        // Against sorting, for many sets of levels, equal ones among them.
        let mut state = 1u32;
        for count in 1..=36 {
            for _ in 0..20 {
                let mut levels = [u8::MAX; 64];
                for level in &mut levels[..count] {
                    state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    *level = (state >> 24) as u8 / 3;
                }
                let mut sorted = levels[..count].to_vec();
                sorted.sort_unstable();
                let (lower, upper) = (sorted[(count - 1) / 2], sorted[count / 2]);
                let expected = (logarithm(lower) + logarithm(upper)) / 2.0;
                assert_eq!(median_logarithm(&levels, count), expected);
            }
        }
        let brightest = [u8::MAX; 16];
        assert_eq!(median_logarithm(&brightest, 3), logarithm(255));
    }

    #[test]
    fn listed_samples_of_a_patch_are_its_floor_and_its_middle() {
        let full: Vec<(usize, usize)> = (0..SAMPLES).map(|i| (i / SIDE, i % SIDE)).collect();
        let side = COARSE.len();
        let coarse = (0..COARSE_SAMPLES).map(|i| (COARSE[i / side], COARSE[i % side]));
        let coarse: Vec<(usize, usize)> = coarse.collect();
        let floor = |kind: PatchKind, places: &[(usize, usize)]| -> Vec<usize> {
            let is_floor = |&index: &usize| kind.is_floor(places[index].0, places[index].1);
            (0..places.len()).filter(is_floor).collect()
        };
        assert_eq!(floor(PatchKind::Ball, &full), BALL_FLOOR);
        assert_eq!(floor(PatchKind::Obstacle, &full), OBSTACLE_FLOOR);
        assert_eq!(floor(PatchKind::Ball, &coarse), COARSE_FLOOR);
        assert_eq!(floor(PatchKind::Obstacle, &coarse), COARSE_OBSTACLE_FLOOR);
        let near = |at: usize| (at as f32 - (SIDE - 1) as f32 / 2.0).abs() < 2.0;
        let inner: Vec<usize> = (0..COARSE_SAMPLES)
            .filter(|&index| near(coarse[index].0) && near(coarse[index].1))
            .collect();
        assert_eq!(inner, COARSE_INNER);
    }
}
