//! Field panel: pose estimate, ground truth, objects and layers from above. Dragging moves the simulation's objects.

use std::sync::Arc;

use eframe::egui::{
    self, Align2, Color32, ColorImage, FontId, Pos2, Rect, Sense, Stroke, TextureHandle,
    TextureOptions, Ui, Vec2,
};
use localize::{At, Pose};
use serde::{Deserialize, Serialize};

use super::field_drag::FieldDrag;
use super::field_drawing::{self as drawing, FieldTransform};
use super::field_marks;
use crate::view::layer_worker::LayerSelection;
use crate::view::palette;
use crate::view::panzoom::{PanZoom, fill_around};
use crate::view::session::Session;
use crate::view::static_scene::StaticScene;
use pipeline::Cycle;

/// Largest distance of a click from the object that it selects, points.
const SELECT_RADIUS: f32 = 12.0;

/// Background of the field.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub(crate) enum FieldBackground {
    /// Plain carpet.
    #[default]
    Carpet,
    /// Distance to the nearest marking.
    DistanceField,
    /// Mean distance of the cycle's line points to the markings, over assumed robot positions.
    ErrorLandscape,
}

/// Visible layers.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct FieldLayers {
    pub(crate) background: FieldBackground,
    pub(crate) line_points: bool,
    pub(crate) trail: bool,
    pub(crate) truth: bool,
    pub(crate) covariance: bool,
    pub(crate) hypotheses: bool,
    pub(crate) particles: bool,
    pub(crate) objects: bool,
    pub(crate) recomputed: bool,
    /// Length of the trail, seconds.
    pub(crate) trail_s: f64,
}

impl Default for FieldLayers {
    fn default() -> Self {
        FieldLayers {
            background: FieldBackground::Carpet,
            line_points: true,
            trail: true,
            truth: true,
            covariance: true,
            hypotheses: true,
            particles: true,
            objects: true,
            recomputed: true,
            trail_s: 10.0,
        }
    }
}

/// State of the panel.
#[derive(Default)]
pub(crate) struct FieldPanel {
    /// Visible layers.
    pub(crate) layers: FieldLayers,
    pan_zoom: PanZoom,
    drag: FieldDrag,
    layer: Option<(Arc<ColorImage>, TextureHandle)>,
}

impl FieldPanel {
    /// The layers to render.
    pub(crate) fn layer_selection(&self) -> LayerSelection {
        LayerSelection {
            distance_field: self.layers.background == FieldBackground::DistanceField,
            error_landscape: self.layers.background == FieldBackground::ErrorLandscape,
            ..LayerSelection::default()
        }
    }

    /// Draws the panel.
    pub(crate) fn show(&mut self, ui: &mut Ui, session: &mut Session) {
        self.switches(ui, session);
        let Some(scene) = session.scene.clone() else {
            ui.weak("This source has no field configuration.");
            return;
        };
        let half = drawing::view_half_extent(&scene.field);
        let line = ui.text_style_height(&egui::TextStyle::Body) + 6.0;
        let area = Vec2::new(
            ui.available_width().max(1.0),
            (ui.available_height() - line).max(1.0),
        );
        let (response, painter) = ui.allocate_painter(area, Sense::click_and_drag());
        let before = FieldTransform::new(self.pan_zoom.transform(response.rect, 2.0 * half), half);
        self.drag.start(&response, session, &before);
        let pans = self.drag.pans();
        let transform = self.pan_zoom.handle_input(ui, &response, 2.0 * half, pans);
        let screen = FieldTransform::new(transform, half);
        self.drag.update(ui, &response, session, &screen);
        if let Some(pointer) = response.interact_pointer_pos()
            && response.clicked()
            && !self.drag.measuring
        {
            let radius = SELECT_RADIUS / screen.scale();
            session.select_at(screen.to_field(pointer), radius);
        }
        let session = &*session;
        let painter = painter.with_clip_rect(response.rect);
        let carpet = drawing::carpet_rect(&screen, &scene.field);
        fill_around(&painter, response.rect, carpet, palette::FLOOR);
        let has_layer = self.draw_background(ui, &painter, session, (&scene, &screen));
        drawing::draw_field(&painter, &screen, &scene.field, !has_layer);
        self.draw_trails(&painter, &screen, session);
        if let Some(now) = &session.shown {
            // The landscape may be of an earlier cycle: what lies on it must be of the same one.
            let rendered = session.rendered_layers.cycle.as_ref();
            let landscape = has_layer && self.layers.background == FieldBackground::ErrorLandscape;
            let cycle = rendered.filter(|_| landscape).unwrap_or(&now.cycle);
            self.draw_estimate(&painter, &screen, cycle, &now.particles);
            self.draw_objects(&painter, &screen, cycle);
            self.draw_tracks(&painter, &screen, cycle);
        }
        self.draw_other_runs(&painter, &screen, session);
        if let Some(place) = session.selected_place() {
            field_marks::draw_selection(&painter, screen.to_screen(place));
        }
        if let Some(hovered) = session.hovered_time {
            field_marks::draw_hovered_moment(&painter, &screen, &session.series, hovered);
        }
        if has_layer {
            drawing::draw_distance_scale(&painter, response.rect);
        }
        field_marks::draw_scale(&painter, &screen, response.rect);
        self.drag.draw_measurement(&painter, &screen);
        painter.text(
            response.rect.left_top() + Vec2::new(6.0, 4.0),
            Align2::LEFT_TOP,
            self.status_text(session),
            FontId::proportional(13.0),
            Color32::WHITE,
        );
        match response.hover_pos() {
            Some(pointer) => {
                let at = screen.to_field(pointer);
                ui.label(format!("{:.2}, {:.2} m{}", at.x, at.y, self.drag.length()));
            }
            None if session.source.simulation().is_some() => {
                ui.weak(
                    "Drag a robot or the ball to move it. Scroll while dragging to rotate a robot.",
                );
            }
            None => {
                ui.weak("Scroll zooms, drag pans, double-click resets.");
            }
        }
    }

