//! Line point detection: peaks of scan lines in, line points in the robot frame out, rejections with their reason.
//!
//! minho2016 section III: green–white–green. White is not a fixed threshold here: a peak must exceed the adjacent
//! carpet by light of the lamp's colour, and have a line's width on the ground.

use crate::colour::carpet_model::CarpetModel;
use crate::config::LineConfig;
use crate::lines::validator::{
    LineCandidate, LineValidator, PeakGround, ScanLineSlice, white_contrast,
};
use crate::scan::brightness::BrightnessReader;
use crate::scan::flanks::Peak;
use crate::scan::limits::ScanLimits;
use crate::scan::pattern::{ScanLines, ScanPattern};
use crate::scan::peaks::find_peaks;

pub use crate::lines::result::{LinePointDetection, RejectedCandidate, RejectionReason};

/// Brightness along the scan lines of one image.
pub(crate) struct ScanReadout<'a> {
    /// The scan lines that were read.
    pub(crate) lines: ScanLines,
    pub(crate) pattern: &'a ScanPattern,
    pub(crate) limits: &'a ScanLimits,
    /// Column and row of each sample, contiguous in memory.
    pub(crate) pixels: &'a [[u16; 2]],
    /// Ground point of each sample, robot frame, metres, contiguous in memory.
    pub(crate) ground: &'a [[f32; 2]],
    /// Brightness by the weights that separate white from carpet.
    pub(crate) brightness: &'a BrightnessReader,
    /// Least height of a peak, one entry per sample; see [`peak_thresholds`].
    pub(crate) peak_thresholds: &'a [u8],
}

/// Buffers reused from image to image to avoid allocation.
#[derive(Debug, Clone, Default)]
pub(crate) struct LineScratch {
    /// Brightness of the samples within the scan limits.
    values: Vec<u8>,
    peaks: Vec<ScanPeak>,
    peak_ground: Vec<PeakGround>,
    candidates: Vec<(ScanPeak, LineCandidate)>,
}

/// A peak and the range of samples of its segment.
#[derive(Debug, Clone, Copy)]
struct ScanPeak {
    start: u32,
    end: u32,
    peak: Peak,
}

/// Finds line points along the scan lines that were read.
///
/// Works in passes over all peaks: their data is scattered in memory, and loads of several peaks overlap only in loops
/// that do little else.
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
        peak_ground,
        candidates,
    } = scratch;
    values.resize(readout.pattern.samples.len(), 0);
    found.clear();
    let segments = &readout.pattern.segments;
    for (number, segment) in segments.iter().enumerate() {
        if !readout.lines.contains(segment) {
            continue;
        }
        let end = readout
            .limits
            .segment_end(number, segments, validator.carpet_end);
        let range = segment.start as usize..end;
        let (start, end) = (segment.start, end as u32);
        readout
            .brightness
            .gather(range.clone(), &mut values[range.clone()]);
        find_peaks(values, readout.peak_thresholds, range, |peak| {
            found.push(ScanPeak { start, end, peak });
        });
    }
    let line = |found: &ScanPeak| {
        let range = found.start as usize..found.end as usize;
        ScanLineSlice {
            ground: &readout.ground[range.clone()],
            pixels: &readout.pixels[range.clone()],
            values: &values[range],
        }
    };
    peak_ground.clear();
    peak_ground.extend(found.iter().map(|found| {
        let (line, peak) = (line(found), &found.peak);
        PeakGround {
            middle: readout.pattern.samples[found.start as usize + peak.middle() as usize],
            edges: [peak.left_edge, peak.right_edge].map(|edge| line.interpolate_ground(edge)),
        }
    }));
    candidates.clear();
    for (found, ground) in found.iter().zip(&*peak_ground) {
        match validator.project_candidate(&found.peak, ground) {
            Ok(candidate) => candidates.push((*found, candidate)),
            Err(reason) => rejected.push(line(found).reject(&found.peak, reason)),
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

/// Least height of a peak at each sample, levels: above the noise and at least half of a line's least contrast.
///
/// Half, since shadows halve the contrast relative to the carpet's median brightness.
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
