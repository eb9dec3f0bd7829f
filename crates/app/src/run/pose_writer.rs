//! How does poses.csv reach the disk? By a thread of its own, so that a slow disk does not delay the robot.

use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;

use anyhow::{Context, Result, anyhow, bail};
use pipeline::Cycle;
use pipeline::result_files::CsvOutputs;

/// Capacity of the queue of poses to write, cycles.
const QUEUE_CAPACITY: usize = 300;

/// Writes poses.csv. The file gets its name at the end of the run.
pub(super) struct PoseWriter {
    queue: SyncSender<Arc<Cycle>>,
    /// None after it has ended before the run.
    thread: Option<JoinHandle<Result<()>>>,
    /// Why it has ended, which has been reported.
    failure: Option<String>,
    /// Rows that the disk was too slow for.
    rows_lost: u64,
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
            thread: Some(thread),
            failure: None,
            rows_lost: 0,
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
            Err(TrySendError::Disconnected(_)) => {
                let thread = self.thread.take()?;
                let reason = join(thread).err().map(|error| format!("{error:#}"))?;
                let message = format!("{reason}. The run continues without them");
                self.failure = Some(reason);
                Some(message)
            }
        }
    }

    /// Completes the table. Errors if it cannot be written, reported or not. Returns the number of rows that the disk was too slow for.
    pub(super) fn finish(self) -> Result<u64> {
        drop(self.queue);
        if let Some(reason) = self.failure {
            bail!(reason);
        }
        self.thread.map_or(Ok(()), join)?;
        Ok(self.rows_lost)
    }
}

fn join(thread: JoinHandle<Result<()>>) -> Result<()> {
    thread
        .join()
        .map_err(|_reported| anyhow!("the writer thread panicked"))
        .flatten()
        .context("cannot write the poses")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn failure_is_reported_once_with_its_reason_and_again_at_the_end() {
        let (queue, cycles) = sync_channel(QUEUE_CAPACITY);
        drop(cycles);
        let mut writer = PoseWriter {
            queue,
            thread: Some(std::thread::spawn(|| Err(anyhow!("poses.csv: disk full")))),
            failure: None,
            rows_lost: 0,
        };
        let cycle = Arc::new(pipeline::testing::random_cycle(0));
        let reason = "cannot write the poses: poses.csv: disk full";
        let message = format!("{reason}. The run continues without them");
        assert_eq!(writer.write_cycle(&cycle), Some(message));
        assert_eq!(writer.write_cycle(&cycle), None);
        assert_eq!(writer.finish().expect_err("incomplete").to_string(), reason);
    }
}