    fn switches(&mut self, ui: &mut Ui, session: &Session) {
        let layers = &mut self.layers;
        ui.horizontal_wrapped(|ui| {
            ui.menu_button("Layers", |ui| {
                for (name, shown) in [
                    ("Line points", &mut layers.line_points),
                    ("Trail", &mut layers.trail),
                    ("Truth", &mut layers.truth),
                    ("Covariance", &mut layers.covariance),
                    ("Hypotheses", &mut layers.hypotheses),
                    ("Particles", &mut layers.particles),
                    ("Ball and robots", &mut layers.objects),
                    ("Recomputed run", &mut layers.recomputed),
                ] {
                    ui.checkbox(shown, name);
                }
                ui.add(
                    egui::Slider::new(&mut layers.trail_s, 1.0..=600.0)
                        .logarithmic(true)
                        .suffix(" s")
                        .text("trail"),
                );
            });
            for (name, ground) in [
                ("Carpet", FieldBackground::Carpet),
                ("Distance field", FieldBackground::DistanceField),
                ("Error landscape", FieldBackground::ErrorLandscape),
            ] {
                ui.selectable_value(&mut layers.background, ground, name);
            }
            if ui
                .toggle_value(&mut self.drag.measuring, "Measure")
                .clicked()
            {
                self.drag.measurement = None;
            }
            ui.menu_button("Legend", field_marks::show_legend);
            if session.recompute.is_some() {
                ui.toggle_value(&mut layers.recomputed, "Recomputed");
            }
        });
    }

    /// Draws the background layer; false if there is none.
    fn draw_background(
        &mut self,
        ui: &Ui,
        painter: &egui::Painter,
        session: &Session,
        (scene, screen): (&StaticScene, &FieldTransform),
    ) -> bool {
        let rendered = &session.rendered_layers;
        let image = match self.layers.background {
            FieldBackground::Carpet => None,
            FieldBackground::DistanceField => rendered.distance_field.as_ref(),
            FieldBackground::ErrorLandscape => rendered.error_landscape.as_ref(),
        };
        let Some(image) = image else {
            return false;
        };
        let (cached, handle) = self.layer.get_or_insert_with(|| {
            let handle = ui.load_texture("ground", image.clone(), TextureOptions::LINEAR);
            (image.clone(), handle)
        });
        if !Arc::ptr_eq(cached, image) {
            handle.set(image.clone(), TextureOptions::LINEAR);
            *cached = image.clone();
        }
        let (half_x, half_y) = scene.field.carpet_half_extent();
        let rect = Rect::from_two_pos(
            screen.to_screen(At::new(-half_x, half_y)),
            screen.to_screen(At::new(half_x, -half_y)),
        );
        let uv = Rect::from_min_max(Pos2::ZERO, Pos2::new(1.0, 1.0));
        painter.image(handle.id(), rect, uv, Color32::WHITE);
        true
    }

