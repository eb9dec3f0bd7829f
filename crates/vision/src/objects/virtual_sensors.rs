//! Virtual sensors (lima2001 section 3.3): image regions that each answer one question.
//!
//! Nine bumpers around the robot, goals, ball, imminent kick, and whether the camera is still centred under the mirror.
//! Regions are configured in image coordinates; the others are derived from the ground map, for any mirror.

use localize::frames::At;
use localize::math;

use crate::colour::lookup_table::{ColourClass, ColourLookupTable};
use crate::config::{ImageRect, VirtualSensorConfig};
use crate::error::VisionError;
use crate::image::ImageView;
use crate::optics::ground_map::GroundMap;
use localize::config::SettingError;
use localize::robot::CameraConfig;

/// The setting below `vision.virtual_sensors` that holds the windows of that name.
fn setting_name(window: &str) -> &str {
    match window {
        "bumper" => "bumpers",
        "goal" => "goals",
        other => other,
    }
}

/// One bumper.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bumper {
    /// Fraction of its region that is black, white or of a team's colour.
    pub share: f32,
    /// True if the fraction reaches the threshold.
    pub hit: bool,
}

/// Readings of one image; positions are column and row, pixels.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct VirtualSensorReadings {
    /// The bumpers, from the left over the front to the right and round the back.
    pub bumpers: Vec<Bumper>,
    /// Centroid of the blue goal, if it is in a goal region.
    pub blue_goal_px: Option<[f32; 2]>,
    /// Centroid of the yellow goal, if it is in a goal region.
    pub yellow_goal_px: Option<[f32; 2]>,
    /// Centroid of the ball, if it is in the ball region.
    pub ball_px: Option<[f32; 2]>,
    /// True if the ball touches the kicker.
    pub kick: bool,
    /// Centroid of the camera's lens in the mirror. None if it does not stand out.
    pub lens_px: Option<[f32; 2]>,
    /// True if the lens is inside its region; otherwise mirror or camera moved.
    pub lens_centred: Option<bool>,
}

/// Sampled pixels of a region: a grid of at most [`GRID`] × [`GRID`].
#[derive(Debug, Clone)]
struct PixelGrid {
    pixels: Vec<[u16; 2]>,
}

