//! Which marks lie over the camera's image? Points, objects and projected lines, as shapes that stay sharp when enlarged.

use std::f32::consts::TAU;

use eframe::egui::{Align2, Color32, FontId, Painter, Pos2, Shape, Stroke, Ui, Vec2};
use localize::At;
use localize::frames::RobotFrame;
use localize::world::TeamColour;
use vision::config::ImageRect;
use vision::lines::detection::RejectionReason;
use vision::objects::goals::GoalKind;

use super::camera::CameraLayers;
use crate::view::layer_worker::{BIRDS_EYE_HALF_EXTENT, BIRDS_EYE_SIDE_PX};
use crate::view::palette;
use crate::view::panzoom::ScreenTransform;
use crate::view::static_scene::StaticScene;
use pipeline::Cycle;

/// Rings of the ground grid, metres.
const RINGS: [f32; 7] = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0];
/// Steps around a ring, and rays.
const RING_STEPS: usize = 96;
const RAYS: usize = 12;

/// What drawing needs.
pub(crate) struct CameraCanvas<'a> {
    pub(crate) painter: &'a Painter,
    pub(crate) transform: ScreenTransform,
    pub(crate) scene: &'a StaticScene,
    pub(crate) cycle: &'a Cycle,
    pub(crate) layers: &'a CameraLayers,
    /// The virtual sensors' windows with their names.
    pub(crate) virtual_sensors: &'a [(&'static str, ImageRect)],
}