    fn draw_trails(&self, painter: &egui::Painter, screen: &FieldTransform, session: &Session) {
        if !self.layers.trail {
            return;
        }
        let at = session.shown_time().unwrap_or(session.playback.time);
        let recent = session.series.between(at - self.layers.trail_s, at);
        // `between` returns one sample after `at`, which must not be drawn.
        let past = recent.iter().filter(|sample| sample.time <= at);
        if self.layers.truth {
            let places = past.clone().map(|sample| sample.truth);
            let stroke = Stroke::new(3.0, palette::TRUTH.gamma_multiply(0.7));
            drawing::draw_trail(painter, screen, places, stroke);
        }
        let places = past.map(|sample| sample.pose);
        drawing::draw_trail(painter, screen, places, Stroke::new(1.6, palette::ESTIMATE));
        if let (true, Some(recompute)) = (self.layers.recomputed, &session.recompute) {
            let recomputed = recompute.series.between(at - self.layers.trail_s, at);
            let places = recomputed.iter().filter(|s| s.time <= at).map(|s| s.pose);
            drawing::draw_trail(painter, screen, places, Stroke::new(1.6, palette::PURPLE));
            if let Some(last) = recompute.series.at(at).filter(|s| s.pose[0].is_finite()) {
                let pose = Pose::new(last.pose[0], last.pose[1], last.pose[2]);
                drawing::draw_robot(painter, screen, pose, palette::PURPLE, 1.6);
            }
        }
    }

    /// Draws the estimate: particles, hypotheses, pose, velocity and covariance.
    fn draw_estimate(
        &self,
        painter: &egui::Painter,
        screen: &FieldTransform,
        cycle: &Cycle,
        particles: &[Pose],
    ) {
        let estimate = &cycle.estimate;
        if self.layers.particles {
            for particle in particles {
                painter.circle_filled(screen.to_screen(particle.origin()), 1.5, palette::YELLOW);
            }
        }
        if self.layers.hypotheses {
            for other in &estimate.runners_up {
                let colour = palette::PURPLE;
                drawing::draw_robot(painter, screen, other.pose, colour, 1.2);
                let text = format!("{:.0} %", 100.0 * other.probability);
                drawing::draw_text(
                    painter,
                    screen.to_screen(other.pose.origin()),
                    &text,
                    colour,
                );
            }
        }
        let truth = cycle.inputs.truth.as_ref().filter(|_| self.layers.truth);
        if let Some(truth) = truth {
            drawing::draw_robot(painter, screen, truth.pose, palette::TRUTH, 3.0);
        }
        let Some(pose) = estimate.pose else {
            return;
        };
        if self.layers.line_points {
            for point in &cycle.line_points {
                painter.circle_filled(screen.to_screen(pose * point.at), 1.8, palette::LINE_POINT);
            }
        }
        drawing::draw_robot(painter, screen, pose, palette::ESTIMATE, 2.2);
        if let Some([vx, vy]) = odometry_velocity(cycle) {
            let (sin, cos) = pose.theta.sin_cos();
            let along = [cos * vx - sin * vy, sin * vx + cos * vy];
            drawing::draw_velocity(painter, screen, pose.origin(), along, palette::ESTIMATE);
        }
        if self.layers.covariance {
            drawing::draw_covariance(
                painter,
                screen,
                pose,
                &estimate.covariance,
                palette::ESTIMATE,
            );
        }
    }

    /// Draws ball and robots: ground truth as circles, detections as discs.
    fn draw_objects(&self, painter: &egui::Painter, screen: &FieldTransform, cycle: &Cycle) {
        if !self.layers.objects {
            return;
        }
        let scale = screen.scale();
        if let Some(truth) = cycle.inputs.truth.as_ref().filter(|_| self.layers.truth) {
            for other in &truth.robots {
                let radius = drawing::ROBOT_RADIUS * scale;
                painter.circle_stroke(screen.to_screen(*other), radius, (1.5, palette::GREY));
            }
            if let Some(ball) = truth.ball {
                let radius = (drawing::BALL_RADIUS * scale).max(4.0);
                painter.circle_stroke(screen.to_screen(ball), radius, (1.5, palette::BALL));
            }
        }
        let (Some(pose), Some(detections)) = (cycle.estimate.pose, &cycle.detections) else {
            return;
        };
        for robot in &detections.robots {
            let radius = (0.6 * drawing::ROBOT_RADIUS * scale).max(3.0);
            painter.circle_filled(screen.to_screen(pose * robot.at), radius, palette::ROBOT);
        }
        if let Some(ball) = &detections.ball {
            let radius = (drawing::BALL_RADIUS * scale).max(3.0);
            painter.circle_filled(screen.to_screen(pose * ball.at), radius, palette::BALL);
        }
    }

