//! Details panel: numbers of the selected object, and their history.

use eframe::egui::{self, Sense, Shape, Stroke, Ui, Vec2};
use pipeline::Cycle;
use pipeline::log::columns::FieldValue;

use crate::view::accessibility::AccessibleLabel;
use crate::view::curves::{Curve, CycleValues, unit_of};
use crate::view::palette;
use crate::view::session::Session;

/// Time that the history covers, seconds.
const HISTORY: f64 = 10.0;
/// Size of a history, points.
const SIZE: Vec2 = Vec2::new(140.0, 18.0);

/// State of the panel.
#[derive(Default)]
pub(crate) struct DetailsPanel {
    values: CycleValues,
}

impl DetailsPanel {
    /// Draws the panel.
    pub(crate) fn show(&mut self, ui: &mut Ui, session: &mut Session) {
        let (Some(selection), Some(now)) = (session.selection, &session.shown) else {
            ui.weak(
                "Click a robot, the ball, a line point or a hypothesis on the field or in the image.",
            );
            return;
        };
        let cycle = now.cycle.clone();
        let fields = selection.fields(&cycle);
        let paths: Vec<String> = fields.iter().map(|(_, path)| path.clone()).collect();
        for path in &paths {
            session.curves.request(path);
        }
        if let Err(error) = self.values.update(&cycle, &paths) {
            ui.colored_label(palette::VERMILION, format!("{error:#}"));
        }
        ui.horizontal_wrapped(|ui| {
            ui.strong(selection.title());
            match session.selected_place() {
                Some(at) => ui.label(format!("{:.2}, {:.2} m on the field", at.x, at.y)),
                None => ui.weak("not in this cycle"),
            };
            if ui.small_button("Unselect").clicked() {
                session.selection = None;
            }
        });
        egui::ScrollArea::vertical()
            .auto_shrink(false)
            .show(ui, |ui| self.table(ui, session, &cycle, &fields));
    }

    fn table(
        &self,
        ui: &mut Ui,
        session: &mut Session,
        cycle: &Cycle,
        fields: &[(&'static str, String)],
    ) {
        egui::Grid::new("details").striped(true).show(ui, |ui| {
            for (name, path) in fields {
                ui.label(*name);
                match self.values.get(path) {
                    FieldValue::Text(text) => ui.monospace(text),
                    FieldValue::Number(value) => {
                        ui.monospace(format!("{value:.4} {}", unit_of(path)))
                    }
                    FieldValue::Absent => ui.monospace("-"),
                };
                match session.curve(path) {
                    Some(curve) => draw_history(ui, curve, cycle.stamp.seconds()),
                    None => drop(ui.weak("no history")),
                }
                let button = ui.small_button("Plot").on_hover_text(path);
                if button
                    .with_accessible_label(&format!("plot {name}"))
                    .clicked()
                {
                    session.plot_request.push(path.clone());
                }
                ui.end_row();
            }
        });
    }
}

/// Draws the last seconds of a curve.
fn draw_history(ui: &mut Ui, curve: Curve<'_>, at: f64) {
    let (response, painter) = ui.allocate_painter(SIZE, Sense::hover());
    let area = response.rect.shrink(2.0);
    let points: Vec<[f64; 2]> = curve.finite(at - HISTORY, at).collect();
    let values = points.iter().map(|point| point[1]);
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
        (low.min(value), high.max(value))
    });
    if points.len() < 2 {
        return;
    }
    let span = (high - low).max(1e-9);
    let place = |[time, value]: &[f64; 2]| {
        let right = ((time - at + HISTORY) / HISTORY) as f32;
        let up = ((value - low) / span) as f32;
        area.left_bottom() + Vec2::new(right * area.width(), -up * area.height())
    };
    let line: Vec<_> = points.iter().map(place).collect();
    painter.add(Shape::line(line, Stroke::new(1.2, palette::ORANGE)));
    response.on_hover_text(format!("{low:.4} to {high:.4} in {HISTORY} s"));
}
