//! Which marks lie over the camera's image? Points, objects and projected lines, as shapes that stay sharp when enlarged.

use std::f32::consts::TAU;

use eframe::egui::{Align2, Color32, FontId, Painter, Pos2, Shape, Stroke, Ui, Vec2};
use localize::At;
use localize::frame::RobotFrame;
use vision::config::ImageRect;
use vision::goals::GoalKind;
use vision::line_points::RejectionReason;
use vision::robots::Marker;

use super::camera::Shows;
use crate::view::ink;
use crate::view::layers::{BIRD_REACH, BIRD_SIDE};
use crate::view::panzoom::Placed;
use crate::view::stage::Stage;
use pipeline::cycle::Cycle;

/// Rings of the ground grid, metres.
const RINGS: [f32; 7] = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0];
/// Steps around a ring, and rays.
const RING_STEPS: usize = 96;
const RAYS: usize = 12;

/// What drawing needs.
pub(crate) struct Drawing<'a> {
    pub(crate) painter: &'a Painter,
    pub(crate) placed: Placed,
    pub(crate) stage: &'a Stage,
    pub(crate) cycle: &'a Cycle,
    pub(crate) shows: &'a Shows,
    /// The virtual sensors' windows with their names.
    pub(crate) windows: &'a [(&'static str, ImageRect)],
}

impl Drawing<'_> {
    /// The middle of a pixel on the screen.
    fn pixel(&self, [u, v]: [f32; 2]) -> Pos2 {
        self.placed.to_screen(u + 0.5, v + 0.5)
    }

    /// A ground point on the screen, in the camera's image.
    fn ground(&self, at: At<RobotFrame>) -> Option<Pos2> {
        let eye = self.stage.eye.as_ref()?;
        let pixel = eye.pixel(at, self.cycle.estimate.tilt)?;
        Some(self.pixel(pixel))
    }

    fn cross(&self, at: Pos2, arm: f32, colour: Color32) {
        let stroke = Stroke::new(1.6, colour);
        let (right, down) = (Vec2::new(arm, 0.0), Vec2::new(0.0, arm));
        self.painter.line_segment([at - right, at + right], stroke);
        self.painter.line_segment([at - down, at + down], stroke);
    }

    fn saltire(&self, at: Pos2, arm: f32, colour: Color32) {
        let stroke = Stroke::new(1.2, colour);
        for way in [Vec2::new(arm, arm), Vec2::new(arm, -arm)] {
            self.painter.line_segment([at - way, at + way], stroke);
        }
    }

    fn label(&self, at: Pos2, text: String, colour: Color32) {
        let font = FontId::proportional(12.0);
        let place = at + Vec2::new(0.0, -10.0);
        let galley = self.painter.layout_no_wrap(text, font, colour);
        let rect = Align2::CENTER_BOTTOM.anchor_size(place, galley.size());
        self.painter
            .rect_filled(rect.expand(1.0), 2.0, Color32::from_black_alpha(150));
        self.painter.galley(rect.min, galley, colour);
    }
}

/// Everything over the camera's own image.
pub(crate) fn draw(drawing: &Drawing<'_>) {
    let shows = drawing.shows;
    if shows.grid {
        grid(drawing);
    }
    if shows.lines
        && let Some(pose) = drawing.cycle.estimate.pose
    {
        let stroke = Stroke::new(1.4, ink::PROJECTED);
        for [from, to] in drawing.stage.projected(pose, drawing.cycle.estimate.tilt) {
            let ends = [drawing.pixel(from), drawing.pixel(to)];
            drawing.painter.line_segment(ends, stroke);
        }
    }
    if shows.windows {
        windows(drawing);
    }
    let Some(seen) = &drawing.cycle.detections else {
        if shows.points {
            // Line points of another vision have no pixel of their own.
            for point in &drawing.cycle.line_points {
                if let Some(at) = drawing.ground(point.at) {
                    drawing.cross(at, 3.0, ink::LINE_POINT);
                }
            }
        }
        return;
    };
    if shows.carpet_end {
        carpet_end(drawing, &seen.carpet_end);
    }
    if shows.refused {
        for refused in &seen.rejected_candidates {
            let (colour, _) = ink::refusal(refused.reason);
            drawing.saltire(drawing.pixel(refused.position_px), 2.5, colour);
        }
    }
    if shows.points {
        for point in &seen.line_points {
            drawing.cross(drawing.pixel(point.position_px), 3.0, ink::LINE_POINT);
        }
    }
    objects(drawing);
}

