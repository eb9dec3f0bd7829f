//! What do the virtual sensors say? Windows of the image, each asked one question: lima2001 section 3.3.
//!
//! Nine bumpers around the camera, goals, ball, imminent kick, and whether the camera still sits under the mirror.
//! The windows are configuration in image coordinates; those not configured are laid out from the ground map, so that
//! any mirror has them.

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
    /// Share of its window that is black, white or of a team's colour: not floor.
    pub share: f32,
    /// Is something there?
    pub hit: bool,
}

/// What the windows of one frame say; places are columns and rows, pixels.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct VirtualSensorReadings {
    /// The bumpers, from the left over the front to the right and round the back.
    pub bumpers: Vec<Bumper>,
    /// Middle of the blue goal, if it is in one of the goal windows.
    pub blue_goal_px: Option<[f32; 2]>,
    /// Middle of the yellow goal, if it is in one of the goal windows.
    pub yellow_goal_px: Option<[f32; 2]>,
    /// Middle of the ball, if it is in the ball window.
    pub ball_px: Option<[f32; 2]>,
    /// Does the ball touch the kicker?
    pub kick: bool,
    /// Middle of the camera's own lens in the mirror, where it stands out.
    pub lens_px: Option<[f32; 2]>,
    /// Is the lens inside its window? If not, mirror or camera were moved.
    pub lens_centred: Option<bool>,
}

/// A window's pixels: a grid of at most [`GRID`] × [`GRID`].
#[derive(Debug, Clone)]
struct PixelGrid {
    pixels: Vec<[u16; 2]>,
}

/// The windows of one camera.
#[derive(Debug, Clone)]
pub(crate) struct VirtualSensors {
    config: VirtualSensorConfig,
    bumpers: Vec<PixelGrid>,
    goals: Vec<PixelGrid>,
    kick: PixelGrid,
    lens: PixelGrid,
    lens_window: ImageRect,
    /// Where each window is: bumpers, goals, ball, kick, lens.
    regions: Vec<(&'static str, ImageRect)>,
}

/// Samples along a window's side: a share of 1/256 is finer than any threshold.
const GRID: usize = 16;
/// The lens is sought in a square this many times as wide as its window.
const LENS_SEARCH_SCALE: f32 = 3.0;
/// The lens is darker than this share of what surrounds it; a blacker robot around it hides it.
const LENS_DARKNESS_RATIO: f32 = 0.6;
/// Bumpers of lima2001: as many, evenly around.
const BUMPERS: usize = 9;
/// Directions of the three goal windows from forward, degrees.
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
            given => given.to_vec(),
        };
        let goals = match &config.goals[..] {
            [] => layout.goals(),
            given => given.to_vec(),
        };
        let kick = config.kick.or_else(|| layout.kick(config));
        let lens_window = config.lens.unwrap_or_else(|| layout.lens());
        let mut laid: Vec<(&'static str, ImageRect)> = Vec::new();
        laid.extend(bumpers.iter().map(|&window| ("bumper", window)));
        laid.extend(goals.iter().map(|&window| ("goal", window)));
        laid.extend(config.ball.map(|window| ("ball", window)));
        laid.extend(kick.map(|window| ("kick", window)));
        laid.push(("lens", lens_window));
        for (name, window) in &laid {
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
            regions: laid,
        })
    }

    pub(crate) fn regions(&self) -> &[(&'static str, ImageRect)] {
        &self.regions
    }

    pub(crate) fn read(
        &self,
        frame: &ImageView<'_>,
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
            let share = samples.class_share(frame, table, obstacle);
            Bumper {
                share,
                hit: share >= self.config.bumper_occupied_share_min,
            }
        });
        let goal = |wanted: ColourClass| {
            let middles = self
                .goals
                .iter()
                .filter_map(|samples| samples.class_centroid(frame, table, wanted));
            let (share, middle) = middles.max_by(|a, b| a.0.total_cmp(&b.0))?;
            (share >= self.config.goal_colour_share_min).then_some(middle)
        };
        let touching = self
            .kick
            .class_share(frame, table, |class| class == ColourClass::BALL);
        let lens_px = self.lens.find_dark_blob(frame);
        VirtualSensorReadings {
            bumpers: bumpers.collect(),
            blue_goal_px: goal(ColourClass::BLUE),
            yellow_goal_px: goal(ColourClass::YELLOW),
            ball_px: ball_px
                .filter(|&at| self.config.ball.is_none_or(|window| window.contains(at))),
            kick: touching >= self.config.kick_colour_share_min,
            lens_px,
            lens_centred: lens_px.map(|at| self.lens_window.contains(at)),
        }
    }
}

impl PixelGrid {
    fn new(window: &ImageRect, map: &GroundMap, grid: usize) -> Self {
        let along = |start: f32, length: f32, size: usize| -> Vec<u16> {
            let count = (length.round() as usize).clamp(1, grid);
            let mut places: Vec<u16> = (0..count)
                .map(|step| start + length * (step as f32 + 0.5) / count as f32)
                .filter(|place| (0.0..size as f32).contains(place))
                .map(|place| place as u16)
                .collect();
            places.dedup();
            places
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
        frame: &'a ImageView<'_>,
        table: &'a ColourLookupTable,
    ) -> impl Iterator<Item = ([u16; 2], ColourClass)> + 'a {
        let class =
            |[u, v]: [u16; 2]| table.class(frame.native_channels(usize::from(u), usize::from(v)));
        self.pixels.iter().map(move |&pixel| (pixel, class(pixel)))
    }

