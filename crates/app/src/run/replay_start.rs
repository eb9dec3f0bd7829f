//! Where can a log that continues after a full disk be computed again? From a cycle at which a new pipeline goes on.
//!
//! Its state is small enough for the log. A thread builds the pipeline, so that the run never waits.

use std::thread::JoinHandle;

use anyhow::Result;
use hw::realtime::lower_priority;
use localize::Stamp;
use pipeline::sample::SettingsChange;
use pipeline::setup::Setup;
use pipeline::{Pipeline, PipelineConfig};

/// Time between two starts, seconds: a disk that fills again and again must not keep the pipeline from learning.
const START_PERIOD: f64 = 10.0;

/// Builds the pipeline that goes on.
#[derive(Default)]
pub(super) struct ReplayStart {
    building: Option<JoinHandle<Result<(Pipeline, String)>>>,
    last: Option<Stamp>,
}

impl ReplayStart {
    /// Starts to build a pipeline of the present settings.
    pub(super) fn prepare(&mut self, setup: &Setup, config: &PipelineConfig, now: Stamp) {
        let is_early = self.last.is_some_and(|last| now - last < START_PERIOD);
        if self.building.is_some() || is_early {
            return;
        }
        self.last = Some(now);
        let (setup, config) = (setup.clone(), config.clone());
        let build = move || {
            lower_priority();
            let pipeline = Pipeline::new(&setup, &config)?;
            Ok((pipeline, toml::to_string(&config)?))
        };
        // Without a thread the next cycle tries again.
        self.building = std::thread::Builder::new()
            .name("replay-start".to_owned())
            .spawn(build)
            .ok();
    }

    /// Drops what is being built: its settings are no longer in force.
    pub(super) fn cancel(&mut self) {
        self.building = None;
        self.last = None;
    }

    /// The pipeline, once it is built and the state of `present` is one that a new pipeline can go on from.
    ///
    /// Several hypotheses of the pose would be lost, so these are left to clear up first.
    pub(super) fn take(
        &mut self,
        present: &Pipeline,
    ) -> Option<Result<(Pipeline, SettingsChange)>> {
        let is_ready = !present.has_several_hypotheses()
            && self.building.as_ref().is_some_and(JoinHandle::is_finished);
        let built = self.building.take_if(|_| is_ready)?.join();
        // A panic has been reported by its thread.
        let built = built.ok()?;
        Some(built.map(|(pipeline, config)| {
            let change = SettingsChange {
                config_toml: config.into(),
                warm_start: None,
            };
            (pipeline, change)
        }))
    }
}
