//! A progress bar on standard error, which prints nothing without a terminal, and lines for the longest work there.

use std::io::IsTerminal;
use std::sync::atomic::{AtomicU8, Ordering};

use indicatif::{ProgressBar, ProgressStyle};

/// A bar for a known number of steps.
pub(crate) fn bar(steps: u64, unit: &'static str) -> ProgressBar {
    let template = format!("{{bar:40}} {{pos}}/{{len}} {unit} {{elapsed}} (to go {{eta}}) {{msg}}");
    let style =
        ProgressStyle::with_template(&template).unwrap_or_else(|_| ProgressStyle::default_bar());
    ProgressBar::new(steps).with_style(style)
}

/// Progress as lines of text, for minutes of work whose standard error goes to a file. A terminal has the bar.
pub(crate) struct Lines {
    command: &'static str,
    /// Tenths that were printed; all of them on a terminal.
    printed: AtomicU8,
}

impl Lines {
    /// `command`: what is at work.
    pub(crate) fn new(command: &'static str) -> Self {
        let printed = if std::io::stderr().is_terminal() {
            10
        } else {
            0
        };
        Lines {
            command,
            printed: AtomicU8::new(printed),
        }
    }

    /// Prints each tenth that is done, once.
    pub(crate) fn show(&self, share: f32) {
        let tenths = (10.0 * share).clamp(0.0, 10.0) as u8;
        if self.printed.fetch_max(tenths, Ordering::Relaxed) < tenths {
            stderr_line!("{}: {} %", self.command, 10 * tenths);
        }
    }
}
