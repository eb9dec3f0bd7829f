//! A curve of a plot, and where an axis places its values.

use eframe::egui::Color32;

use crate::view::curves::Curve;

/// Smallest value that a logarithmic axis shows.
const LOGARITHM_MIN: f64 = 1e-6;

/// A curve as it is drawn.
pub(super) struct PlottedCurve<'a> {
    pub(super) name: &'a str,
    pub(super) unit: &'static str,
    pub(super) colour: Color32,
    pub(super) curve: Curve<'a>,
    /// The same of other runs, with their names.
    pub(super) others: Vec<(&'a str, Curve<'a>)>,
}

/// The value as a logarithmic axis places it.
pub(super) fn scale(value: f64, logarithmic: bool) -> f64 {
    if logarithmic {
        value.abs().max(LOGARITHM_MIN).log10()
    } else {
        value
    }
}
