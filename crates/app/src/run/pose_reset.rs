//! How does a run go on from a pose that another program gives? A thread builds a pipeline of the present settings, which
//! begins there. The log holds the pose, so a replay repeats every bit.

use std::thread::JoinHandle;

use anyhow::Result;
use hw::realtime::lower_priority;
use pipeline::setup::Setup;
use pipeline::{Pipeline, PipelineConfig};

use crate::ros2::GivenPose;

/// Builds the pipeline that begins at the pose.
#[derive(Default)]
pub(super) struct PoseReset {
    building: Option<JoinHandle<Result<(Pipeline, String)>>>,
    given: Option<GivenPose>,
}

impl PoseReset {
    /// Begins at `given`, in place of a pose that was given just before.
    pub(super) fn request(&mut self, given: GivenPose, setup: &Setup, config: &PipelineConfig) {
        self.given = Some(given);
        if self.building.is_some() {
            return;
        }
        let (setup, config) = (setup.clone(), config.clone());
        let build = move || {
            lower_priority();
            let pipeline = Pipeline::new(&setup, &config)?;
            Ok((pipeline, toml::to_string(&config)?))
        };
        // Without a thread the pose is lost; the sender sees that it does not change.
        self.building = std::thread::Builder::new()
            .name("pose-reset".to_owned())
            .spawn(build)
            .ok();
    }

    /// Drops what is being built: its settings are no longer in force.
    pub(super) fn cancel(&mut self) {
        self.building = None;
        self.given = None;
    }

    /// The pipeline, its settings (TOML) and the pose, once it is built.
    pub(super) fn take(&mut self) -> Option<(Result<(Pipeline, String)>, GivenPose)> {
        let built = self.building.take_if(|thread| thread.is_finished())?.join();
        // A panic has been reported by its thread.
        Some((built.ok()?, self.given.take()?))
    }
}
