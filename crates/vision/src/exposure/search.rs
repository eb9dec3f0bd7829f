//! The search for the best setting: restores the level that was best before; maximises entropy if that is not enough.

use localize::math;
use localize::robot::CameraControl;

use crate::exposure::ExposureCommand;
use crate::exposure::auto_exposure::{AutoExposure, VALID_LEVELS};
use crate::exposure::optimum::{EntropyStatistics, Measurement, Optimum, SearchPhase};

/// Plausible exponents of the camera's response.
const RESPONSE_RANGE: std::ops::RangeInclusive<f32> = 0.35..=1.1;
/// The search for the peak ends after this many commands, since the light keeps changing.
const PEAK_STEPS_MAX: u32 = 8;
/// Images in a row that must have the restored level: the light may still be changing.
const STEADY_IMAGES: u32 = 4;

impl AutoExposure {
    /// Begins a search since the light changed.
    pub(super) fn restart_search(&mut self) {
        self.state.reference_level = None;
        self.state.phase = match self.state.optimum {
            Some(_) => SearchPhase::RestoringLevel { steady: 0 },
            None => SearchPhase::MaximizingEntropy,
        };
        (self.state.search_steps, self.state.last_step) = (0, 0.0);
    }

    /// One iteration of the search. None if it ends or waits.
    ///
    /// The peak of the entropy is flat, so each search for it ends elsewhere. While the level that was found best still
    /// gives the entropy that it gave before, it therefore stays the best, and restoring it leaves no rest.
    pub(super) fn search_step(
        &mut self,
        control: &CameraControl,
        image: &Measurement<'_>,
    ) -> Option<ExposureCommand> {
        if let (SearchPhase::RestoringLevel { steady }, Some(optimum)) =
            (self.state.phase, self.state.optimum)
        {
            let error = math::ln(image.level / optimum.level);
            if error.abs() > self.config.convergence_tolerance * self.state.response {
                self.state.phase = SearchPhase::RestoringLevel { steady: 0 };
                let log_step = self.log_step(math::exp(-error));
                let command = self.command(control, log_step, image);
                // The camera is at its limit.
                if command.is_none() {
                    self.state.reference_level = Some(image.level);
                }
                return command;
            }
            if steady + 1 < STEADY_IMAGES {
                self.state.phase = SearchPhase::RestoringLevel { steady: steady + 1 };
                return None;
            }
            let variation = self.config.entropy_gain_min;
            if optimum.entropy.is_usual(image.entropy, variation) {
                self.state.reference_level = Some(optimum.level);
                return None;
            }
            self.state.phase = SearchPhase::MaximizingEntropy;
        }
        self.maximize_entropy(control, image)
    }

    fn maximize_entropy(
        &mut self,
        control: &CameraControl,
        image: &Measurement<'_>,
    ) -> Option<ExposureCommand> {
        let mut log_step = self.log_step(image.histogram.best_scale(self.config.entropy_gain_min));
        // A reversed step means that the peak was passed: halve the step so that the search converges.
        if log_step * self.state.last_step < 0.0 {
            log_step = log_step.signum() * log_step.abs().min(0.5 * self.state.last_step.abs());
        }
        self.state.search_steps += 1;
        let command = (self.state.search_steps <= PEAK_STEPS_MAX)
            .then(|| self.command(control, log_step, image))
            .flatten();
        match command {
            Some(command) => {
                let before = control.light(self.state.setting);
                self.state.last_step = math::ln(control.light(command.setting) / before);
            }
            None => {
                // Without a step the level is still that of the optimum, but for the tolerance.
                let known = self.state.optimum.filter(|_| self.state.last_step == 0.0);
                let level = known.map_or(image.level, |optimum| optimum.level);
                self.state.reference_level = Some(level);
                self.state.optimum = Some(Optimum {
                    level,
                    entropy: EntropyStatistics::new(image.entropy),
                });
            }
        }
        command
    }

    /// Change of the logarithm of the light that scales the levels by `scale`.
    fn log_step(&self, scale: f32) -> f32 {
        let limit = math::ln(self.config.step_factor_max.max(1.0));
        (math::ln(scale) / self.state.response).clamp(-limit, limit)
    }

    /// The command for a step. None if it is below the tolerance, perhaps because the camera is at its limit.
    fn command(
        &mut self,
        control: &CameraControl,
        log_step: f32,
        image: &Measurement<'_>,
    ) -> Option<ExposureCommand> {
        let now = control.light(self.state.setting);
        let setting = control.setting(now * math::exp(log_step));
        let taken = math::ln(control.light(setting) / now);
        if taken.abs() < self.config.convergence_tolerance {
            return None;
        }
        let command = ExposureCommand {
            setting,
            from_frame: image.image_index + control.delay_frames.max(1),
        };
        self.state.pending = Some((command, image.level));
        Some(command)
    }

    /// Updates the response exponent from the levels before and after a change of light by `ratio`.
    pub(super) fn update_response(&mut self, before: f32, after: f32, ratio: f32) {
        let usable = VALID_LEVELS.contains(&before) && VALID_LEVELS.contains(&after);
        // Below a fifth of a stop, changes of the scene dominate.
        if !usable || math::ln(ratio).abs() < 0.15 {
            return;
        }
        let response = (math::ln(after / before) / math::ln(ratio))
            .clamp(*RESPONSE_RANGE.start(), *RESPONSE_RANGE.end());
        self.state.response = 0.5 * (self.state.response + response);
    }
}
