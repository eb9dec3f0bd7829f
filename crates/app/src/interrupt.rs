//! Has somebody asked us to stop? Ctrl-C and SIGTERM end a run between two cycles, so that nothing is left half-written.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result, bail};

static STOP_REQUESTED: AtomicBool = AtomicBool::new(false);
/// What a shell reports of a process that SIGINT ended.
const EXIT_CODE_SIGINT: i32 = 130;

/// From now on `asked` and `check` tell; whoever asks twice does not wait for the end of a cycle.
pub fn install_handler() -> Result<()> {
    ctrlc::set_handler(|| {
        if STOP_REQUESTED.swap(true, Ordering::Relaxed) {
            std::process::exit(EXIT_CODE_SIGINT);
        }
    })
    .context("cannot listen for Ctrl-C")
}

/// Whether somebody asked us to stop.
pub fn stop_requested() -> bool {
    STOP_REQUESTED.load(Ordering::Relaxed)
}

/// Breaks off a loop once somebody asked us to stop.
pub fn flow() -> ControlFlow<()> {
    if stop_requested() {
        ControlFlow::Break(())
    } else {
        ControlFlow::Continue(())
    }
}

/// An error once somebody asked us to stop: what drops on the way out takes its unfinished files with it.
pub fn check() -> Result<()> {
    if stop_requested() {
        bail!("interrupted");
    }
    Ok(())
}
