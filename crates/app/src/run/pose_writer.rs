//! How does poses.csv reach the disk? By a thread of its own, so that a slow disk does not delay the robot.

use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;

use anyhow::{Context, Result, anyhow};
use pipeline::Cycle;
use pipeline::result_files::CsvOutputs;

/// Capacity of the queue of poses to write, cycles.
const QUEUE_CAPACITY: usize = 300;

/// Writes poses.csv. The file gets its name at the end of the run.
pub(super) struct PoseWriter {
    queue: SyncSender<Arc<Cycle>>,
    thread: JoinHandle<Result<()>>,
    /// Rows that the disk was too slow for.
    rows_lost: u64,
    /// The thread has ended, which has been reported.
    has_failed: bool,
}

impl PoseWriter {
    pub(super) fn start(path: &Path) -> Result<Self> {
        let mut outputs = CsvOutputs::create(Some(path), None, None)?;
        let (queue, cycles): (_, Receiver<Arc<Cycle>>) = sync_channel(QUEUE_CAPACITY);
        let write = move || {
            for cycle in cycles {
                outputs.write(&cycle)?;
            }
            outputs.finish()
        };
        let thread = std::thread::Builder::new()
            .name("poses".to_owned())
            .spawn(write)?;
        Ok(PoseWriter {
            queue,
            thread,
            rows_lost: 0,
            has_failed: false,
        })
    }

    /// Queues a row. Returns a message once, if the table cannot be written.
    pub(super) fn write_cycle(&mut self, cycle: &Arc<Cycle>) -> Option<String> {
        match self.queue.try_send(Arc::clone(cycle)) {
            Ok(()) => None,
            Err(TrySendError::Full(_)) => {
                self.rows_lost += 1;
                None
            }
            Err(TrySendError::Disconnected(_)) if self.has_failed => None,
            Err(TrySendError::Disconnected(_)) => {
                self.has_failed = true;
                Some("cannot write the poses. The run continues without them".to_owned())
            }
        }
    }

    /// Completes the table. Returns the number of rows that the disk was too slow for.
    pub(super) fn finish(self) -> Result<u64> {
        drop(self.queue);
        self.thread
            .join()
            .map_err(|_reported| anyhow!("the writer thread panicked"))
            .flatten()
            .context("cannot write the poses")?;
        Ok(self.rows_lost)
    }
}
