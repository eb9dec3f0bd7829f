//! Is the picture well exposed, and which exposure and gain would be better? Entropy along one path of settings.
//!
//! nubot2013 section 5: the entropy of an image (eq. 5) has one peak along exposure = a·gain + b, and the brightness of
//! the image's centre, where the robot sees itself, tells when to seek it and in which direction. There the robot has to
//! stand, since every setting is tried on another picture. Here the entropy at other settings is computed from the
//! histogram of one picture: like is compared with like, and a search takes one or two commands.

use crate::config::AutoExposureConfig;
use crate::error::VisionError;
use crate::image::ImageView;
use crate::optics::ground_map::GroundMap;
use localize::config::SettingError;
use localize::robot::{CameraConfig, CameraControl, CameraSetting};

mod histogram;

use histogram::Histogram;

/// A command to the camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExposureCommand {
    /// What to set.
    pub setting: CameraSetting,
    /// The first frame that is taken with it, counted from 0 in the order in which they were looked at.
    pub from_frame: u64,
}

/// What a look at a frame's exposure gave.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExposureStatus {
    /// Entropy of red, green and blue together (nubot2013 eq. 5), bits: at most 24.
    pub entropy: f32,
    /// Brightness of the image's centre, own body and nearest carpet, of 255.
    pub level: f32,
    /// What this frame was taken with; none if the camera has no control.
    pub applied_setting: Option<CameraSetting>,
    /// True while the best setting is sought.
    pub searching: bool,
    /// What to set now.
    pub command: Option<ExposureCommand>,
    /// True if this frame is the first with a setting that changes brightness enough for colours to be learned anew.
    pub light_jumped: bool,
    /// True once: the light changed, and the camera has no control to follow it.
    pub warning: bool,
}

/// Follows the light with exposure and gain.
#[derive(Debug, Clone)]
pub struct AutoExposure {
    config: AutoExposureConfig,
    camera: Option<CameraControl>,
    /// Own body and nearest carpet: always in view.
    centre_pixels: Vec<[u16; 2]>,
    /// Everything that the mirror shows.
    scene_pixels: Vec<[u16; 2]>,
    image_index: u64,
    setting: CameraSetting,
    /// A command, and the centre's level when it was given.
    pending: Option<(ExposureCommand, f32)>,
    /// The level that the present setting was found to be best at; none while it is sought.
    reference_level: Option<f32>,
    search_steps: u32,
    /// The level to get back to first, after the light changed.
    target_level: Option<f32>,
    /// Logarithm of the light's last step that entropy asked for; 0 before the first.
    last_step: f32,
    /// Level ∝ light^response: 1 for a linear camera, about 0.45 with the usual gamma; learned from commands.
    response: f32,
    warned: bool,
    levels: Vec<u8>,
}

/// Before it is learned: between a linear camera and the usual gamma, so that the first step overshoots with neither.
const INITIAL_RESPONSE: f32 = 0.65;
/// No camera answers less, or more, than this.
const RESPONSE_RANGE: std::ops::RangeInclusive<f32> = 0.35..=1.1;
/// A search that takes more commands than this follows a light that keeps changing; it ends, and the next look decides.
const SEARCH_STEPS_MAX: u32 = 8;
/// Pixels of the centre and of the scene: enough for a median and a histogram, few enough to be read in 20 µs.
const CENTRE_PIXELS: usize = 1500;
const SCENE_PIXELS: usize = 4000;
/// A level outside this tells nothing of how the camera answers.
const VALID_LEVELS: std::ops::RangeInclusive<f32> = 6.0..=235.0;

impl AutoExposure {
    /// Lays out what is looked at; `control` as robot.toml has it.
    ///
    /// `mask`: one entry a pixel, row by row; false where the robot's own body is.
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
        let radius = |column: usize, row: usize| (column as f32 - cu).hypot(row as f32 - cv);
        let mut rim = 0.0f32;
        let (mut near, mut seen) = (Vec::new(), Vec::new());
        for row in 0..map.height_px {
            for column in 0..map.width_px {
                if !camera.is_inside_mirror(column as f32, row as f32) {
                    continue;
                }
                seen.push([column as u16, row as u16]);
                let range = map.at(column, row).map(|ground| ground.distance());
                let carpet = range.is_some_and(|range| range <= config.centre_range_max);
                if carpet {
                    rim = rim.max(radius(column, row));
                }
                near.push(carpet || own(column, row));
            }
        }
        // Within the ring there is only the robot itself, whatever the map says of it.
        let centre: Vec<[u16; 2]> = seen
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
                why: "no pixel shows own body or carpet within it",
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
            scene_pixels: subsample(&seen, SCENE_PIXELS),
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

