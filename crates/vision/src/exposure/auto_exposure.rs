//! Checks brightness and applies commands image by image; selects the pixels to measure.

use localize::config::SettingError;
use localize::math;
use localize::robot::{CameraConfig, CameraControl, CameraSetting};

use crate::config::AutoExposureConfig;
use crate::error::VisionError;
use crate::exposure::histogram::Histogram;
use crate::exposure::{ExposureCommand, ExposureStatus};
use crate::image::ImageView;
use crate::optics::ground_map::GroundMap;

/// Controls exposure and gain.
#[derive(Debug, Clone)]
pub struct AutoExposure {
    pub(super) config: AutoExposureConfig,
    camera: Option<CameraControl>,
    /// Own body and nearest carpet: always visible.
    centre_pixels: Vec<[u16; 2]>,
    /// The whole mirror.
    scene_pixels: Vec<[u16; 2]>,
    image_index: u64,
    pub(super) setting: CameraSetting,
    /// A command not yet in effect, and the centre's level when it was issued.
    pub(super) pending: Option<(ExposureCommand, f32)>,
    /// Centre level at which the present setting was found best. None during a search.
    pub(super) reference_level: Option<f32>,
    pub(super) search_steps: u32,
    /// Centre level to restore first after the light changed.
    pub(super) target_level: Option<f32>,
    /// Logarithm of the last light step taken for entropy; 0 before the first.
    pub(super) last_step: f32,
    /// Level ∝ light^response: 1 for a linear camera, about 0.45 with the usual gamma; estimated from commands.
    pub(super) response: f32,
    warned: bool,
    levels: Vec<u8>,
}

/// Initial `response`, between a linear camera and the usual gamma, so that the first step overshoots with neither.
const INITIAL_RESPONSE: f32 = 0.65;
/// Pixels read of the centre and of the scene: enough for statistics, read in 20 µs.
const CENTRE_PIXELS: usize = 1500;
const SCENE_PIXELS: usize = 4000;

impl AutoExposure {
    /// Selects the pixels to measure; `control`: `[exposure]` of robot.toml.
    ///
    /// `mask`: one entry per pixel, row by row; false on the robot's own body.
    pub fn new(
        map: &GroundMap,
        camera: &CameraConfig,
        mask: Option<&[bool]>,
        control: Option<CameraControl>,
        config: &AutoExposureConfig,
    ) -> Result<Self, VisionError> {
        let [cu, cv] = camera.centre_px;
        let own =
            |column: usize, row: usize| mask.is_some_and(|mask| !mask[row * map.width_px + column]);
        let radius = |column: usize, row: usize| math::hypot(column as f32 - cu, row as f32 - cv);
        let mut rim = 0.0f32;
        let (mut near, mut scene) = (Vec::new(), Vec::new());
        for row in 0..map.height_px {
            for column in 0..map.width_px {
                if !camera.is_inside_mirror(column as f32, row as f32) {
                    continue;
                }
                scene.push([column as u16, row as u16]);
                let range = map.at(column, row).map(|ground| ground.distance());
                let carpet = range.is_some_and(|range| range <= config.centre_range_max);
                if carpet {
                    rim = rim.max(radius(column, row));
                }
                near.push(carpet || own(column, row));
            }
        }
        // Inside the ring there is only the robot's body, whatever the map contains there.
        let centre: Vec<[u16; 2]> = scene
            .iter()
            .zip(&near)
            .filter(|&(&[u, v], &near)| near || radius(usize::from(u), usize::from(v)) <= rim)
            .map(|(&pixel, _)| pixel)
            .collect();
        if centre.is_empty() {
            return Err(SettingError {
                key: "vision.exposure.centre_range_max".to_owned(),
                value: f64::from(config.centre_range_max),
                min: f64::from(map.nearest_ground()),
                max: f64::INFINITY,
                why: "no pixel shows the robot's body or carpet within this range",
            }
            .into());
        }
        let setting = control.map_or(
            CameraSetting {
                exposure: 1.0,
                gain: 1.0,
            },
            |control| CameraSetting {
                exposure: control.exposure,
                gain: control.gain,
            },
        );
        Ok(AutoExposure {
            config: config.clone(),
            camera: control,
            centre_pixels: subsample(&centre, CENTRE_PIXELS),
            scene_pixels: subsample(&scene, SCENE_PIXELS),
            image_index: 0,
            setting,
            pending: None,
            reference_level: None,
            search_steps: 0,
            target_level: None,
            last_step: 0.0,
            response: INITIAL_RESPONSE,
            warned: false,
            levels: Vec::new(),
        })
    }

