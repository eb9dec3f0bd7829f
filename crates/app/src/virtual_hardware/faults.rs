//! What goes wrong, and when? A plan of faults of the virtual hardware, for proving that the robot plays on.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use serde::{Deserialize, Serialize};

/// A plan: what fails, from when, for how long.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FaultPlan {
    /// The faults; they may overlap.
    #[serde(default, rename = "fault")]
    pub(super) faults: Vec<HardwareFault>,
}

/// One fault.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct HardwareFault {
    /// What fails.
    pub(super) kind: HardwareFaultKind,
    /// When it begins, seconds after the start.
    pub(super) at: f64,
    /// How long it lasts, seconds.
    #[serde(rename = "for")]
    pub(super) duration: f64,
    /// Of a clock's step: how far, seconds.
    #[serde(default = "default_clock_step")]
    pub(super) step: f64,
}

fn default_clock_step() -> f64 {
    0.6
}

/// What can fail.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum HardwareFaultKind {
    /// The camera sends the same image again and again.
    CameraFreezes,
    /// The camera sends nothing.
    CameraSilent,
    /// The camera sends half a frame and then nothing.
    CameraHalfFrame,
    /// The camera is pulled out.
    CameraUnplugged,
    /// The camera's clock is off by `step`.
    CameraClock,
    /// The base board is pulled out.
    BaseUnplugged,
    /// The base board says nothing.
    BaseSilent,
    /// The base board's line carries noise instead of messages.
    BaseGarbage,
    /// One byte in 200 from the base board is wrong.
    BaseNoise,
    /// The base board restarts: its counters begin at zero.
    BaseRestarts,
    /// The base board's clock is off by `step`.
    BaseClock,
    /// The inertial unit is pulled out.
    ImuUnplugged,
    /// The inertial unit repeats itself.
    ImuStuck,
    /// The inertial unit sends what no sensor measures (its wire has no NaN: the end of the range).
    ImuNan,
    /// The inertial unit's line carries noise instead of messages.
    ImuGarbage,
}

impl FaultPlan {
    /// Reads a plan.
    pub(super) fn load(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path)
            .with_context(|| format!("cannot read {}", path.display()))?;
        let plan: FaultPlan = toml::from_str(&text).with_context(|| path.display().to_string())?;
        for fault in &plan.faults {
            ensure!(
                fault.at >= 0.0
                    && fault.duration > 0.0
                    && (fault.at + fault.duration).is_finite()
                    && fault.step.abs() <= 1000.0,
                "{}: {:?}: at and step must be seconds, for above zero",
                path.display(),
                fault.kind
            );
        }
        Ok(plan)
    }

    /// The fault of this kind that is on at a time.
    pub(super) fn active(&self, kind: HardwareFaultKind, time: f64) -> Option<&HardwareFault> {
        self.faults.iter().find(|fault| {
            fault.kind == kind && fault.at <= time && time < fault.at + fault.duration
        })
    }

    /// True while the fault is on.
    pub(super) fn is_active(&self, kind: HardwareFaultKind, time: f64) -> bool {
        self.active(kind, time).is_some()
    }

    /// How many faults of this kind have begun.
    pub(super) fn started_count(&self, kind: HardwareFaultKind, time: f64) -> usize {
        self.faults
            .iter()
            .filter(|fault| fault.kind == kind && fault.at <= time)
            .count()
    }
}
