//! Which rays can meet an object? All pixels' rays, sorted by azimuth and slope, with their spacing.
//!
//! An object spans a few azimuth bins and in each bin one run of slopes. Two binary searches find its pixels for any
//! shape of the mirror, and rendering reads memory sequentially.

use std::f32::consts::{PI, TAU};
use std::ops::Range;

use vision::{Ray, RayTable};

use super::lanes::LANES;
use super::row_transform::RowTransform;
use super::slope_reach::SlopeReach;

/// Azimuth bins in a full circle: 0.5° is about a pixel at half the radius of a 480 × 480 image.
const BINS: usize = 720;
/// Rays at which a tile is complete: their data fill half a cache of 512 KiB.
const TILE_RAYS: usize = 4096;
/// Half width of a bin, radians, and a little more.
pub(super) const BIN_SPREAD: f32 = 0.51 * TAU / BINS as f32;
/// Largest slope (height over horizontal distance): steeper rays count as vertical.
const SLOPE_MAX: f32 = 1e4;

/// Rays in bin order, one array per component (padded by `LANES`), robot frame. Points on a ray are `origin + s·(direction, slope)` for a
/// horizontal distance s, metres.
#[derive(Debug, Clone, Default)]
pub(crate) struct SortedRays {
    /// Where each bin starts; the last entry is the number of rays.
    starts: Vec<usize>,
    /// Pixel of each ray (row by row).
    pub(crate) pixel: Vec<u32>,
    pub(crate) origin_x: Vec<f32>,
    pub(crate) origin_y: Vec<f32>,
    pub(crate) origin_z: Vec<f32>,
    /// Horizontal direction, unit length.
    pub(crate) direction_x: Vec<f32>,
    pub(crate) direction_y: Vec<f32>,
    /// Height per horizontal metre; increases within a bin.
    pub(crate) slope: Vec<f32>,
    /// Azimuth between neighbouring pixels' rays times the blur, radians.
    pub(crate) azimuth_spacing: Vec<f32>,
    /// Slope between neighbouring pixels' rays times the blur.
    pub(crate) slope_spacing: Vec<f32>,
    /// Row of each ray's pixel: -0.5 at the top of the image, 0.5 at the bottom.
    pub(super) row: Vec<f32>,
    /// Motion of the rays during the current image.
    pub(super) transform: RowTransform,
    /// Groups of bins with a few thousand rays each.
    pub(super) tiles: Vec<Tile>,
    /// Horizontal direction of the middle of each bin, unit vectors.
    bin_directions: Vec<[f32; 2]>,
    reach: SlopeReach,
    /// Runs of neighbouring pixels without a ray.
    pub(super) blank: Vec<Range<usize>>,
    /// Largest horizontal distance of an origin from the axis, metres.
    pub(super) origin_radius_max: f32,
    /// Largest distance between a ray's line and the axis, metres: 0 for an upright mirror.
    axis_offset_max: f32,
    origin_height_min: f32,
    pub(super) origin_height_max: f32,
}

/// Neighbouring bins that are rendered together.
#[derive(Debug, Clone)]
pub(super) struct Tile {
    bins: Range<usize>,
    /// The rays of those bins.
    pub(super) rays: Range<usize>,
    /// First pixel of each run of neighbouring pixels in the order of the image, and their number.
    spans: Vec<(u32, u32)>,
    /// Ray of each pixel of these runs, by its index in the tile.
    by_pixel: Vec<u32>,
}

/// Rays that may meet an object: bins, counter-clockwise from the first, and the range of slopes in each.
#[derive(Debug, Clone, Copy)]
pub(super) struct RayRange {
    first: usize,
    count: usize,
    slope_min: f32,
    slope_max: f32,
    /// Limits of the level slopes; infinite if all slopes count.
    level: [f32; 2],
}

