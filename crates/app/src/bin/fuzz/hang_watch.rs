//! Does a parser hang? A thread ends the process if an input takes too long, and keeps that input.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

/// Seconds after which an input counts as a hang.
const INPUT_SECONDS_MAX: u32 = 20;

/// Watches the inputs of one target until it is dropped.
pub(crate) struct HangWatch {
    state: Arc<WatchState>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Default)]
struct WatchState {
    /// Number of inputs begun.
    inputs: AtomicU64,
    ended: AtomicBool,
}

impl HangWatch {
    /// `current`: the file that holds the input being parsed; `artifacts`: where it is kept.
    pub(crate) fn start(target: &str, current: &Path, artifacts: &Path) -> Self {
        let state = Arc::<WatchState>::default();
        let (shared, current) = (Arc::clone(&state), current.to_owned());
        let saved = artifacts.join(format!("{target}-hang"));
        let target = target.to_owned();
        let thread = std::thread::spawn(move || shared.watch(&target, &current, &saved));
        HangWatch {
            state,
            thread: Some(thread),
        }
    }

    /// The next input is parsed from now on.
    pub(crate) fn begin_input(&self) {
        self.state.inputs.fetch_add(1, Ordering::Relaxed);
    }
}

impl Drop for HangWatch {
    fn drop(&mut self) {
        self.state.ended.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.thread().unpark();
            // A panic was reported when it happened.
            let _ended = thread.join();
        }
    }
}

impl WatchState {
    fn watch(&self, target: &str, current: &Path, saved: &Path) {
        let (mut last, mut seconds) = (0, 0);
        while !self.ended.load(Ordering::Relaxed) {
            std::thread::park_timeout(Duration::from_secs(1));
            let inputs = self.inputs.load(Ordering::Relaxed);
            seconds = if inputs == last { seconds + 1 } else { 0 };
            last = inputs;
            if seconds >= INPUT_SECONDS_MAX && inputs > 0 {
                let place = if std::fs::copy(current, saved).is_ok() {
                    saved
                } else {
                    current
                };
                eprintln!("fuzz: {target}: hang; input {}", place.display());
                // Nothing else stops a thread that parses for ever.
                std::process::exit(1);
            }
        }
    }
}
