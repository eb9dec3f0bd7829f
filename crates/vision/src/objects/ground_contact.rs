//! Refines an obstacle's ground contact pixel by pixel around the ray that found it.

use localize::math;

use crate::colour::lookup_table::{ColourClass, ColourLookupTable};
use crate::image::ImageView;
use crate::optics::ground_map::GroundMap;
use crate::optics::image_polar::nearest_pixel;

/// Search radius along a direction, pixels: a few samples of a ray.
const SEARCH_RADIUS_PX: i32 = 6;
const SEARCH_SAMPLES: usize = 2 * SEARCH_RADIUS_PX as usize + 1;
/// Directions between two rays: 0.5° for 180 of them, 4 cm at 4 m.
const DIRECTIONS_PER_RAY: i16 = 4;
/// Consecutive pixels that are not floor and confirm an obstacle: a line's blurred edge has two.
const OBSTACLE_PIXELS_MIN: usize = 3;

/// Searches ground contacts in one image.
#[derive(Clone, Copy)]
pub(crate) struct GroundContactSearch<'a> {
    pub(crate) image: &'a ImageView<'a>,
    pub(crate) map: &'a GroundMap,
    pub(crate) lookup_table: &'a ColourLookupTable,
    /// The mirror's axis in the image, pixels.
    pub(crate) centre_px: [f32; 2],
}

/// An obstacle's nearest ground contact.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct GroundContact {
    /// Metres.
    pub(crate) range: f32,
    /// Column and row.
    pub(crate) position_px: [f32; 2],
}

impl GroundContactSearch<'_> {
    /// Nearest end of the floor around a pixel, up to one ray angle (radians) to both sides.
    pub(crate) fn find_nearest(&self, [u, v]: [f32; 2], ray_angle: f32) -> Option<GroundContact> {
        let (across, up) = (u - self.centre_px[0], self.centre_px[1] - v);
        let (angle, radius) = (math::atan2(up, across), math::hypot(across, up));
        let step = ray_angle / f32::from(DIRECTIONS_PER_RAY);
        (-DIRECTIONS_PER_RAY..=DIRECTIONS_PER_RAY)
            .filter_map(|step_index| {
                self.find_in_direction(angle + f32::from(step_index) * step, radius)
            })
            .min_by(|a, b| a.range.total_cmp(&b.range))
    }

    /// End of the floor in one direction. None if it does not end within the search radius.
    fn find_in_direction(&self, angle: f32, radius: f32) -> Option<GroundContact> {
        let azimuth = math::sin_cos(angle);
        let mut pixels = [[0.0; 2]; SEARCH_SAMPLES];
        let mut levels = [0.0; SEARCH_SAMPLES];
        let (mut carpet_sum, mut carpet_count) = (0.0, 0.0);
        let (mut first, mut obstacle_pixels) = (None, 0);
        for (index, step) in (-SEARCH_RADIUS_PX..=SEARCH_RADIUS_PX).enumerate() {
            let from_axis = radius + step as f32;
            let at = nearest_pixel(self.centre_px, from_axis, azimuth);
            let (class, level) = self.class_and_brightness(at)?;
            (pixels[index], levels[index]) = (at, level);
            match class {
                ColourClass::CARPET | ColourClass::WHITE => (first, obstacle_pixels) = (None, 0),
                _ => (first, obstacle_pixels) = (first.or(Some(index)), obstacle_pixels + 1),
            }
            if class == ColourClass::CARPET {
                (carpet_sum, carpet_count) = (carpet_sum + level, carpet_count + 1.0);
            }
            if obstacle_pixels == OBSTACLE_PIXELS_MIN {
                break;
            }
        }
        let first = first.filter(|&first| {
            obstacle_pixels == OBSTACLE_PIXELS_MIN && first > 0 && carpet_count > 0.0
        })?;
        let dark = levels[first..first + OBSTACLE_PIXELS_MIN].iter().copied();
        let dark = dark.fold(f32::INFINITY, f32::min);
        // A blurred edge is at half height; classes change later, since dim carpet is still carpet.
        let half = (carpet_sum / carpet_count + dark) / 2.0;
        let edge = (1..=first).rev().find(|&index| levels[index - 1] >= half);
        let (edge, part) = match edge {
            Some(edge) if levels[edge] < half => {
                let (before, after) = (levels[edge - 1], levels[edge]);
                (edge, (before - half) / (before - after))
            }
            _ => (first, 0.5),
        };
        let range = |[u, v]: [f32; 2]| Some(self.map.at(u as usize, v as usize)?.distance());
        let (before, after) = (range(pixels[edge - 1])?, range(pixels[edge])?);
        Some(GroundContact {
            range: before + part * (after - before),
            position_px: pixels[edge],
        })
    }

    /// A pixel's class and brightness.
    fn class_and_brightness(&self, [u, v]: [f32; 2]) -> Option<(ColourClass, f32)> {
        let (width, height) = (self.map.width_px as f32, self.map.height_px as f32);
        let inside = u >= 0.0 && v >= 0.0 && u < width && v < height;
        inside.then(|| {
            let (column, row) = (u as usize, v as usize);
            let level: f32 = self.image.rgb(column, row).map(f32::from).iter().sum();
            (
                self.lookup_table
                    .class(self.image.native_channels(column, row)),
                level,
            )
        })
    }
}