impl Tile {
    /// Writes the values of the tile's rays to their pixels. Sequential writes, one a pixel, since they miss the cache.
    pub(super) fn write<T: Copy>(&self, by_ray: &[T], image: &mut [T]) {
        let mut rays = &self.by_pixel[..];
        for &(first, count) in &self.spans {
            let (own, others) = rays.split_at(count as usize);
            rays = others;
            for (pixel, ray) in image[first as usize..].iter_mut().zip(own) {
                *pixel = by_ray[*ray as usize];
            }
        }
    }
}

impl SortedRays {
    /// Sorts a table of rays; the blur of the optics (pixels, by the pixel's index) widens every ray.
    pub(crate) fn new(table: &RayTable, blur_px: impl Fn(usize) -> f32) -> Self {
        let mut keyed: Vec<(usize, f32, u32)> = Vec::new();
        let mut rays = SortedRays::default();
        for (pixel, ray) in table.rays.iter().enumerate() {
            match ray {
                Some(ray) => keyed.push((bin_of(azimuth(ray)), slope(ray), pixel as u32)),
                None => match rays.blank.last_mut() {
                    Some(run) if run.end == pixel => run.end += 1,
                    _ => rays.blank.push(pixel..pixel + 1),
                },
            }
        }
        keyed.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.cmp(&b.2)));
        rays.origin_height_min = f32::MAX;
        rays.starts = (0..=BINS)
            .map(|bin| keyed.partition_point(|key| key.0 < bin))
            .collect();
        for (_, slope, pixel) in keyed {
            let Some(ray) = table.rays[pixel as usize] else {
                continue;
            };
            let (sin, cos) = azimuth(&ray).sin_cos();
            let (spacing, slope_spacing) = pixel_spacing(table, pixel as usize, &ray);
            rays.pixel.push(pixel);
            rays.origin_x.push(ray.origin[0]);
            rays.origin_y.push(ray.origin[1]);
            rays.origin_z.push(ray.origin[2]);
            rays.direction_x.push(cos);
            rays.direction_y.push(sin);
            rays.slope.push(slope);
            let blur = blur_px(pixel as usize);
            rays.azimuth_spacing.push(spacing * blur);
            rays.slope_spacing.push(slope_spacing * blur);
            let row = (pixel as usize / table.width_px) as f32 + 0.5;
            rays.row.push(row / table.height_px as f32 - 0.5);
            rays.axis_offset_max = rays
                .axis_offset_max
                .max((ray.origin[0] * sin - ray.origin[1] * cos).abs());
            rays.origin_radius_max = rays
                .origin_radius_max
                .max(ray.origin[0].hypot(ray.origin[1]));
            rays.origin_height_min = rays.origin_height_min.min(ray.origin[2]);
            rays.origin_height_max = rays.origin_height_max.max(ray.origin[2]);
        }
        rays.reach = SlopeReach::new(&rays.slope, &rays.slope_spacing);
        rays.bin_directions = (0..BINS)
            .map(|bin| {
                let (sin, cos) = ((bin as f32 + 0.5) * TAU / BINS as f32).sin_cos();
                [cos, sin]
            })
            .collect();
        let mut first = 0;
        for bin in 1..=BINS {
            let count = rays.starts[bin] - rays.starts[first];
            if count >= TILE_RAYS || bin == BINS {
                rays.tiles.push(rays.tile(first..bin));
                first = bin;
            }
        }
        for component in [
            &mut rays.origin_x,
            &mut rays.origin_y,
            &mut rays.origin_z,
            &mut rays.direction_x,
            &mut rays.direction_y,
            &mut rays.slope,
            &mut rays.azimuth_spacing,
            &mut rays.slope_spacing,
            &mut rays.row,
        ] {
            component.extend([1.0; LANES]);
        }
        rays
    }

    pub(crate) fn count(&self) -> usize {
        self.pixel.len()
    }

    /// The tile of some bins.
    fn tile(&self, bins: Range<usize>) -> Tile {
        let rays = self.starts[bins.start]..self.starts[bins.end];
        let mut by_pixel: Vec<(u32, u32)> =
            self.pixel[rays.clone()].iter().copied().zip(0..).collect();
        by_pixel.sort_unstable();
        let spans = by_pixel
            .chunk_by(|before, after| before.0 + 1 == after.0)
            .map(|run| (run[0].0, run.len() as u32))
            .collect();
        Tile {
            bins,
            rays,
            spans,
            by_pixel: by_pixel.into_iter().map(|(_, ray)| ray).collect(),
        }
    }

    /// All rays as one tile.
    pub(super) fn single_tile(&self) -> Tile {
        self.tile(0..BINS)
    }

    /// The bins of a tile, each with its rays.
    pub(super) fn bins(&self, tile: &Tile) -> impl Iterator<Item = (usize, Range<usize>)> + '_ {
        tile.bins
            .clone()
            .map(|bin| (bin, self.starts[bin]..self.starts[bin + 1]))
    }

    /// Horizontal direction of the middle of a bin, unit vector.
    pub(super) fn bin_direction(&self, bin: usize) -> [f32; 2] {
        self.bin_directions[bin]
    }

    /// The runs of a tile's rays in a range.
    pub(super) fn runs_in(
        &self,
        range: &RayRange,
        tile: &Tile,
    ) -> impl Iterator<Item = Range<usize>> + '_ {
        let RayRange {
            first,
            count,
            slope_min: low,
            slope_max: high,
            level,
        } = *range;
        let bins = tile.bins.clone();
        // The range may wrap around from the last bin to bin 0.
        [0, BINS]
            .into_iter()
            .flat_map(move |turn| {
                let from = first.max(bins.start + turn) - turn;
                let to = (first + count).min(bins.end + turn).max(turn) - turn;
                from..to
            })
            .map(move |bin| {
                let start = self.starts[bin];
                let slopes = &self.slope[start..self.starts[bin + 1]];
                let low = self.steepest(bin, level[0]).max(low);
                let high = self.highest(bin, level[1]).min(high);
                let from = slopes.partition_point(|&slope| slope < low);
                let more = slopes[from..].partition_point(|&slope| slope <= high);
                start + from..start + from + more
            })
    }

    /// The rays that may meet an upright cylinder around (x, y) between two heights, and some neighbours.
    pub(super) fn range_of_cylinder(
        &self,
        x: f32,
        y: f32,
        radius: f32,
        bottom: f32,
        top: f32,
    ) -> RayRange {
        let distance = x.hypot(y);
        let RowTransform {
            angle_max,
            shift_max,
            ..
        } = self.transform;
        let radius = radius + shift_max;
        // Rays do not start exactly on the axis.
        let wide = radius + self.axis_offset_max;
        let half = if distance > wide * 1.01 {
            (wide / distance).asin()
        } else {
            PI
        };
        let middle = y.atan2(x);
        let near = (distance - radius - self.origin_radius_max).max(1e-3);
        let far = distance + radius + self.origin_radius_max;
        // From the highest origin to the near bottom, from the lowest to the top; a pixel's width of margin.
        let down = bottom - self.origin_height_max;
        let up = top - self.origin_height_min;
        let low = if down < 0.0 { down / near } else { down / far };
        let high = if up < 0.0 { up / far } else { up / near };
        // A tilt by an angle changes azimuths by up to angle·slope and slopes by up to angle·(1 + slope²).
        let half = (half + angle_max * (1.0 + low.abs().max(high.abs()))).min(PI);
        let margin = |slope: f32| 0.02 + 0.02 * slope.abs() + angle_max * (1.0 + slope * slope);
        // The same limits without the tilt, which is known for each bin, and with the footprints' real size.
        let lifted = angle_max * (self.origin_radius_max + angle_max * self.origin_height_max);
        let (down, up) = (down - lifted, up + lifted);
        let level_low = if down < 0.0 { down / near } else { down / far };
        let level_high = if up < 0.0 { up / far } else { up / near };
        let spare = 1e-4 / near;
        let level = [
            level_low - self.reach_below(level_low) - spare,
            level_high + self.reach_above(level_high) + spare,
        ];
        RayRange {
            slope_min: low - 1.2 * margin(low),
            slope_max: high + 1.2 * margin(high),
            level,
            ..self.range_of_sector(middle - half, middle + half)
        }
    }

    /// All rays between two azimuths (counter-clockwise), and the bins on either side.
    pub(super) fn range_of_sector(&self, from: f32, to: f32) -> RayRange {
        let width = TAU / BINS as f32;
        let first = (from / width).floor() as i64 - 1;
        let count = ((to - from) / width).ceil().max(0.0) as usize + 3;
        RayRange {
            first: first.rem_euclid(BINS as i64) as usize,
            count: count.min(BINS),
            slope_min: f32::NEG_INFINITY,
            slope_max: f32::INFINITY,
            level: [f32::NEG_INFINITY, f32::INFINITY],
        }
    }

    /// The least slope as mounted of the rays of a bin that may be at or above a level slope.
    pub(super) fn steepest(&self, bin: usize, level: f32) -> f32 {
        let mounted = self
            .transform
            .mounted_slope(level, self.bin_directions[bin]);
        mounted.map_or(f32::NEG_INFINITY, |slope| {
            slope - self.transform.slope_margin(slope, BIN_SPREAD)
        })
    }

    /// The largest slope as mounted of the rays of a bin that may be at or below a level slope.
    fn highest(&self, bin: usize, level: f32) -> f32 {
        let mounted = self
            .transform
            .mounted_slope(level, self.bin_directions[bin]);
        mounted.map_or(f32::INFINITY, |slope| {
            slope + self.transform.slope_margin(slope, BIN_SPREAD)
        })
    }

    /// How far below a level slope a ray's footprint may still reach it, at any tilt of the current image.
    pub(super) fn reach_below(&self, level: f32) -> f32 {
        let tilted = 1.2 * self.transform.angle_max * (1.0 + level * level);
        let [low, high] = [level - tilted, level + tilted].map(|slope| self.reach.below(slope));
        low.max(high)
    }

    fn reach_above(&self, level: f32) -> f32 {
        let tilted = 1.2 * self.transform.angle_max * (1.0 + level * level);
        let [low, high] = [level - tilted, level + tilted].map(|slope| self.reach.above(slope));
        low.max(high)
    }
}

