//! Which curves does a plot show, and how?

use eframe::egui::Color32;
use serde::{Deserialize, Serialize};

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

/// How a plot shows its curves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub(crate) enum PlotKind {
    /// Over time.
    #[default]
    Curve,
    /// The second curve over the first one.
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
pub(crate) struct PlotConfig {
    /// Names of its curves: quantities, fields as `/cycle.estimate.pose.x`, formulas as `= 2 * {x}`.
    pub(super) curves: Vec<String>,
    pub(super) kind: PlotKind,
    /// Logarithmic values.
    pub(super) logarithmic: bool,
    /// Values at which a line is drawn.
    pub(super) thresholds: Vec<f64>,
}

impl PlotConfig {
    pub(super) fn of(names: &[&str]) -> Self {
        PlotConfig {
            curves: names.iter().map(|&name| name.to_owned()).collect(),
            ..PlotConfig::default()
        }
    }

    /// Its curves with their colours.
    pub(super) fn colours(&self) -> impl Iterator<Item = (&str, Color32)> {
        let names = self.curves.iter().map(String::as_str);
        names.zip(COLOURS.into_iter().cycle())
    }

    /// One plot of each kind, with a logarithmic axis and a threshold.
    #[cfg(test)]
    pub(crate) fn one_of_each_kind(names: [&str; 2]) -> Vec<Self> {
        let kinds = [
            PlotKind::Curve,
            PlotKind::Against,
            PlotKind::Histogram,
            PlotKind::Spectrum,
            PlotKind::Numbers,
        ];
        let plot = |kind| PlotConfig {
            kind,
            logarithmic: kind == PlotKind::Curve,
            thresholds: vec![10.0],
            ..PlotConfig::of(&names)
        };
        kinds.map(plot).into()
    }
}
