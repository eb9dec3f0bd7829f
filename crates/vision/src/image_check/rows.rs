//! What do the rows of an image say about it? Samples of each row that shows ground, compared with each other and with
//! the image before.

use std::ops::Range;

use super::samples::{COLUMN_STEP, ChannelSample, brightness, read_samples, sample_at};
use crate::image::{ImageView, PixelFormat};
use crate::optics::ground_map::GroundMap;

/// Fewest samples of a row; a shorter one at the edge of the ground says little.
const ROW_SAMPLES_MIN: usize = 12;
/// Rows and samples of a part of the floor, whose mean brightness is compared with others.
const PART_ROWS: usize = 12;
const PART_SAMPLES: usize = 4;
/// Quantiles of the brightness and the noise are of every n-th row: 5,000 samples suffice.
const STATISTICS_ROWS: usize = 4;

/// A row that shows ground.
#[derive(Debug, Clone)]
pub(super) struct SampledRow {
    pub(super) row: usize,
    /// Of each sample of the row, from the image's left edge to its right one: true if it shows ground.
    pub(super) ground: Vec<bool>,
    /// The samples that show ground, as runs of neighbours.
    runs: Vec<Range<usize>>,
    /// Where its samples start.
    start: usize,
}

/// The samples of an image and of the one before.
#[derive(Debug, Clone)]
pub(super) struct SampledRows {
    size_px: (usize, usize),
    rows: Vec<SampledRow>,
    samples: Vec<ChannelSample>,
    last: Vec<ChannelSample>,
    /// Brightness of each sample.
    brightness: Vec<u8>,
    /// True if `last` is of the image before.
    has_last: bool,
    yuv: bool,
    /// Rows that one cell of a colour filter spans are read once.
    row_step: usize,
}

/// Consecutive rows with a property: how many were sampled, and the first and last of them in the image.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct RowRun {
    pub(super) count: usize,
    pub(super) first: usize,
    pub(super) last: usize,
}

/// Brightness that 1 % and 99 % of the samples do not exceed.
#[derive(Debug, Clone, Copy)]
pub(super) struct Levels {
    pub(super) lower: f32,
    pub(super) upper: f32,
}

/// Brightness differences on the floor, and those that noise explains.
#[derive(Debug, Clone, Copy)]
pub(super) struct Contrast {
    pub(super) spread: f32,
    pub(super) by_noise: f32,
}

impl SampledRows {
    pub(super) fn new(map: &GroundMap) -> Self {
        let mut start = 0;
        let rows = (0..map.height_px)
            .filter_map(|row| {
                let ground: Vec<bool> = (0..map.width_px)
                    .step_by(COLUMN_STEP)
                    .map(|column| map.at(column, row).is_some())
                    .collect();
                let shown = ground.iter().filter(|&&shown| shown).count();
                (shown >= ROW_SAMPLES_MIN).then(|| {
                    let begin = start;
                    start += ground.len();
                    SampledRow {
                        row,
                        runs: runs_of(&ground),
                        ground,
                        start: begin,
                    }
                })
            })
            .collect();
        SampledRows {
            size_px: (map.width_px, map.height_px),
            rows,
            samples: vec![[0; 4]; start],
            last: vec![[0; 4]; start],
            brightness: vec![0; start],
            has_last: false,
            yuv: false,
            row_step: 1,
        }
    }

    pub(super) fn size_px(&self) -> (usize, usize) {
        self.size_px
    }

    pub(super) fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// Distance of two rows that are read and follow each other.
    pub(super) fn row_step(&self) -> usize {
        self.row_step
    }

    /// Brightness of any pixel.
    pub(super) fn level_at(&self, image: &ImageView<'_>, column: usize, row: usize) -> u8 {
        brightness(self.yuv, sample_at(image, column, row))
    }

    /// Number of rows that are read.
    pub(super) fn count(&self) -> usize {
        self.rows.len().div_ceil(self.row_step)
    }

    /// Reads an image; `follows`: it is the next of a sequence.
    pub(super) fn read(&mut self, image: &ImageView<'_>, follows: bool) {
        std::mem::swap(&mut self.samples, &mut self.last);
        self.has_last = follows;
        self.yuv = image.format.is_yuv();
        self.row_step = match image.format {
            PixelFormat::BayerRggb
            | PixelFormat::BayerBggr
            | PixelFormat::BayerGrbg
            | PixelFormat::BayerGbrg => 2,
            _ => 1,
        };
        let yuv = self.yuv;
        for row in self.rows.iter().step_by(self.row_step) {
            let here = row.start..row.start + row.ground.len();
            let samples = &mut self.samples[here.clone()];
            read_samples(image, row.row, samples);
            for (level, &sample) in self.brightness[here].iter_mut().zip(&*samples) {
                *level = brightness(yuv, sample);
            }
        }
    }

    /// Brightness of a row's samples.
    pub(super) fn levels_of(&self, row: &SampledRow) -> &[u8] {
        &self.brightness[row.start..][..row.ground.len()]
    }

    pub(super) fn read_rows(&self) -> impl Iterator<Item = &SampledRow> {
        self.rows.iter().step_by(self.row_step)
    }

