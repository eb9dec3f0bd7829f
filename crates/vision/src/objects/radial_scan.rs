//! The carpet's boundary in each direction: rays from the mirror's axis to its rim.

use std::f32::consts::TAU;
use std::ops::Range;

use crate::colour::lookup_table::{ColourClass, ColourLookupTable};
use crate::colour::pixel_classifier::PixelClassifier;
use crate::config::ObjectDetectionConfig;
use crate::image::ImageView;
use crate::optics::ground_map::GroundMap;
use crate::optics::image_polar::nearest_pixel;
use localize::math;
use localize::robot::CameraConfig;

/// A sample of a ray.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct RaySample {
    pub(crate) u: u16,
    pub(crate) v: u16,
    /// Ground point, robot frame, metres; NaN above the horizon.
    pub(crate) ground: [f32; 2],
    /// Its distance, metres; infinite above the horizon.
    pub(crate) range: f32,
}

/// Samples of all rays, ray by ray, outward.
#[derive(Debug, Clone)]
pub(crate) struct RadialScan {
    pub(crate) samples: Vec<RaySample>,
    /// Index of each ray's first sample, and one past the last.
    pub(crate) starts: Vec<usize>,
    /// Index of each ray's first sample above the horizon, or one past its last.
    horizon: Vec<usize>,
    /// Range of each sample, contiguous in memory.
    pub(crate) ranges: Vec<f32>,
    /// Of each ray, whether its ranges never fall.
    pub(crate) ascending: Vec<bool>,
    /// Class of each sample in the last image read.
    pub(crate) classes: Vec<ColourClass>,
    reader: PixelClassifier,
}

/// Samples of other colours that do not split a ball: noise, a cable.
const BALL_GAP_SAMPLES: usize = 2;
/// Samples before a run of which one is carpet: the ball's edge is mixed with it, a line may lie between.
const FLOOR_SAMPLES: usize = 4;
/// Shortest and longest run of a ball's colour, balls on the ground. A ball in the air appears larger.
const BALL_EXTENTS_MIN: f32 = 0.3;
const BALL_EXTENTS_MAX: f32 = 3.0;

impl RadialScan {
    pub(crate) fn new(
        map: &GroundMap,
        camera: &CameraConfig,
        mask: Option<&[bool]>,
        range_min: f32,
        config: &ObjectDetectionConfig,
    ) -> Self {
        let (width, height) = (map.width_px as f32, map.height_px as f32);
        let (mut samples, mut starts) = (Vec::new(), vec![0]);
        for ray in 0..config.ray_count {
            let azimuth = math::sin_cos(TAU * ray as f32 / config.ray_count as f32);
            for step in (0..).step_by(config.ray_step_px) {
                let [u, v] = nearest_pixel(camera.centre_px, step as f32, azimuth);
                let inside = u >= 0.0 && v >= 0.0 && u < width && v < height;
                if !(inside && camera.is_inside_mirror(u, v)) {
                    break;
                }
                let (column, row) = (u as usize, v as usize);
                if mask.is_some_and(|mask| !mask[row * map.width_px + column]) {
                    continue;
                }
                let ground = map.at(column, row);
                let range = ground.map_or(f32::INFINITY, |at| at.distance());
                // Pixels without ground before the first ground show the robot itself.
                if range < range_min || ground.is_none() && samples.len() == starts[ray] {
                    continue;
                }
                samples.push(RaySample {
                    u: column as u16,
                    v: row as u16,
                    ground: ground.map_or([f32::NAN; 2], |at| [at.x, at.y]),
                    range,
                });
            }
            starts.push(samples.len());
        }
        let pixels: Vec<[u16; 2]> = samples.iter().map(|s| [s.u, s.v]).collect();
        let ranges: Vec<f32> = samples.iter().map(|s| s.range).collect();
        let first_above = |ray: &[usize; 2]| {
            let [start, end] = *ray;
            let above = ranges[start..end]
                .iter()
                .position(|range| range.is_infinite());
            above.map_or(end, |index| start + index)
        };
        RadialScan {
            horizon: starts.array_windows().map(first_above).collect(),
            ascending: starts
                .array_windows()
                .map(|&[start, end]| ranges[start..end].is_sorted())
                .collect(),
            ranges,
            reader: PixelClassifier::new(&pixels, map.height_px),
            classes: vec![ColourClass::OTHER; samples.len()],
            samples,
            starts,
        }
    }

    pub(crate) fn count(&self) -> usize {
        self.starts.len() - 1
    }

    /// Classifies the samples in these rows. The image must have been checked.
    pub(crate) fn read(
        &mut self,
        image: &ImageView<'_>,
        table: &ColourLookupTable,
        rows: &Range<usize>,
    ) {
        self.reader
            .classify_rows(image, table, rows, &mut self.classes);
    }

