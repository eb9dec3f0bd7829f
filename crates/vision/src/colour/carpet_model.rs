//! Colours of carpet and lines in the present light, learned from an image without labels.
//!
//! The carpet is the largest cluster of chromaticity on the ground. Shading scales a colour; glare and lines add light of
//! the lamp's colour. So carpet and lines lie in the plane spanned by carpet and white (dichromatic reflection), and
//! objects of other colours do not.

use localize::math;

use crate::colour::lookup_table::{CELL_LEVELS, ColourClass};
use crate::config::ColourConfig;

/// Colours of carpet and white under the light of one image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CarpetModel {
    /// The carpet's median red, green, blue.
    pub carpet: [f32; 3],
    /// A white line's red, green, blue.
    pub white: [f32; 3],
    /// Standard deviation of a channel on plain carpet, levels.
    pub noise: f32,
    /// True once white was measured on lines; until then white is assumed neutral.
    pub white_measured: bool,
    /// Direction of the carpet's chroma: orthonormal to grey, in coordinates divided by white.
    hue_axis: [f32; 3],
    /// Orthogonal to grey and to `hue_axis`: other hues.
    cross_hue_axis: [f32; 3],
    /// The carpet's chroma divided by its brightness.
    chroma: f32,
    /// Standard deviation of a pixel's chroma on plain carpet, divided by the brightness; the table's cells included.
    chroma_noise: f32,
}

/// Chroma below this fraction of the brightness is a cast of the light: the image is treated as grey.
const CHROMA_MIN: f32 = 0.03;
/// Chroma below this many standard deviations of a pixel's tells carpet from lines less well than brightness does, which loses a tenth
/// of the carpet's pixels: the image is treated as grey, too. Green carpets have 10 to 60, in dim halls too, dark grey ones with a tint
/// 0.5 to 4.
const CHROMA_SIGMAS_MIN: f32 = 5.0;

/// Least chroma of a colour, divided by its brightness: less is a cast or noise.
const SATURATION_MIN: f32 = 0.35;
/// Where brightness decides, a colour differs from carpet and white by so many standard deviations of a pixel's chroma: two of a
/// thousand pixels of a plain carpet do.
const COLOURED_SIGMAS_MIN: f32 = 3.5;

/// Pixels so far apart in their list are compared for the noise: demosaicing and compression make nearer ones alike.
const NOISE_LAG: usize = 4;
/// Share of the carpet's brightness within which a pixel counts as carpet there.
const NOISE_BRIGHTNESS: f32 = 0.4;

/// Darker pixels (sum of the channels, of 765) have an unreliable chromaticity and do not vote.
const VOTE_BRIGHTNESS_MIN: u16 = 60;

/// Noise before it is measured, levels: typical of a camera in sufficient light.
const DEFAULT_NOISE: f32 = 2.0;

/// Bins of the chromaticities r and g: with a width of 1/48 a carpet's noise covers few bins.
const BINS: usize = 48;

impl CarpetModel {
    /// Learns the carpet's colour from pixels of the ground. None if nearly all are too dark.
    ///
    /// Neighbours in the list are neighbours in the image.
    pub fn learn(ground: &[[u8; 3]]) -> Option<Self> {
        let carpet = largest_cluster(ground)?;
        let brightest = carpet.iter().fold(1.0f32, |a, &b| a.max(b));
        // Until lines are detected, white is assumed neutral and brighter than the carpet.
        let white = [(2.0 * brightest).min(255.0); 3];
        let model = CarpetModel::new(carpet, white, DEFAULT_NOISE, false);
        Some(CarpetModel {
            chroma_noise: model.measure_chroma_noise(ground),
            ..model
        })
    }

