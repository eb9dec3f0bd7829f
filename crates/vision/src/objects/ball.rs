//! Ball detection: a region of the ball's colour on the carpet, of the size expected at its distance.
//!
//! From a viewpoint at height H, a ball of radius r at distance d covers the angles φ ± δ from the vertical, with
//! tan φ = d/(H − r) and sin δ = r/√(d² + (H − r)²). The map gives each pixel's ground point and so its angle.

use localize::frames::{At, RobotFrame};
use localize::math;

use crate::colour::lookup_table::{ColourClass, ColourLookupTable};
use crate::config::ObjectDetectionConfig;
use crate::image::ImageView;
use crate::objects::covariance::covariance_from_polar;
use crate::optics::ground_map::GroundMap;
use crate::optics::image_polar::{azimuth, wrap_turns};
use crate::scan::pattern::pixel_footprint;

/// The ball.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BallDetection {
    /// Contact point with the ground, metres; apparent if the ball is in the air.
    pub at: At<RobotFrame>,
    /// Covariance: xx, xy, yy, m².
    pub covariance: [f32; 3],
    /// False if it appears larger than a ball on the ground, so it is in the air.
    pub on_ground: bool,
    /// Confidence, 0 to 1: visible part of a whole ball.
    pub score: f32,
    /// Centroid of its region in the image: column, row, pixels.
    pub position_px: [f32; 2],
    /// Number of pixels of the region.
    pub pixels: usize,
    /// Distance of the centre from the viewpoint by the apparent size, and its standard deviation, metres. None for a ball
    /// on the ground, whose size was not measured.
    pub distance: Option<[f32; 2]>,
}

/// Detects the ball in one image.
pub(crate) struct BallDetector<'a> {
    pub(crate) image: &'a ImageView<'a>,
    pub(crate) map: &'a GroundMap,
    pub(crate) lookup_table: &'a ColourLookupTable,
    pub(crate) config: &'a ObjectDetectionConfig,
    /// Range of the carpet's boundary along each ray, metres.
    pub(crate) carpet_end: &'a [f32],
    /// The mirror's axis in the image, pixels.
    pub(crate) centre_px: [f32; 2],
}

/// Marks visited pixels; reused to avoid an allocation per image.
#[derive(Debug, Clone, Default)]
pub(crate) struct VisitedMask {
    /// One byte per pixel, so that the whole plane fits a core's cache.
    marks: Vec<u8>,
    generation: u8,
}

impl VisitedMask {
    /// Unmarks all pixels.
    fn reset(&mut self, pixels: usize) {
        if self.marks.len() != pixels || self.generation == u8::MAX {
            self.marks.clear();
            self.marks.resize(pixels, 0);
            self.generation = 0;
        }
        self.generation += 1;
    }

    /// Marks a pixel; true if it was unmarked.
    fn mark(&mut self, pixel: usize) -> bool {
        let first = self.marks[pixel] != self.generation;
        self.marks[pixel] = self.generation;
        first
    }
}

/// Largest region, pixels, and as a share of a whole ball on the ground: a ball in the air appears larger.
const REGION_PIXELS_MAX: usize = 20_000;
const PIXELS_SHARE_MAX: f32 = 5.0;
/// Standard deviation of a distance by the size of the region: its edge is blurred, and its shaded side may be missing.
const DISTANCE_STD_SHARE: f32 = 0.2;
/// Length of a ball's region over the square root of its pixels, with room for one that the mirror draws long.
const REACH_SHARE: f32 = 1.6;

/// Neighbours for the flood fill, up to two pixels away, so that noise and thin cables do not split a ball.
const NEIGHBOURS: [(i32, i32); 12] = [
    (-1, 0),
    (1, 0),
    (0, -1),
    (0, 1),
    (-2, 0),
    (2, 0),
    (0, -2),
    (0, 2),
    (-1, -1),
    (1, -1),
    (-1, 1),
    (1, 1),
];

