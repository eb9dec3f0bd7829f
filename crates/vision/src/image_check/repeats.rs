//! Does a driver deliver old images again? Buffers that take turns, or one image with a few bytes that differ, such as a clock drawn
//! into it.

use super::rows::SampledRows;
use super::samples::ChannelSample;

/// Images that are remembered to the bit: drivers have four to eight buffers.
const REMEMBERED: usize = 8;
/// Share of the samples that equal those of an image of the same place: noise changes more of them in every working camera.
const EQUAL_SHARE: f32 = 0.98;
/// Motion in which even a picture without noise changes more than that, metres.
const MOTION_MIN: f64 = 0.15;

/// The images that the next one is compared with.
#[derive(Debug, Clone, Default)]
pub(super) struct Repeats {
    recent: [u64; REMEMBERED],
    next: usize,
    /// The last image that differs, and the path of the wheels at it, metres.
    reference: Vec<ChannelSample>,
    reference_path: f64,
    samples: Vec<ChannelSample>,
}

impl Repeats {
    /// Forgets all images.
    pub(super) fn restart(&mut self) {
        *self = Repeats::default();
    }

    /// True for an image that was there before, to the bit, or that hardly differs from one although the wheels turned since.
    /// `path`: of the wheels up to now, metres.
    pub(super) fn add(&mut self, rows: &SampledRows, path: f64) -> bool {
        self.samples.clear();
        self.samples.extend(rows.statistics_samples());
        let hash = hash(&self.samples);
        let is_known = self.recent.contains(&hash);
        self.recent[self.next] = hash;
        self.next = (self.next + 1) % REMEMBERED;
        let pairs = self.samples.iter().zip(&self.reference);
        let equal = pairs.filter(|(now, before)| now == before).count();
        let is_alike = self.samples.len() == self.reference.len()
            && equal as f32 >= EQUAL_SHARE * self.samples.len() as f32;
        if !is_alike {
            std::mem::swap(&mut self.reference, &mut self.samples);
            self.reference_path = path;
        }
        is_known || is_alike && path - self.reference_path > MOTION_MIN
    }
}

/// Fowler, Noll and Vo's hash, a sample at a time, in lanes that do not wait for each other. Not zero, which stands for no image.
fn hash(samples: &[ChannelSample]) -> u64 {
    let step = |hash: u64, word: u64| (hash ^ word).wrapping_mul(0x0100_0000_01b3);
    let word = |sample: &ChannelSample| u64::from(u32::from_ne_bytes(*sample));
    let (blocks, rest) = samples.as_chunks::<4>();
    let mut lanes = [0xcbf2_9ce4_8422_2325; 4];
    for block in blocks {
        for (lane, sample) in lanes.iter_mut().zip(block) {
            *lane = step(*lane, word(sample));
        }
    }
    let all = lanes.into_iter().chain(rest.iter().map(word));
    all.fold(0, step) | 1
}