    /// From the median difference of pixels near each other, which edges do not change; the table's cells included.
    pub(crate) fn measure_chroma_noise(&self, ground: &[[u8; 3]]) -> f32 {
        let level = mean(self.carpet).max(1.0);
        let across = |rgb: [u8; 3]| {
            let rgb = rgb.map(f32::from);
            let is_carpet = (mean(rgb) / level - 1.0).abs() <= NOISE_BRIGHTNESS;
            is_carpet.then(|| dot(rgb, self.cross_hue_axis) / mean(rgb))
        };
        // One pair in so many pixels is enough for a median.
        let pairs = ground.chunks_exact(2 * NOISE_LAG);
        let mut differences: Vec<f32> = pairs
            .filter_map(|pixels| Some((across(pixels[0])? - across(pixels[NOISE_LAG])?).abs()))
            .collect();
        let cell = CELL_LEVELS / 12f32.sqrt() / level;
        if differences.is_empty() {
            return cell;
        }
        let middle = differences.len() / 2;
        let median = *differences.select_nth_unstable_by(middle, f32::total_cmp).1;
        // Half of |N(0, √2 σ)| lies below 0.954 σ.
        math::hypot(median / 0.954, cell)
    }

    fn new(carpet: [f32; 3], white: [f32; 3], noise: f32, white_measured: bool) -> Self {
        let balanced = white_balance(carpet, white);
        let brightness = mean(balanced);
        let off_grey = balanced.map(|channel| channel - brightness);
        let length = dot(off_grey, off_grey).sqrt();
        // The difference of equal channels is rounding, whose direction is not orthogonal to grey.
        let hue_axis = if length > 1e-3 * brightness {
            off_grey.map(|channel| channel / length)
        } else {
            [-0.408_248_3, 0.816_496_6, -0.408_248_3]
        };
        let third = 1.0 / 3f32.sqrt();
        let across = [
            third * (hue_axis[2] - hue_axis[1]),
            third * (hue_axis[0] - hue_axis[2]),
            third * (hue_axis[1] - hue_axis[0]),
        ];
        CarpetModel {
            carpet,
            white,
            noise,
            white_measured,
            hue_axis,
            cross_hue_axis: across,
            chroma: length / brightness.max(1e-6),
            chroma_noise: 0.0,
        }
    }

    /// The same carpet with measured white and noise (levels).
    pub fn with_white(&self, white: [f32; 3], noise: f32) -> Self {
        let white = white.map(|channel| channel.max(1.0));
        CarpetModel {
            chroma_noise: self.chroma_noise,
            ..CarpetModel::new(self.carpet, white, noise, true)
        }
    }

    /// Replaces the colours of carpet and white; keeps noise and `white_measured`.
    pub(crate) fn with_colours(&self, carpet: [f32; 3], white: [f32; 3]) -> Self {
        let white = white.map(|channel| channel.max(1.0));
        CarpetModel {
            chroma_noise: self.chroma_noise,
            ..CarpetModel::new(carpet, white, self.noise, self.white_measured)
        }
    }

    /// True if the carpet is too grey for classification by hue.
    pub fn is_grey(&self) -> bool {
        self.chroma < CHROMA_MIN.max(CHROMA_SIGMAS_MIN * self.chroma_noise)
    }

    /// The carpet's chroma divided by its brightness, at least `CHROMA_MIN`.
    pub(crate) fn carpet_chroma(&self) -> f32 {
        self.chroma.max(CHROMA_MIN)
    }

    /// A colour's brightness (1 for white), its chroma along the carpet's hue, and its chroma across it.
    pub fn chroma_coordinates(&self, rgb: [f32; 3]) -> [f32; 3] {
        let balanced = white_balance(rgb, self.white);
        [
            mean(balanced),
            dot(balanced, self.hue_axis) / self.chroma.max(CHROMA_MIN),
            dot(balanced, self.cross_hue_axis) / self.chroma.max(CHROMA_MIN),
        ]
    }

    /// True if a colour's chroma is neither the carpet's nor white's nor between them, by more than noise and casts of the light.
    pub(crate) fn is_coloured(&self, rgb: [u8; 3]) -> bool {
        let rgb = rgb.map(f32::from);
        let [brightness, along, across] = self.chroma_coordinates(rgb);
        let brightness = brightness.max(1e-6);
        let (share, off) = (along / brightness, across / brightness);
        let carpet_share = self.chroma / self.carpet_chroma();
        let beyond = share - share.clamp(0.0, carpet_share);
        let noise = self.chroma_noise * mean(self.carpet) / mean(rgb).max(1.0);
        math::hypot(beyond, off) * self.carpet_chroma()
            > SATURATION_MIN.max(COLOURED_SIGMAS_MIN * noise)
    }