/// The virtual sensors of one camera.
#[derive(Debug, Clone)]
pub(crate) struct VirtualSensors {
    config: VirtualSensorConfig,
    bumpers: Vec<PixelGrid>,
    goals: Vec<PixelGrid>,
    kick: PixelGrid,
    lens: PixelGrid,
    lens_window: ImageRect,
    /// Name and rectangle of each region: bumpers, goals, ball, kick, lens.
    regions: Vec<(&'static str, ImageRect)>,
}

/// Samples along a region's side: a resolution of 1/256 is finer than any threshold.
const GRID: usize = 16;
/// The lens is searched in a square this many times as wide as its region.
const LENS_SEARCH_SCALE: f32 = 3.0;
/// The lens is darker than this fraction of its surroundings.
const LENS_DARKNESS_RATIO: f32 = 0.6;
/// Number of bumpers, evenly around the robot (lima2001).
const BUMPERS: usize = 9;
/// Directions of the three goal regions from forward, degrees.
const GOALS_DEG: [f32; 3] = [40.0, 0.0, -40.0];

impl VirtualSensors {
    pub(crate) fn new(
        map: &GroundMap,
        camera: &CameraConfig,
        config: &VirtualSensorConfig,
    ) -> Result<Self, VisionError> {
        let layout = Layout { map, camera };
        let bumpers = match &config.bumpers[..] {
            [] => layout.bumpers(config),
            rects => rects.to_vec(),
        };
        let goals = match &config.goals[..] {
            [] => layout.goals(),
            rects => rects.to_vec(),
        };
        let kick = config.kick.or_else(|| layout.kick(config));
        let lens_window = config.lens.unwrap_or_else(|| layout.lens());
        let mut regions: Vec<(&'static str, ImageRect)> = Vec::new();
        regions.extend(bumpers.iter().map(|&window| ("bumper", window)));
        regions.extend(goals.iter().map(|&window| ("goal", window)));
        regions.extend(config.ball.map(|window| ("ball", window)));
        regions.extend(kick.map(|window| ("kick", window)));
        regions.push(("lens", lens_window));
        for (name, window) in &regions {
            let right = window.left_px + window.width_px;
            let bottom = window.top_px + window.height_px;
            let configured = match *name {
                "bumper" => !config.bumpers.is_empty(),
                "goal" => !config.goals.is_empty(),
                "ball" => true,
                "kick" => config.kick.is_some(),
                _ => config.lens.is_some(),
            };
            let inside = right <= map.width_px as f32 && bottom <= map.height_px as f32;
            if configured && !inside {
                let wide = right > map.width_px as f32;
                let (end, size_px) = match wide {
                    true => (right, map.width_px),
                    false => (bottom, map.height_px),
                };
                return Err(SettingError {
                    key: format!("vision.virtual_sensors.{}", setting_name(name)),
                    value: f64::from(end),
                    min: 0.0,
                    max: size_px as f64,
                    why: "a window must lie inside the image",
                }
                .into());
            }
        }
        let samples = |window: &ImageRect| PixelGrid::new(window, map, GRID);
        Ok(VirtualSensors {
            config: config.clone(),
            bumpers: bumpers.iter().map(samples).collect(),
            goals: goals.iter().map(samples).collect(),
            kick: kick
                .as_ref()
                .map_or(PixelGrid { pixels: Vec::new() }, samples),
            lens: PixelGrid::new(&lens_window.scaled(LENS_SEARCH_SCALE), map, 3 * GRID / 2),
            lens_window,
            regions,
        })
    }

    pub(crate) fn regions(&self) -> &[(&'static str, ImageRect)] {
        &self.regions
    }

    pub(crate) fn read(
        &self,
        image: &ImageView<'_>,
        table: &ColourLookupTable,
        ball_px: Option<[f32; 2]>,
    ) -> VirtualSensorReadings {
        let obstacle = |class| {
            matches!(
                class,
                ColourClass::BLACK | ColourClass::WHITE | ColourClass::CYAN | ColourClass::MAGENTA
            )
        };
        let bumpers = self.bumpers.iter().map(|samples| {
            let share = samples.class_share(image, table, obstacle);
            Bumper {
                share,
                hit: share >= self.config.bumper_occupied_share_min,
            }
        });
        let goal = |target: ColourClass| {
            let middles = self
                .goals
                .iter()
                .filter_map(|samples| samples.class_centroid(image, table, target));
            let (share, middle) = middles.max_by(|a, b| a.0.total_cmp(&b.0))?;
            (share >= self.config.goal_colour_share_min).then_some(middle)
        };
        let ball_share = self
            .kick
            .class_share(image, table, |class| class == ColourClass::BALL);
        let lens_px = self.lens.find_dark_blob(image);
        VirtualSensorReadings {
            bumpers: bumpers.collect(),
            blue_goal_px: goal(ColourClass::BLUE),
            yellow_goal_px: goal(ColourClass::YELLOW),
            ball_px: ball_px
                .filter(|&at| self.config.ball.is_none_or(|window| window.contains(at))),
            kick: ball_share >= self.config.kick_colour_share_min,
            lens_px,
            lens_centred: lens_px.map(|at| self.lens_window.contains(at)),
        }
    }
}

impl PixelGrid {
    fn new(window: &ImageRect, map: &GroundMap, grid: usize) -> Self {
        let along = |start: f32, length: f32, size: usize| -> Vec<u16> {
            let count = (length.round() as usize).clamp(1, grid);
            let mut positions: Vec<u16> = (0..count)
                .map(|step| start + length * (step as f32 + 0.5) / count as f32)
                .filter(|position| (0.0..size as f32).contains(position))
                .map(|position| position as u16)
                .collect();
            positions.dedup();
            positions
        };
        let columns = along(window.left_px, window.width_px, map.width_px);
        let rows = along(window.top_px, window.height_px, map.height_px);
        PixelGrid {
            pixels: rows
                .iter()
                .flat_map(|&v| columns.iter().map(move |&u| [u, v]))
                .collect(),
        }
    }

    fn classes<'a>(
        &'a self,
        image: &'a ImageView<'_>,
        table: &'a ColourLookupTable,
    ) -> impl Iterator<Item = ([u16; 2], ColourClass)> + 'a {
        let class =
            |[u, v]: [u16; 2]| table.class(image.native_channels(usize::from(u), usize::from(v)));
        self.pixels.iter().map(move |&pixel| (pixel, class(pixel)))
    }

    fn class_share(
        &self,
        image: &ImageView<'_>,
        table: &ColourLookupTable,
        matches: impl Fn(ColourClass) -> bool,
    ) -> f32 {
        let found = self
            .classes(image, table)
            .filter(|&(_, class)| matches(class));
        found.count() as f32 / self.pixels.len().max(1) as f32
    }

    /// Fraction and centroid of a class's pixels.
    fn class_centroid(
        &self,
        image: &ImageView<'_>,
        table: &ColourLookupTable,
        target: ColourClass,
    ) -> Option<(f32, [f32; 2])> {
        let found = self
            .classes(image, table)
            .filter(|&(_, class)| class == target);
        let [u, v, count] = found.fold([0.0f32; 3], |[u, v, count], ([at_u, at_v], _)| {
            [u + f32::from(at_u), v + f32::from(at_v), count + 1.0]
        });
        (count > 0.0).then(|| (count / self.pixels.len() as f32, [u / count, v / count]))
    }

