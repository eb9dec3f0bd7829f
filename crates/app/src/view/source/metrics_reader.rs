//! Reads the whole log once in a thread, chunk by chunk, and sends the metrics of its cycles.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use localize::robot::BaseConfig;

use crate::view::time_series::CycleMetrics;
use pipeline::log::LogIndex;

/// Batches queued for the view; a batch holds one chunk's cycles.
const BATCH_CAPACITY: usize = 64;
/// One image in this many is decoded for its brightness and entropy.
const IMAGE_STRIDE: u64 = 10;

/// The running reader; dropping it stops the thread.
pub(crate) struct MetricsReader {
    batches: Receiver<Vec<CycleMetrics>>,
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

    /// Metrics read since the last call.
    pub(crate) fn poll(&mut self) -> Vec<CycleMetrics> {
        let mut samples = Vec::new();
        loop {
            match self.batches.try_recv() {
                Ok(batch) => samples.extend(batch),
                Err(std::sync::mpsc::TryRecvError::Empty) => return samples,
                Err(std::sync::mpsc::TryRecvError::Disconnected) => {
                    self.done = true;
                    return samples;
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
    sender: &SyncSender<Vec<CycleMetrics>>,
) {
    let mut next = 0;
    for part in 0..index.chunks().len() {
        if stop.load(Ordering::Relaxed) {
            return;
        }
        // The player reports an unreadable chunk when it is shown. The plots have a gap there.
        let Ok(cycles) = index.load(part) else {
            continue;
        };
        let mut batch = Vec::with_capacity(cycles.len());
        for mut logged in cycles {
            let image = logged
                .image
                .filter(|_| logged.index.is_multiple_of(IMAGE_STRIDE));
            logged.cycle.inputs.image = image.and_then(|image| Some(image.decode().ok()?.into()));
            batch.push(CycleMetrics::from_cycle(
                &logged.cycle,
                base,
                logged.index.saturating_sub(next),
            ));
            next = logged.index + 1;
        }
        if sender.send(batch).is_err() {
            return;
        }
    }
}
