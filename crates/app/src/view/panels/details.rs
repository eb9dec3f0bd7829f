//! Details panel: numbers of the selected object, and their history.

use eframe::egui::{self, Sense, Shape, Stroke, Ui, Vec2};

use crate::view::accessibility::AccessibleLabel;
use crate::view::curves::{Curve, CurveState, unit_of};
use crate::view::palette;
use crate::view::session::Session;

/// Time that the history covers, seconds.
const HISTORY: f64 = 10.0;
/// Size of a history, points.
const SIZE: Vec2 = Vec2::new(140.0, 18.0);

/// Draws the panel.
pub(crate) fn show(ui: &mut Ui, session: &mut Session) {
    let (Some(selection), Some(now)) = (session.selection, &session.shown) else {
        ui.weak(
            "Click a robot, the ball, a line point or a hypothesis on the field or in the image.",
        );
        return;
    };
    let cycle = now.cycle.clone();
    let fields = selection.fields(&cycle);
    for (_, path) in &fields {
        session.curves.request(path);
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
    let at = cycle.stamp.seconds();
    egui::ScrollArea::vertical()
        .auto_shrink(false)
        .show(ui, |ui| {
            egui::Grid::new("details").striped(true).show(ui, |ui| {
                for (name, path) in &fields {
                    ui.label(*name);
                    let curve = session.curve(path);
                    let value = curve.map_or(f64::NAN, |curve| value_of_cycle(curve, at));
                    let text = curve.and_then(|curve| curve.text(value));
                    match (text, session.curves.state(path)) {
                        (Some(text), _) => ui.monospace(text),
                        (None, CurveState::Failed(reason)) => {
                            ui.colored_label(palette::VERMILION, reason)
                        }
                        (None, CurveState::Reading) if value.is_nan() => ui.spinner(),
                        _ if value.is_nan() => ui.monospace("-"),
                        _ => ui.monospace(format!("{value:.4} {}", unit_of(path))),
                    };
                    if let Some(curve) = curve {
                        draw_history(ui, curve, at);
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
        });
}

/// Value of a field in the cycle of a stamp, seconds; NaN if the field has not been read so far.
fn value_of_cycle(curve: Curve<'_>, stamp: f64) -> f64 {
    // The time of a message is the stamp, rounded to a float.
    let value = curve.at(stamp + 1e-6);
    if curve.count_until(stamp - 0.5) == curve.len() {
        f64::NAN
    } else {
        value
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
