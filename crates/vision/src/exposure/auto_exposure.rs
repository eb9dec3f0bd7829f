//! Checks brightness and applies commands image by image; selects the pixels to measure.

use localize::config::SettingError;
use localize::math;
use localize::robot::{CameraConfig, CameraControl, ExposureSetting};
use serde::{Deserialize, Serialize};

use crate::config::AutoExposureConfig;
use crate::error::VisionError;
use crate::exposure::histogram::Histogram;
use crate::exposure::optimum::{Measurement, Optimum, SearchPhase};
use crate::exposure::{ExposureCommand, ExposureStatus};
use crate::image::ImageView;
use crate::optics::ground_map::GroundMap;

/// What a control has learned about the camera, to go on from.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ExposureState {
    pub(super) image_index: u64,
    pub(super) setting: ExposureSetting,
    /// A command not yet in effect, and the centre's level when it was issued.
    pub(super) pending: Option<(ExposureCommand, f32)>,
    /// Images by which the last checked command took effect later than assumed or reported.
    pub(super) effect_delay: u64,
    /// First image on which the pending command seemed to be in effect.
    pub(super) arrived_at: Option<u64>,
    /// Centre level from which a change of the light is measured. None during a search.
    pub(super) reference_level: Option<f32>,
    pub(super) search_steps: u32,
    /// The best level that a search found. None before the first search ends.
    pub(super) optimum: Option<Optimum>,
    /// Present part of the search.
    pub(super) phase: SearchPhase,
    /// Logarithm of the last light step taken for entropy; 0 before the first.
    pub(super) last_step: f32,
    /// Level ∝ light^response: 1 for a linear camera, about 0.45 with the usual gamma; estimated from commands.
    pub(super) response: f32,
    pub(super) warned: bool,
}

/// Controls exposure and gain.
#[derive(Debug, Clone)]
pub struct AutoExposure {
    pub(super) config: AutoExposureConfig,
    camera: Option<CameraControl>,
    /// Own body and nearest carpet in all directions, by sectors of the azimuth.
    centre_sectors: Vec<Vec<[u16; 2]>>,
    /// The whole mirror.
    scene_pixels: Vec<[u16; 2]>,
    pub(super) state: ExposureState,
    /// Levels of one sector, and of all sectors, of an image.
    levels: Vec<u8>,
    sector_levels: Vec<f32>,
}

