//! What if the log's run had had other settings? A thread computes it once more from the recorded inputs.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};

use anyhow::{Context, Result};
use localize::robot::BaseConfig;

use crate::view::time_series::{CycleMetrics, TimeSeries};
use pipeline::log::{ImageCompression, LogReader};
use pipeline::setup::Setup;
use pipeline::{Pipeline, PipelineConfig};

/// Cycles that may wait for the view to take them.
const EVENT_CAPACITY: usize = 256;

/// What the thread says.
enum RecomputeEvent {
    /// A cycle; true if its pose is the recorded one to the last bit.
    Cycle(Box<CycleMetrics>, bool),
    /// It broke off.
    Failed(String),
}

/// A run computed once more; dropping it ends its thread.
pub(crate) struct Recompute {
    events: Receiver<RecomputeEvent>,
    stop: Arc<AtomicBool>,
    /// The numbers of the cycles so far.
    pub(crate) series: TimeSeries,
    /// Cycles computed.
    pub(crate) cycles: u64,
    /// Of these, poses that are not the recorded ones.
    pub(crate) changed_poses: u64,
    /// Whether vision was computed again, too.
    pub(crate) vision_recomputed: bool,
    /// True once all is computed.
    pub(crate) done: bool,
    /// Why it broke off.
    pub(crate) error: Option<String>,
}

impl Recompute {
    /// Starts to compute the log at `path` with other settings.
    pub(crate) fn start(path: &Path, config: PipelineConfig) -> Result<Self> {
        let sight = LogReader::open(path)?.header().images == ImageCompression::Png;
        let (sender, news) = sync_channel(EVENT_CAPACITY);
        let stop = Arc::new(AtomicBool::new(false));
        let (stopped, path) = (stop.clone(), path.to_owned());
        std::thread::Builder::new()
            .name("recompute".to_owned())
            .spawn(move || {
                if let Err(error) = recompute_log(&path, &config, sight, &stopped, &sender) {
                    // The view may have gone on to something else.
                    let _ = sender.send(RecomputeEvent::Failed(format!("{error:#}")));
                }
            })?;
        Ok(Recompute {
            events: news,
            stop,
            series: TimeSeries::default(),
            cycles: 0,
            changed_poses: 0,
            vision_recomputed: sight,
            done: false,
            error: None,
        })
    }

    /// Takes what was computed since the last call.
    pub(crate) fn poll(&mut self) {
        loop {
            match self.events.try_recv() {
                Ok(RecomputeEvent::Cycle(sample, same)) => {
                    self.cycles += 1;
                    self.changed_poses += u64::from(!same);
                    self.series.push(*sample);
                }
                Ok(RecomputeEvent::Failed(fault)) => self.error = Some(fault),
                Err(TryRecvError::Empty) => return,
                Err(TryRecvError::Disconnected) => {
                    self.done = true;
                    return;
                }
            }
        }
    }
}

impl Drop for Recompute {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
    }
}

fn recompute_log(
    path: &Path,
    config: &PipelineConfig,
    sight: bool,
    stop: &AtomicBool,
    sender: &SyncSender<RecomputeEvent>,
) -> Result<()> {
    let log = LogReader::open(path)?;
    let folder = tempfile::tempdir().context("no room for the log's files")?;
    log.header().write_files(folder.path())?;
    let setup = Setup::load(&folder.path().join("robot.toml"), None)?;
    let mut spine = Pipeline::new(&setup, config)?;
    let base: BaseConfig = setup.robot.base.clone().unwrap_or_default();
    for logged in log {
        let logged = logged?;
        for sample in logged.samples(sight)? {
            let Some(cycle) = spine.process_sample(sample) else {
                continue;
            };
            let same = cycle.estimate.pose == logged.cycle.estimate.pose;
            let sample = CycleMetrics::from_cycle(&cycle, &base, 0);
            let news = RecomputeEvent::Cycle(Box::new(sample), same);
            if stop.load(Ordering::Relaxed) || sender.send(news).is_err() {
                return Ok(());
            }
        }
    }
    Ok(())
}
