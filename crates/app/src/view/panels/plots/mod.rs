//! Plots panel: any quantities over time, against each other, as histogram, spectrum or numbers.

mod catalogue;
mod config;
mod drawing;
mod numbers;

use eframe::egui::{self, RichText, Ui};
use serde::{Deserialize, Serialize};

use self::catalogue::{CATALOGUE, PlottedQuantity};
use self::config::{PlotConfig, PlotKind};
use self::drawing::{PLOT_HEIGHT_MIN, PlotArea};
use self::numbers::short;
use crate::view::accessibility::AccessibleLabel;
use crate::view::palette;
use crate::view::session::Session;

/// Height of a plot's line of names and values, points.
const HEADER_HEIGHT: f32 = 26.0;
/// Names of the kinds, in menu order.
const KINDS: [(PlotKind, &str); 5] = [
    (PlotKind::Curve, "Over time"),
    (PlotKind::Against, "Second over first"),
    (PlotKind::Histogram, "Histogram"),
    (PlotKind::Spectrum, "Spectrum"),
    (PlotKind::Numbers, "Numbers"),
];

/// State of the panel.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct PlotsPanel {
    plots: Vec<PlotConfig>,
    /// Time range around the cursor, seconds; 0 shows the whole run.
    window_s: f64,
    /// Time range that was dragged or zoomed to; it holds until a double click.
    #[serde(skip)]
    range: Option<(f64, f64)>,
    /// Start of the measured time, seconds.
    #[serde(skip)]
    measured_from: Option<f64>,
    /// What is typed to find a quantity.
    #[serde(skip)]
    search: String,
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
            window_s: 0.0,
            range: None,
            measured_from: None,
            search: String::new(),
        }
    }
}

impl PlotsPanel {
    /// Draws the panel; a click seeks to its time.
    pub(crate) fn show(&mut self, ui: &mut Ui, session: &mut Session) {
        self.toolbar(ui, session);
        let Some(span) = session.span() else {
            ui.weak("No run yet.");
            return;
        };
        let mut area = PlotArea {
            range: self.visible_range(span, session.playback.time),
            span,
            height: self.plot_height(ui),
            measured_from: self.measured_from,
            request: None,
            hovered: None,
        };
        let mut changed = None;
        egui::ScrollArea::vertical()
            .auto_shrink(false)
            .show(ui, |ui| {
                for number in 0..self.plots.len() {
                    ui.push_id(number, |ui| {
                        if let Some(change) = self.header(ui, number, session, &area) {
                            changed = Some((number, change));
                        }
                        let plot = &self.plots[number];
                        area.draw(ui, plot, &plot.quantities(), session);
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
    }

    fn toolbar(&mut self, ui: &mut Ui, session: &Session) {
        ui.horizontal_wrapped(|ui| {
            ui.menu_button("Add plot", |ui| {
                if let Some(name) = search_quantity(ui, &mut self.search) {
                    self.plots.push(PlotConfig::of(&[name]));
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
                .on_hover_text("Copies the plotted quantities of the visible time")
                .clicked()
                && let Some(span) = session.span()
            {
                let range = self.visible_range(span, session.playback.time);
                ui.ctx().copy_text(self.csv(session, range));
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
                "Click seeks, drag pans, wheel zooms, double-click shows all, Shift-drag measures.\nA click on a name removes the curve; ... changes the plot.",
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
        let at = session.hovered_time.unwrap_or(session.playback.time);
        let sample = session.series.at(at);
        let mut change = None;
        ui.horizontal_wrapped(|ui| {
            for (quantity, colour) in plot.quantities() {
                let value = sample.map_or(f64::NAN, |sample| quantity.of(sample));
                let value = if value.is_finite() {
                    format!("{} {}", short(value), quantity.unit)
                } else {
                    "-".to_owned()
                };
                let text = RichText::new(format!("{} {value}", quantity.name)).color(colour);
                ui.menu_button(text.small(), |ui| {
                    if ui.button("Remove the curve").clicked() {
                        change = Some(Change::RemoveCurve(quantity.name));
                    }
                });
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
                if ui.button("Remove the plot").clicked() {
                    change = Some(Change::RemovePlot);
                }
                ui.separator();
                ui.label("Add a curve");
                if let Some(name) = search_quantity(ui, &mut self.search) {
                    change = Some(Change::AddCurve(name));
                }
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
            Change::AddCurve(name) if plot.curves.iter().any(|curve| curve == name) => {}
            Change::AddCurve(name) => plot.curves.push(name.to_owned()),
            Change::RemoveCurve(name) => {
                plot.curves.retain(|curve| curve != name);
                if plot.curves.is_empty() {
                    self.plots.remove(number);
                }
            }
            Change::RemovePlot => {
                self.plots.remove(number);
            }
        }
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

    /// The plotted quantities of a time range: a line a cycle.
    fn csv(&self, session: &Session, (from, to): (f64, f64)) -> String {
        let mut quantities: Vec<&PlottedQuantity> = Vec::new();
        for (quantity, _) in self.plots.iter().flat_map(PlotConfig::quantities) {
            if !quantities.contains(&quantity) {
                quantities.push(quantity);
            }
        }
        let names = quantities.iter().map(|quantity| {
            let unit = quantity.unit;
            format!(",{} ({unit})", quantity.name)
        });
        let mut text = format!("time (s){}\n", names.collect::<String>());
        for sample in session.series.between(from, to) {
            text += &format!("{:.6}", sample.time);
            for quantity in &quantities {
                let value = quantity.of(sample);
                // An empty field, as in the CSV files of other commands.
                text += &if value.is_finite() {
                    format!(",{value}")
                } else {
                    ",".to_owned()
                };
            }
            text.push('\n');
        }
        text
    }
}

/// A change of a plot.
enum Change {
    Kind(PlotKind),
    Logarithmic(bool),
    AddCurve(&'static str),
    RemoveCurve(&'static str),
    RemovePlot,
}

/// A field to type in, and the quantities whose name or unit contains it. Returns the chosen one.
fn search_quantity(ui: &mut Ui, search: &mut String) -> Option<&'static str> {
    let field = ui
        .add(egui::TextEdit::singleline(search).hint_text("quantity"))
        .with_accessible_label("name of a quantity");
    let words = search.to_lowercase();
    let found = CATALOGUE.iter().filter(|quantity| {
        let text = format!("{} {}", quantity.name, quantity.unit).to_lowercase();
        words.split_whitespace().all(|word| text.contains(word))
    });
    let entered = field.lost_focus() && ui.input(|input| input.key_pressed(egui::Key::Enter));
    let mut chosen = found
        .clone()
        .next()
        .filter(|_| entered)
        .map(|first| first.name);
    egui::ScrollArea::vertical()
        .max_height(240.0)
        .show(ui, |ui| {
            for quantity in found {
                let text = format!("{} ({})", quantity.name, quantity.unit);
                if ui.button(text).clicked() {
                    chosen = Some(quantity.name);
                }
            }
        });
    if chosen.is_some() {
        search.clear();
        ui.close();
    }
    chosen
}