impl CameraCanvas<'_> {
    /// The middle of a pixel on the screen.
    fn to_screen(&self, [u, v]: [f32; 2]) -> Pos2 {
        self.transform.to_screen(u + 0.5, v + 0.5)
    }

    /// A ground point on the screen, in the camera's image.
    fn project_to_screen(&self, at: At<RobotFrame>) -> Option<Pos2> {
        let eye = self.scene.camera.as_ref()?;
        let pixel = eye.project(at, self.cycle.estimate.tilt)?;
        Some(self.to_screen(pixel))
    }

    fn draw_plus(&self, at: Pos2, arm: f32, colour: Color32) {
        let stroke = Stroke::new(1.6, colour);
        let (right, down) = (Vec2::new(arm, 0.0), Vec2::new(0.0, arm));
        self.painter.line_segment([at - right, at + right], stroke);
        self.painter.line_segment([at - down, at + down], stroke);
    }

    fn draw_x(&self, at: Pos2, arm: f32, colour: Color32) {
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
pub(crate) fn draw_image_overlay(drawing: &CameraCanvas<'_>) {
    let shows = drawing.layers;
    if shows.grid {
        grid(drawing);
    }
    if shows.field_lines
        && let Some(pose) = drawing.cycle.estimate.pose
    {
        let stroke = Stroke::new(1.4, palette::PROJECTED_LINE);
        for [from, to] in drawing
            .scene
            .project_markings(pose, drawing.cycle.estimate.tilt)
        {
            let ends = [drawing.to_screen(from), drawing.to_screen(to)];
            drawing.painter.line_segment(ends, stroke);
        }
    }
    if shows.virtual_sensors {
        draw_virtual_sensors(drawing);
    }
    let Some(seen) = &drawing.cycle.detections else {
        if shows.line_points {
            // Line points of another vision have no pixel of their own.
            for point in &drawing.cycle.line_points {
                if let Some(at) = drawing.project_to_screen(point.at) {
                    drawing.draw_plus(at, 3.0, palette::LINE_POINT);
                }
            }
        }
        return;
    };
    if shows.carpet_end {
        carpet_end(drawing, &seen.carpet_end);
    }
    if shows.rejected_candidates {
        for refused in &seen.rejected_candidates {
            let (colour, _) = palette::rejection_style(refused.reason);
            drawing.draw_x(drawing.to_screen(refused.position_px), 2.5, colour);
        }
    }
    if shows.line_points {
        for point in &seen.line_points {
            drawing.draw_plus(
                drawing.to_screen(point.position_px),
                3.0,
                palette::LINE_POINT,
            );
        }
    }
    objects(drawing);
}

fn objects(drawing: &CameraCanvas<'_>) {
    let (shows, painter) = (drawing.layers, drawing.painter);
    let Some(seen) = &drawing.cycle.detections else {
        return;
    };
    if let (true, Some(ball)) = (shows.ball, &seen.ball) {
        let at = drawing.to_screen(ball.position_px);
        painter.circle_stroke(at, 9.0, (2.5, palette::BALL));
        let air = if ball.on_ground { "" } else { ", in the air" };
        let text = format!("ball {:.1} m{air}", ball.at.distance());
        drawing.label(at, text, palette::BALL);
    }
    if shows.robots {
        for robot in &seen.robots {
            let at = drawing.to_screen(robot.position_px);
            let half = Vec2::splat(7.0);
            let square = eframe::egui::Rect::from_min_max(at - half, at + half);
            painter.rect_stroke(
                square,
                1.0,
                (2.0, palette::ROBOT),
                eframe::egui::StrokeKind::Middle,
            );
            let team = match robot.marker {
                Some(TeamColour::Cyan) => " cyan",
                Some(TeamColour::Magenta) => " magenta",
                None => "",
            };
            let text = format!("robot{team} {:.1} m", robot.at.distance());
            drawing.label(at, text, palette::ROBOT);
        }
    }
    if shows.goals {
        for goal in &seen.goals {
            let at = drawing.to_screen(goal.position_px);
            drawing.draw_plus(at, 8.0, palette::GOAL);
            let kind = match goal.kind {
                GoalKind::Blue => "blue goal",
                GoalKind::Yellow => "yellow goal",
                GoalKind::Post => "post",
            };
            drawing.label(at, kind.to_owned(), palette::GOAL);
        }
    }
}

/// Everything over the floor from above: the same marks where the map puts them.
pub(crate) fn draw_birds_eye_overlay(drawing: &CameraCanvas<'_>) {
    let per_metre = BIRDS_EYE_SIDE_PX as f32 / (2.0 * BIRDS_EYE_HALF_EXTENT);
    let place = |at: At<RobotFrame>| {
        drawing.transform.to_screen(
            (BIRDS_EYE_HALF_EXTENT - at.y) * per_metre,
            (BIRDS_EYE_HALF_EXTENT - at.x) * per_metre,
        )
    };
    let shows = drawing.layers;
    let scale = per_metre * drawing.transform.scale;
    if shows.grid {
        for ring in RINGS {
            let stroke = Stroke::new(1.0, palette::PROJECTED_LINE.gamma_multiply(0.6));
            drawing
                .painter
                .circle_stroke(place(At::new(0.0, 0.0)), ring * scale, stroke);
        }
    }
    if let (true, Some(pose)) = (shows.field_lines, drawing.cycle.estimate.pose) {
        let robot_from_field = pose.inverse();
        let stroke = Stroke::new(1.4, palette::PROJECTED_LINE);
        for [from, to] in super::field_drawing::marking_segments(&drawing.scene.field) {
            let ends = [from, to].map(|at| place(robot_from_field * at));
            drawing.painter.line_segment(ends, stroke);
        }
    }
    if shows.line_points {
        for point in &drawing.cycle.line_points {
            drawing.draw_plus(place(point.at), 3.0, palette::LINE_POINT);
        }
    }
    let Some(seen) = &drawing.cycle.detections else {
        return;
    };
    if let (true, Some(ball)) = (shows.ball, &seen.ball) {
        drawing
            .painter
            .circle_stroke(place(ball.at), 0.11 * scale, (2.0, palette::BALL));
    }
    if shows.robots {
        for robot in &seen.robots {
            drawing
                .painter
                .circle_stroke(place(robot.at), 0.25 * scale, (2.0, palette::ROBOT));
        }
    }
}

/// The virtual sensors' windows; those that say yes are drawn thick.
fn draw_virtual_sensors(drawing: &CameraCanvas<'_>) {
    let readings = drawing
        .cycle
        .detections
        .as_ref()
        .map(|seen| &seen.virtual_sensors);
    let mut bumpers = readings
        .map(|found| found.bumpers.iter())
        .into_iter()
        .flatten();
    for (name, window) in drawing.virtual_sensors {
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
        let [from, to] = corners.map(|[u, v]| drawing.transform.to_screen(u, v));
        let rect = eframe::egui::Rect::from_two_pos(from, to);
        let (width, colour) = if says {
            (3.0, palette::YELLOW)
        } else {
            (1.2, palette::SKY)
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

fn grid(drawing: &CameraCanvas<'_>) {
    let stroke = Stroke::new(1.0, palette::PROJECTED_LINE.gamma_multiply(0.6));
    let join = |points: &mut dyn Iterator<Item = At<RobotFrame>>| {
        let mut last = None;
        for at in points {
            let here = drawing.project_to_screen(at);
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
        if let Some(at) = drawing.project_to_screen(polar(ring, 0.0)) {
            drawing.label(at, format!("{ring:.0} m"), palette::PROJECTED_LINE);
        }
    }
    for ray in 0..RAYS {
        let angle = TAU * ray as f32 / RAYS as f32;
        join(&mut (1..=20).map(|step| polar(0.4 * step as f32, angle)));
    }
}

fn carpet_end(drawing: &CameraCanvas<'_>, ends: &[f32]) {
    let Some(eye) = &drawing.scene.camera else {
        return;
    };
    let [cu, cv] = eye.config.centre_px;
    for (ray, &end) in ends.iter().enumerate() {
        let angle = TAU * ray as f32 / ends.len() as f32;
        // Outward from the axis, first pixel that shows ground beyond the end.
        let (cos, sin) = (angle.cos(), angle.sin());
        let rim = eye
            .config
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
                .circle_filled(drawing.to_screen(at), 1.8, palette::ORANGE);
        }
    }
}

/// What the signs mean.
pub(crate) fn show_legend(ui: &mut Ui) {
    let row = |ui: &mut Ui, sign: &str, colour: Color32, text: &str| {
        ui.horizontal(|ui| {
            ui.colored_label(colour, sign);
            ui.label(text);
        });
    };
    row(ui, "+", palette::LINE_POINT, "line point");
    for reason in [
        RejectionReason::NoAdjacentCarpet,
        RejectionReason::TooNarrow,
        RejectionReason::TooWide,
        RejectionReason::TooFaint,
        RejectionReason::NotWhite,
        RejectionReason::BeyondCarpet,
    ] {
        let (colour, text) = palette::rejection_style(reason);
        row(ui, "x", colour, &format!("refused: {text}"));
    }
    row(
        ui,
        "-",
        palette::PROJECTED_LINE,
        "field lines at the estimated pose",
    );
    ui.separator();
    for (class, name) in vision::colour::lookup_table::CLASS_NAMES.iter().enumerate() {
        row(
            ui,
            "■",
            palette::class_colour(vision::colour::lookup_table::ColourClass(class as u8)),
            name,
        );
    }
}
