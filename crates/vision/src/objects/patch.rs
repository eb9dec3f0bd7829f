//! Pixels around a candidate, in a frame that is the same for every camera, distance and light.
//!
//! Rows lead away from the robot and columns lie across. A step is a fraction of the ball, or a fixed length at an
//! obstacle's foot. Colours are logarithmic and relative to the floor before the candidate, so exposure, colour cast and
//! the carpet's colour cancel (docs/methods.md 4.9). `py/training/patches.py` samples the same patches for training.

use std::sync::LazyLock;

use localize::math;

use crate::image::ImageView;
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
/// Row of an obstacle's foot.
const FOOT_ROW: f32 = 3.0;
/// Added before the logarithm, levels: noise of dark pixels has little effect.
const LOG_OFFSET: f32 = 8.0;
/// Limit of each channel.
const CHANNEL_MAX: f32 = 2.0;

/// Logarithm of each level.
static LOGARITHMS: LazyLock<[f32; 256]> =
    LazyLock::new(|| std::array::from_fn(|level| math::ln(level as f32 + LOG_OFFSET)));

/// Logarithm of a level, see `LOG_OFFSET`.
pub(crate) fn logarithm(level: u8) -> f32 {
    LOGARITHMS[usize::from(level)]
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
            columns: Columns::Metric(OBSTACLE_STEP, range),
        }
    }

    /// View angle of a row.
    fn row_angle(&self, row: usize) -> f32 {
        self.view_angle + (row as f32 - self.origin_row) * self.row_step
    }

    /// Sine and cosine of each column's azimuth.
    fn directions(&self) -> [(f32, f32); SIDE] {
        let (sin, cos) = math::sin_cos(self.azimuth);
        std::array::from_fn(|column| {
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

/// View angle per row of an obstacle's patch at a ground distance, radians: as long as a column is wide.
pub(crate) fn obstacle_row_step(range: f32, height: f32) -> f32 {
    OBSTACLE_STEP / math::hypot(range, height)
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

/// Red, green and blue of a patch's samples, row by row; None outside the image.
pub(crate) type PatchColours = [Option<[u8; 3]>; SAMPLES];

/// Reads a full patch.
pub(crate) fn read_patch(
    image: &ImageView<'_>,
    angles: &ViewAngles,
    frame: &PatchFrame,
) -> PatchColours {
    let directions = frame.directions();
    let ray = angles.ray(frame.azimuth);
    let size_px = [image.width_px, image.height_px];
    let mut colours = [None; SAMPLES];
    for (row, colours) in colours.chunks_exact_mut(SIDE).enumerate() {
        let radius = ray.radius_px(frame.row_angle(row));
        for (colour, &direction) in colours.iter_mut().zip(&directions) {
            *colour = pixel(angles.centre_px, size_px, radius, direction)
                .map(|[u, v]| image.rgb(usize::from(u), usize::from(v)));
        }
    }
    colours
}

/// Pixels of a coarse patch, column and row; [`OUTSIDE`] outside the image.
pub(crate) type CoarsePixels = [[u16; 2]; COARSE_SAMPLES];

/// Marks a sample outside the image.
const OUTSIDE: [u16; 2] = [u16::MAX; 2];

/// Pixels of a coarse patch: every second sample of the patch.
pub(crate) fn coarse_pixels(
    angles: &ViewAngles,
    frame: &PatchFrame,
    size_px: [usize; 2],
) -> CoarsePixels {
    let directions = frame.directions();
    let ray = angles.ray(frame.azimuth);
    let mut pixels = [OUTSIDE; COARSE_SAMPLES];
    for (number, &row) in COARSE.iter().enumerate() {
        let radius = ray.radius_px(frame.row_angle(row));
        for (place, &column) in COARSE.iter().enumerate() {
            let found = pixel(angles.centre_px, size_px, radius, directions[column]);
            pixels[number * COARSE.len() + place] = found.unwrap_or(OUTSIDE);
        }
    }
    pixels
}

/// Pixels of the floor before a ball, inside the image.
pub(crate) fn floor_pixels(pixels: &CoarsePixels) -> impl Iterator<Item = [u16; 2]> + '_ {
    let side = COARSE.len();
    let is_floor =
        move |index: usize| PatchKind::Ball.is_floor(COARSE[index / side], COARSE[index % side]);
    let places = pixels.iter().enumerate();
    places
        .filter(move |&(index, &pixel)| is_floor(index) && pixel != OUTSIDE)
        .map(|(_, &pixel)| pixel)
}

/// Pixels of a coarse patch nearest its origin, inside the image.
pub(crate) fn inner_pixels(pixels: &CoarsePixels) -> impl Iterator<Item = [u16; 2]> {
    let side = COARSE.len();
    let middle = [side / 2 - 1, side / 2];
    let places = middle.map(|row| middle.map(|column| pixels[row * side + column]));
    let inside = |&pixel: &[u16; 2]| pixel != OUTSIDE;
    places.into_iter().flatten().filter(inside)
}

/// Reads a coarse patch.
pub(crate) fn read_coarse_patch(
    image: &ImageView<'_>,
    pixels: &CoarsePixels,
) -> [Option<[u8; 3]>; COARSE_SAMPLES] {
    pixels.map(|pixel| {
        let [u, v] = pixel.map(usize::from);
        (pixel != OUTSIDE).then(|| image.rgb(u, v))
    })
}

/// Pixel at a radius and direction (sine, cosine of the azimuth).
fn pixel(
    centre_px: [f32; 2],
    [width, height]: [usize; 2],
    radius: f32,
    (sin, cos): (f32, f32),
) -> Option<[u16; 2]> {
    let (u, v) = (
        (centre_px[0] + radius * cos + 0.5).floor(),
        (centre_px[1] - radius * sin + 0.5).floor(),
    );
    // Not a number fails as well.
    let inside = u >= 0.0 && v >= 0.0 && u < width as f32 && v < height as f32;
    inside.then_some([u as u16, v as u16])
}

/// What a patch shows; decides which samples are floor before it and what samples outside the image mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum PatchKind {
    /// The ball.
    Ball,
    /// A robot or a person.
    Obstacle,
}

impl PatchKind {
    /// True if a sample belongs to the floor before the candidate.
    fn is_floor(self, row: usize, column: usize) -> bool {
        match self {
            PatchKind::Ball => row < 2 || row < SIDE / 2 && (column == 0 || column == SIDE - 1),
            PatchKind::Obstacle => row < FOOT_ROW as usize,
        }
    }
}

/// Input of a network: channel by channel, row by row.
pub(crate) fn normalize_patch(
    kind: PatchKind,
    colours: &PatchColours,
) -> [f32; CHANNELS * SAMPLES] {
    let floor = |index: usize| kind.is_floor(index / SIDE, index % SIDE);
    normalize(kind, colours, floor)
}

/// As [`normalize_patch`], for a coarse patch.
pub(crate) fn normalize_coarse_patch(
    kind: PatchKind,
    colours: &[Option<[u8; 3]>; COARSE_SAMPLES],
) -> [f32; CHANNELS * COARSE_SAMPLES] {
    let side = COARSE.len();
    let floor = |index: usize| kind.is_floor(COARSE[index / side], COARSE[index % side]);
    normalize(kind, colours, floor)
}

fn normalize<const N: usize, const M: usize>(
    kind: PatchKind,
    colours: &[Option<[u8; 3]>; N],
    is_floor: impl Fn(usize) -> bool,
) -> [f32; M] {
    let logarithms = &*LOGARITHMS;
    let mut floor = [[0u8; N]; 3];
    let mut count = 0;
    // One array for each channel, so that the arithmetic below is vectorised.
    let mut logs = [[0.0f32; N]; 3];
    let mut known = [1.0f32; N];
    for (index, colour) in colours.iter().enumerate() {
        let rgb = colour.unwrap_or([0; 3]);
        for channel in 0..3 {
            logs[channel][index] = logarithms[usize::from(rgb[channel])];
        }
        if kind == PatchKind::Obstacle && colour.is_none() {
            known[index] = 0.0;
        }
        if is_floor(index) {
            for channel in 0..3 {
                floor[channel][count] = rgb[channel];
            }
            count += 1;
        }
    }
    let reference = floor.map(|mut levels| median_logarithm(&mut levels[..count]));
    let reference_range = range(reference);
    let mut input = [0.0; M];
    let [reds, greens, blues] = &logs;
    let (brightness, rest) = input.split_at_mut(N);
    let (relative_range, saturation) = rest.split_at_mut(N);
    for index in 0..N {
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
fn range([a, b, c]: [f32; 3]) -> f32 {
    a.max(b).max(c) - a.min(b).min(c)
}

/// Median of the levels' logarithms; the mean of the middle two of an even number.
fn median_logarithm(levels: &mut [u8]) -> f32 {
    let is_odd = levels.len() % 2 == 1;
    let (before, &mut upper, _) = levels.select_nth_unstable(levels.len() / 2);
    let lower = match before.iter().max() {
        Some(&lower) if !is_odd => lower,
        _ => upper,
    };
    (logarithm(lower) + logarithm(upper)) / 2.0
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A disc of one colour on a floor of another.
    fn disc(floor: [u8; 3], ball: [u8; 3]) -> PatchColours {
        std::array::from_fn(|index| {
            let [row, column] = [index / SIDE, index % SIDE].map(|at| at as f32 - 5.5);
            Some(if row * row + column * column < 7.0 {
                ball
            } else {
                floor
            })
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
        colours[SAMPLES - SIDE..].fill(None);
        let input = normalize_patch(PatchKind::Obstacle, &colours);
        assert!(
            input[SAMPLES - SIDE..SAMPLES]
                .iter()
                .all(|&value| value == 0.0)
        );
    }

    #[test]
    fn median_of_levels_is_that_of_their_logarithms() {
        let mean = (logarithm(20) + logarithm(30)) / 2.0;
        assert!((median_logarithm(&mut [50, 10, 30, 20]) - mean).abs() < 1e-6);
        assert!((median_logarithm(&mut [50, 10, 30]) - logarithm(30)).abs() < 1e-6);
    }
}
