//! Reads the whole log once in a thread, chunk by chunk, and sends the metrics of its cycles and the odd moments.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use localize::robot::BaseConfig;

use crate::view::time_series::CycleMetrics;
use pipeline::findings::{Finding, RunHistory};
use pipeline::log::LogIndex;

/// Batches queued for the view; a batch holds one chunk's cycles.
const BATCH_CAPACITY: usize = 64;
/// One image in this many is decoded for its brightness and entropy.
const IMAGE_STRIDE: u64 = 10;

/// Findings are sought when the run has this many cycles, and each time that it has doubled.
const FIRST_SEARCH: usize = 1000;

/// What was read.
#[derive(Default)]
pub(crate) struct ReadPart {
    /// Metrics of the next cycles.
    pub(crate) samples: Vec<CycleMetrics>,
    /// Stamps (s) at which settings changed, and the settings (TOML).
    pub(crate) setting_changes: Vec<(f64, Arc<str>)>,
    /// Chunks that cannot be read, each with its first and last time, seconds.
    pub(crate) damaged: Vec<(usize, (f64, f64))>,
    /// All findings so far; None: as before.
    pub(crate) findings: Option<Vec<Finding>>,
}

/// The running reader; dropping it stops the thread.
pub(crate) struct MetricsReader {
    batches: Receiver<ReadPart>,
    stop: Arc<AtomicBool>,
    done: bool,
}

impl MetricsReader {
    /// Starts the thread.
    pub(crate) fn start(index: Arc<LogIndex>, base: BaseConfig) -> std::io::Result<Self> {
        let (sender, batches) = sync_channel(BATCH_CAPACITY);
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = stop.clone();
        std::thread::Builder::new()
            .name("metrics".to_owned())
            .spawn(move || read_metrics(&index, &base, &stopped, &sender))?;
        Ok(MetricsReader {
            batches,
            stop,
            done: false,
        })
    }

    /// What was read since the last call.
    pub(crate) fn poll(&mut self) -> ReadPart {
        let mut read = ReadPart::default();
        loop {
            match self.batches.try_recv() {
                Ok(batch) => {
                    read.samples.extend(batch.samples);
                    read.setting_changes.extend(batch.setting_changes);
                    read.damaged.extend(batch.damaged);
                    read.findings = batch.findings.or(read.findings);
                }
                Err(std::sync::mpsc::TryRecvError::Empty) => return read,
                Err(std::sync::mpsc::TryRecvError::Disconnected) => {
                    self.done = true;
                    return read;
                }
            }
        }
    }

    /// True once the whole log is read.
    pub(crate) fn is_done(&self) -> bool {
        self.done
    }
}

impl Drop for MetricsReader {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
    }
}

fn read_metrics(
    index: &LogIndex,
    base: &BaseConfig,
    stop: &AtomicBool,
    sender: &SyncSender<ReadPart>,
) {
    let mut next = 0;
    let mut history = RunHistory::default();
    let mut next_search = FIRST_SEARCH;
    for (part, chunk) in index.chunks().iter().enumerate() {
        if stop.load(Ordering::Relaxed) {
            return;
        }
        // The player reports the reason when the chunk is shown.
        let Ok(cycles) = index.load(part) else {
            let damaged = vec![(part, (chunk.start.seconds(), chunk.end.seconds()))];
            let batch = ReadPart {
                damaged,
                ..ReadPart::default()
            };
            if sender.send(batch).is_err() {
                return;
            }
            continue;
        };
        let mut batch = ReadPart::default();
        for mut logged in cycles {
            // Without poses the whole run would be a finding.
            if index.holds_poses() {
                history.push(logged.index, &logged.cycle);
            }
            if let Some(settings) = &logged.cycle.inputs.changed_config_toml {
                let time = logged.cycle.stamp.seconds();
                batch.setting_changes.push((time, settings.clone()));
            }
            let image = logged
                .image
                .filter(|_| logged.index.is_multiple_of(IMAGE_STRIDE));
            logged.cycle.inputs.image = image.and_then(|image| Some(image.decode().ok()?.into()));
            batch.samples.push(CycleMetrics::from_cycle(
                &logged.cycle,
                base,
                logged.index.saturating_sub(next),
            ));
            next = logged.index + 1;
        }
        if history.len() >= next_search {
            next_search = 2 * history.len();
            batch.findings = Some(history.findings());
        }
        if sender.send(batch).is_err() {
            return;
        }
    }
    // The receiver is gone if the view opened another source.
    let _ = sender.send(ReadPart {
        findings: Some(history.findings()),
        ..ReadPart::default()
    });
}