/// Directions in which a region's surroundings are sampled.
const SURROUND_DIRECTIONS: usize = 24;
/// Distance outside the region at which its blurred edge has ended, pixels.
const SURROUND_OFFSET_PX: f32 = 3.0;

impl BallDetector<'_> {
    /// Best candidate among the regions at the seeds (column, row of pixels of the ball's colour).
    pub(crate) fn detect(
        &self,
        seeds: impl Iterator<Item = [u16; 2]>,
        visited: &mut VisitedMask,
    ) -> Option<BallDetection> {
        visited.reset(self.map.width_px * self.map.height_px);
        let mut best: Option<BallDetection> = None;
        let mut region = Vec::new();
        for seed in seeds {
            // A region that outgrows a ball is none; filling all of a wooden floor would cost more than all else.
            let Some(pixels_max) = self.region_pixels_max(seed) else {
                continue;
            };
            if self.flood_fill(seed, visited, pixels_max, &mut region)
                && let Some(ball) = self.evaluate_region(&region)
                && best.is_none_or(|best| ball.score > best.score)
            {
                best = Some(ball);
            }
        }
        best
    }

    /// Pixels of the largest region that may be a ball around a seed at its near edge.
    fn region_pixels_max(&self, [u, v]: [u16; 2]) -> Option<usize> {
        let range = self.map.at(usize::from(u), usize::from(v))?.distance();
        let whole = expected_ball_pixels(self.map, self.config, range, [u, v].map(f32::from))?;
        Some((PIXELS_SHARE_MAX * whole).min(REGION_PIXELS_MAX as f32) as usize)
    }

    /// Collects the region around a seed; false if it outgrows a ball or was collected before.
    fn flood_fill(
        &self,
        [u, v]: [u16; 2],
        visited: &mut VisitedMask,
        pixels_max: usize,
        region: &mut Vec<[u16; 2]>,
    ) -> bool {
        region.clear();
        let (width, height) = (self.map.width_px, self.map.height_px);
        if !visited.mark(usize::from(v) * width + usize::from(u)) {
            return false;
        }
        region.push([u, v]);
        // A ball of so many pixels is as long as this; a strip that is longer is none.
        let reach = (REACH_SHARE * (pixels_max as f32).sqrt()) as i32 + 2;
        let [seed_u, seed_v] = [u, v].map(i32::from);
        let mut next = 0;
        while next < region.len() && region.len() < pixels_max {
            let [u, v] = region[next].map(i32::from);
            next += 1;
            if (u - seed_u).abs().max((v - seed_v).abs()) > reach {
                return false;
            }
            let inside = |column: i32, row: i32| {
                (0..width as i32).contains(&column) && (0..height as i32).contains(&row)
            };
            // Only near the border each neighbour is checked.
            let inner = inside(u - 2, v - 2) && inside(u + 2, v + 2);
            for (du, dv) in NEIGHBOURS {
                let (column, row) = (u + du, v + dv);
                if !(inner || inside(column, row)) {
                    continue;
                }
                let (column, row) = (column as usize, row as usize);
                // Each pixel is classified once.
                if visited.mark(row * width + column)
                    && self
                        .lookup_table
                        .class(self.image.native_channels(column, row))
                        == ColourClass::BALL
                {
                    region.push([column as u16, row as u16]);
                }
            }
        }
        region.len() < pixels_max
    }

    fn evaluate_region(&self, region: &[[u16; 2]]) -> Option<BallDetection> {
        let config = self.config;
        if region.len() < config.ball_pixels_min {
            return None;
        }
        let height = config.viewpoint_height;
        let mut ranges = Vec::with_capacity(region.len());
        let [mut x, mut y, mut u_sum, mut v_sum] = [0.0f32; 4];
        for &[u, v] in region {
            u_sum += f32::from(u);
            v_sum += f32::from(v);
            let Some(ground) = self.map.at(usize::from(u), usize::from(v)) else {
                continue;
            };
            let range = ground.distance();
            x += ground.x / range;
            y += ground.y / range;
            ranges.push(range);
        }
        let length = math::hypot(x, y);
        if ranges.len() * 3 < region.len() || length <= 0.0 {
            return None;
        }
        let [ex, ey] = [x / length, y / length];
        let mapped = ranges.len();
        // The angle is monotone in the range, so ranges are ranked and only two converted to angles.
        let outliers = ranges.len() / 50;
        let mut angle = |rank: usize| {
            let (_, range, _) = ranges.select_nth_unstable_by(rank, f32::total_cmp);
            math::atan(*range / height)
        };
        let near = angle(outliers);
        let far = angle(mapped - 1 - outliers);
        // If the horizon or an occluder cuts the ball, only its near edge is reliable; otherwise its middle is used.
        let whole = mapped == region.len();
        let centre_height = height - config.ball_radius;
        let half = |range: f32| math::asin(config.ball_radius / math::hypot(range, centre_height));
        let mut middle = (near + far) / 2.0;
        if !whole {
            for _ in 0..4 {
                middle = near + half(centre_height * math::tan(middle));
            }
        }
        let range = centre_height * math::tan(middle);
        if !(range.is_finite() && range > 0.0 && range <= config.ball_range_max) {
            return None;
        }
        let half_expected = half(range);
        let [u, v] = [u_sum, v_sum].map(|sum| sum / region.len() as f32);
        let angle = azimuth(self.centre_px, [u, v]);
        if self.is_beyond_carpet(angle / std::f32::consts::TAU, range) {
            return None;
        }
        let part = (far - near) / (2.0 * half_expected);
        let pixels = expected_ball_pixels(self.map, config, range, [u, v])?;
        let share = region.len() as f32 / pixels;
        // Larger than a ball on the ground: it is nearer and thus higher.
        let on_ground = part < 1.6 && share < 2.5;
        if share.min(part) < config.ball_visible_share_min || share > PIXELS_SHARE_MAX {
            return None;
        }
        if !self.is_surrounded_by_carpet([u, v], region.len()) {
            return None;
        }
        let far_footprint = height / math::cos(middle).powi(2) * half_expected;
        let along = 0.02 + 0.25 * far_footprint * (1.0 - part.min(1.0)) + 0.05 * far_footprint;
        let across = 0.01 + 0.01 * range;
        Some(BallDetection {
            at: At::new(range * ex, range * ey),
            covariance: covariance_from_polar([ex, ey], along, across),
            on_ground,
            score: share.min(1.0 / share).min(1.0) * part.min(1.0 / part).min(1.0).sqrt(),
            position_px: [u, v],
            pixels: region.len(),
            distance: (whole && !on_ground).then(|| {
                let distance = config.ball_radius / math::sin(half_expected * share.sqrt());
                [distance, DISTANCE_STD_SHARE * distance]
            }),
        })
    }

    /// True if a region is surrounded by carpet, unlike a poster or a shirt behind the field.
    ///
    /// Lines and occluding robots are neutral.
    fn is_surrounded_by_carpet(&self, [u, v]: [f32; 2], pixels: usize) -> bool {
        let reach = 3.0 * (pixels as f32 / std::f32::consts::PI).sqrt() + SURROUND_OFFSET_PX;
        let class = |length: f32, cos: f32, sin: f32| {
            let (column, row) = ((u + length * cos).round(), (v + length * sin).round());
            let inside = column >= 0.0
                && row >= 0.0
                && (column as usize) < self.map.width_px
                && (row as usize) < self.map.height_px;
            inside.then(|| {
                let native = self.image.native_channels(column as usize, row as usize);
                self.lookup_table.class(native)
            })
        };
        let [mut carpet, mut other, mut near_carpet, mut near_other] = [0u32; 4];
        let [towards_u, towards_v] = [self.centre_px[0] - u, self.centre_px[1] - v];
        let away = math::hypot(towards_u, towards_v).max(1.0);
        for direction in 0..SURROUND_DIRECTIONS {
            let (sin, cos) = math::sin_cos(
                std::f32::consts::TAU * direction as f32 / SURROUND_DIRECTIONS as f32,
            );
            let mut length = 0.0;
            while length <= reach && class(length, cos, sin) == Some(ColourClass::BALL) {
                length += 1.0;
            }
            // The near half borders carpet; the far half may hide the carpet's boundary.
            let near = u32::from(cos * towards_u + sin * towards_v > 0.5 * away);
            match class(length + SURROUND_OFFSET_PX, cos, sin) {
                Some(ColourClass::CARPET) => {
                    (carpet, near_carpet) = (carpet + 1, near_carpet + near)
                }
                Some(
                    ColourClass::WHITE
                    | ColourClass::BLACK
                    | ColourClass::BALL
                    | ColourClass::CYAN
                    | ColourClass::MAGENTA,
                ) => {}
                _ => (other, near_other) = (other + 1, near_other + near),
            }
        }
        match near_carpet + near_other {
            0 => carpet > other,
            _ => near_carpet >= near_other,
        }
    }

    /// True if the carpet ends before the ball's centre on both sides, so the region is behind the carpet.
    ///
    /// `turns`: azimuth about the mirror's axis; `range`: distance, metres.
    pub(crate) fn is_beyond_carpet(&self, turns: f32, range: f32) -> bool {
        let rays = rays_beside_ball(turns, range, self.config.ball_radius, self.carpet_end.len());
        ends_before(self.carpet_end, rays, range)
    }
}