/// Images after the usual delay of a command until what the camera reports is taken as its result.
const ARRIVAL_FRAMES_MAX: u64 = 8;
/// Levels outside this range are too clipped to estimate the response.
pub(super) const VALID_LEVELS: std::ops::RangeInclusive<f32> = 6.0..=235.0;
/// Commands with a smaller change of the logarithm of the light are not checked: a change of the light could hide them.
const CHECKED_CHANGE_MIN: f32 = 0.2;
/// Smallest effect of a command on the logarithm of the level, per change of the light: half of the flattest response.
const EFFECT_MIN: f32 = 0.17;
/// Smallest change of the logarithm of the light that is taken as a new setting, not as rounding by the camera.
const REPORTED_CHANGE_MIN: f32 = 0.02;
/// Depth of the carpet in the centre of a mirror that shows none within `centre_range_max`, metres.
const CENTRE_DEPTH: f32 = 0.5;
/// Initial `response`, between a linear camera and the usual gamma, so that the first step overshoots with neither.
const INITIAL_RESPONSE: f32 = 0.65;
/// Pixels read of the centre and of the scene: enough for statistics, read in 20 µs.
const CENTRE_PIXELS: usize = 1500;
const SCENE_PIXELS: usize = 4000;
/// Sectors of the centre: small beside a robot that stands close, with some 90 pixels each.
const SECTORS: usize = 16;
/// Sectors of fewer pixels are not measured: little of them lies in the image.
const SECTOR_PIXELS_MIN: usize = 10;
/// Which of the sectors are measured, as shares of all from the brightest one on: dark objects may cover the half behind
/// them, a glare or a white robot may light those before.
const MEASURED_SECTORS: std::ops::Range<f32> = 0.15..0.4;

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
        let nearest = map.nearest_ground();
        // A mirror that shows no carpet so near has its nearest one in the centre.
        let range_max = if nearest > config.centre_range_max {
            nearest + CENTRE_DEPTH
        } else {
            config.centre_range_max
        };
        let mut rim = 0.0f32;
        let (mut near, mut scene) = (Vec::new(), Vec::new());
        for row in 0..map.height_px {
            for column in 0..map.width_px {
                if !camera.is_inside_mirror(column as f32, row as f32) {
                    continue;
                }
                scene.push([column as u16, row as u16]);
                let range = map.at(column, row).map(|ground| ground.distance());
                let carpet = range.is_some_and(|range| range <= range_max);
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
                min: f64::from(nearest),
                max: f64::INFINITY,
                why: "no pixel of the mirror shows the robot's body or carpet within this range",
            }
            .into());
        }
        let setting = control.map_or(
            ExposureSetting {
                exposure: 1.0,
                gain: 1.0,
            },
            |control| ExposureSetting {
                exposure: control.exposure,
                gain: control.gain,
            },
        );
        Ok(AutoExposure {
            config: config.clone(),
            camera: control,
            centre_sectors: sectors(&subsample(&centre, CENTRE_PIXELS), camera.centre_px),
            scene_pixels: subsample(&scene, SCENE_PIXELS),
            state: ExposureState {
                image_index: 0,
                setting,
                pending: None,
                effect_delay: ARRIVAL_FRAMES_MAX,
                arrived_at: None,
                reference_level: None,
                search_steps: 0,
                optimum: None,
                phase: SearchPhase::MaximizingEntropy,
                last_step: 0.0,
                response: INITIAL_RESPONSE,
                warned: false,
            },
            levels: Vec::new(),
            sector_levels: Vec::new(),
        })
    }

    /// What was learned so far. With it, another control goes on without a search.
    pub fn state(&self) -> ExposureState {
        self.state
    }

    /// Goes on from what another control has learned.
    pub fn continue_from(&mut self, state: ExposureState) {
        self.state = state;
    }

    /// Call with every image, in order; measures every `check_every`-th, and more often during a search.
    ///
    /// `reported`: the setting with which the image was taken, if the camera reports it. Without it, a command takes
    /// effect after the camera's usual delay. None if the image was not measured or has another size.
    pub fn process(
        &mut self,
        image: &ImageView<'_>,
        reported: Option<ExposureSetting>,
    ) -> Option<ExposureStatus> {
        let image_index = self.state.image_index;
        self.state.image_index += 1;
        let reported = reported.filter(|setting| {
            let light = self.camera.map(|control| control.light(*setting));
            light.is_some_and(|light| light.is_finite() && light > 0.0)
        });
        let arrived = self
            .state
            .pending
            .filter(|(command, _)| self.has_arrived(command, image_index, reported));
        let waiting = self.state.pending.is_some() && arrived.is_none();
        // Someone else set the camera, or it starts with another setting.
        let other_setting = reported.filter(|reported| {
            self.state.pending.is_none()
                && math::ln(self.light_ratio(*reported)).abs() > REPORTED_CHANGE_MIN
        });
        let searching = self.camera.is_some() && self.state.reference_level.is_none();
        let due = image_index.is_multiple_of(self.config.check_every.max(1));
        let changed = arrived.is_some() || other_setting.is_some();
        if !self.config.enabled || waiting || !(due || searching || changed) {
            return None;
        }
        let level = self.level(image)?;
        let mut light_jumped = false;
        if let Some((command, before)) = arrived {
            let setting = reported.unwrap_or(command.setting);
            let ratio = self.light_ratio(setting);
            if !self.is_in_effect(&command, before, level, ratio, image_index) {
                return None;
            }
            light_jumped = math::ln(ratio).abs() > self.config.brightness_change_min;
            self.state.setting = setting;
            self.update_response(before, level, ratio);
            self.state.pending = None;
            // A camera that does not follow is at its limit: the search ends.
            if math::ln(ratio).abs() < self.config.convergence_tolerance {
                self.state.reference_level = Some(level.max(1.0));
            }
        } else if let Some(setting) = other_setting {
            light_jumped =
                math::ln(self.light_ratio(setting)).abs() > self.config.brightness_change_min;
            self.state.setting = setting;
        }
        let histogram = Histogram::from_pixels(image, &self.scene_pixels);
        let mut status = ExposureStatus {
            entropy: histogram.entropy(1.0),
            centre_brightness: level,
            applied_setting: self.camera.map(|_| self.state.setting),
            searching: false,
            command: None,
            setting_changed_brightness: light_jumped,
            uncontrolled_light_change: false,
        };
        let change = self
            .state
            .reference_level
            .map(|reference| math::ln(level.max(1.0) / reference));
        let changed = change.is_none_or(|change| change.abs() > self.config.brightness_change_min);
        match self.camera {
            Some(control) if changed => {
                if change.is_some() {
                    self.restart_search();
                }
                let image = Measurement {
                    histogram: &histogram,
                    entropy: status.entropy,
                    level: level.max(1.0),
                    image_index,
                };
                status.command = self.search_step(&control, &image);
                status.searching = status.command.is_some();
            }
            Some(_) => {
                let at_optimum =
                    |optimum: &&mut Optimum| self.state.reference_level == Some(optimum.level);
                if let Some(optimum) = self.state.optimum.as_mut().filter(at_optimum) {
                    optimum.entropy.add(status.entropy);
                }
            }
            None => {
                // The first measurement is the reference for the others.
                self.state.reference_level.get_or_insert(level.max(1.0));
                status.uncontrolled_light_change =
                    change.is_some() && changed && !self.state.warned;
                self.state.warned |= status.uncontrolled_light_change;
            }
        }
        Some(status)
    }

    /// Light of a setting over that of the present one; 1 without control.
    fn light_ratio(&self, setting: ExposureSetting) -> f32 {
        self.camera.map_or(1.0, |control| {
            control.light(setting) / control.light(self.state.setting)
        })
    }

    /// True if an image was taken with the commanded setting: its reported one is nearer to the command than to the
    /// setting before. A camera that never gets there is limited; what it reports is then taken as the result.
    fn has_arrived(
        &self,
        command: &ExposureCommand,
        image_index: u64,
        reported: Option<ExposureSetting>,
    ) -> bool {
        let Some(reported) = reported else {
            return image_index >= command.from_frame;
        };
        let taken = math::ln(self.light_ratio(reported));
        let commanded = math::ln(self.light_ratio(command.setting));
        (taken - commanded).abs() < taken.abs()
            || image_index >= command.from_frame + ARRIVAL_FRAMES_MAX
    }

    /// False if the image was taken before the command took effect, whatever the camera's delay or report. Without this
    /// the control would answer a missing effect by an even larger command.
    ///
    /// A large command must show its effect. A change of the scene could hide that of a small one, which therefore
    /// waits as long as the last large one had to.
    fn is_in_effect(
        &mut self,
        command: &ExposureCommand,
        before: f32,
        level: f32,
        ratio: f32,
        image_index: u64,
    ) -> bool {
        let waited = image_index - *self.state.arrived_at.get_or_insert(image_index);
        let is_checked =
            math::ln(ratio).abs() >= CHECKED_CHANGE_MIN && VALID_LEVELS.contains(&before);
        let is_last_chance = image_index >= command.from_frame + ARRIVAL_FRAMES_MAX;
        let is_in_effect = if is_checked {
            shows_effect(before, level, ratio)
        } else {
            waited >= self.state.effect_delay
        };
        if !is_in_effect && !is_last_chance {
            return false;
        }
        if is_checked {
            self.state.effect_delay = waited;
        }
        self.state.arrived_at = None;
        true
    }

    /// Brightness of the centre, of 255: mean of the sectors of [`MEASURED_SECTORS`], so that objects which cover half of the
    /// centre are not taken for a change of the light.
    fn level(&mut self, image: &ImageView<'_>) -> Option<f32> {
        let inside =
            |[u, v]: [u16; 2]| usize::from(u) < image.width_px && usize::from(v) < image.height_px;
        let last = *self.scene_pixels.last()?;
        if !inside(last) || image.check(image.width_px, image.height_px).is_err() {
            return None;
        }
        self.sector_levels.clear();
        for pixels in &self.centre_sectors {
            self.levels.clear();
            self.levels.extend(pixels.iter().map(|&[u, v]| {
                let [r, g, b] = image.rgb(usize::from(u), usize::from(v)).map(u32::from);
                ((r + 2 * g + b) / 4) as u8
            }));
            self.levels.sort_unstable();
            let count = self.levels.len();
            let middle = &self.levels[count / 4..count - count / 4];
            let sum: u32 = middle.iter().map(|&level| u32::from(level)).sum();
            self.sector_levels
                .push(sum as f32 / middle.len().max(1) as f32);
        }
        self.sector_levels.sort_unstable_by(|a, b| b.total_cmp(a));
        let count = self.sector_levels.len();
        let from = (MEASURED_SECTORS.start * count as f32) as usize;
        let to = ((MEASURED_SECTORS.end * count as f32) as usize).max(from + 1);
        let measured = &self.sector_levels[from..to];
        Some(measured.iter().sum::<f32>() / measured.len() as f32)
    }
}

