//! Plots panel: any curves over time, against each other, as histogram, spectrum or numbers.

mod axes;
mod config;
mod csv;
mod drawing;
mod drawn_line;
mod menus;
mod mode_bands;
mod numbers;
mod plotted_curve;
mod search;
mod thinned;

use eframe::egui::{self, RichText, Ui};
use serde::{Deserialize, Serialize};

pub(crate) use self::config::PlotConfig;
use self::config::PlotKind;
use self::csv::csv;
use self::drawing::{PLOT_HEIGHT_MIN, PlotArea};
use self::menus::{Change, curve_menu, threshold_menu};
use self::mode_bands::ModeBands;
use self::plotted_curve::PlottedCurve;
use self::search::search_curve;
use self::thinned::ThinnedPlot;
use crate::view::accessibility::AccessibleLabel;
use crate::view::curves::catalogue::PlottedQuantity;
use crate::view::curves::{Curve, unit_of};
use crate::view::palette;
use crate::view::panel_command::PanelCommand;
use crate::view::session::Session;

/// Height of a plot's line of names and values, points.
const HEADER_HEIGHT: f32 = 26.0;
/// Share of the visible time that a key moves by.
const PAN_SHARE: f64 = 0.1;
/// Shortest visible time of the keys, seconds.
const TIME_MIN: f64 = 0.1;
/// Names of the kinds, in menu order.
const KINDS: [(PlotKind, &str); 5] = [
    (PlotKind::Curve, "Over time"),
    (PlotKind::Against, "Second over first"),
    (PlotKind::Histogram, "Histogram"),
    (PlotKind::Spectrum, "Spectrum"),
    (PlotKind::Numbers, "Numbers"),
];

/// State of the panel.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct PlotsPanel {
    plots: Vec<PlotConfig>,
    #[serde(skip)]
    thinned: Vec<ThinnedPlot>,
    /// Time range around the cursor, seconds; 0 shows the whole run.
    window_s: f64,
    /// Time range that was dragged or zoomed to; it holds until a double click.
    #[serde(skip)]
    range: Option<(f64, f64)>,
    #[serde(skip)]
    modes: ModeBands,
    /// Start of the measured time, seconds.
    #[serde(skip)]
    measured_from: Option<f64>,
    /// What is typed to find a curve.
    #[serde(skip)]
    search: String,
    /// Value of the next threshold.
    #[serde(skip)]
    threshold: f64,
}

impl Default for PlotsPanel {
    fn default() -> Self {
        PlotsPanel {
            plots: vec![
                PlotConfig::of(&["position error"]),
                PlotConfig::of(&["std x", "std y"]),
                PlotConfig::of(&["line points", "rejected points"]),
                PlotConfig::of(&["time of vision", "time of localization"]),
            ],
            thinned: Vec::new(),
            window_s: 0.0,
            range: None,
            modes: ModeBands::default(),
            measured_from: None,
            search: String::new(),
            threshold: 0.0,
        }
    }
}

impl PlotsPanel {
    /// Draws the panel; a click seeks to its time.
    pub(crate) fn show(&mut self, ui: &mut Ui, session: &mut Session) {
        for name in std::mem::take(&mut session.plot_request) {
            self.plots.push(PlotConfig::of(&[&name]));
        }
        for name in self.plots.iter().flat_map(|plot| &plot.curves) {
            session.curves.request(name);
        }
        self.toolbar(ui, session);
        let Some(span) = session.span() else {
            ui.weak("No run yet.");
            return;
        };
        let range = self.visible_range(span, session.playback.time);
        if session.holds_poses {
            self.modes.update(&session.series, range);
        }
        let mut area = PlotArea {
            range,
            span,
            height: self.plot_height(ui),
            measured_from: self.measured_from,
            modes: std::mem::take(&mut self.modes),
            request: None,
            hovered: None,
        };
        let mut changed = None;
        self.thinned
            .resize_with(self.plots.len(), ThinnedPlot::default);
        egui::ScrollArea::vertical()
            .auto_shrink(false)
            .show(ui, |ui| {
                for number in 0..self.plots.len() {
                    ui.push_id(number, |ui| {
                        if let Some(change) = self.header(ui, number, session, &area) {
                            changed = Some((number, change));
                        }
                        let plot = &self.plots[number];
                        let curves = plotted_curves(plot, session);
                        let thinned = &mut self.thinned[number];
                        area.draw(ui, (plot, thinned), &curves, session);
                    });
                }
            });
        if let Some((number, change)) = changed {
            self.apply(number, change);
        }
        match area.request {
            Some(drawing::Request::Seek(time)) => session.seek(time.clamp(span.0, span.1)),
            Some(drawing::Request::Show(range)) => self.range = Some(range),
            Some(drawing::Request::ShowAll) => {
                self.range = None;
                self.measured_from = None;
            }
            Some(drawing::Request::MeasureFrom(time)) => self.measured_from = Some(time),
            None => {}
        }
        session.hovered_time = area.hovered;
        self.modes = area.modes;
    }

