//! The search for the best setting: first restores the centre's level, then maximises entropy.

use localize::math;
use localize::robot::CameraControl;

use crate::exposure::ExposureCommand;
use crate::exposure::auto_exposure::{AutoExposure, VALID_LEVELS};
use crate::exposure::histogram::Histogram;

/// Plausible exponents of the camera's response.
const RESPONSE_RANGE: std::ops::RangeInclusive<f32> = 0.35..=1.1;
/// The search ends after this many commands, since the light keeps changing.
const SEARCH_STEPS_MAX: u32 = 8;

impl AutoExposure {
    /// One iteration of the search. None if the present setting is the best by this image's histogram.
    pub(super) fn search_step(
        &mut self,
        control: &CameraControl,
        histogram: &Histogram,
        level: f32,
        change: Option<f32>,
        image_index: u64,
    ) -> Option<ExposureCommand> {
        if change.is_some() {
            (self.search_steps, self.last_step) = (0, 0.0);
        }
        self.search_steps += 1;
        // First restore the centre's level, since the entropy of clipped pixels cannot be predicted. Then maximise entropy.
        if let Some(change) = change {
            self.target_level = Some(level.max(1.0) / math::exp(change));
        }
        let error = self
            .target_level
            .map(|target| math::ln(level.max(1.0) / target));
        let target_error =
            error.filter(|error| error.abs() > self.config.convergence_tolerance * self.response);
        let best = match target_error {
            Some(error) => math::exp(-error),
            None => {
                self.target_level = None;
                histogram.best_scale(self.config.entropy_gain_min)
            }
        };
        let factor_max = self.config.step_factor_max.max(1.0);
        let step = math::powf(best, 1.0 / self.response).clamp(1.0 / factor_max, factor_max);
        let now = control.light(self.setting);
        let mut log_step = math::ln(step);
        // A reversed step means that the peak was passed: halve the step so that the search converges.
        if target_error.is_none() && log_step * self.last_step < 0.0 {
            log_step = log_step.signum() * log_step.abs().min(0.5 * self.last_step.abs());
        }
        let setting = control.setting(now * math::exp(log_step));
        let log_step_taken = math::ln(control.light(setting) / now);
        if log_step_taken.abs() < self.config.convergence_tolerance
            || self.search_steps > SEARCH_STEPS_MAX
        {
            self.reference_level = Some(level.max(1.0));
            return None;
        }
        if target_error.is_none() {
            self.last_step = log_step_taken;
        }
        let command = ExposureCommand {
            setting,
            from_frame: image_index + control.delay_frames.max(1),
        };
        self.pending = Some((command, level));
        self.reference_level = None;
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
        self.response = 0.5 * (self.response + response);
    }
}
