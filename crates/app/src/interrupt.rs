//! Was the process asked to stop? Ctrl-C and SIGTERM end a command between two cycles, so that no file is half written.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result, bail};

static STOP_REQUESTED: AtomicBool = AtomicBool::new(false);
/// Exit code that a shell reports for a process ended by SIGINT.
const EXIT_CODE_SIGINT: i32 = 130;

/// Installs the signal handler for `stop_requested`. The second signal ends the process at once.
pub(crate) fn install_handler() -> Result<()> {
    ctrlc::set_handler(|| {
        if STOP_REQUESTED.swap(true, Ordering::Relaxed) {
            std::process::exit(EXIT_CODE_SIGINT);
        }
    })
    .context("cannot install the signal handler")
}

/// True once a signal has arrived.
pub(crate) fn stop_requested() -> bool {
    STOP_REQUESTED.load(Ordering::Relaxed)
}

/// Breaks a loop once a signal has arrived.
pub(crate) fn flow() -> ControlFlow<()> {
    if stop_requested() {
        ControlFlow::Break(())
    } else {
        ControlFlow::Continue(())
    }
}

/// An error once a signal has arrived. Unfinished files are removed on drop.
pub(crate) fn check() -> Result<()> {
    if stop_requested() {
        bail!("interrupted");
    }
    Ok(())
}