/// True if the level followed a command by which the light changed by `ratio`. The level of a clipped image tells nothing.
fn shows_effect(before: f32, level: f32, ratio: f32) -> bool {
    let (commanded, observed) = (math::ln(ratio), math::ln(level.max(1.0) / before.max(1.0)));
    let is_clipped = !VALID_LEVELS.contains(&before);
    is_clipped || observed * commanded.signum() > EFFECT_MIN * commanded.abs()
}

/// Every n-th pixel, so that at least `count_min` remain.
fn subsample(pixels: &[[u16; 2]], count_min: usize) -> Vec<[u16; 2]> {
    let step = (pixels.len() / count_min).max(1);
    pixels.iter().step_by(step).copied().collect()
}

/// The pixels by sectors of their azimuth about `centre_px`, without sectors of which too little lies in the image.
fn sectors(pixels: &[[u16; 2]], centre_px: [f32; 2]) -> Vec<Vec<[u16; 2]>> {
    let mut sectors = vec![Vec::new(); SECTORS];
    for &[u, v] in pixels {
        let (right, down) = (f32::from(u) - centre_px[0], f32::from(v) - centre_px[1]);
        let turn = 0.5 + math::atan2(down, right) / std::f32::consts::TAU;
        sectors[((turn * SECTORS as f32) as usize).min(SECTORS - 1)].push([u, v]);
    }
    let largest = sectors.iter().map(Vec::len).max().unwrap_or(0);
    sectors.retain(|pixels| pixels.len() >= SECTOR_PIXELS_MIN.min(largest));
    sectors
}