    /// First sample of a ray from `from` on that is above the horizon, or one past its last.
    pub(crate) fn first_above_horizon(&self, ray: usize, from: usize) -> usize {
        let end = self.starts[ray + 1];
        if from <= self.horizon[ray] {
            return self.horizon[ray];
        }
        let above = self.ranges[from..end]
            .iter()
            .position(|range| range.is_infinite());
        above.map_or(end, |index| from + index)
    }

    /// One past the last sample of a ray that is hidden from sample `from` on: where two samples in a row are carpet.
    pub(crate) fn hidden_end(&self, ray: usize, from: usize) -> usize {
        let classes = &self.classes[from..self.starts[ray + 1]];
        let clear = |pair: &[ColourClass; 2]| *pair == [ColourClass::CARPET; 2];
        let seen = classes.array_windows().position(clear);
        from + seen.unwrap_or(classes.len())
    }

    /// Samples of the ball's colour from which a ball may be filled, each with its ray's azimuth, turns: the nearest of
    /// each run along a ray that follows carpet, is no longer than a ball and does not continue on both sides.
    ///
    /// A wooden floor around the carpet has the ball's colour as well, and filling it would cost more than all else.
    pub(crate) fn ball_seeds(
        &self,
        config: &ObjectDetectionConfig,
    ) -> impl Iterator<Item = (f32, &RaySample)> {
        let turns = move |ray: usize| ray as f32 / self.count() as f32;
        (0..self.count()).flat_map(move |ray| {
            let (start, end) = (self.starts[ray], self.starts[ray + 1]);
            // Most rays have none: this fold vectorises.
            let any = self.classes[start..end]
                .iter()
                .fold(false, |any, &class| any | (class == ColourClass::BALL));
            let mut index = if any { start } else { end };
            std::iter::from_fn(move || {
                while index < end {
                    let run = self.ball_run(index, end);
                    index = run.end;
                    let before = start.max(run.start.saturating_sub(FLOOR_SAMPLES))..run.start;
                    let on_carpet = self.classes[before].contains(&ColourClass::CARPET);
                    if !run.is_empty() && on_carpet && self.is_ball_sized(ray, &run, config) {
                        return Some((turns(ray), &self.samples[run.start]));
                    }
                }
                None
            })
        })
    }

    /// The next run of the ball's colour from a sample on; empty at `end` if there is none.
    fn ball_run(&self, from: usize, end: usize) -> Range<usize> {
        let is_ball = |index: &usize| self.classes[*index] == ColourClass::BALL;
        let Some(first) = (from..end).find(is_ball) else {
            return end..end;
        };
        let mut last = first;
        while let Some(next) = (last + 1..end.min(last + 2 + BALL_GAP_SAMPLES)).find(is_ball) {
            last = next;
        }
        first..last + 1
    }

    /// True if a run along a ray is not much longer than a ball and ends on at least one side of it.
    fn is_ball_sized(
        &self,
        ray: usize,
        run: &Range<usize>,
        config: &ObjectDetectionConfig,
    ) -> bool {
        let height = config.viewpoint_height;
        let near = self.samples[run.start].range;
        if !near.is_finite() {
            return false;
        }
        let slant = math::hypot(near, height - config.ball_radius);
        let far = self.samples[run.end - 1].range;
        let covered = math::atan2(far, height) - math::atan2(near, height);
        let ball = 2.0 * config.ball_radius / slant;
        // The first and last sample stand for half a step more each.
        let steps = (run.len() - 1).max(1) as f32;
        if covered > BALL_EXTENTS_MAX * ball
            || run.len() > 1 && covered * (steps + 1.0) / steps < BALL_EXTENTS_MIN * ball
        {
            return false;
        }
        let ray_angle = TAU / self.count() as f32;
        let aside =
            (BALL_EXTENTS_MAX * config.ball_radius / (near * ray_angle)).ceil() as usize + 1;
        let middle = usize::midpoint(run.start, run.end - 1);
        let continues = |ray: usize| {
            let ray = ray % self.count();
            // Rays may start at different radii, so the sample is sought by its range.
            let samples = self.starts[ray]..self.starts[ray + 1];
            let range = self.samples[middle].range;
            let at = self.samples[samples.clone()].partition_point(|sample| sample.range < range);
            let at = samples.start + at;
            (at.saturating_sub(1)..at + 2)
                .any(|index| index < samples.end && self.classes[index] == ColourClass::BALL)
        };
        !(aside < self.count() / 4
            && continues(ray + aside)
            && continues(ray + self.count() - aside))
    }
}
