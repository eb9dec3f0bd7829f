//! Which floor points are white line? Peaks of scan lines in, robot-frame points out, refusals with their reason.
//!
//! minho2016 section III: green–white–green. White is not a threshold here: a run must stand out from the carpet
//! beside it by added light of the lamp's colour, and be as wide on the ground as a line can be.

use localize::sample::LinePoint;

use crate::carpet::CarpetModel;
use crate::config::LineConfig;
use crate::judge::{Extent, Judge, Line, white_contrast};
use crate::reach::Reach;
use crate::read::BrightnessReader;
use crate::runs::{Run, peaks};
use crate::scan::{ScanPattern, ScanSample};

/// Why a run is no line point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Refusal {
    /// No carpet on one of its sides.
    NoCarpetBeside,
    /// Narrower on the ground than a line.
    TooNarrow,
    /// Wider on the ground than a line, even if crossed aslant.
    TooWide,
    /// Fainter than noise could be, or than a line of this width must be here.
    TooFaint,
    /// The added light is not white.
    NotWhite,
    /// Something that is not carpet lies between it and the robot.
    BeyondCarpet,
}

/// A run that was looked at, and what became of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RefusedRun {
    /// Its middle in the image: column, row, pixels.
    pub at_px: [f32; 2],
    /// Why it is no line point.
    pub reason: Refusal,
}

/// A line point with its place in the image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SeenLinePoint {
    /// On the ground, robot frame.
    pub point: LinePoint,
    /// In the image: column, row, pixels.
    pub at_px: [f32; 2],
    /// How much it stands out from the carpet beside it, levels of 255.
    pub contrast: f32,
    /// Width of the run on the ground along its scan line, metres.
    pub width: f32,
}

/// What was read along the scan lines.
pub(crate) struct Reading<'a> {
    pub(crate) pattern: &'a ScanPattern,
    pub(crate) reach: &'a Reach,
    /// Column and row of each sample, together in memory.
    pub(crate) places: &'a [[u16; 2]],
    /// Brightness by the weights that tell white from carpet.
    pub(crate) brightness: &'a BrightnessReader,
    /// How high a peak must be to be looked at, one a sample; see [`thresholds`].
    pub(crate) thresholds: &'a [u8],
}

/// What is kept from frame to frame, so that none allocates.
#[derive(Debug, Clone, Default)]
pub(crate) struct Scratch {
    /// Brightness of the samples that were worth reading.
    values: Vec<u8>,
    found: Vec<Found>,
    middles: Vec<ScanSample>,
    extents: Vec<(Found, Extent)>,
}

/// A run, and which samples its piece of a scan line was read in.
#[derive(Debug, Clone, Copy)]
struct Found {
    start: u32,
    end: u32,
    run: Run,
}

/// Finds line points along all scan lines.
///
/// Pass by pass over all runs: what they look at lies far apart in memory, and the look-ups of many runs overlap only
/// where nothing but look-ups lies between them.
pub(crate) fn line_points(
    reading: &Reading<'_>,
    judge: &Judge<'_>,
    scratch: &mut Scratch,
    points: &mut Vec<SeenLinePoint>,
    refused: &mut Vec<RefusedRun>,
) {
    let Scratch {
        values,
        found,
        middles,
        extents,
    } = scratch;
    values.resize(reading.pattern.samples.len(), 0);
    found.clear();
    let pieces = &reading.pattern.pieces;
    for (number, piece) in pieces.iter().enumerate() {
        let end = reading.reach.end(number, pieces, judge.carpet_end);
        let range = piece.start as usize..end;
        let values = &mut values[range.clone()];
        reading.brightness.pick(range.clone(), values);
        let (start, end) = (piece.start, end as u32);
        peaks(values, &reading.thresholds[range], |run| {
            found.push(Found { start, end, run });
        });
    }
    let line = |found: &Found| {
        let range = found.start as usize..found.end as usize;
        Line {
            samples: &reading.pattern.samples[range.clone()],
            places: &reading.places[range.clone()],
            values: &values[range],
        }
    };
    middles.clear();
    middles.extend(
        found.iter().map(|found| {
            reading.pattern.samples[found.start as usize + found.run.middle() as usize]
        }),
    );
    extents.clear();
    for (found, middle) in found.iter().zip(&*middles) {
        let line = line(found);
        match judge.extent(&line, &found.run, middle) {
            Ok(extent) => extents.push((*found, extent)),
            Err(reason) => refused.push(line.refused(&found.run, reason)),
        }
    }
    for (found, extent) in &*extents {
        let line = line(found);
        match judge.point(&line, &found.run, extent) {
            Ok(point) => points.push(point),
            Err(reason) => refused.push(line.refused(&found.run, reason)),
        }
    }
}

/// How high a peak must be to be looked at, levels, one a sample: out of the noise, and not much fainter than lines are.
///
/// Half of the least contrast that a line may have in the carpet's median light, since shadows halve it.
pub(crate) fn thresholds(
    pattern: &ScanPattern,
    model: &CarpetModel,
    noise: f32,
    config: &LineConfig,
    line_width: f32,
    thresholds: &mut Vec<u8>,
) {
    let least = (config.contrast_noises * noise).max(config.contrast_levels);
    let faintest = 0.5 * config.white_share_min * white_contrast(model);
    thresholds.clear();
    thresholds.extend(pattern.samples.iter().map(|sample| {
        let sharp = (line_width / (sample.radial_px * config.blur_px)).min(1.0);
        (faintest * sharp).max(least).clamp(1.0, 120.0).round() as u8
    }));
    for piece in &pattern.pieces {
        let mut lowest = u8::MAX;
        for threshold in &mut thresholds[piece.start as usize..piece.end as usize] {
            lowest = lowest.min(*threshold);
            *threshold = lowest;
        }
    }
}
