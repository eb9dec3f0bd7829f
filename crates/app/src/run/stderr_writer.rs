//! Who is told? Whoever reads standard error, by a thread of its own: a reader that is slow or gone holds up nobody.

use std::io::Write;
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Lines that may wait; beyond it new ones are lost.
const QUEUE_CAPACITY: usize = 256;
/// How long the end waits for a slow reader.
const SHUTDOWN_TIMEOUT: Duration = Duration::from_millis(300);

/// Writes to standard error, and never waits for it.
pub struct StderrWriter {
    lines: Option<SyncSender<String>>,
    thread: Option<JoinHandle<()>>,
}

impl StderrWriter {
    /// Starts the thread; without one nothing is told.
    pub fn start() -> Self {
        let (lines, waiting) = sync_channel::<String>(QUEUE_CAPACITY);
        let write = move || {
            let mut out = std::io::stderr();
            for text in waiting {
                // Whoever watched may be gone; nothing of the robot depends on being watched.
                let _gone = out.write_all(text.as_bytes());
            }
        };
        let thread = std::thread::Builder::new()
            .name("tell".to_owned())
            .spawn(write)
            .ok();
        StderrWriter {
            lines: Some(lines),
            thread,
        }
    }

    /// Writes the text as it is, sooner or later.
    pub fn write(&self, text: String) {
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
        let until = Instant::now() + SHUTDOWN_TIMEOUT;
        while !thread.is_finished() && Instant::now() < until {
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}
