//! Recomputes a log's run with other settings from its recorded inputs, in a thread.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};

use anyhow::Result;
use localize::robot::BaseConfig;

use crate::view::time_series::{CycleMetrics, TimeSeries};
use pipeline::log::{ImageCompression, LogReader, UnpackedSetup};
use pipeline::{Pipeline, PipelineConfig};

/// Events queued for the view.
const EVENT_CAPACITY: usize = 256;

/// A message of the thread.
enum RecomputeEvent {
    /// Metrics of a cycle; true if its pose is bit-identical to the recorded one.
    Cycle(Box<CycleMetrics>, bool),
    /// The run stopped with an error.
    Failed(String),
}

/// A recomputed run; dropping it stops its thread.
pub(crate) struct Recompute {
    events: Receiver<RecomputeEvent>,
    stop: Arc<AtomicBool>,
    /// Metrics of the cycles so far.
    pub(crate) series: TimeSeries,
    /// Number of recomputed cycles.
    pub(crate) cycles: u64,
    /// Number of poses that differ from the recorded ones.
    pub(crate) changed_poses: u64,
    /// True if vision was recomputed; false if the recorded line points were used.
    pub(crate) vision_recomputed: bool,
    /// True once the run is complete.
    pub(crate) done: bool,
    /// Why the run stopped early.
    pub(crate) error: Option<String>,
}

impl Recompute {
    /// Starts to recompute the log at `path` with `config`.
    pub(crate) fn start(path: &Path, config: PipelineConfig) -> Result<Self> {
        let recompute_vision = LogReader::open(path)?.header().images == ImageCompression::Png;
        let (sender, events) = sync_channel(EVENT_CAPACITY);
        let stop = Arc::new(AtomicBool::new(false));
        let (stopped, path) = (stop.clone(), path.to_owned());
        std::thread::Builder::new()
            .name("recompute".to_owned())
            .spawn(move || {
                if let Err(error) =
                    recompute_log(&path, &config, recompute_vision, &stopped, &sender)
                {
                    // The receiver is gone if the view opened another source.
                    let _ = sender.send(RecomputeEvent::Failed(format!("{error:#}")));
                }
            })?;
        Ok(Recompute {
            events,
            stop,
            series: TimeSeries::default(),
            cycles: 0,
            changed_poses: 0,
            vision_recomputed: recompute_vision,
            done: false,
            error: None,
        })
    }

    /// Takes the results since the last call.
    pub(crate) fn poll(&mut self) {
        loop {
            match self.events.try_recv() {
                Ok(RecomputeEvent::Cycle(metrics, identical)) => {
                    self.cycles += 1;
                    self.changed_poses += u64::from(!identical);
                    self.series.push(*metrics);
                }
                Ok(RecomputeEvent::Failed(error)) => self.error = Some(error),
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
    recompute_vision: bool,
    stop: &AtomicBool,
    sender: &SyncSender<RecomputeEvent>,
) -> Result<()> {
    let log = LogReader::open(path)?;
    let UnpackedSetup { setup, .. } = UnpackedSetup::load(log.header())?;
    let mut pipeline = Pipeline::new(&setup, config)?;
    let base: BaseConfig = setup.robot.base.clone().unwrap_or_default();
    for logged in log {
        let logged = logged?;
        for sample in logged.samples(recompute_vision)? {
            let Some(cycle) = pipeline.process_sample(sample) else {
                continue;
            };
            let identical = cycle.estimate.pose == logged.cycle.estimate.pose;
            let metrics = CycleMetrics::from_cycle(&cycle, &base, 0);
            let event = RecomputeEvent::Cycle(Box::new(metrics), identical);
            if stop.load(Ordering::Relaxed) || sender.send(event).is_err() {
                return Ok(());
            }
        }
    }
    Ok(())
}