    /// The same colours with another measured noise of a pixel's chroma.
    pub(crate) fn with_chroma_noise(&self, chroma_noise: f32) -> Self {
        CarpetModel {
            chroma_noise,
            ..*self
        }
    }

    /// Standard deviation of a pixel's chroma on plain carpet, divided by the brightness.
    pub(crate) fn chroma_noise(&self) -> f32 {
        self.chroma_noise
    }

    /// Weights of the channels that separate white from carpet; they sum to 1.
    pub fn channel_weights(&self) -> [f32; 3] {
        let rise: [f32; 3] =
            std::array::from_fn(|i| (self.white[i].min(250.0) - self.carpet[i]).max(0.0));
        let sum: f32 = rise.iter().sum();
        if sum < 1.0 || self.is_grey() {
            return [1.0 / 3.0; 3];
        }
        rise.map(|channel| channel / sum)
    }

    /// Classifies a colour; `ball_hue_deg`: the ball's hue from..to, see [`crate::config::ObjectDetectionConfig`].
    pub fn classify(
        &self,
        rgb: [u8; 3],
        config: &ColourConfig,
        ball_hue_deg: [f32; 2],
    ) -> ColourClass {
        let rgb = rgb.map(f32::from);
        let [brightness, along, across] = self.chroma_coordinates(rgb);
        let [carpet_brightness, ..] = self.chroma_coordinates(self.carpet);
        let relative = brightness / carpet_brightness.max(1e-6);
        // Brighter than midway between carpet and white.
        let bright = brightness > 0.5 * (carpet_brightness + 1.0);
        if self.is_grey() {
            return match relative {
                r if bright && r > 1.2 => ColourClass::WHITE,
                r if r > config.carpet_brightness_min.max(0.4) => ColourClass::CARPET,
                _ => ColourClass::BLACK,
            };
        }
        // Chroma relative to the carpet's at the pixel's brightness.
        let (share, off) = (along / brightness.max(1e-6), across / brightness.max(1e-6));
        if relative < config.carpet_brightness_min {
            return ColourClass::BLACK;
        }
        let slack = config.carpet_hue_tolerance * share.clamp(0.75, 1.25);
        // Noise of a dark grey pixel resembles the carpet's chroma. So the darker the pixel, the closer the threshold is to
        // midway between grey and carpet, which minimises both errors.
        let white = mean(self.white);
        let noise = self.noise / (white * brightness * self.chroma).max(1e-3);
        let least = (config.carpet_chroma_min + 1.5 * noise).min(0.55);
        if share >= least && off.abs() <= slack {
            return ColourClass::CARPET;
        }
        let saturation = math::hypot(share, off) * self.chroma;
        // Noise of a dark grey pixel must not pass for a colour either.
        if saturation < SATURATION_MIN
            || math::hypot(share, off) < 0.6
            || math::hypot(share, off) < 4.0 * noise
        {
            return match relative {
                _ if bright => ColourClass::WHITE,
                r if r < 0.5 => ColourClass::BLACK,
                _ => ColourClass::OTHER,
            };
        }
        let hue = hue_deg(white_balance(rgb, self.white));
        let [from, to] = ball_hue_deg;
        let ball = if from <= to {
            (from..to).contains(&hue)
        } else {
            hue >= from || hue < to
        };
        if ball {
            ColourClass::BALL
        } else {
            hue_class(hue)
        }
    }
}

/// A colour's hue, degrees from red over green to blue.
fn hue_deg([r, g, b]: [f32; 3]) -> f32 {
    let (x, y) = (r - 0.5 * (g + b), 0.866_025_4 * (g - b));
    math::atan2(y, x).to_degrees().rem_euclid(360.0)
}

