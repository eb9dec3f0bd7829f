//! Scene panel: field, robots, ball and the ray of a pixel in space, seen from any side.

use std::f32::consts::TAU;

use eframe::egui::{Align2, Color32, Sense, Shape, Stroke, Ui, Vec2};
use localize::frames::{At, FieldFrame};
use localize::{Field, Pose};
use pipeline::Cycle;

use super::field_drawing::{BALL_RADIUS, ROBOT_RADIUS, marking_segments};
use super::scene_camera::{Point, Projection, SceneCamera};
use crate::view::ground_placement::GroundPlacement;
use crate::view::labels::Labels;
use crate::view::palette;
use crate::view::panel_command::PanelCommand;
use crate::view::pen::Pen;
use crate::view::session::Session;

/// Length of the drawn axes, metres.
const AXIS: f32 = 2.0;
/// Height of a robot, metres: the league's largest.
const ROBOT_HEIGHT: f32 = 0.8;
/// Height of a goal's bar, metres.
const GOAL_HEIGHT: f32 = 1.0;
/// Segments of a circle.
const CIRCLE_STEPS: usize = 24;
/// Radius of the drawn mirror, metres.
const MIRROR_RADIUS: f32 = 0.08;
/// Distance of the camera below the mirror's effective viewpoint, metres, where it is drawn.
const CAMERA_BELOW: f32 = 0.35;

/// State of the panel.
#[derive(Default)]
pub(crate) struct ScenePanel {
    camera: SceneCamera,
    /// The camera follows the robot.
    follow: bool,
}

struct Canvas<'a> {
    pen: &'a Pen,
    projection: Projection,
}

impl ScenePanel {
    /// Does what keys ask for: moving turns.
    pub(super) fn apply(&mut self, command: PanelCommand) {
        self.camera.apply(command);
    }

    /// The place from which the scene is seen.
    #[cfg(test)]
    pub(crate) fn camera(&self) -> String {
        format!("{:?}", self.camera)
    }

    /// Draws the panel.
    pub(crate) fn show(&mut self, ui: &mut Ui, session: &Session) {
        ui.horizontal_wrapped(|ui| {
            ui.checkbox(&mut self.follow, "Follow the robot");
            ui.weak("Drag turns, Shift-drag moves, scroll zooms, double-click resets.");
        });
        let Some(scene) = &session.scene else {
            ui.weak("This source has no field configuration.");
            return;
        };
        let size = ui.available_size().max(Vec2::splat(1.0));
        let (response, painter) = ui.allocate_painter(size, Sense::click_and_drag());
        self.camera.handle_input(ui, &response);
        let shown = session.shown.as_ref().map(|now| &*now.cycle);
        let pose = shown.and_then(|cycle| cycle.estimate.pose);
        if let (true, Some(pose)) = (self.follow, pose) {
            self.camera.target = [pose.x, pose.y, 0.3];
        }
        let pen = Pen::new(painter.with_clip_rect(response.rect));
        pen.rect(response.rect, palette::FLOOR);
        let canvas = Canvas {
            pen: &pen,
            projection: self.camera.projection(response.rect),
        };
        let labels = Labels::default();
        canvas.draw_field(&scene.field, &labels);
        for (number, other) in session.others.iter().enumerate() {
            if let Some(pose) = other.pose() {
                canvas.draw_robot(pose, palette::run_colour(number), 1.4);
            }
        }
        if let Some(cycle) = shown {
            let height = scene.camera.as_ref().map(|camera| camera.viewpoint_height);
            canvas.draw_cycle(cycle, height);
            if let (Some(ground), Some(pose), Some(height)) = (session.pointed_ground, pose, height)
            {
                canvas.draw_ray(pose, pose * ground, height);
            }
        }
        labels.draw(&pen);
    }
}

