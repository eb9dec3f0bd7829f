//! Which floor points are white line? Peaks of scan lines in, robot-frame points out, refusals with their reason.
//!
//! minho2016 section III: green–white–green. White is not a threshold here: a run must stand out from the carpet
//! beside it by added light of the lamp's colour, and be as wide on the ground as a line can be.

use localize::sample::LinePoint;

use crate::colour::carpet_model::CarpetModel;
use crate::config::LineConfig;
use crate::lines::validator::{LineCandidate, LineValidator, ScanLineSlice, white_contrast};
use crate::scan::brightness::BrightnessReader;
use crate::scan::limits::ScanLimits;
use crate::scan::pattern::{ScanPattern, ScanSample};
use crate::scan::peaks::{Peak, find_peaks};

/// Why a run is no line point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RejectionReason {
    /// No carpet on one of its sides.
    NoAdjacentCarpet,
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
pub struct RejectedCandidate {
    /// Its middle in the image: column, row, pixels.
    pub position_px: [f32; 2],
    /// Why it is no line point.
    pub reason: RejectionReason,
}

/// A line point with its place in the image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinePointDetection {
    /// On the ground, robot frame.
    pub point: LinePoint,
    /// In the image: column, row, pixels.
    pub position_px: [f32; 2],
    /// How much it stands out from the carpet beside it, levels of 255.
    pub contrast: f32,
    /// Width of the run on the ground along its scan line, metres.
    pub width: f32,
}

/// What was read along the scan lines.
pub(crate) struct ScanReadout<'a> {
    pub(crate) pattern: &'a ScanPattern,
    pub(crate) limits: &'a ScanLimits,
    /// Column and row of each sample, together in memory.
    pub(crate) pixels: &'a [[u16; 2]],
    /// Brightness by the weights that tell white from carpet.
    pub(crate) brightness: &'a BrightnessReader,
    /// How high a peak must be to be looked at, one a sample; see [`thresholds`].
    pub(crate) peak_thresholds: &'a [u8],
}

/// What is kept from frame to frame, so that none allocates.
#[derive(Debug, Clone, Default)]
pub(crate) struct LineScratch {
    /// Brightness of the samples that were worth reading.
    values: Vec<u8>,
    peaks: Vec<ScanPeak>,
    centre_samples: Vec<ScanSample>,
    candidates: Vec<(ScanPeak, LineCandidate)>,
}

/// A run, and which samples its piece of a scan line was read in.
#[derive(Debug, Clone, Copy)]
struct ScanPeak {
    start: u32,
    end: u32,
    peak: Peak,
}

/// Finds line points along all scan lines.
///
/// Pass by pass over all runs: what they look at lies far apart in memory, and the look-ups of many runs overlap only
/// where nothing but look-ups lies between them.
pub(crate) fn detect_line_points(
    readout: &ScanReadout<'_>,
    validator: &LineValidator<'_>,
    scratch: &mut LineScratch,
    points: &mut Vec<LinePointDetection>,
    rejected: &mut Vec<RejectedCandidate>,
) {
    let LineScratch {
        values,
        peaks: found,
        centre_samples,
        candidates,
    } = scratch;
    values.resize(readout.pattern.samples.len(), 0);
    found.clear();
    let segments = &readout.pattern.segments;
    for (number, segment) in segments.iter().enumerate() {
        let end = readout
            .limits
            .segment_end(number, segments, validator.carpet_end);
        let range = segment.start as usize..end;
        let values = &mut values[range.clone()];
        readout.brightness.gather(range.clone(), values);
        let (start, end) = (segment.start, end as u32);
        find_peaks(values, &readout.peak_thresholds[range], |peak| {
            found.push(ScanPeak { start, end, peak });
        });
    }
    let line = |found: &ScanPeak| {
        let range = found.start as usize..found.end as usize;
        ScanLineSlice {
            samples: &readout.pattern.samples[range.clone()],
            pixels: &readout.pixels[range.clone()],
            values: &values[range],
        }
    };
    centre_samples.clear();
    centre_samples.extend(
        found.iter().map(|found| {
            readout.pattern.samples[found.start as usize + found.peak.middle() as usize]
        }),
    );
    candidates.clear();
    for (found, centre_sample) in found.iter().zip(&*centre_samples) {
        let line = line(found);
        match validator.project_candidate(&line, &found.peak, centre_sample) {
            Ok(candidate) => candidates.push((*found, candidate)),
            Err(reason) => rejected.push(line.reject(&found.peak, reason)),
        }
    }
    for (found, candidate) in &*candidates {
        let line = line(found);
        match validator.validate_candidate(&line, &found.peak, candidate) {
            Ok(point) => points.push(point),
            Err(reason) => rejected.push(line.reject(&found.peak, reason)),
        }
    }
}

/// How high a peak must be to be looked at, levels, one a sample: out of the noise, and not much fainter than lines are.
///
/// Half of the least contrast that a line may have in the carpet's median light, since shadows halve it.
pub(crate) fn peak_thresholds(
    pattern: &ScanPattern,
    model: &CarpetModel,
    noise: f32,
    config: &LineConfig,
    line_width: f32,
    thresholds: &mut Vec<u8>,
) {
    let least = (config.contrast_sigma_min * noise).max(config.contrast_levels_min);
    let faintest = 0.5 * config.white_share_min * white_contrast(model);
    thresholds.clear();
    thresholds.extend(pattern.samples.iter().map(|sample| {
        let sharp = (line_width / (sample.radial_footprint * config.blur_px)).min(1.0);
        (faintest * sharp).max(least).clamp(1.0, 120.0).round() as u8
    }));
    for segment in &pattern.segments {
        let mut lowest = u8::MAX;
        for threshold in &mut thresholds[segment.start as usize..segment.end as usize] {
            lowest = lowest.min(*threshold);
            *threshold = lowest;
        }
    }
}