    /// Call with every image, in order; measures every `check_every`-th, and more often during a search.
    ///
    /// None if the image was not measured or has another size.
    pub fn process(&mut self, image: &ImageView<'_>) -> Option<ExposureStatus> {
        let image_index = self.image_index;
        self.image_index += 1;
        let arrived = self
            .pending
            .filter(|(command, _)| image_index >= command.from_frame);
        let waiting = self.pending.is_some() && arrived.is_none();
        let searching = self.camera.is_some() && self.reference_level.is_none();
        let due = image_index.is_multiple_of(self.config.check_every.max(1));
        if !self.config.enabled || waiting || !(due || searching || arrived.is_some()) {
            return None;
        }
        let level = self.level(image)?;
        let mut light_jumped = false;
        if let (Some((command, before)), Some(control)) = (arrived, &self.camera) {
            let ratio = control.light(command.setting) / control.light(self.setting);
            light_jumped = math::ln(ratio).abs() > self.config.brightness_change_min;
            self.setting = command.setting;
            self.update_response(before, level, ratio);
            self.pending = None;
        }
        let histogram = Histogram::from_pixels(image, &self.scene_pixels);
        let mut status = ExposureStatus {
            entropy: histogram.entropy(1.0),
            level,
            applied_setting: self.camera.map(|_| self.setting),
            searching: false,
            command: None,
            light_jumped,
            warning: false,
        };
        let change = self
            .reference_level
            .map(|reference| math::ln(level.max(1.0) / reference));
        let changed = change.is_none_or(|change| change.abs() > self.config.brightness_change_min);
        match self.camera {
            Some(control) if changed => {
                status.command = self.search_step(&control, &histogram, level, change, image_index);
                status.searching = status.command.is_some();
            }
            Some(_) => {}
            None => {
                // The first measurement is the reference for the others.
                self.reference_level.get_or_insert(level.max(1.0));
                status.warning = change.is_some() && changed && !self.warned;
                self.warned |= status.warning;
            }
        }
        Some(status)
    }

    /// Interquartile mean of the centre's brightness, of 255: robust to objects that cross it.
    fn level(&mut self, image: &ImageView<'_>) -> Option<f32> {
        let inside =
            |[u, v]: [u16; 2]| usize::from(u) < image.width_px && usize::from(v) < image.height_px;
        let last = *self.scene_pixels.last()?;
        if !inside(last) || image.check(image.width_px, image.height_px).is_err() {
            return None;
        }
        self.levels.clear();
        self.levels.extend(self.centre_pixels.iter().map(|&[u, v]| {
            let [r, g, b] = image.rgb(usize::from(u), usize::from(v)).map(u32::from);
            ((r + 2 * g + b) / 4) as u8
        }));
        self.levels.sort_unstable();
        let count = self.levels.len();
        let middle = &self.levels[count / 4..count - count / 4];
        let sum: u32 = middle.iter().map(|&level| u32::from(level)).sum();
        Some(sum as f32 / middle.len().max(1) as f32)
    }
}

/// Every n-th pixel, so that at least `count_min` remain.
fn subsample(pixels: &[[u16; 2]], count_min: usize) -> Vec<[u16; 2]> {
    let step = (pixels.len() / count_min).max(1);
    pixels.iter().step_by(step).copied().collect()
}
