//! Coarse patches, eight at a time: a lane of a vector for each of them.
//!
//! Hundreds of places of an image come as far as the coarse networks. Their results have the same bits in any lane.

use crate::image::{ImageView, OUTSIDE};
use crate::objects::coarse_network::CoarseNetwork;
use crate::objects::patch::{
    CHANNEL_MAX, CHANNELS, COARSE_FLOOR, COARSE_OBSTACLE_FLOOR, COARSE_SAMPLES, CoarsePixels,
    PatchKind, logarithms,
};

/// Patches at a time.
pub(crate) const LANES: usize = 8;

/// One number of each patch.
type Lane = [f32; LANES];

/// Inputs of the coarse network: channel by channel, row by row.
pub(crate) type CoarseInputs = [Lane; CHANNELS * COARSE_SAMPLES];

/// Log odds of an object at each of up to [`LANES`] places. The rest of the result is meaningless.
pub(crate) fn coarse_log_odds<'a>(
    network: &CoarseNetwork,
    kind: PatchKind,
    image: &ImageView<'_>,
    patches: impl Iterator<Item = &'a CoarsePixels>,
) -> Lane {
    network.log_odds(&normalize_coarse_patches(kind, image, patches))
}

/// Reads and normalizes up to [`LANES`] patches, see [`crate::objects::patch`].
fn normalize_coarse_patches<'a>(
    kind: PatchKind,
    image: &ImageView<'_>,
    patches: impl Iterator<Item = &'a CoarsePixels>,
) -> CoarseInputs {
    // All places' tables first, then all their pixels: loads from memory overlap in loops that do nothing else.
    let mut pixels = [[OUTSIDE; COARSE_SAMPLES]; LANES];
    let mut count = 0;
    for (pixels, patch) in pixels.iter_mut().zip(patches) {
        *pixels = *patch;
        count += 1;
    }
    let pixels = &pixels[..count];
    let mut read = [[0u32; COARSE_SAMPLES]; LANES];
    image.read_rgb(
        pixels.as_flattened(),
        read[..pixels.len()].as_flattened_mut(),
    );
    let mut colours = [[0u32; LANES]; COARSE_SAMPLES];
    for (lane, read) in read.iter().enumerate() {
        for (colours, &colour) in colours.iter_mut().zip(read) {
            colours[lane] = colour;
        }
    }
    let mut known = [[1.0f32; LANES]; COARSE_SAMPLES];
    if kind == PatchKind::Obstacle {
        for (lane, pixels) in pixels.iter().enumerate() {
            for (known, &pixel) in known.iter_mut().zip(pixels) {
                known[lane] = if pixel == OUTSIDE { 0.0 } else { 1.0 };
            }
        }
    }
    let reference = match kind {
        PatchKind::Ball => floor_logarithms(&colours, COARSE_FLOOR),
        PatchKind::Obstacle => floor_logarithms(&colours, COARSE_OBSTACLE_FLOOR),
    };
    normalize(&colours, &known, &reference)
}

fn normalize(
    colours: &[[u32; LANES]; COARSE_SAMPLES],
    known: &[Lane; COARSE_SAMPLES],
    reference: &[Lane; 3],
) -> CoarseInputs {
    let logarithms = logarithms();
    let [floor_r, floor_g, floor_b] = reference;
    let floor_range: Lane =
        std::array::from_fn(|lane| range([floor_r[lane], floor_g[lane], floor_b[lane]]));
    let mut inputs = [[0.0; LANES]; CHANNELS * COARSE_SAMPLES];
    let (brightness, rest) = inputs.split_at_mut(COARSE_SAMPLES);
    let (relative_range, saturation) = rest.split_at_mut(COARSE_SAMPLES);
    for (index, colours) in colours.iter().enumerate() {
        let mut logs = [[0.0f32; LANES]; 3];
        for (lane, colour) in colours.iter().enumerate() {
            let [r, g, b, _] = colour.to_le_bytes();
            logs[0][lane] = logarithms[usize::from(r)];
            logs[1][lane] = logarithms[usize::from(g)];
            logs[2][lane] = logarithms[usize::from(b)];
        }
        let known = &known[index];
        let limit = |value: f32, lane: usize| value.clamp(-CHANNEL_MAX, CHANNEL_MAX) * known[lane];
        for lane in 0..LANES {
            let here = [logs[0][lane], logs[1][lane], logs[2][lane]];
            let [r, g, b] = [
                here[0] - floor_r[lane],
                here[1] - floor_g[lane],
                here[2] - floor_b[lane],
            ];
            brightness[index][lane] = limit((r + g + b) / 3.0, lane);
            relative_range[index][lane] = limit(range([r, g, b]), lane);
            saturation[index][lane] = limit(range(here) - floor_range[lane], lane);
        }
    }
    inputs
}

