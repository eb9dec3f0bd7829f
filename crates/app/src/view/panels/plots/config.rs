//! Which quantities does a plot show, and how?

use eframe::egui::Color32;
use serde::{Deserialize, Serialize};

use super::catalogue::PlottedQuantity;
use crate::view::palette;

/// Colours of a plot's curves, in turn.
const COLOURS: [Color32; 7] = [
    palette::ORANGE,
    palette::SKY,
    palette::GREEN,
    palette::PURPLE,
    palette::VERMILION,
    palette::YELLOW,
    palette::GREY,
];

/// How a plot shows its quantities.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub(super) enum PlotKind {
    /// Over time.
    #[default]
    Curve,
    /// The second quantity over the first one.
    Against,
    /// How often each value occurs in the visible time.
    Histogram,
    /// Amplitude over frequency in the visible time.
    Spectrum,
    /// Values at the shown time, and their statistics in the visible time.
    Numbers,
}

/// One plot.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub(super) struct PlotConfig {
    /// Names of its quantities.
    pub(super) curves: Vec<String>,
    pub(super) kind: PlotKind,
    /// Logarithmic values.
    pub(super) logarithmic: bool,
}

impl PlotConfig {
    pub(super) fn of(names: &[&str]) -> Self {
        PlotConfig {
            curves: names.iter().map(|&name| name.to_owned()).collect(),
            ..PlotConfig::default()
        }
    }

    /// Its quantities with their colours. A name of another version is left out.
    pub(super) fn quantities(&self) -> Vec<(&'static PlottedQuantity, Color32)> {
        let known = self
            .curves
            .iter()
            .filter_map(|name| PlottedQuantity::named(name));
        known.zip(COLOURS.into_iter().cycle()).collect()
    }
}
