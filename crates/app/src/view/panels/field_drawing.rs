//! Draws a field from above: markings, goals, robots, covariances, velocities and trails.

use std::f32::consts::TAU;

use eframe::egui::{Align2, Color32, FontId, Pos2, Rect, Stroke, Vec2};
use localize::field::{Field, GoalColour, Marking};
use localize::frames::FieldFrame;
use localize::{At, Pose};
use nalgebra::{Matrix2, Matrix3, SymmetricEigen};

use crate::view::layer_worker::{HEATMAP_MAX_DISTANCE, apply_colormap};
use crate::view::palette;
use crate::view::panzoom::ScreenTransform;
use crate::view::pen::Pen;

/// Segments of a full circle.
const ARC_STEPS: f32 = 72.0;
/// Segments of an ellipse.
const ELLIPSE_STEPS: usize = 48;
/// Radius of the 95 % region of a bivariate normal distribution, standard deviations.
const SIGMAS_95_2D: f32 = 2.448;
/// Floor shown around the carpet, metres: room for the goals.
const RIM: f32 = 0.8;
/// Place of a text beside a thing, points.
pub(super) const LABEL_OFFSET: Vec2 = Vec2::new(8.0, -8.0);
/// Radius of a robot, metres.
pub(crate) const ROBOT_RADIUS: f32 = 0.25;
/// Radius of a ball, metres.
pub(crate) const BALL_RADIUS: f32 = 0.11;

/// Transform between field and screen; the field's x axis points right, its y axis up.
#[derive(Clone, Copy)]
pub(crate) struct FieldTransform {
    pub(crate) transform: ScreenTransform,
    half_extent: Vec2,
}

/// Half of the drawn extent of a field, metres.
pub(crate) fn view_half_extent(field: &Field) -> Vec2 {
    let (x, y) = field.carpet_half_extent();
    Vec2::new(x + RIM, y + RIM)
}

impl FieldTransform {
    /// `transform` places a picture of size `2 half`, in metres.
    pub(crate) fn new(transform: ScreenTransform, half: Vec2) -> Self {
        FieldTransform {
            transform,
            half_extent: half,
        }
    }

    /// Screen position of a field point.
    pub(crate) fn to_screen(self, at: At<FieldFrame>) -> Pos2 {
        self.transform
            .to_screen(at.x + self.half_extent.x, self.half_extent.y - at.y)
    }

    /// Field point at a screen position.
    pub(crate) fn to_field(self, at: Pos2) -> At<FieldFrame> {
        let place = self.transform.to_picture(at);
        At::new(place.x - self.half_extent.x, self.half_extent.y - place.y)
    }

    /// Screen points per metre.
    pub(crate) fn scale(&self) -> f32 {
        self.transform.scale
    }
}

/// Segments of the markings' centre lines; arcs become chords, spots become crosses.
pub(crate) fn marking_segments(field: &Field) -> Vec<[At<FieldFrame>; 2]> {
    let mut segments = Vec::new();
    for marking in &field.markings {
        match *marking {
            Marking::Line { from, to } => segments.push([from, to]),
            Marking::Arc {
                centre,
                radius,
                start,
                sweep,
            } => {
                let points = arc(centre, radius, start, sweep);
                segments.extend(points.windows(2).map(|pair| [pair[0], pair[1]]));
            }
            Marking::Spot { centre, radius } => {
                let arm = |x: f32, y: f32| At::new(centre.x + x * radius, centre.y + y * radius);
                segments.push([arm(-1.0, 0.0), arm(1.0, 0.0)]);
                segments.push([arm(0.0, -1.0), arm(0.0, 1.0)]);
            }
        }
    }
    segments
}

fn arc(centre: At<FieldFrame>, radius: f32, start: f32, sweep: f32) -> Vec<At<FieldFrame>> {
    let steps = (ARC_STEPS * sweep / TAU).ceil().max(1.0) as usize;
    (0..=steps)
        .map(|step| {
            let angle = start + sweep * step as f32 / steps as f32;
            At::new(
                centre.x + radius * angle.cos(),
                centre.y + radius * angle.sin(),
            )
        })
        .collect()
}

/// Screen area of the carpet.
pub(crate) fn carpet_rect(screen: &FieldTransform, field: &Field) -> Rect {
    let (half_x, half_y) = field.carpet_half_extent();
    let [from, to] =
        [At::new(-half_x, half_y), At::new(half_x, -half_y)].map(|at| screen.to_screen(at));
    Rect::from_two_pos(from, to)
}

/// Draws carpet, markings and goals. Pass false for `with_carpet` if a background layer is already drawn.
pub(crate) fn draw_field(pen: &Pen, screen: &FieldTransform, field: &Field, with_carpet: bool) {
    if with_carpet {
        pen.rect(carpet_rect(screen, field), palette::CARPET);
    }
    let width = (field.config.line_width * screen.scale()).max(1.0);
    let stroke = Stroke::new(width, palette::LINE);
    for marking in &field.markings {
        match *marking {
            Marking::Line { from, to } => {
                pen.segment([screen.to_screen(from), screen.to_screen(to)], stroke);
            }
            Marking::Arc {
                centre,
                radius,
                start,
                sweep,
            } => {
                let points = arc(centre, radius, start, sweep);
                pen.line(points.into_iter().map(|at| screen.to_screen(at)), stroke);
            }
            Marking::Spot { centre, radius } => {
                let radius = (radius * screen.scale()).max(1.0);
                pen.disc(screen.to_screen(centre), radius, palette::LINE);
            }
        }
    }
    let goal = &field.config.goal;
    let sides = [1.0, -1.0].into_iter().filter(|_| field.has_goals());
    for (side, colour) in sides.zip(goal.colours) {
        let colour = match colour {
            GoalColour::White => Color32::WHITE,
            GoalColour::Blue => palette::BLUE,
            GoalColour::Yellow => palette::YELLOW,
        };
        let (front, half) = (side * field.config.length / 2.0, goal.width / 2.0);
        let back = front + side * goal.depth;
        let corners = [(front, half), (back, half), (back, -half), (front, -half)];
        let points = corners.map(|(x, y)| screen.to_screen(At::new(x, y)));
        let width = (goal.post * screen.scale()).max(2.0);
        pen.line(points, Stroke::new(width, colour));
    }
}

