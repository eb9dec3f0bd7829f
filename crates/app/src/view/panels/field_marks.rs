//! Marks over the field: the selection, a hovered moment, other runs, the scale and the legend.

use eframe::egui::{Align2, Color32, FontId, Pos2, Rect, RichText, Stroke, Ui, Vec2};
use localize::Pose;
use pipeline::Cycle;

use super::field_drawing::{self as drawing, FieldTransform};
use crate::view::palette;
use crate::view::pen::Pen;
use crate::view::time_series::TimeSeries;

/// Lengths that the scale may have, metres.
const SCALE_LENGTHS: [f32; 7] = [0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0];
/// Least length of the scale on the screen, points.
const SCALE_POINTS_MIN: f32 = 50.0;

/// Rings the selected object.
pub(super) fn draw_selection(pen: &Pen, at: Pos2) {
    pen.circle(at, 13.0, Stroke::new(3.5, Color32::BLACK));
    pen.circle(at, 13.0, Stroke::new(1.8, Color32::WHITE));
}

/// Draws the pose at the time under the pointer of another panel.
pub(super) fn draw_hovered_moment(
    pen: &Pen,
    screen: &FieldTransform,
    series: &TimeSeries,
    time: f64,
) {
    let Some([x, y, theta]) = series.at(time).map(|sample| sample.pose) else {
        return;
    };
    if x.is_finite() {
        let pose = Pose::new(x, y, theta);
        drawing::draw_robot(pen, screen, pose, palette::YELLOW, 1.2);
    }
}

/// Draws pose and ball of another run.
pub(super) fn draw_other_run(pen: &Pen, screen: &FieldTransform, cycle: &Cycle, colour: Color32) {
    let Some(other) = cycle.estimate.pose else {
        return;
    };
    drawing::draw_robot(pen, screen, other, colour, 2.0);
    if let Some(ball) = cycle.detections.as_ref().and_then(|d| d.ball.as_ref()) {
        let radius = (drawing::BALL_RADIUS * screen.scale()).max(3.0);
        pen.circle(screen.to_screen(other * ball.at), radius, (1.5, colour));
    }
}

/// Draws the axes of the field frame and a bar of a round length, in the lower left corner.
pub(super) fn draw_scale(pen: &Pen, screen: &FieldTransform, area: Rect) {
    let length = SCALE_LENGTHS
        .into_iter()
        .find(|length| length * screen.scale() >= SCALE_POINTS_MIN)
        .unwrap_or(SCALE_LENGTHS[SCALE_LENGTHS.len() - 1]);
    let stroke = Stroke::new(1.5, Color32::WHITE);
    let origin = area.left_bottom() + Vec2::new(14.0, -14.0);
    let font = FontId::proportional(11.0);
    let right = Vec2::new(length * screen.scale(), 0.0);
    pen.arrow(origin, right, stroke);
    pen.arrow(origin, Vec2::new(0.0, -34.0), stroke);
    pen.text(
        origin + right + Vec2::new(5.0, 0.0),
        Align2::LEFT_CENTER,
        format!("x  {length} m"),
        font.clone(),
        Color32::WHITE,
    );
    pen.text(
        origin + Vec2::new(5.0, -34.0),
        Align2::LEFT_CENTER,
        "y",
        font,
        Color32::WHITE,
    );
}

/// Lists what the marks of the field mean.
pub(super) fn show_legend(ui: &mut Ui) {
    for (colour, text) in [
        (
            palette::ESTIMATE,
            "estimate with its 95 % ellipse, its trail and velocity",
        ),
        (palette::TRUTH, "truth and its trail"),
        (
            palette::PURPLE,
            "hypotheses with probability; recomputed run; robots as seen (discs)",
        ),
        (palette::LINE_POINT, "line points at the estimated pose"),
        (
            palette::BALL,
            "ball: as seen (disc), as it is (rim), of the team (large ring)",
        ),
        (palette::GREY, "robots as they are (rims)"),
        (palette::GREEN, "team-mates with the age of their message"),
        (
            palette::YELLOW,
            "particles; the pose at the time under the pointer",
        ),
    ] {
        ui.label(RichText::new(text).color(colour));
    }
}
