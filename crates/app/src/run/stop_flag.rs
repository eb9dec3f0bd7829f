//! When does the run end? A signal (SIGTERM, SIGINT, SIGHUP, SIGQUIT) or a thread raises the flag.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result};

/// A flag that ends the run. Clones share the same state.
#[derive(Debug, Clone, Default)]
pub(crate) struct StopFlag {
    raised: Arc<AtomicBool>,
}

impl StopFlag {
    /// A flag raised by signals. May be made once per process.
    pub(crate) fn on_signals() -> Result<Self> {
        let stop = StopFlag::default();
        let flag = stop.clone();
        ctrlc::set_handler(move || flag.raise()).context("cannot install the signal handler")?;
        hw::signals::treat_quit_as_termination().context("cannot install the signal handler")?;
        Ok(stop)
    }

    /// Requests the end.
    pub(crate) fn raise(&self) {
        self.raised.store(true, Ordering::Relaxed);
    }

    /// True once the end was requested.
    pub(crate) fn is_raised(&self) -> bool {
        self.raised.load(Ordering::Relaxed)
    }
}