/// Median logarithms of red, green and blue of the floor's samples, whose number is even.
fn floor_logarithms<const N: usize>(
    colours: &[[u32; LANES]; COARSE_SAMPLES],
    floor: [usize; N],
) -> [Lane; 3] {
    const { assert!(N.is_multiple_of(2)) };
    let mut sorted: [[u8; 4 * LANES]; N] = floor.map(|sample| {
        let mut levels = [0; 4 * LANES];
        for (levels, colour) in levels
            .as_chunks_mut::<4>()
            .0
            .iter_mut()
            .zip(colours[sample])
        {
            *levels = colour.to_le_bytes();
        }
        levels
    });
    // Each pass moves the largest of the rest to the end, in all lanes and channels at once.
    for sorted_from in (N / 2 - 1..N).rev() {
        for index in 0..sorted_from {
            order_pair(&mut sorted, index);
        }
    }
    let logarithms = logarithms();
    let [lower, upper] = [&sorted[N / 2 - 1], &sorted[N / 2]];
    std::array::from_fn(|channel| {
        std::array::from_fn(|lane| {
            let level = |levels: &[u8; 4 * LANES]| usize::from(levels[4 * lane + channel]);
            (logarithms[level(lower)] + logarithms[level(upper)]) / 2.0
        })
    })
}

/// Puts the smaller of two neighbours first, byte by byte.
#[inline(always)]
fn order_pair<const N: usize>(rows: &mut [[u8; 4 * LANES]; N], index: usize) {
    let (first, second) = (rows[index], rows[index + 1]);
    rows[index] = std::array::from_fn(|place| first[place].min(second[place]));
    rows[index + 1] = std::array::from_fn(|place| first[place].max(second[place]));
}

/// Largest minus smallest channel.
#[inline(always)]
fn range([a, b, c]: [f32; 3]) -> f32 {
    larger(larger(a, b), c) - smaller(smaller(a, b), c)
}

/// As `f32::max` of numbers: one instruction for all lanes.
#[inline(always)]
fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

#[inline(always)]
fn smaller(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::PixelFormat;
    use crate::objects::network::NETWORKS;

    /// The definition, for one patch: medians by sorting, one sample after the other.
    fn normalize_one(
        kind: PatchKind,
        image: &ImageView<'_>,
        pixels: &CoarsePixels,
    ) -> [f32; CHANNELS * COARSE_SAMPLES] {
        let logs = pixels.map(|pixel| {
            let [u, v] = pixel.map(usize::from);
            let rgb = if pixel == OUTSIDE {
                [0; 3]
            } else {
                image.rgb(u, v)
            };
            rgb.map(|level| logarithms()[usize::from(level)])
        });
        let floor: &[usize] = match kind {
            PatchKind::Ball => &COARSE_FLOOR,
            PatchKind::Obstacle => &COARSE_OBSTACLE_FLOOR,
        };
        let reference: [f32; 3] = std::array::from_fn(|channel| {
            let mut floor: Vec<f32> = floor.iter().map(|&index| logs[index][channel]).collect();
            floor.sort_by(f32::total_cmp);
            (floor[floor.len() / 2 - 1] + floor[floor.len() / 2]) / 2.0
        });
        let spread = |[a, b, c]: [f32; 3]| a.max(b).max(c) - a.min(b).min(c);
        let mut inputs = [0.0; CHANNELS * COARSE_SAMPLES];
        for (index, here) in logs.into_iter().enumerate() {
            let beside: [f32; 3] =
                std::array::from_fn(|channel| here[channel] - reference[channel]);
            let known = kind == PatchKind::Ball || pixels[index] != OUTSIDE;
            let channels = [
                (beside[0] + beside[1] + beside[2]) / 3.0,
                spread(beside),
                spread(here) - spread(reference),
            ];
            for (channel, value) in channels.into_iter().enumerate() {
                let limited = value.clamp(-CHANNEL_MAX, CHANNEL_MAX);
                inputs[channel * COARSE_SAMPLES + index] = if known { limited } else { 0.0 };
            }
        }
        inputs
    }

    #[test]
    fn patches_in_lanes_have_the_bits_of_single_ones() {
        let mut state = 7u32;
        let mut random = move || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            state >> 16
        };
        let data: Vec<u8> = (0..40 * 30 * 3).map(|_| random() as u8).collect();
        let image = ImageView::packed(40, 30, PixelFormat::Rgb8, &data);
        for kind in [PatchKind::Ball, PatchKind::Obstacle] {
            for count in [1, 5, LANES] {
                let patches: Vec<CoarsePixels> = (0..count)
                    .map(|_| {
                        std::array::from_fn(|_| match random() % 12 {
                            0 => OUTSIDE,
                            _ => [(random() % 40) as u16, (random() % 30) as u16],
                        })
                    })
                    .collect();
                let network = &NETWORKS.ball_coarse;
                let lanes = normalize_coarse_patches(kind, &image, patches.iter());
                let odds = coarse_log_odds(network, kind, &image, patches.iter());
                for (lane, pixels) in patches.iter().enumerate() {
                    let single = normalize_one(kind, &image, pixels);
                    for (index, value) in single.into_iter().enumerate() {
                        assert_eq!(lanes[index][lane], value, "{kind:?} {lane} {index}");
                    }
                    let alone = coarse_log_odds(network, kind, &image, [pixels].into_iter());
                    assert_eq!(odds[lane].to_bits(), alone[0].to_bits());
                }
            }
        }
    }
}