impl Canvas<'_> {
    fn line(&self, from: Point, to: Point, stroke: Stroke) {
        if let Some(ends) = self.projection.segment(from, to) {
            self.pen.segment(ends, stroke);
        }
    }

    fn ring(&self, at: Point, radius: f32, stroke: Stroke) {
        let corner = |step: usize| {
            let (sin, cos) = (TAU * step as f32 / CIRCLE_STEPS as f32).sin_cos();
            [at[0] + radius * cos, at[1] + radius * sin, at[2]]
        };
        for step in 0..CIRCLE_STEPS {
            self.line(corner(step), corner(step + 1), stroke);
        }
    }

    fn sphere(&self, at: Point, radius: f32, colour: Color32, filled: bool) {
        let Some(place) = self.projection.point(at) else {
            return;
        };
        let radius = (radius * self.projection.scale(at)).max(3.0);
        // The shadow shows where on the floor it is.
        let floor = [at[0], at[1], 0.0];
        self.line(floor, at, Stroke::new(1.0, colour.gamma_multiply(0.5)));
        if filled {
            self.pen.disc(place, radius, colour);
        } else {
            self.pen.circle(place, radius, (1.5, colour));
        }
    }

    fn draw_field(&self, field: &Field, labels: &Labels) {
        let (x, y) = field.carpet_half_extent();
        let corners = [[x, y, 0.0], [-x, y, 0.0], [-x, -y, 0.0], [x, -y, 0.0]];
        let places: Vec<_> = corners
            .iter()
            .filter_map(|corner| self.projection.point(*corner))
            .collect();
        // A corner behind the camera would need a clipped polygon: the lines alone are drawn then.
        if places.len() == corners.len() {
            let carpet = Shape::convex_polygon(places, palette::CARPET, Stroke::NONE);
            self.pen.painter().add(carpet);
        }
        let stroke = Stroke::new(1.5, palette::LINE);
        for [from, to] in marking_segments(field) {
            self.line(floor(from), floor(to), stroke);
        }
        let goal = &field.config.goal;
        let half = goal.width / 2.0;
        for side in [1.0, -1.0].into_iter().filter(|_| field.has_goals()) {
            let front = side * field.config.length / 2.0;
            let back = front + side * goal.depth;
            let stroke = Stroke::new(2.0, palette::GOAL);
            for y in [half, -half] {
                self.line([front, y, 0.0], [front, y, GOAL_HEIGHT], stroke);
                self.line([front, y, GOAL_HEIGHT], [back, y, 0.0], stroke);
            }
            self.line(
                [front, half, GOAL_HEIGHT],
                [front, -half, GOAL_HEIGHT],
                stroke,
            );
            self.line([back, half, 0.0], [back, -half, 0.0], stroke);
        }
        for (to, name) in [
            ([AXIS, 0.0, 0.0], format!("x {AXIS} m")),
            ([0.0, AXIS, 0.0], "y".to_owned()),
            ([0.0, 0.0, AXIS], "z".to_owned()),
        ] {
            self.line([0.0; 3], to, Stroke::new(1.0, Color32::WHITE));
            if let Some(at) = self.projection.point(to) {
                let place = (at, Vec2::ZERO);
                labels.add(self.pen, place, Align2::LEFT_BOTTOM, name, Color32::WHITE);
            }
        }
    }

    fn draw_robot(&self, pose: Pose, colour: Color32, width: f32) {
        let stroke = Stroke::new(width, colour);
        for height in [0.0, ROBOT_HEIGHT] {
            self.ring([pose.x, pose.y, height], ROBOT_RADIUS, stroke);
        }
        for step in 0..4 {
            let (sin, cos) = (pose.theta + TAU * step as f32 / 4.0).sin_cos();
            let [x, y] = [pose.x + ROBOT_RADIUS * cos, pose.y + ROBOT_RADIUS * sin];
            self.line([x, y, 0.0], [x, y, ROBOT_HEIGHT], stroke);
        }
        let (sin, cos) = pose.theta.sin_cos();
        let nose = 1.8 * ROBOT_RADIUS;
        self.line(
            [pose.x, pose.y, 0.02],
            [pose.x + nose * cos, pose.y + nose * sin, 0.02],
            stroke,
        );
    }

    fn draw_cycle(&self, cycle: &Cycle, viewpoint_height: Option<f32>) {
        if let Some(truth) = &cycle.inputs.truth {
            self.draw_robot(truth.pose, palette::TRUTH, 2.4);
            for other in &truth.robots {
                self.ring(floor(*other), ROBOT_RADIUS, Stroke::new(1.2, palette::GREY));
                let top = [other.x, other.y, ROBOT_HEIGHT];
                self.ring(top, ROBOT_RADIUS, Stroke::new(1.2, palette::GREY));
            }
            if let Some(ball) = truth.ball {
                self.sphere(
                    [ball.x, ball.y, BALL_RADIUS],
                    BALL_RADIUS,
                    palette::BALL,
                    false,
                );
            }
        }
        let seen = GroundPlacement::of(cycle, viewpoint_height);
        let (Some(pose), Some(seen)) = (cycle.estimate.pose, seen) else {
            return;
        };
        self.draw_robot(pose, palette::ESTIMATE, 1.8);
        if let Some(height) = viewpoint_height {
            let top = [pose.x, pose.y, height];
            self.ring(top, MIRROR_RADIUS, Stroke::new(1.5, Color32::WHITE));
        }
        for point in &cycle.line_points {
            if let Some(at) = self.projection.point(floor(seen.place(point.at))) {
                self.pen.disc(at, 1.5, palette::LINE_POINT);
            }
        }
        if let Some(detections) = &cycle.detections {
            for robot in &detections.robots {
                let at = seen.place(robot.at);
                let stroke = Stroke::new(1.6, palette::ROBOT);
                self.ring(floor(at), ROBOT_RADIUS, stroke);
                self.ring([at.x, at.y, ROBOT_HEIGHT], ROBOT_RADIUS, stroke);
            }
            if let Some(ball) = &detections.ball {
                let at = seen.place(ball.at);
                self.sphere([at.x, at.y, BALL_RADIUS], BALL_RADIUS, palette::BALL, true);
            }
        }
    }

    /// Draws the ray of the pixel under the camera panel's pointer, as the ground map has it: from the ground to the
    /// mirror's effective viewpoint, and down to the camera.
    fn draw_ray(&self, pose: Pose, ground: At<FieldFrame>, height: f32) {
        let mirror = [pose.x, pose.y, height];
        let lens = [pose.x, pose.y, (height - CAMERA_BELOW).max(0.0)];
        let stroke = Stroke::new(1.6, palette::YELLOW);
        self.line(floor(ground), mirror, stroke);
        self.line(mirror, lens, stroke);
        self.ring(floor(ground), 0.05, stroke);
    }
}

fn floor(at: At<FieldFrame>) -> Point {
    [at.x, at.y, 0.0]
}
