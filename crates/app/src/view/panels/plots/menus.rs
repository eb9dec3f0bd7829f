//! The menus of a plot: what the user changes.

use eframe::egui::{self, Color32, RichText, Ui};

use super::config::{PlotConfig, PlotKind};
use super::numbers::short;
use crate::view::accessibility::AccessibleLabel;
use crate::view::curves::{CurveState, unit_of};
use crate::view::session::Session;

/// A change of a plot.
pub(super) enum Change {
    Kind(PlotKind),
    Logarithmic(bool),
    AddCurve(String),
    RemoveCurve(String),
    AddThreshold(f64),
    RemoveThreshold(f64),
    RemovePlot,
}

/// A curve's name and value, which opens its menu.
pub(super) fn curve_menu(
    ui: &mut Ui,
    session: &Session,
    name: &str,
    colour: Color32,
) -> Option<Change> {
    let at = session.hovered_time.unwrap_or(session.playback.time);
    let curve = session.curve(name);
    let value = curve.map_or(f64::NAN, |curve| curve.at(at));
    let text = curve.and_then(|curve| curve.text(value).map(str::to_owned));
    let value = text.unwrap_or_else(|| match (value.is_finite(), unit_of(name)) {
        (true, unit) => format!("{} {unit}", short(value)).trim_end().to_owned(),
        (false, _) => "-".to_owned(),
    });
    let state = session.curves.state(name);
    let shown = match &state {
        CurveState::Failed(reason) => format!("{name}: {reason}"),
        _ => format!("{name} {value}"),
    };
    let shown = RichText::new(shown).color(colour).small();
    let mut change = None;
    ui.menu_button(shown, |ui| {
        if ui.button("Remove the curve").clicked() {
            change = Some(Change::RemoveCurve(name.to_owned()));
        }
        if ui.button("Copy the value").clicked() {
            ui.ctx().copy_text(value);
        }
        if ui.button("Copy the name").clicked() {
            ui.ctx().copy_text(name.to_owned());
        }
    });
    if state == CurveState::Reading {
        ui.spinner();
    }
    change
}

/// Adds and removes thresholds.
pub(super) fn threshold_menu(ui: &mut Ui, plot: &PlotConfig, value: &mut f64) -> Option<Change> {
    let mut change = None;
    ui.add(egui::DragValue::new(value).speed(0.1))
        .with_accessible_label("value of the threshold");
    if ui.button("Add").clicked() {
        change = Some(Change::AddThreshold(*value));
    }
    for threshold in &plot.thresholds {
        if ui.button(format!("Remove {}", short(*threshold))).clicked() {
            change = Some(Change::RemoveThreshold(*threshold));
        }
    }
    change
}
