//! The scan pattern: radial lines, spirals and circles as pixel tables, built once per map and mask.
//!
//! minho2016 section III: 72 radial lines every 5° and 36 spirals each way every 10°; lima2001 4.4: circles.

use std::f32::consts::TAU;
use std::ops::Range;

use crate::config::ScanConfig;
use crate::optics::ground_map::GroundMap;
use crate::optics::image_polar::{azimuth, nearest_pixel};
use localize::math;
use localize::robot::CameraConfig;

/// Kind of a scan line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ScanKind {
    /// Straight outward from the mirror's axis.
    Radial,
    /// Archimedes' spiral outward.
    Spiral,
    /// Around the axis.
    Circle,
}

/// A contiguous segment of a scan line: `samples[start..end]`, outward.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ScanSegment {
    /// Kind of its scan line.
    pub kind: ScanKind,
    /// Index of its scan line among its kind.
    pub line_index: u32,
    /// First sample.
    pub start: u32,
    /// One past the last.
    pub end: u32,
}

/// Which scan lines are read in an image.
///
/// The halves are interlaced: every second line of each kind, in both directions of rotation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ScanLines {
    /// All of them.
    #[default]
    All,
    /// The half with even numbers.
    Even,
    /// The half with odd numbers.
    Odd,
}

impl ScanLines {
    /// True if this selection contains the segment's scan line.
    pub fn contains(self, segment: &ScanSegment) -> bool {
        let number = match segment.kind {
            ScanKind::Radial | ScanKind::Circle => segment.line_index,
            // Two spirals start at the same azimuth, one in each direction of rotation.
            ScanKind::Spiral => segment.line_index / 2,
        };
        match self {
            ScanLines::All => true,
            ScanLines::Even => number.is_multiple_of(2),
            ScanLines::Odd => !number.is_multiple_of(2),
        }
    }
}

/// One sample: a pixel and its ground.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScanSample {
    /// Column.
    pub u: u16,
    /// Row.
    pub v: u16,
    /// Ground point of the pixel's centre, robot frame, metres.
    pub ground: [f32; 2],
    /// Distance from the robot on the ground, metres.
    pub range: f32,
    /// Ground that the pixel covers along the direction from the robot, metres.
    pub radial_footprint: f32,
    /// Ground that the pixel covers across that direction, metres.
    pub tangential_footprint: f32,
    /// Azimuth about the mirror's axis in the image, turns from image right towards image up, in [0, 1).
    pub azimuth_turns: f32,
}

/// All samples, scan line by scan line.
#[derive(Debug, Clone, PartialEq)]
pub struct ScanPattern {
    /// Line by line, outward.
    pub samples: Vec<ScanSample>,
    /// The lines, split where no ground is visible.
    pub segments: Vec<ScanSegment>,
    /// Number of distinct pixels.
    pub pixel_count: usize,
    /// Distinct pixels as a fraction of the image (minho2016: 27.5 %).
    pub coverage: f32,
}

impl ScanSegment {
    /// Indices of its samples.
    pub(crate) fn samples(&self) -> Range<usize> {
        self.start as usize..self.end as usize
    }
}

/// Shorter segments cannot contain carpet, line and carpet, samples.
const SEGMENT_SAMPLES_MIN: usize = 5;