/// Draws a robot as a circle with a line along its heading.
pub(crate) fn draw_robot(
    pen: &Pen,
    screen: &FieldTransform,
    pose: Pose,
    colour: Color32,
    width: f32,
) {
    let stroke = Stroke::new(width, colour);
    let radius = (ROBOT_RADIUS * screen.scale()).max(5.0);
    let middle = screen.to_screen(pose.origin());
    pen.circle(middle, radius, stroke);
    let nose = Vec2::angled(-pose.theta) * radius * 1.7;
    pen.segment([middle, middle + nose], stroke);
}

/// Draws the 95 % ellipse of the position, and two rays at ± 2.448 σ of the heading (98.6 %).
pub(crate) fn draw_covariance(
    pen: &Pen,
    screen: &FieldTransform,
    pose: Pose,
    covariance: &Matrix3<f32>,
    colour: Color32,
) {
    let plane = Matrix2::new(
        covariance[(0, 0)],
        covariance[(0, 1)],
        covariance[(1, 0)],
        covariance[(1, 1)],
    );
    if !plane.iter().all(|value| value.is_finite()) {
        return;
    }
    let eigen = SymmetricEigen::new(plane);
    let axis = |number: usize| {
        let length = SIGMAS_95_2D * eigen.eigenvalues[number].max(0.0).sqrt();
        eigen.eigenvectors.column(number) * length
    };
    let (first, second) = (axis(0), axis(1));
    let points: Vec<Pos2> = (0..ELLIPSE_STEPS)
        .map(|step| {
            let (sin, cos) = (TAU * step as f32 / ELLIPSE_STEPS as f32).sin_cos();
            let off = first * cos + second * sin;
            screen.to_screen(At::new(pose.x + off[0], pose.y + off[1]))
        })
        .collect();
    pen.ring(&points, Stroke::new(1.5, colour));
    let spread = SIGMAS_95_2D * covariance[(2, 2)].max(0.0).sqrt();
    let middle = screen.to_screen(pose.origin());
    for sign in [-1.0, 1.0] {
        let ray = Vec2::angled(-(pose.theta + sign * spread.min(TAU / 2.0)));
        let end = middle + ray * (1.0 * screen.scale()).max(20.0);
        pen.segment([middle, end], Stroke::new(1.0, colour.gamma_multiply(0.6)));
    }
}

/// Draws a velocity as an arrow; its length is the distance of one second.
pub(crate) fn draw_velocity(
    pen: &Pen,
    screen: &FieldTransform,
    at: At<FieldFrame>,
    [vx, vy]: [f32; 2],
    colour: Color32,
) {
    if vx.hypot(vy) > 0.1 {
        let along = Vec2::new(vx, -vy) * screen.scale();
        pen.arrow(screen.to_screen(at), along, Stroke::new(1.5, colour));
    }
}

/// Draws a trail of poses; a jump of more than 1 m starts a new line.
pub(crate) fn draw_trail(
    pen: &Pen,
    screen: &FieldTransform,
    places: impl Iterator<Item = [f32; 3]>,
    stroke: Stroke,
) {
    let mut points: Vec<Pos2> = Vec::new();
    let mut last: Option<[f32; 3]> = None;
    for place in places {
        let is_known = place[0].is_finite();
        let jumps = last.is_some_and(|last| (last[0] - place[0]).hypot(last[1] - place[1]) > 1.0);
        if !is_known || jumps {
            pen.line(std::mem::take(&mut points), stroke);
        }
        if is_known {
            points.push(screen.to_screen(At::new(place[0], place[1])));
        }
        last = is_known.then_some(place);
    }
    pen.line(points, stroke);
}

/// Draws a text next to a position.
pub(crate) fn draw_text(pen: &Pen, at: Pos2, text: &str, colour: Color32) {
    pen.text(
        at + LABEL_OFFSET,
        Align2::LEFT_BOTTOM,
        text,
        FontId::proportional(12.0),
        colour,
    );
}

/// The colours of distance field and error landscape with their distances, in the lower right corner.
pub(super) fn draw_distance_scale(pen: &Pen, area: Rect) {
    const SIZE: Vec2 = Vec2::new(160.0, 10.0);
    const STEPS: u8 = 40;
    let bar = Rect::from_min_size(area.right_bottom() - SIZE - Vec2::new(16.0, 8.0), SIZE);
    for step in 0..STEPS {
        let [from, to] = [step, step + 1].map(|at| f32::from(at) / f32::from(STEPS));
        let part = Rect::from_x_y_ranges(
            bar.left() + from * SIZE.x..=bar.left() + to * SIZE.x,
            bar.y_range(),
        );
        pen.rect(part, apply_colormap(from));
    }
    let far = format!("{HEATMAP_MAX_DISTANCE} m");
    for (place, anchor, text) in [
        (bar.left_top(), Align2::LEFT_BOTTOM, "0"),
        (bar.center_top(), Align2::CENTER_BOTTOM, "distance"),
        (bar.right_top(), Align2::RIGHT_BOTTOM, &*far),
    ] {
        pen.text(
            place,
            anchor,
            text,
            FontId::proportional(11.0),
            Color32::WHITE,
        );
    }
}
