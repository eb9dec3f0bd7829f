//! When does it end? A signal (SIGTERM, SIGINT, SIGHUP) asks for the end; who asked is not asked back.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result};

/// Raised by a signal, or by whoever has seen enough; clones are the same.
#[derive(Debug, Clone, Default)]
pub struct StopFlag {
    raised: Arc<AtomicBool>,
}

impl StopFlag {
    /// Listens for signals; once a process.
    pub fn on_signals() -> Result<Self> {
        let stop = StopFlag::default();
        let heard = stop.clone();
        ctrlc::set_handler(move || heard.raise()).context("cannot listen for signals")?;
        Ok(stop)
    }

    /// Asks for the end.
    pub fn raise(&self) {
        self.raised.store(true, Ordering::Relaxed);
    }

    /// True once the end was asked for.
    pub fn is_raised(&self) -> bool {
        self.raised.load(Ordering::Relaxed)
    }
}
