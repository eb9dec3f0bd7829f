//! How are messages printed without blocking? A thread writes to standard error, so that a slow reader delays nobody.

use std::io::Write;
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Capacity of the queue, lines. When it is full, new lines are lost.
const QUEUE_CAPACITY: usize = 256;
/// Longest wait for a slow reader at the end.
const SHUTDOWN_TIMEOUT: Duration = Duration::from_millis(300);

/// Writes to standard error without blocking the caller.
pub(crate) struct StderrWriter {
    lines: Option<SyncSender<String>>,
    thread: Option<JoinHandle<()>>,
}

impl StderrWriter {
    /// Starts the thread. If that fails, nothing is printed.
    pub(crate) fn start() -> Self {
        let (lines, queue) = sync_channel::<String>(QUEUE_CAPACITY);
        let write = move || {
            let mut out = std::io::stderr();
            for text in queue {
                // The reader may be gone; that must not affect the robot.
                let _gone = out.write_all(text.as_bytes());
            }
        };
        let thread = std::thread::Builder::new()
            .name("stderr".to_owned())
            .spawn(write)
            .ok();
        StderrWriter {
            lines: Some(lines),
            thread,
        }
    }

    /// Queues the text as it is.
    pub(crate) fn write(&self, text: String) {
        if let Some(lines) = &self.lines {
            let _full = lines.try_send(text);
        }
    }
}

impl Drop for StderrWriter {
    fn drop(&mut self) {
        self.lines = None;
        let Some(thread) = self.thread.take() else {
            return;
        };
        let deadline = Instant::now() + SHUTDOWN_TIMEOUT;
        while !thread.is_finished() && Instant::now() < deadline {
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}