    fn toolbar(&mut self, ui: &mut Ui, session: &Session) {
        ui.horizontal_wrapped(|ui| {
            ui.menu_button("Add plot", |ui| {
                if let Some(name) = search_curve(ui, &mut self.search, session.curves.paths()) {
                    self.plots.push(PlotConfig::of(&[&name]));
                }
            });
            for (name, window) in [("All", 0.0), ("60 s", 60.0), ("10 s", 10.0)] {
                if ui
                    .selectable_label(self.range.is_none() && self.window_s == window, name)
                    .clicked()
                {
                    (self.window_s, self.range) = (window, None);
                }
            }
            if ui
                .button("Copy CSV")
                .on_hover_text("Copies the plotted curves of the visible time")
                .clicked()
                && let Some(span) = session.span()
            {
                let range = self.visible_range(span, session.playback.time);
                ui.ctx().copy_text(csv(&self.plotted(session), range));
            }
            if let Some(error) = session.series.mean_error() {
                ui.label(format!("mean error {:.1} cm", 100.0 * error));
            }
            if let Some(recompute) = &session.recompute
                && let Some(error) = recompute.series.mean_error()
            {
                let text = format!("recomputed {:.1} cm", 100.0 * error);
                ui.colored_label(palette::PURPLE, text);
            }
            ui.weak("(?)").on_hover_text(
                "Click seeks, Ctrl follows the pointer, drag pans, wheel zooms, double-click shows all, Shift-drag measures.\nA click on a name copies or removes the curve; ... changes the plot.",
            );
        });
    }

    /// The line above a plot: its curves with their values, and its menu. Returns what the user changes.
    fn header(
        &mut self,
        ui: &mut Ui,
        number: usize,
        session: &Session,
        area: &PlotArea,
    ) -> Option<Change> {
        let plot = &self.plots[number];
        let mut change = None;
        ui.horizontal_wrapped(|ui| {
            for (name, colour) in plot.colours() {
                change = change.take().or(curve_menu(ui, session, name, colour));
            }
            ui.menu_button(RichText::new("...").small(), |ui| {
                for (kind, name) in KINDS {
                    if ui.radio(plot.kind == kind, name).clicked() {
                        change = Some(Change::Kind(kind));
                    }
                }
                let mut logarithmic = plot.logarithmic;
                if ui.checkbox(&mut logarithmic, "Logarithmic").changed() {
                    change = Some(Change::Logarithmic(logarithmic));
                }
                ui.menu_button("Threshold", |ui| {
                    change = change
                        .take()
                        .or(threshold_menu(ui, plot, &mut self.threshold));
                });
                if ui.button("Remove the plot").clicked() {
                    change = Some(Change::RemovePlot);
                }
                ui.separator();
                ui.label("Add a curve");
                let found = search_curve(ui, &mut self.search, session.curves.paths());
                change = change.take().or(found.map(Change::AddCurve));
            })
            .response
            .with_accessible_label(&format!("menu of plot {}", number + 1));
            if let (0, Some(text)) = (number, area.measurement(session.hovered_time)) {
                ui.colored_label(palette::YELLOW, text);
            }
        });
        change
    }