    fn of<'a>(row: &SampledRow, samples: &'a [ChannelSample]) -> &'a [ChannelSample] {
        &samples[row.start..][..row.ground.len()]
    }

    pub(super) fn levels(&self) -> Levels {
        let mut histogram = [0u32; 256];
        let mut count = 0;
        for row in self.read_rows().step_by(STATISTICS_ROWS) {
            let levels = self.levels_of(row);
            for run in &row.runs {
                for &level in &levels[run.clone()] {
                    histogram[usize::from(level)] += 1;
                }
                count += run.len();
            }
        }
        let quantile = |share: f32| {
            let rank = (share * count as f32) as u32;
            let mut sum = 0;
            let level = histogram.iter().position(|bin| {
                sum += bin;
                sum > rank
            });
            level.unwrap_or(255) as f32
        };
        Levels {
            lower: quantile(0.01),
            upper: quantile(0.99),
        }
    }

    /// Samples of every n-th row.
    pub(super) fn statistics_samples(&self) -> impl Iterator<Item = ChannelSample> {
        let rows = self.read_rows().step_by(STATISTICS_ROWS);
        rows.flat_map(|row| SampledRows::of(row, &self.samples).iter().copied())
    }

    /// The longest run of rows that equal those of the image before.
    pub(super) fn repeated_run(&self) -> RowRun {
        if !self.has_last {
            return RowRun::default();
        }
        self.longest_run(|row| {
            let (now, before) = (
                SampledRows::of(row, &self.samples),
                SampledRows::of(row, &self.last),
            );
            now == before && !is_even(now)
        })
    }

    /// The longest run of rows whose samples are all the same, beside the mirror's image too.
    pub(super) fn empty_run(&self) -> RowRun {
        self.longest_run(|row| is_even(SampledRows::of(row, &self.samples)))
    }

    fn longest_run(&self, has: impl Fn(&SampledRow) -> bool) -> RowRun {
        let (mut longest, mut run) = (RowRun::default(), RowRun::default());
        for row in self.read_rows() {
            if !has(row) {
                run = RowRun::default();
                continue;
            }
            if run.count == 0 {
                run.first = row.row;
            }
            (run.count, run.last) = (run.count + 1, row.row);
            if run.count > longest.count {
                longest = run;
            }
        }
        longest
    }

    /// Spread of the mean brightness over parts of the floor.
    pub(super) fn contrast(&self) -> Contrast {
        let mut means: Vec<f32> = Vec::new();
        // Counts of the differences between neighbours.
        let mut noise = [0usize; 256];
        let mut fewest = usize::MAX;
        let rows: Vec<&SampledRow> = self.read_rows().collect();
        let columns = rows.first().map_or(0, |row| row.ground.len());
        // Of each column of a band: the sum of its levels on the ground, and how many they are.
        let mut sums = vec![0u16; columns];
        let mut counts = vec![0u16; columns];
        for band in rows.chunks(PART_ROWS) {
            sums.fill(0);
            counts.fill(0);
            for (number, row) in band.iter().enumerate() {
                let levels = self.levels_of(row);
                let runs: &[Range<usize>] = match number % STATISTICS_ROWS {
                    0 => &row.runs,
                    _ => &[],
                };
                for run in runs {
                    for [left, right] in levels[run.clone()].array_windows() {
                        noise[usize::from(left.abs_diff(*right))] += 1;
                    }
                }
                let totals = sums.iter_mut().zip(&mut counts);
                for ((sum, count), (level, shown)) in totals.zip(levels.iter().zip(&row.ground)) {
                    *sum += u16::from(*level) * u16::from(*shown);
                    *count += u16::from(*shown);
                }
            }
            let full = PART_ROWS * PART_SAMPLES / (2 * self.row_step);
            for (sums, counts) in sums.chunks(PART_SAMPLES).zip(counts.chunks(PART_SAMPLES)) {
                let count = usize::from(counts.iter().sum::<u16>());
                if count >= full {
                    let sum: u32 = sums.iter().map(|sum| u32::from(*sum)).sum();
                    means.push(sum as f32 / count as f32);
                    fewest = fewest.min(count);
                }
            }
        }
        if means.len() < 20 {
            return Contrast {
                spread: f32::INFINITY,
                by_noise: 0.0,
            };
        }
        means.sort_unstable_by(f32::total_cmp);
        // The median absolute difference of two normal numbers is 0.954 σ; the mean of n has σ/√n, and 90 % of such
        // means lie within ± 1.64 of that.
        let sigma = median_bin(&noise) as f32 / 0.954;
        Contrast {
            spread: means[means.len() * 19 / 20] - means[means.len() / 20],
            by_noise: 1.5 * 2.0 * 1.64 * sigma / (fewest as f32).sqrt(),
        }
    }
}

/// Bin of a histogram that holds the upper median.
fn median_bin(counts: &[usize; 256]) -> usize {
    let rank = counts.iter().sum::<usize>() / 2;
    let mut below = 0;
    let median = counts.iter().position(|count| {
        below += count;
        below > rank
    });
    median.unwrap_or(0)
}

/// Runs of true values, as ranges of indices.
fn runs_of(values: &[bool]) -> Vec<Range<usize>> {
    let mut runs: Vec<Range<usize>> = Vec::new();
    for (index, _) in values.iter().enumerate().filter(|(_, value)| **value) {
        match runs.last_mut().filter(|run| run.end == index) {
            Some(run) => run.end += 1,
            None => runs.push(index..index + 1),
        }
    }
    runs
}

/// True if all samples are the same, but for a level.
fn is_even(samples: &[ChannelSample]) -> bool {
    let Some(first) = samples.first() else {
        return true;
    };
    // Most rows show within a few samples that they are not.
    let near = |sample: &ChannelSample| (0..3).all(|k| sample[k].abs_diff(first[k]) <= 1);
    if !samples.iter().all(near) {
        return false;
    }
    let (mut least, mut most) = ([u8::MAX; 3], [u8::MIN; 3]);
    for sample in samples {
        for k in 0..3 {
            least[k] = least[k].min(sample[k]);
            most[k] = most[k].max(sample[k]);
        }
    }
    (0..3).all(|k| most[k] - least[k] <= 1)
}