fn azimuth(ray: &Ray) -> f32 {
    ray.direction[1].atan2(ray.direction[0])
}

fn slope(ray: &Ray) -> f32 {
    let across = ray.direction[0].hypot(ray.direction[1]);
    (ray.direction[2] / across.max(1e-9)).clamp(-SLOPE_MAX, SLOPE_MAX)
}

fn bin_of(azimuth: f32) -> usize {
    ((azimuth.rem_euclid(TAU) / TAU * BINS as f32) as usize).min(BINS - 1)
}

/// Change of azimuth and slope from a pixel to the next, root sum square over rows and columns.
fn pixel_spacing(table: &RayTable, pixel: usize, ray: &Ray) -> (f32, f32) {
    let (column, row) = (pixel % table.width_px, pixel / table.width_px);
    let (mut turn2, mut rise2) = (0.0, 0.0);
    for (from, to) in [
        (
            (column > 0).then(|| pixel - 1),
            (column + 1 < table.width_px).then_some(pixel + 1),
        ),
        (
            (row > 0).then(|| pixel - table.width_px),
            (row + 1 < table.height_px).then_some(pixel + table.width_px),
        ),
    ] {
        let neighbour = |at: Option<usize>| at.and_then(|at| table.rays[at]);
        let (before, after) = (neighbour(from), neighbour(to));
        let steps = f32::from(u8::from(before.is_some()) + u8::from(after.is_some())).max(1.0);
        let (before, after) = (before.unwrap_or(*ray), after.unwrap_or(*ray));
        let turn = localize::frames::wrap_angle(azimuth(&after) - azimuth(&before)) / steps;
        let rise = (slope(&after) - slope(&before)) / steps;
        turn2 += turn * turn;
        rise2 += rise * rise;
    }
    (turn2.sqrt().clamp(1e-4, 1.0), rise2.sqrt().max(1e-5))
}

#[cfg(test)]
mod tests;