    fn apply(&mut self, number: usize, change: Change) {
        let plot = &mut self.plots[number];
        match change {
            Change::Kind(kind) => plot.kind = kind,
            Change::Logarithmic(logarithmic) => plot.logarithmic = logarithmic,
            Change::AddCurve(name) if plot.curves.contains(&name) => {}
            Change::AddCurve(name) => plot.curves.push(name),
            Change::AddThreshold(value) => plot.thresholds.push(value),
            Change::RemoveThreshold(value) => plot.thresholds.retain(|other| *other != value),
            Change::RemoveCurve(name) => {
                plot.curves.retain(|curve| *curve != name);
                if plot.curves.is_empty() {
                    self.plots.remove(number);
                }
            }
            Change::RemovePlot => {
                self.plots.remove(number);
            }
        }
    }

    /// Multiplies the visible time, around the shown moment.
    pub(crate) fn scale_time(&mut self, session: &Session, factor: f64) {
        let Some(span) = session.span() else {
            return;
        };
        let at = session.playback.time;
        let (from, to) = self.visible_range(span, at);
        let half = (factor * (to - from) / 2.0).max(TIME_MIN / 2.0);
        let whole = 2.0 * half >= span.1 - span.0;
        self.range = (!whole).then_some((at - half, at + half));
    }

    /// Does what keys ask for.
    pub(crate) fn take_command(&mut self, command: PanelCommand, session: &Session) {
        match command {
            PanelCommand::Pan([steps, _]) => {
                if let Some(span) = session.span() {
                    let (from, to) = self.visible_range(span, session.playback.time);
                    let moved = PAN_SHARE * f64::from(steps) * (to - from);
                    self.range = Some((from + moved, to + moved));
                }
            }
            PanelCommand::Zoom(factor) => self.scale_time(session, 1.0 / f64::from(factor)),
            PanelCommand::ShowAll => (self.range, self.measured_from) = (None, None),
        }
    }

    /// The time range that was chosen.
    #[cfg(test)]
    pub(crate) fn range(&self) -> Option<(f64, f64)> {
        self.range
    }

    /// The plots, for undo.
    pub(crate) fn plots(&self) -> &[PlotConfig] {
        &self.plots
    }

    /// Shows other plots.
    pub(crate) fn set_plots(&mut self, plots: Vec<PlotConfig>) {
        self.plots = plots;
    }

    /// Every plotted curve once, with its name.
    fn plotted<'a>(&'a self, session: &'a Session) -> Vec<(&'a str, Curve<'a>)> {
        let mut curves: Vec<(&str, Curve<'_>)> = Vec::new();
        for name in self.plots.iter().flat_map(|plot| &plot.curves) {
            if !curves.iter().any(|(known, _)| known == name)
                && let Some(curve) = session.curve(name)
            {
                curves.push((name, curve));
            }
        }
        curves
    }

    /// Height that lets all plots fit, if it is not too low.
    fn plot_height(&self, ui: &Ui) -> f32 {
        let rows = self.plots.len().max(1) as f32;
        (ui.available_height() / rows - HEADER_HEIGHT).max(PLOT_HEIGHT_MIN)
    }

    /// The visible time range, seconds.
    fn visible_range(&self, (start, end): (f64, f64), at: f64) -> (f64, f64) {
        if let Some(range) = self.range {
            return range;
        }
        if self.window_s <= 0.0 || end - start <= self.window_s {
            return (start, end.max(start + 0.1));
        }
        let from = (at - self.window_s / 2.0).clamp(start, end - self.window_s);
        (from, from + self.window_s)
    }
}

/// A plot's curves as they are drawn. A name of another version is left out.
fn plotted_curves<'a>(plot: &'a PlotConfig, session: &'a Session) -> Vec<PlottedCurve<'a>> {
    let curves = plot.colours().filter_map(|(name, colour)| {
        let quantity = PlottedQuantity::named(name);
        let others = session.other_runs().filter_map(|(run, series)| {
            quantity.map(|quantity| (run, Curve::Quantity(series, quantity)))
        });
        Some(PlottedCurve {
            name,
            unit: unit_of(name),
            colour,
            curve: session.curve(name)?,
            others: others.collect(),
        })
    });
    curves.collect()
}