    /// Centroid of the dark pixels, if they stand out and are not cut by the region's edge.
    fn find_dark_blob(&self, image: &ImageView<'_>) -> Option<[f32; 2]> {
        let level = |[u, v]: [u16; 2]| {
            let rgb = image.rgb(usize::from(u), usize::from(v));
            rgb.iter().map(|&channel| f32::from(channel)).sum::<f32>() / 3.0
        };
        let levels: Vec<f32> = self.pixels.iter().map(|&pixel| level(pixel)).collect();
        let mut ranked = levels.clone();
        let upper_quarter = levels.len() * 3 / 4;
        ranked.get(upper_quarter)?;
        let (_, &mut surround_level, _) =
            ranked.select_nth_unstable_by(upper_quarter, f32::total_cmp);
        let (first, last) = (self.pixels.first()?, self.pixels.last()?);
        let at_edge =
            |[u, v]: [u16; 2]| u == first[0] || v == first[1] || u == last[0] || v == last[1];
        let (mut sum, mut count, mut cut) = ([0.0f32; 2], 0.0, 0.0);
        let pixels = self.pixels.iter().zip(&levels);
        for (&pixel, _) in
            pixels.filter(|&(_, &level)| level < LENS_DARKNESS_RATIO * surround_level)
        {
            sum = [sum[0] + f32::from(pixel[0]), sum[1] + f32::from(pixel[1])];
            count += 1.0;
            cut += f32::from(u8::from(at_edge(pixel)));
        }
        // A disc inside the square does not touch its edge; rods may.
        let stands_out = count >= 4.0 && cut < 0.25 * count && surround_level >= 8.0;
        stands_out.then(|| sum.map(|sum| sum / count))
    }
}

/// Derives default regions from the ground map.
struct Layout<'a> {
    map: &'a GroundMap,
    camera: &'a CameraConfig,
}

impl Layout<'_> {
    /// Pixel nearest to a ground point; None if it is off by more than a tenth of the range.
    fn nearest_pixel(&self, angle: f32, range: f32) -> Option<[f32; 2]> {
        let ground = At::new(range * math::cos(angle), range * math::sin(angle));
        self.map.nearest_pixel(ground, 0.1 * range)
    }

    /// Square around a ground point, as wide as `size` metres of ground along the ray.
    fn square(&self, angle: f32, range: f32, size: f32) -> Option<ImageRect> {
        let middle = self.nearest_pixel(angle, range)?;
        let [near, far] =
            [range - 0.5 * size, range + 0.5 * size].map(|at| self.nearest_pixel(angle, at));
        let (near, far) = (near.unwrap_or(middle), far?);
        let along = math::hypot(far[0] - near[0], far[1] - near[1]);
        Some(ImageRect::square(middle, along.max(3.0)))
    }

    fn bumpers(&self, config: &VirtualSensorConfig) -> Vec<ImageRect> {
        let quarter = std::f32::consts::FRAC_PI_2;
        let step = std::f32::consts::TAU / BUMPERS as f32;
        (0..BUMPERS)
            .filter_map(|number| {
                let angle = quarter - step * number as f32;
                self.square(angle, config.bumper_range, config.bumper_size)
            })
            .collect()
    }

    fn goals(&self) -> Vec<ImageRect> {
        let [cu, cv] = self.camera.centre_px;
        let smaller = cu.min(cv).min(self.map.width_px as f32 - cu);
        let rim = self.camera.outer_radius_px.unwrap_or(smaller);
        let [[xu, yu], [xv, yv]] = self.camera.image_from_robot();
        GOALS_DEG
            .iter()
            .map(|degrees| {
                let (sin, cos) = math::sin_cos(degrees.to_radians());
                let direction = [xu * cos + yu * sin, xv * cos + yv * sin];
                let middle = [
                    cu + 0.75 * rim * direction[0],
                    cv + 0.75 * rim * direction[1],
                ];
                ImageRect::square(middle, 0.5 * rim)
            })
            .collect()
    }

    fn kick(&self, config: &VirtualSensorConfig) -> Option<ImageRect> {
        self.square(0.0, config.kick_range, config.kick_size)
    }

    /// A fiftieth of the image around the axis: a larger displacement of the mirror distorts the map by centimetres.
    fn lens(&self) -> ImageRect {
        let side = 0.02 * self.map.width_px.min(self.map.height_px) as f32;
        ImageRect::square(self.camera.centre_px, side.max(4.0))
    }
}

impl ImageRect {
    fn square([u, v]: [f32; 2], side: f32) -> Self {
        ImageRect {
            left_px: u - 0.5 * side,
            top_px: v - 0.5 * side,
            width_px: side,
            height_px: side,
        }
    }

    fn scaled(self, factor: f32) -> Self {
        let more = 0.5 * (factor - 1.0);
        ImageRect {
            left_px: self.left_px - more * self.width_px,
            top_px: self.top_px - more * self.height_px,
            width_px: factor * self.width_px,
            height_px: factor * self.height_px,
        }
    }

    /// True if an image position is inside.
    pub fn contains(&self, [u, v]: [f32; 2]) -> bool {
        (self.left_px..self.left_px + self.width_px).contains(&u)
            && (self.top_px..self.top_px + self.height_px).contains(&v)
    }
}