/// Class of a saturated pixel by its hue.
fn hue_class(hue_deg: f32) -> ColourClass {
    match hue_deg {
        h if h < 30.0 => ColourClass::RED,
        h if h < 90.0 => ColourClass::YELLOW,
        h if h < 160.0 => ColourClass::OTHER,
        h if h < 215.0 => ColourClass::CYAN,
        h if h < 270.0 => ColourClass::BLUE,
        h if h < 335.0 => ColourClass::MAGENTA,
        _ => ColourClass::RED,
    }
}

/// Median colour of the largest cluster in the chromaticity plane.
fn largest_cluster(ground: &[[u8; 3]]) -> Option<[f32; 3]> {
    let bin = |part: u8, sum: u16| (usize::from(part) * BINS / usize::from(sum)).min(BINS - 1);
    let place = |rgb: &[u8; 3]| {
        let sum: u16 = rgb.iter().map(|&channel| u16::from(channel)).sum();
        (sum >= VOTE_BRIGHTNESS_MIN).then(|| (bin(rgb[0], sum), bin(rgb[1], sum)))
    };
    let mut votes = vec![0u32; BINS * BINS];
    let mut voters = 0;
    for (r, g) in ground.iter().filter_map(place) {
        votes[r * BINS + g] += 1;
        voters += 1;
    }
    if voters * 10 < ground.len() || voters == 0 {
        return None;
    }
    let near = |r: usize, g: usize| {
        let around = |i: usize| i.saturating_sub(1)..=(i + 1).min(BINS - 1);
        around(r)
            .flat_map(|r| around(g).map(move |g| (r, g)))
            .map(|(r, g)| votes[r * BINS + g])
            .sum::<u32>()
    };
    let mut best = (0.0f32, 0, 0);
    for r in 0..BINS {
        for g in 0..BINS {
            let [red, green] = [r, g].map(|i| (i as f32 + 0.5) / BINS as f32);
            let score = near(r, g) as f32 * carpet_prior(red, green);
            if score > best.0 {
                best = (score, r, g);
            }
        }
    }
    let (_, r, g) = best;
    let members: Vec<[u8; 3]> = ground
        .iter()
        .filter(|rgb| place(rgb).is_some_and(|(pr, pg)| pr.abs_diff(r) <= 1 && pg.abs_diff(g) <= 1))
        .copied()
        .collect();
    median_colour(&members)
}

/// Prior weight of a carpet with these chromaticities.
///
/// The league's carpets are green, from yellowish to teal; adjacent grey floors may be larger.
fn carpet_prior(red: f32, green: f32) -> f32 {
    let blue = 1.0 - red - green;
    let greenness = green - red.max(blue);
    0.15 + (8.0 * (greenness + 0.02)).clamp(0.0, 0.85)
}

/// Median of each channel.
pub(crate) fn median_colour(colours: &[[u8; 3]]) -> Option<[f32; 3]> {
    if colours.is_empty() {
        return None;
    }
    Some(std::array::from_fn(|channel| {
        let mut counts = [0usize; 256];
        for colour in colours {
            counts[usize::from(colour[channel])] += 1;
        }
        let mut below = 0;
        counts
            .iter()
            .position(|&count| {
                below += count;
                2 * below >= colours.len()
            })
            .unwrap_or(255) as f32
    }))
}

fn white_balance(rgb: [f32; 3], white: [f32; 3]) -> [f32; 3] {
    std::array::from_fn(|i| rgb[i] / white[i])
}