    fn class_share(
        &self,
        frame: &ImageView<'_>,
        table: &ColourLookupTable,
        wanted: impl Fn(ColourClass) -> bool,
    ) -> f32 {
        let found = self
            .classes(frame, table)
            .filter(|&(_, class)| wanted(class));
        found.count() as f32 / self.pixels.len().max(1) as f32
    }

    /// Share and middle of a class's pixels.
    fn class_centroid(
        &self,
        frame: &ImageView<'_>,
        table: &ColourLookupTable,
        wanted: ColourClass,
    ) -> Option<(f32, [f32; 2])> {
        let found = self
            .classes(frame, table)
            .filter(|&(_, class)| class == wanted);
        let [u, v, count] = found.fold([0.0f32; 3], |[u, v, count], ([at_u, at_v], _)| {
            [u + f32::from(at_u), v + f32::from(at_v), count + 1.0]
        });
        (count > 0.0).then(|| (count / self.pixels.len() as f32, [u / count, v / count]))
    }

    /// Middle of what is dark here, if it stands out from the rest and is not cut by the window's edge.
    fn find_dark_blob(&self, frame: &ImageView<'_>) -> Option<[f32; 2]> {
        let level = |[u, v]: [u16; 2]| {
            let rgb = frame.rgb(usize::from(u), usize::from(v));
            rgb.iter().map(|&channel| f32::from(channel)).sum::<f32>() / 3.0
        };
        let levels: Vec<f32> = self.pixels.iter().map(|&pixel| level(pixel)).collect();
        let mut ranked = levels.clone();
        let upper_quarter = levels.len() * 3 / 4;
        ranked.get(upper_quarter)?;
        let (_, &mut around, _) = ranked.select_nth_unstable_by(upper_quarter, f32::total_cmp);
        let (first, last) = (self.pixels.first()?, self.pixels.last()?);
        let at_edge =
            |[u, v]: [u16; 2]| u == first[0] || v == first[1] || u == last[0] || v == last[1];
        let (mut sum, mut count, mut cut) = ([0.0f32; 2], 0.0, 0.0);
        let pixels = self.pixels.iter().zip(&levels);
        for (&pixel, _) in pixels.filter(|&(_, &level)| level < LENS_DARKNESS_RATIO * around) {
            sum = [sum[0] + f32::from(pixel[0]), sum[1] + f32::from(pixel[1])];
            count += 1.0;
            cut += f32::from(u8::from(at_edge(pixel)));
        }
        // A disc inside the square touches its edge nowhere; a rod or two may.
        let stands_out = count >= 4.0 && cut < 0.25 * count && around >= 8.0;
        stands_out.then(|| sum.map(|sum| sum / count))
    }
}

/// Lays out windows by what the map says of the ground.
struct Layout<'a> {
    map: &'a GroundMap,
    camera: &'a CameraConfig,
}

impl Layout<'_> {
    /// The pixel that shows a place of the ground best; none if it is farther off than a tenth of its distance.
    fn nearest_pixel(&self, angle: f32, range: f32) -> Option<[f32; 2]> {
        let [x, y] = [range * angle.cos(), range * angle.sin()];
        let mut best = (0.1 * range, None);
        for row in 0..self.map.height_px {
            for column in 0..self.map.width_px {
                let Some(ground) = self.map.at(column, row) else {
                    continue;
                };
                let off = (ground.x - x).hypot(ground.y - y);
                if off < best.0 {
                    best = (off, Some([column as f32, row as f32]));
                }
            }
        }
        best.1
    }

    /// A square around a place of the ground that is as wide as `size` metres of ground along the ray.
    fn square(&self, angle: f32, range: f32, size: f32) -> Option<ImageRect> {
        let middle = self.nearest_pixel(angle, range)?;
        let [near, far] =
            [range - 0.5 * size, range + 0.5 * size].map(|at| self.nearest_pixel(angle, at));
        let (near, far) = (near.unwrap_or(middle), far?);
        let along = (far[0] - near[0]).hypot(far[1] - near[1]);
        Some(ImageRect::around(middle, along.max(3.0)))
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
                let (sin, cos) = degrees.to_radians().sin_cos();
                let direction = [xu * cos + yu * sin, xv * cos + yv * sin];
                let middle = [
                    cu + 0.75 * rim * direction[0],
                    cv + 0.75 * rim * direction[1],
                ];
                ImageRect::around(middle, 0.5 * rim)
            })
            .collect()
    }

    fn kick(&self, config: &VirtualSensorConfig) -> Option<ImageRect> {
        self.square(0.0, config.kick_range, config.kick_size)
    }

    /// A fiftieth of the image around where the axis should be: a mirror moved by more bends the map by centimetres.
    fn lens(&self) -> ImageRect {
        let side = 0.02 * self.map.width_px.min(self.map.height_px) as f32;
        ImageRect::around(self.camera.centre_px, side.max(4.0))
    }
}

impl ImageRect {
    fn around([u, v]: [f32; 2], side: f32) -> Self {
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

    /// Is a place of the image inside?
    pub fn contains(&self, [u, v]: [f32; 2]) -> bool {
        (self.left_px..self.left_px + self.width_px).contains(&u)
            && (self.top_px..self.top_px + self.height_px).contains(&v)
    }
}
