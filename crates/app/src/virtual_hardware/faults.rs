//! Which device fails, and when? A plan of faults of the virtual hardware, for testing fault tolerance.

use std::path::Path;

use anyhow::{Result, ensure};
use localize::toml_file;
use serde::{Deserialize, Serialize};

/// A fault plan.
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
    /// Kind of the fault.
    pub(super) kind: HardwareFaultKind,
    /// Start, seconds after the start of the simulation.
    pub(super) at: f64,
    /// Duration, seconds.
    #[serde(rename = "for")]
    pub(super) duration: f64,
    /// Size of a clock step, seconds.
    #[serde(default = "default_clock_step")]
    pub(super) step: f64,
}

fn default_clock_step() -> f64 {
    0.6
}

/// Kinds of faults.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum HardwareFaultKind {
    /// The camera repeats the same image.
    CameraFreezes,
    /// The camera sends nothing.
    CameraSilent,
    /// The camera sends half an image and then nothing.
    CameraHalfFrame,
    /// The camera is unplugged.
    CameraUnplugged,
    /// The camera's clock is off by `step`.
    CameraClock,
    /// The base board is unplugged.
    BaseUnplugged,
    /// The base board sends nothing.
    BaseSilent,
    /// The base board sends noise instead of messages.
    BaseGarbage,
    /// One byte in 200 from the base board is wrong.
    BaseNoise,
    /// The base board restarts: its counters begin at zero.
    BaseRestarts,
    /// The base board's clock is off by `step`.
    BaseClock,
    /// The IMU is unplugged.
    ImuUnplugged,
    /// The IMU repeats the same values.
    ImuStuck,
    /// The IMU sends saturated values (its wire format has no NaN).
    ImuNan,
    /// The IMU sends noise instead of messages.
    ImuGarbage,
}

/// Interval of a fault, CLOCK_MONOTONIC, seconds.
#[derive(Serialize)]
pub(super) struct FaultInterval {
    pub(super) kind: HardwareFaultKind,
    pub(super) from_s: f64,
    pub(super) until_s: f64,
}

impl FaultPlan {
    /// Reads a plan.
    pub(super) fn load(path: &Path) -> Result<Self> {
        let (plan, _): (FaultPlan, _) = toml_file::read(path)?;
        for fault in &plan.faults {
            ensure!(
                fault.at >= 0.0
                    && fault.duration > 0.0
                    && (fault.at + fault.duration).is_finite()
                    && fault.step.abs() <= 1000.0,
                "{}: {:?}: invalid times (expected at >= 0, for > 0, step within ±1000 s)",
                path.display(),
                fault.kind
            );
        }
        Ok(plan)
    }

    /// The fault of this kind that is active at a time.
    pub(super) fn active(&self, kind: HardwareFaultKind, time: f64) -> Option<&HardwareFault> {
        self.faults.iter().find(|fault| {
            fault.kind == kind && fault.at <= time && time < fault.at + fault.duration
        })
    }

    /// True while a fault of this kind is active.
    pub(super) fn is_active(&self, kind: HardwareFaultKind, time: f64) -> bool {
        self.active(kind, time).is_some()
    }

    /// Number of faults of this kind that have started.
    pub(super) fn started_count(&self, kind: HardwareFaultKind, time: f64) -> usize {
        self.faults
            .iter()
            .filter(|fault| fault.kind == kind && fault.at <= time)
            .count()
    }
}