    /// Looks at a frame, every few of them; to be called with each, in order.
    ///
    /// None where nothing was looked at. Frames of another size are passed over.
    pub fn process(&mut self, frame: &ImageView<'_>) -> Option<ExposureStatus> {
        let number = self.image_index;
        self.image_index += 1;
        let arrived = self
            .pending
            .filter(|(command, _)| number >= command.from_frame);
        let waiting = self.pending.is_some() && arrived.is_none();
        let searching = self.camera.is_some() && self.reference_level.is_none();
        let due = number.is_multiple_of(self.config.check_every.max(1));
        if !self.config.enabled || waiting || !(due || searching || arrived.is_some()) {
            return None;
        }
        let level = self.level(frame)?;
        let mut light_jumped = false;
        if let (Some((command, before)), Some(control)) = (arrived, &self.camera) {
            let ratio = control.light(command.setting) / control.light(self.setting);
            light_jumped = ratio.ln().abs() > self.config.brightness_change_min;
            self.setting = command.setting;
            self.update_response(before, level, ratio);
            self.pending = None;
        }
        let histogram = Histogram::from_pixels(frame, &self.scene_pixels);
        let mut reading = ExposureStatus {
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
            .map(|reference| (level.max(1.0) / reference).ln());
        let changed = change.is_none_or(|change| change.abs() > self.config.brightness_change_min);
        match self.camera {
            Some(control) if changed => {
                reading.command = self.search_step(&control, &histogram, level, change, number);
                reading.searching = reading.command.is_some();
            }
            Some(_) => {}
            None => {
                // The first look is what the others are compared with.
                self.reference_level.get_or_insert(level.max(1.0));
                reading.warning = change.is_some() && changed && !self.warned;
                self.warned |= reading.warning;
            }
        }
        Some(reading)
    }

    /// One round of the search: the best setting by this frame's histogram, or the present one if none is better.
    fn search_step(
        &mut self,
        control: &CameraControl,
        histogram: &Histogram,
        level: f32,
        change: Option<f32>,
        number: u64,
    ) -> Option<ExposureCommand> {
        if change.is_some() {
            (self.search_steps, self.last_step) = (0, 0.0);
        }
        self.search_steps += 1;
        // A brighter centre asks for less light and a darker one for more: as much as makes it what it was, since what was
        // clipped cannot be foretold. Then the entropy decides.
        if let Some(change) = change {
            self.target_level = Some(level.max(1.0) / change.exp());
        }
        let off = self.target_level.map(|aim| (level.max(1.0) / aim).ln());
        let aimed = off.filter(|off| off.abs() > self.config.convergence_tolerance * self.response);
        let best = match aimed {
            Some(off) => (-off).exp(),
            None => {
                self.target_level = None;
                histogram.best_scale(self.config.entropy_gain_min)
            }
        };
        let most = self.config.step_factor_max.max(1.0);
        let step = best.powf(1.0 / self.response).clamp(1.0 / most, most);
        let now = control.light(self.setting);
        let mut wanted = step.ln();
        // A step back: the peak was passed. Halved each time, the steps close in on it.
        if aimed.is_none() && wanted * self.last_step < 0.0 {
            wanted = wanted.signum() * wanted.abs().min(0.5 * self.last_step.abs());
        }
        let setting = control.setting(now * wanted.exp());
        let moved = (control.light(setting) / now).ln();
        if moved.abs() < self.config.convergence_tolerance || self.search_steps > SEARCH_STEPS_MAX {
            self.reference_level = Some(level.max(1.0));
            return None;
        }
        if aimed.is_none() {
            self.last_step = moved;
        }
        let command = ExposureCommand {
            setting,
            from_frame: number + control.delay_frames.max(1),
        };
        self.pending = Some((command, level));
        self.reference_level = None;
        Some(command)
    }

    /// How the level answered to a change of light by `ratio`.
    fn update_response(&mut self, before: f32, after: f32, ratio: f32) {
        let telling = VALID_LEVELS.contains(&before) && VALID_LEVELS.contains(&after);
        // Less than a fifth of a stop drowns in what the scene changes by itself.
        if !telling || ratio.ln().abs() < 0.15 {
            return;
        }
        let answered = ((after / before).ln() / ratio.ln())
            .clamp(*RESPONSE_RANGE.start(), *RESPONSE_RANGE.end());
        self.response = 0.5 * (self.response + answered);
    }

    /// Mean brightness of the middle half of the centre's pixels, of 255: what crosses it counts little.
    fn level(&mut self, frame: &ImageView<'_>) -> Option<f32> {
        let inside =
            |[u, v]: [u16; 2]| usize::from(u) < frame.width_px && usize::from(v) < frame.height_px;
        let last = *self.scene_pixels.last()?;
        if !inside(last) || frame.check(frame.width_px, frame.height_px).is_err() {
            return None;
        }
        self.levels.clear();
        self.levels.extend(self.centre_pixels.iter().map(|&[u, v]| {
            let [r, g, b] = frame.rgb(usize::from(u), usize::from(v)).map(u32::from);
            ((r + 2 * g + b) / 4) as u8
        }));
        self.levels.sort_unstable();
        let count = self.levels.len();
        let middle = &self.levels[count / 4..count - count / 4];
        let sum: u32 = middle.iter().map(|&level| u32::from(level)).sum();
        Some(sum as f32 / middle.len().max(1) as f32)
    }
}

/// Every n-th pixel, so that about `wanted` remain.
fn subsample(pixels: &[[u16; 2]], wanted: usize) -> Vec<[u16; 2]> {
    let step = (pixels.len() / wanted).max(1);
    pixels.iter().step_by(step).copied().collect()
}

#[cfg(test)]
mod tests;
