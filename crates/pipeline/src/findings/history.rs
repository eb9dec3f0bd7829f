//! What is kept of a run's cycles, and the findings in it.

use anyhow::Result;

use super::causes::Causes;
use super::record::CycleRecord;
use super::wheel_path::WheelPath;
use super::{Finding, missing, poses, sensors};
use crate::cycle::Cycle;
use crate::log::LogIndex;

/// What is kept of a run in order to find its odd moments.
#[derive(Debug, Clone, Default)]
pub struct RunHistory {
    records: Vec<CycleRecord>,
    wheels: WheelPath,
}

impl RunHistory {
    /// Reads a whole log. `stopped` is asked before each chunk; true ends the reading early.
    ///
    /// Fails if a chunk cannot be read.
    pub fn read(index: &LogIndex, stopped: impl Fn() -> Result<bool>) -> Result<Self> {
        let mut history = RunHistory::default();
        for part in 0..index.chunks().len() {
            if stopped()? {
                break;
            }
            for logged in index.load(part)? {
                history.push(logged.index, &logged.cycle);
            }
        }
        Ok(history)
    }

    /// Adds a cycle; `index`: its number in the run. A stamp from the past begins a new run.
    pub fn push(&mut self, index: u64, cycle: &Cycle) {
        let record = CycleRecord::new(index, cycle);
        if self
            .records
            .last()
            .is_some_and(|last| record.time < last.time)
        {
            *self = RunHistory::default();
        }
        for odometry in &cycle.inputs.odometry {
            self.wheels.push(odometry);
        }
        self.records.push(record);
    }

    /// Number of cycles kept.
    pub fn len(&self) -> usize {
        self.records.len()
    }

    /// True without a cycle.
    pub fn is_empty(&self) -> bool {
        self.records.is_empty()
    }

    /// Stamps of the first and the last cycle, seconds.
    pub fn span(&self) -> Option<(f64, f64)> {
        Some((self.records.first()?.time, self.records.last()?.time))
    }

    /// Forgets the cycles before a time, seconds.
    pub fn forget_before(&mut self, time: f64) {
        let first = self.records.partition_point(|record| record.time < time);
        self.records.drain(..first);
        self.wheels.forget_before(time);
    }

    /// The moments that deserve a look, in order of time.
    ///
    /// Errors need truth. Without truth, uncertain poses, leaps against the wheels, lost robots, slip, light, drift of the map,
    /// gaps and unusable images are found.
    pub fn findings(&self) -> Vec<Finding> {
        let run = &self.records[..];
        let causes = Causes::new(run);
        let mut found = poses::pose_findings(run, &causes);
        found.extend(poses::leaps(run, &self.wheels, &causes));
        found.extend(sensors::slip(run));
        found.extend(sensors::light_changes(run));
        found.extend(sensors::map_drift(run));
        found.extend(missing::missing(run));
        found.sort_by(|a, b| {
            let by_time = a.start.total_cmp(&b.start);
            by_time.then_with(|| a.kind.name().cmp(b.kind.name()))
        });
        found
    }
}