fn objects(drawing: &Drawing<'_>) {
    let (shows, painter) = (drawing.shows, drawing.painter);
    let Some(seen) = &drawing.cycle.detections else {
        return;
    };
    if let (true, Some(ball)) = (shows.ball, &seen.ball) {
        let at = drawing.pixel(ball.position_px);
        painter.circle_stroke(at, 9.0, (2.5, ink::BALL));
        let air = if ball.on_ground { "" } else { ", in the air" };
        let text = format!("ball {:.1} m{air}", ball.at.distance());
        drawing.label(at, text, ink::BALL);
    }
    if shows.robots {
        for robot in &seen.robots {
            let at = drawing.pixel(robot.position_px);
            let half = Vec2::splat(7.0);
            let square = eframe::egui::Rect::from_min_max(at - half, at + half);
            painter.rect_stroke(
                square,
                1.0,
                (2.0, ink::ROBOT),
                eframe::egui::StrokeKind::Middle,
            );
            let team = match robot.marker {
                Some(Marker::Cyan) => " cyan",
                Some(Marker::Magenta) => " magenta",
                None => "",
            };
            let text = format!("robot{team} {:.1} m", robot.at.distance());
            drawing.label(at, text, ink::ROBOT);
        }
    }
    if shows.goals {
        for goal in &seen.goals {
            let at = drawing.pixel(goal.position_px);
            drawing.cross(at, 8.0, ink::GOAL);
            let kind = match goal.kind {
                GoalKind::Blue => "blue goal",
                GoalKind::Yellow => "yellow goal",
                GoalKind::Post => "post",
            };
            drawing.label(at, kind.to_owned(), ink::GOAL);
        }
    }
}

/// Everything over the floor from above: the same marks where the map puts them.
pub(crate) fn draw_bird(drawing: &Drawing<'_>) {
    let per_metre = BIRD_SIDE as f32 / (2.0 * BIRD_REACH);
    let place = |at: At<RobotFrame>| {
        drawing.placed.to_screen(
            (BIRD_REACH - at.y) * per_metre,
            (BIRD_REACH - at.x) * per_metre,
        )
    };
    let shows = drawing.shows;
    let scale = per_metre * drawing.placed.scale;
    if shows.grid {
        for ring in RINGS {
            let stroke = Stroke::new(1.0, ink::PROJECTED.gamma_multiply(0.6));
            drawing
                .painter
                .circle_stroke(place(At::new(0.0, 0.0)), ring * scale, stroke);
        }
    }
    if let (true, Some(pose)) = (shows.lines, drawing.cycle.estimate.pose) {
        let robot_from_field = pose.inverse();
        let stroke = Stroke::new(1.4, ink::PROJECTED);
        for [from, to] in super::field_marks::outline(&drawing.stage.field) {
            let ends = [from, to].map(|at| place(robot_from_field * at));
            drawing.painter.line_segment(ends, stroke);
        }
    }
    if shows.points {
        for point in &drawing.cycle.line_points {
            drawing.cross(place(point.at), 3.0, ink::LINE_POINT);
        }
    }
    let Some(seen) = &drawing.cycle.detections else {
        return;
    };
    if let (true, Some(ball)) = (shows.ball, &seen.ball) {
        drawing
            .painter
            .circle_stroke(place(ball.at), 0.11 * scale, (2.0, ink::BALL));
    }
    if shows.robots {
        for robot in &seen.robots {
            drawing
                .painter
                .circle_stroke(place(robot.at), 0.25 * scale, (2.0, ink::ROBOT));
        }
    }
}