fn mean([a, b, c]: [f32; 3]) -> f32 {
    (a + b + c) / 3.0
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Pixels of a colour with independent noise of `noise` levels in each channel.
    fn pixels(colour: [f32; 3], noise: f32) -> Vec<[u8; 3]> {
        let mut state = 1u32;
        let mut uniform = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1 << 24) as f32 - 0.5
        };
        let mut level = |mean: f32| {
            // Twelve uniform numbers make a normal one.
            let normal: f32 = (0..12).map(|_| uniform()).sum();
            (mean + noise * normal).round().clamp(0.0, 255.0) as u8
        };
        (0..4000).map(|_| colour.map(&mut level)).collect()
    }

    /// Share of the pixels of each colour that a model of the first one, with the second as white, classifies as carpet and white.
    fn right(carpet: [f32; 3], white: [f32; 3], noise: f32) -> [f32; 2] {
        let ground = pixels(carpet, noise);
        let model = CarpetModel::learn(&ground).expect("a carpet");
        let model = model.with_white(white, noise / 3f32.sqrt());
        let config = ColourConfig::default();
        let share = |pixels: &[[u8; 3]], class: ColourClass| {
            let is_right = |rgb: &&[u8; 3]| {
                // As the table does: the middle of its cell.
                let cell = rgb.map(|level| level / 4 * 4 + 2);
                model.classify(cell, &config, [10.0, 40.0]) == class
            };
            pixels.iter().filter(is_right).count() as f32 / pixels.len() as f32
        };
        [
            share(&ground, ColourClass::CARPET),
            share(&pixels(white, noise), ColourClass::WHITE),
        ]
    }

    #[test]
    fn carpets_of_any_tint_brightness_and_noise_are_told_from_white() {
        let tints = [
            [1.0, 1.0, 1.0],
            [0.99, 1.0, 1.01],
            [0.98, 1.0, 1.02],
            [0.96, 1.0, 1.04],
            [0.96, 1.03, 0.96],
            [1.03, 1.0, 0.95],
            [0.9, 1.0, 1.1],
        ];
        for tint in tints {
            for brightness in [40.0, 55.0, 90.0] {
                for noise in [0.0, 2.0, 4.0] {
                    let carpet = tint.map(|part| part * brightness);
                    let white = [148.0, 148.0, 146.0].map(|level| level * brightness / 55.0);
                    let [carpet, white] = right(carpet, white, noise);
                    assert!(
                        carpet > 0.9 && white > 0.9,
                        "tint {tint:?} at {brightness}, noise {noise}: carpet {carpet}, white {white}"
                    );
                }
            }
        }
    }

    #[test]
    fn coloured_objects_differ_from_carpet_and_lines_where_brightness_decides() {
        // A green carpet in the noise of a high gain, with things of its own brightness.
        let model = CarpetModel::learn(&pixels([45.0, 75.0, 45.0], 9.0)).expect("a carpet");
        let model = model.with_white([200.0, 200.0, 190.0], 9.0);
        assert!(model.is_grey());
        let share = |colour: [f32; 3]| {
            let pixels = pixels(colour, 9.0);
            let coloured = pixels.iter().filter(|rgb| model.is_coloured(**rgb));
            coloured.count() as f32 / pixels.len() as f32
        };
        for ball in [[130.0, 55.0, 15.0], [20.0, 50.0, 130.0]] {
            assert!(share(ball) > 0.8, "{ball:?}");
        }
        assert!(share([45.0, 75.0, 45.0]) < 0.02);
        assert!(share([200.0, 200.0, 190.0]) < 0.01);
    }

    #[test]
    fn grey_images_have_no_coloured_pixels() {
        for level in 40..120u8 {
            let ground = vec![[level; 3]; 400];
            let model = CarpetModel::learn(&ground).expect("a carpet");
            let model = model.with_white([f32::from(level) * 2.1; 3], 2.0);
            let class =
                |level: u8| model.classify([level; 3], &ColourConfig::default(), [10.0, 40.0]);
            assert_eq!(class(level), ColourClass::CARPET, "{level}");
            assert_eq!(class(2 * level), ColourClass::WHITE, "{level}");
            assert!(!model.is_coloured([level; 3]), "{level}");
        }
    }

    #[test]
    fn green_carpets_are_told_from_grey_floors_in_noise() {
        for noise in [2.0, 6.0] {
            let model = CarpetModel::learn(&pixels([50.0, 110.0, 60.0], noise)).expect("a carpet");
            assert!(!model.is_grey());
            let model = model.with_white([220.0, 225.0, 215.0], noise);
            let class = model.classify([75, 77, 74], &ColourConfig::default(), [10.0, 40.0]);
            assert_ne!(class, ColourClass::CARPET, "noise {noise}");
        }
    }
}
