//! A progress bar on standard error; nothing is printed without a terminal.

use indicatif::{ProgressBar, ProgressStyle};

/// A bar for a known number of steps.
pub(crate) fn bar(steps: u64, unit: &'static str) -> ProgressBar {
    let template = format!("{{bar:40}} {{pos}}/{{len}} {unit} {{elapsed}} (to go {{eta}}) {{msg}}");
    let style =
        ProgressStyle::with_template(&template).unwrap_or_else(|_| ProgressStyle::default_bar());
    ProgressBar::new(steps).with_style(style)
}