impl ScanPattern {
    /// Lays the scan lines over the image; keeps pixels that show ground within range and are true in the mask.
    ///
    /// `mask`: one entry per pixel, row by row; false on the robot's own body and rods.
    pub fn new(
        map: &GroundMap,
        camera: &CameraConfig,
        mask: Option<&[bool]>,
        line_width: f32,
        config: &ScanConfig,
    ) -> Self {
        let mut builder = Builder {
            map,
            camera,
            mask,
            config,
            radial_footprint_max: config.pixel_footprint_max * line_width,
            visited: vec![false; map.width_px * map.height_px],
            samples: Vec::new(),
            segments: Vec::new(),
        };
        let (width, height) = (map.width_px as f32, map.height_px as f32);
        let [cu, cv] = camera.centre_px;
        let corner = math::hypot(cu.max(width - cu), cv.max(height - cv));
        let rim = camera.outer_radius_px.unwrap_or(corner).min(corner);
        for line in 0..config.radial_lines {
            let angle = TAU * line as f32 / config.radial_lines as f32;
            builder.walk(ScanKind::Radial, line, rim, |arc_length| {
                (arc_length, angle)
            });
        }
        let sweep = TAU * config.spiral_turns;
        for line in 0..2 * config.spirals_each_way {
            let sweep_signed = if line % 2 == 0 { sweep } else { -sweep };
            let start = TAU * (line / 2) as f32 / config.spirals_each_way as f32;
            // Archimedes' spiral: equal steps along the arc need the radius as a function of its length.
            let radius_at = SpiralLength::new(rim, sweep);
            let length = radius_at.length();
            builder.walk(ScanKind::Spiral, line, length, |arc_length| {
                let radius = radius_at.radius(arc_length);
                (radius, start + sweep_signed * radius / rim)
            });
        }
        let [inner, outer] = builder.radii(rim);
        for line in 0..config.circles {
            let part = (line as f32 + 0.5) / config.circles as f32;
            let radius = inner + part * (outer - inner);
            builder.walk(ScanKind::Circle, line, TAU * radius, |arc_length| {
                (radius, arc_length / radius)
            });
        }
        let pixels = builder.visited.iter().filter(|&&visited| visited).count();
        ScanPattern {
            coverage: pixels as f32 / builder.visited.len().max(1) as f32,
            samples: builder.samples,
            segments: builder.segments,
            pixel_count: pixels,
        }
    }

    /// Number of samples of the longest segment.
    pub(crate) fn longest_segment(&self) -> usize {
        self.segments
            .iter()
            .map(|segment| segment.samples().len())
            .max()
            .unwrap_or(0)
    }

    /// The segments of these scan lines.
    pub(crate) fn segments_of(&self, lines: ScanLines) -> impl Iterator<Item = &ScanSegment> {
        self.segments
            .iter()
            .filter(move |segment| lines.contains(segment))
    }
}

struct Builder<'a> {
    map: &'a GroundMap,
    camera: &'a CameraConfig,
    mask: Option<&'a [bool]>,
    config: &'a ScanConfig,
    radial_footprint_max: f32,
    visited: Vec<bool>,
    samples: Vec<ScanSample>,
    segments: Vec<ScanSegment>,
}

impl Builder<'_> {
    /// Samples a line in steps of one pixel; `place` returns radius (pixels) and azimuth at a length along the line.
    fn walk(
        &mut self,
        kind: ScanKind,
        line: usize,
        length_px: f32,
        place: impl Fn(f32) -> (f32, f32),
    ) {
        let mut start = self.samples.len();
        let mut last = None;
        for step in 0..=length_px as usize {
            let (radius, angle) = place(step as f32);
            let [u, v] = nearest_pixel(self.camera.centre_px, radius, math::sin_cos(angle));
            if last == Some((u, v)) {
                continue;
            }
            last = Some((u, v));
            match self.sample(u, v) {
                Some(sample) => self.samples.push(sample),
                None => start = self.close(kind, line, start),
            }
        }
        self.close(kind, line, start);
    }

    /// Image radii between which ground within range is visible in any direction, pixels.
    fn radii(&self, rim: f32) -> [f32; 2] {
        const DIRECTIONS: usize = 64;
        let mut radii = [rim, 0.0];
        for step in 0..=rim as usize {
            let radius = step as f32;
            let visible = (0..DIRECTIONS).any(|direction| {
                let angle = TAU * direction as f32 / DIRECTIONS as f32;
                let [u, v] = nearest_pixel(self.camera.centre_px, radius, math::sin_cos(angle));
                self.sample(u, v).is_some()
            });
            if visible {
                radii = [radii[0].min(radius), radius];
            }
        }
        if radii[0] < radii[1] {
            radii
        } else {
            [0.0, rim]
        }
    }

    fn close(&mut self, kind: ScanKind, line: usize, start: usize) -> usize {
        if self.samples.len() - start < SEGMENT_SAMPLES_MIN {
            self.samples.truncate(start);
            return start;
        }
        for sample in &self.samples[start..] {
            self.visited[sample.v as usize * self.map.width_px + sample.u as usize] = true;
        }
        self.segments.push(ScanSegment {
            kind,
            line_index: line as u32,
            start: start as u32,
            end: self.samples.len() as u32,
        });
        self.samples.len()
    }

    fn sample(&self, u: f32, v: f32) -> Option<ScanSample> {
        if !(u >= 0.0 && v >= 0.0 && self.camera.is_inside_mirror(u, v)) {
            return None;
        }
        let (column, row) = (u as usize, v as usize);
        let ground = self.map.at(column, row)?;
        if self
            .mask
            .is_some_and(|mask| !mask[row * self.map.width_px + column])
        {
            return None;
        }
        let range = ground.distance();
        if !(self.config.range_min..=self.config.range_max).contains(&range) {
            return None;
        }
        let footprint = pixel_footprint(self.map, column, row)?;
        if footprint.radial > self.radial_footprint_max {
            return None;
        }
        let angle = azimuth(self.camera.centre_px, [u, v]);
        Some(ScanSample {
            u: column as u16,
            v: row as u16,
            ground: [ground.x, ground.y],
            range,
            radial_footprint: footprint.radial,
            tangential_footprint: footprint.tangential,
            azimuth_turns: (angle / TAU).rem_euclid(1.0),
        })
    }
}