    /// Draws the tracked objects' velocities (length: one second), the team ball and the teammates.
    fn draw_tracks(&self, painter: &egui::Painter, screen: &FieldTransform, cycle: &Cycle) {
        if !self.layers.objects {
            return;
        }
        for robot in cycle.world.robots.iter().filter_map(|robot| robot.on_field) {
            drawing::draw_velocity(painter, screen, robot.at, robot.velocity, palette::ROBOT);
        }
        if let Some(ball) = cycle.world.ball.and_then(|ball| ball.on_field) {
            drawing::draw_velocity(painter, screen, ball.at, ball.velocity, palette::BALL);
        }
        if let Some(flight) = cycle.world.ball_in_air.and_then(|ball| ball.on_field) {
            let [x, y, height] = flight.at;
            let at = screen.to_screen(At::new(x, y));
            let text = format!("{height:.1} m up");
            drawing::draw_text(painter, at, &text, palette::BALL);
            if let Some(landing) = flight.landing {
                let [x, y] = landing.at;
                let end = screen.to_screen(At::new(x, y));
                painter.line_segment([at, end], (1.0, palette::BALL));
                painter.circle_stroke(end, 4.0, (1.0, palette::BALL));
            }
        }
        if let Some(ball) = &cycle.team.ball {
            let radius = (2.0 * drawing::BALL_RADIUS * screen.scale()).max(7.0);
            painter.circle_stroke(screen.to_screen(ball.at), radius, (1.0, palette::BALL));
        }
        for mate in &cycle.team.teammates {
            if let Some(pose) = mate.pose {
                drawing::draw_robot(painter, screen, pose, palette::GREEN, 1.6);
                let text = format!("{} ({:.1} s ago)", mate.robot, mate.age);
                drawing::draw_text(
                    painter,
                    screen.to_screen(pose.origin()),
                    &text,
                    palette::GREEN,
                );
            }
        }
    }

    /// Draws the poses and trails of the other runs.
    fn draw_other_runs(&self, painter: &egui::Painter, screen: &FieldTransform, session: &Session) {
        let at = session.shown_time().unwrap_or(session.playback.time);
        let from = at
            - if self.layers.trail {
                self.layers.trail_s
            } else {
                0.0
            };
        let pose = session
            .shown
            .as_ref()
            .and_then(|now| now.cycle.estimate.pose);
        for (number, other) in session.others.iter().enumerate() {
            let colour = palette::run_colour(number);
            let recent = other.series.between(from, at);
            let places = recent.iter().filter(|s| s.time <= at).map(|s| s.pose);
            drawing::draw_trail(painter, screen, places, Stroke::new(1.6, colour));
            if let Some(cycle) = &other.cycle {
                field_marks::draw_other_run(painter, screen, (&other.name, colour), cycle, pose);
            }
        }
    }

    fn status_text(&self, session: &Session) -> String {
        let Some(now) = &session.shown else {
            return "no cycle yet".to_owned();
        };
        let estimate = &now.cycle.estimate;
        let mut text = pipeline::log::mode_and_reason(estimate);
        if let Some(pose) = estimate.pose {
            let std = |axis: usize| 100.0 * estimate.covariance[(axis, axis)].max(0.0).sqrt();
            text += &format!(
                "\n{:.2} m, {:.2} m, {:.1}°   ± {:.1} cm, {:.1} cm, {:.1}°",
                pose.x,
                pose.y,
                pose.theta.to_degrees(),
                std(0),
                std(1),
                (std(2) / 100.0).to_degrees()
            );
            if let Some(truth) = &now.cycle.inputs.truth {
                let error = pose.origin().distance_to(truth.pose.origin());
                text += &format!("\nposition error {:.1} cm", 100.0 * error);
            }
        }
        text
    }
}

/// Velocity from the cycle's odometry, robot frame, m/s.
fn odometry_velocity(cycle: &Cycle) -> Option<[f32; 2]> {
    let (first, rest) = cycle.inputs.odometry.split_first()?;
    let span = (rest.last()?.stamp - first.stamp) as f32;
    let sum = |part: fn(&localize::sample::Odometry) -> f32| rest.iter().map(part).sum::<f32>();
    (span > 0.0).then(|| [sum(|o| o.dx) / span, sum(|o| o.dy) / span])
}
