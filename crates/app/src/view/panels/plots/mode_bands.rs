//! Where was the robot not tracking? Bands behind all plots, computed again only when something has changed.

use localize::estimate::Mode;

use crate::view::time_series::TimeSeries;

/// The bands of the visible time.
#[derive(Debug, Clone, Default)]
pub(super) struct ModeBands {
    /// Visible time, and number, thinning and last time of the samples.
    key: Option<((f64, f64), usize, usize, f64)>,
    bands: Vec<(f64, f64, Mode)>,
}

impl ModeBands {
    /// Computes the bands if they are not those of the last call.
    pub(super) fn update(&mut self, series: &TimeSeries, (from, to): (f64, f64)) {
        let end = series.samples().last().map_or(0.0, |last| last.time);
        let key = ((from, to), series.samples().len(), series.stride(), end);
        if self.key == Some(key) {
            return;
        }
        self.key = Some(key);
        self.bands.clear();
        for run in series.between(from, to).chunk_by(|a, b| a.mode == b.mode) {
            if let (Some(first), Some(last)) = (run.first(), run.last())
                && first.mode != Mode::Tracking
            {
                // Up to the next cycle, so that a single one is seen.
                let end = series.after(last.time).map_or(last.time, |next| next.time);
                self.bands.push((first.time, end, first.mode));
            }
        }
    }

    /// Start, end (s) and mode of each band.
    pub(super) fn all(&self) -> &[(f64, f64, Mode)] {
        &self.bands
    }
}