/// Ground that a pixel covers, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PixelFootprint {
    /// Along the direction from the robot.
    pub radial: f32,
    /// Across that direction.
    pub tangential: f32,
}

/// Ground that a pixel covers, from the map's differences to the neighbouring pixels.
///
/// None if the pixel, or both its neighbours in a row or column, show no ground.
pub fn pixel_footprint(map: &GroundMap, column: usize, row: usize) -> Option<PixelFootprint> {
    let here = map.at(column, row)?;
    let derivative = |before: Option<_>, after: Option<_>| -> Option<[f32; 2]> {
        type Ground = localize::frames::At<localize::frames::RobotFrame>;
        let (before, after): (Option<Ground>, Option<Ground>) = (before, after);
        match (before, after) {
            (Some(b), Some(a)) => Some([(a.x - b.x) / 2.0, (a.y - b.y) / 2.0]),
            (Some(b), None) => Some([here.x - b.x, here.y - b.y]),
            (None, Some(a)) => Some([a.x - here.x, a.y - here.y]),
            (None, None) => None,
        }
    };
    let along_u = derivative(
        column.checked_sub(1).and_then(|u| map.at(u, row)),
        map.at(column + 1, row),
    )?;
    let along_v = derivative(
        row.checked_sub(1).and_then(|v| map.at(column, v)),
        map.at(column, row + 1),
    )?;
    let range = here.distance();
    if range < 1e-6 {
        return None;
    }
    let [ex, ey] = [here.x / range, here.y / range];
    let along = |[x, y]: [f32; 2]| ex * x + ey * y;
    let across = |[x, y]: [f32; 2]| ex * y - ey * x;
    let length = |a: f32, b: f32| (a * a + b * b).sqrt();
    Some(PixelFootprint {
        radial: length(along(along_u), along(along_v)),
        tangential: length(across(along_u), across(along_v)),
    })
}

/// Arc length of Archimedes' spiral r = rim·φ/sweep as a function of the radius, tabulated and inverted.
struct SpiralLength {
    rim: f32,
    lengths: Vec<f32>,
}

impl SpiralLength {
    fn new(rim: f32, sweep: f32) -> Self {
        let steps = rim.ceil().max(1.0) as usize;
        let step = rim / steps as f32;
        let mut lengths = Vec::with_capacity(steps + 1);
        let mut length = 0.0;
        lengths.push(0.0);
        for index in 0..steps {
            let middle = (index as f32 + 0.5) * step;
            length += step * math::hypot(1.0f32, sweep * middle / rim);
            lengths.push(length);
        }
        SpiralLength { rim, lengths }
    }

    fn length(&self) -> f32 {
        self.lengths[self.lengths.len() - 1]
    }

    fn radius(&self, length: f32) -> f32 {
        let steps = self.lengths.len() - 1;
        let upper = self
            .lengths
            .partition_point(|&l| l <= length)
            .clamp(1, steps);
        let (l0, l1) = (self.lengths[upper - 1], self.lengths[upper]);
        let part = ((length - l0) / (l1 - l0)).clamp(0.0, 1.0);
        self.rim * (upper as f32 - 1.0 + part) / steps as f32
    }
}