/// The virtual sensors' windows; those that say yes are drawn thick.
fn windows(drawing: &Drawing<'_>) {
    let readings = drawing
        .cycle
        .detections
        .as_ref()
        .map(|seen| &seen.virtual_sensors);
    let mut bumpers = readings
        .map(|found| found.bumpers.iter())
        .into_iter()
        .flatten();
    for (name, window) in drawing.windows {
        let says = match *name {
            "bumper" => bumpers.next().is_some_and(|bumper| bumper.hit),
            "kick" => readings.is_some_and(|found| found.kick),
            "ball" => readings.is_some_and(|found| found.ball_px.is_some()),
            "lens" => readings.is_some_and(|found| found.lens_centred == Some(true)),
            _ => readings.is_some_and(|found| {
                let inside = |goal: Option<[f32; 2]>| goal.is_some_and(|at| window.contains(at));
                inside(found.blue_goal_px) || inside(found.yellow_goal_px)
            }),
        };
        let (left, top) = (window.left_px, window.top_px);
        let corners = [
            [left, top],
            [left + window.width_px, top + window.height_px],
        ];
        let [from, to] = corners.map(|[u, v]| drawing.placed.to_screen(u, v));
        let rect = eframe::egui::Rect::from_two_pos(from, to);
        let (width, colour) = if says {
            (3.0, ink::YELLOW)
        } else {
            (1.2, ink::SKY)
        };
        let kind = eframe::egui::StrokeKind::Middle;
        drawing
            .painter
            .rect_stroke(rect, 0.0, (width, colour), kind);
        drawing.painter.text(
            rect.left_top(),
            Align2::LEFT_BOTTOM,
            *name,
            FontId::proportional(11.0),
            colour,
        );
    }
}

fn grid(drawing: &Drawing<'_>) {
    let stroke = Stroke::new(1.0, ink::PROJECTED.gamma_multiply(0.6));
    let join = |points: &mut dyn Iterator<Item = At<RobotFrame>>| {
        let mut last = None;
        for at in points {
            let here = drawing.ground(at);
            if let (Some(from), Some(to)) = (last, here) {
                drawing.painter.add(Shape::line_segment([from, to], stroke));
            }
            last = here;
        }
    };
    let polar = |range: f32, angle: f32| At::new(range * angle.cos(), range * angle.sin());
    for ring in RINGS {
        let angle = |step: usize| TAU * step as f32 / RING_STEPS as f32;
        join(&mut (0..=RING_STEPS).map(|step| polar(ring, angle(step))));
        if let Some(at) = drawing.ground(polar(ring, 0.0)) {
            drawing.label(at, format!("{ring:.0} m"), ink::PROJECTED);
        }
    }
    for ray in 0..RAYS {
        let angle = TAU * ray as f32 / RAYS as f32;
        join(&mut (1..=20).map(|step| polar(0.4 * step as f32, angle)));
    }
}

fn carpet_end(drawing: &Drawing<'_>, ends: &[f32]) {
    let Some(eye) = &drawing.stage.eye else {
        return;
    };
    let [cu, cv] = eye.camera.centre_px;
    for (ray, &end) in ends.iter().enumerate() {
        let angle = TAU * ray as f32 / ends.len() as f32;
        // Outward from the axis, first pixel that shows ground beyond the end.
        let (cos, sin) = (angle.cos(), angle.sin());
        let rim = eye
            .camera
            .outer_radius_px
            .unwrap_or(eye.map.width_px as f32 / 2.0);
        let found = (0..rim as usize).find_map(|step| {
            let at = [cu + step as f32 * cos, cv - step as f32 * sin];
            let inside = at[0] >= 0.0 && at[1] >= 0.0;
            let ground = inside.then(|| eye.map.at(at[0] as usize, at[1] as usize))??;
            (ground.distance() >= end).then_some(at)
        });
        if let Some(at) = found {
            drawing
                .painter
                .circle_filled(drawing.pixel(at), 1.8, ink::ORANGE);
        }
    }
}

/// What the signs mean.
pub(crate) fn key(ui: &mut Ui) {
    let row = |ui: &mut Ui, sign: &str, colour: Color32, text: &str| {
        ui.horizontal(|ui| {
            ui.colored_label(colour, sign);
            ui.label(text);
        });
    };
    row(ui, "+", ink::LINE_POINT, "line point");
    for reason in [
        RejectionReason::NoAdjacentCarpet,
        RejectionReason::TooNarrow,
        RejectionReason::TooWide,
        RejectionReason::TooFaint,
        RejectionReason::NotWhite,
        RejectionReason::BeyondCarpet,
    ] {
        let (colour, text) = ink::refusal(reason);
        row(ui, "x", colour, &format!("refused: {text}"));
    }
    row(ui, "-", ink::PROJECTED, "field lines at the estimated pose");
    ui.separator();
    for (class, name) in vision::colours::CLASS_NAMES.iter().enumerate() {
        row(
            ui,
            "■",
            ink::class(vision::colours::ColourClass(class as u8)),
            name,
        );
    }
}
