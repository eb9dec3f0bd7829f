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

/// The value as a logarithmic axis places it; an unknown one stays unknown.
pub(super) fn scale(value: f64, logarithmic: bool) -> f64 {
    if logarithmic && !value.is_nan() {
        value.abs().max(LOGARITHM_MIN).log10()
    } else {
        value
    }
}

#[test]
fn unknown_value_has_no_place_on_a_logarithmic_axis() {
    assert!(scale(f64::NAN, true).is_nan());
    assert_eq!(scale(0.0, true), -6.0);
    assert_eq!(scale(-100.0, true), 2.0);
}