/// Rays one past each side of a ball, of so many in all. `turns`: its azimuth; `range`: its distance, metres.
pub(crate) fn rays_beside_ball(
    turns: f32,
    range: f32,
    ball_radius: f32,
    count: usize,
) -> [usize; 2] {
    let half = ball_radius / (std::f32::consts::TAU * range);
    let ray = |turns: f32, outward: usize| {
        let place = wrap_turns(turns) * count as f32;
        (place as usize + outward) % count
    };
    [ray(turns - half, count - 1), ray(turns + half, 2)]
}

/// True if the carpet ends before a ball's centre on both rays beside it.
pub(crate) fn ends_before(carpet_end: &[f32], [right, left]: [usize; 2], range: f32) -> bool {
    // The ball hides carpet, so its centre may appear slightly farther.
    let farther = |ray: usize| range > 1.02 * carpet_end[ray];
    farther(right) & farther(left)
}

/// Pixels of a whole ball on the ground at a distance and image position: its solid angle over a pixel's.
pub(crate) fn expected_ball_pixels(
    map: &GroundMap,
    config: &ObjectDetectionConfig,
    range: f32,
    [u, v]: [f32; 2],
) -> Option<f32> {
    let height = config.viewpoint_height;
    let half = math::asin(config.ball_radius / math::hypot(range, height - config.ball_radius));
    let (column, row) = (u.round() as usize, v.round() as usize);
    let footprint = pixel_footprint(map, column, row)?;
    let ground = map.at(column, row)?.distance();
    let angle = math::atan(ground / height);
    let radial_angle = footprint.radial * math::cos(angle).powi(2) / height;
    let tangential_angle = footprint.tangential / ground * math::sin(angle);
    Some(std::f32::consts::PI * half * half / (radial_angle * tangential_angle))
}

/// Pixels of a whole ball at a ground point. None if the map does not show it.
pub fn expected_ball_pixels_at(
    map: &GroundMap,
    config: &ObjectDetectionConfig,
    at: At<RobotFrame>,
) -> Option<f32> {
    // The ball's centre projects to ground slightly beyond its contact point.
    let beyond = config.viewpoint_height / (config.viewpoint_height - config.ball_radius);
    let hidden = At::new(beyond * at.x, beyond * at.y);
    let pixel = map.nearest_pixel(hidden, 0.1 * at.distance())?;
    expected_ball_pixels(map, config, at.distance(), pixel)
}
