//! Base points of white walls: white that starts at the carpet and is wider than any line.
//!
//! lima2001 4.4 uses every white-to-green and green-to-white transition on its circles, "the intersection between the
//! field and the walls" (4) included. A line has two transitions a few pixels apart, whose middle is more accurate; a
//! wall has only one.

use localize::frames::At;
use localize::math;
use localize::sample::LinePoint;

use crate::colour::lookup_table::ColourClass;
use crate::lines::detection::{LinePointDetection, ScanReadout};
use crate::lines::validator::{LineValidator, is_beyond_carpet};
use crate::scan::pattern::ScanSample;

/// Blurred samples between carpet and white that are neither.
const BLUR_SAMPLES: usize = 3;
/// Consecutive samples that confirm carpet or white.
const CONFIRMING_SAMPLES: usize = 2;

/// Adds base points of walls along the scan lines that were read.
pub(crate) fn detect_wall_bases(
    readout: &ScanReadout<'_>,
    validator: &LineValidator<'_>,
    points: &mut Vec<LinePointDetection>,
) {
    let mut values = vec![0; readout.pattern.longest_segment()];
    for segment in readout.pattern.segments_of(readout.lines) {
        let range = segment.samples();
        let values = &mut values[..range.len()];
        readout.brightness.gather(range.clone(), values);
        let samples = &readout.pattern.samples[range];
        let classes: Vec<ColourClass> = samples
            .iter()
            .map(|sample| {
                let (u, v) = (usize::from(sample.u), usize::from(sample.v));
                validator
                    .lookup_table
                    .class(validator.image.native_channels(u, v))
            })
            .collect();
        let line = ClassifiedScanLine {
            samples,
            values,
            classes: &classes,
        };
        for at in CONFIRMING_SAMPLES..samples.len() {
            // A wall starts after this sample or ends before it.
            points.extend(line.find_wall_base(at - 1, 1, validator));
            points.extend(line.find_wall_base(at, -1, validator));
        }
    }
}

/// A segment of a scan line with brightness and classes.
struct ClassifiedScanLine<'a> {
    samples: &'a [ScanSample],
    values: &'a [u8],
    classes: &'a [ColourClass],
}

impl ClassifiedScanLine<'_> {
    fn offset_index(&self, start: usize, direction: isize, step: usize) -> Option<usize> {
        let index = start.checked_add_signed(direction * step as isize)?;
        (index < self.samples.len()).then_some(index)
    }

    /// True if `CONFIRMING_SAMPLES` samples from `start` on have this class.
    fn are_class(&self, class: ColourClass, start: usize, direction: isize) -> bool {
        (0..CONFIRMING_SAMPLES).all(|step| {
            self.offset_index(start, direction, step)
                .is_some_and(|index| self.classes[index] == class)
        })
    }

    /// Base point of a wall whose last carpet sample is `carpet`; `direction`: ±1 along the line.
    fn find_wall_base(
        &self,
        carpet: usize,
        direction: isize,
        validator: &LineValidator<'_>,
    ) -> Option<LinePointDetection> {
        if !self.are_class(ColourClass::CARPET, carpet, -direction)
            || self.classes[self.offset_index(carpet, direction, 1)?] == ColourClass::CARPET
            || is_beyond_carpet(validator.carpet_end, &self.samples[carpet])
        {
            return None;
        }
        let white = (1..=BLUR_SAMPLES + 1)
            .filter_map(|step| self.offset_index(carpet, direction, step))
            .find(|&index| self.are_class(ColourClass::WHITE, index, direction))?;
        let width = self.white_width(white, direction);
        // Wider than a line crossed at a slant: see `LineValidator::project_candidate`.
        if width
            <= validator.config.width_ratio_max * validator.line_width
                + 1.5 * self.samples[white].radial_footprint
        {
            return None;
        }
        // The edge is at the mean of both levels; the first white sample may still be blurred.
        let value = |index: usize| f32::from(self.values[index]);
        let top = value(white).max(self.offset_index(white, direction, 1).map_or(0.0, value));
        let low = value(self.offset_index(carpet, -direction, 1)?);
        let half = 0.5 * (low + top);
        let mut before = carpet;
        for step in 1..=BLUR_SAMPLES + CONFIRMING_SAMPLES {
            let after = self.offset_index(carpet, direction, step)?;
            if value(after) >= half {
                let rise = (value(after) - value(before)).max(1.0);
                let part = ((half - value(before)) / rise).clamp(0.0, 1.0);
                return Some(self.interpolate_point(
                    before,
                    after,
                    part,
                    width,
                    top - low,
                    validator,
                ));
            }
            before = after;
        }
        None
    }

    /// Width of the white from `start` on, metres on the ground.
    fn white_width(&self, start: usize, direction: isize) -> f32 {
        let mut end = start;
        while let Some(next) = self.offset_index(end, direction, 1)
            && self.classes[next] == ColourClass::WHITE
        {
            end = next;
        }
        let [ax, ay] = self.samples[start].ground;
        let [bx, by] = self.samples[end].ground;
        math::hypot(bx - ax, by - ay)
    }

    fn interpolate_point(
        &self,
        before: usize,
        after: usize,
        part: f32,
        width: f32,
        contrast: f32,
        validator: &LineValidator<'_>,
    ) -> LinePointDetection {
        let (a, b) = (&self.samples[before], &self.samples[after]);
        let mix = |a: f32, b: f32| a + part * (b - a);
        LinePointDetection {
            point: LinePoint {
                at: At::new(mix(a.ground[0], b.ground[0]), mix(a.ground[1], b.ground[1])),
                std_radial: validator.config.position_std_px * b.radial_footprint,
                std_tangential: validator.config.position_std_px * b.tangential_footprint,
            },
            position_px: [
                mix(f32::from(a.u), f32::from(b.u)),
                mix(f32::from(a.v), f32::from(b.v)),
            ],
            contrast,
            width,
        }
    }
}
