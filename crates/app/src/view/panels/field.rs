//! Where does the robot take itself to be, and what stands around it? The field from above; what is dragged is kidnapped.

use std::sync::Arc;

use eframe::egui::{
    self, Align2, Color32, ColorImage, FontId, Pos2, Rect, Response, Sense, Stroke, TextureHandle,
    TextureOptions, Ui, Vec2,
};
use localize::frame::FieldFrame;
use localize::{At, Pose};
use serde::{Deserialize, Serialize};

use super::field_marks::{self as marks, OnScreen};
use crate::view::ink;
use crate::view::layers::Wanted;
use crate::view::panzoom::{PanZoom, paint_around};
use crate::view::session::Session;
use crate::view::source::worker::Order;
use crate::view::stage::Stage;
use pipeline::cycle::Cycle;

/// What can be caught with the pointer is this near, points.
const CATCH: f32 = 18.0;
/// Scrolling a caught robot turns it: degrees a scrolled point.
const TURN_DEG: f32 = 0.5;

/// What lies on the carpet.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub(crate) enum Ground {
    /// The carpet alone.
    #[default]
    Carpet,
    /// Distance to the nearest marking.
    Distance,
    /// Mean distance of this frame's points, were the robot there.
    Landscape,
}

/// What is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct Shows {
    pub(crate) ground: Ground,
    pub(crate) points: bool,
    pub(crate) trail: bool,
    pub(crate) truth: bool,
    pub(crate) covariance: bool,
    pub(crate) hypotheses: bool,
    pub(crate) particles: bool,
    pub(crate) objects: bool,
    pub(crate) recomputed: bool,
    /// Seconds of the trail.
    pub(crate) trail_s: f64,
}

impl Default for Shows {
    fn default() -> Self {
        Shows {
            ground: Ground::Carpet,
            points: true,
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

/// What the pointer holds.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Held {
    Robot(Pose),
    Ball,
    Other(usize),
}

/// The panel's memory.
#[derive(Default)]
pub(crate) struct FieldView {
    /// What is drawn.
    pub(crate) shows: Shows,
    view: PanZoom,
    held: Option<Held>,
    measuring: bool,
    /// From and to.
    measured: Option<[At<FieldFrame>; 2]>,
    layer: Option<(Arc<ColorImage>, TextureHandle)>,
}

impl FieldView {
    /// Which layers are to be painted.
    pub(crate) fn wanted(&self) -> Wanted {
        Wanted {
            distance: self.shows.ground == Ground::Distance,
            landscape: self.shows.ground == Ground::Landscape,
            ..Wanted::default()
        }
    }

    /// Draws the panel.
    pub(crate) fn show(&mut self, ui: &mut Ui, session: &Session) {
        self.switches(ui, session);
        let Some(stage) = session.stage.clone() else {
            ui.weak("The source does not say on which field it is.");
            return;
        };
        let half = marks::half_extent(&stage.field);
        let line = ui.text_style_height(&egui::TextStyle::Body) + 6.0;
        let area = Vec2::new(
            ui.available_width().max(1.0),
            (ui.available_height() - line).max(1.0),
        );
        let (response, painter) = ui.allocate_painter(area, Sense::click_and_drag());
        let before = OnScreen::new(self.view.placed(response.rect, 2.0 * half), half);
        self.catch(&response, session, &before);
        let pans = self.held.is_none() && !self.measuring;
        let placed = self.view.follow(ui, &response, 2.0 * half, pans);
        let screen = OnScreen::new(placed, half);
        self.drag(ui, &response, session, &screen);
        let painter = painter.with_clip_rect(response.rect);
        let carpet = marks::carpet(&screen, &stage.field);
        paint_around(&painter, response.rect, carpet, ink::SURROUND);
        let layer = self.ground(ui, &painter, session, (&stage, &screen));
        marks::draw_field(&painter, &screen, &stage.field, !layer);
        self.paths(&painter, &screen, session);
        if let Some(now) = &session.now {
            self.beliefs(&painter, &screen, &now.cycle, &now.particles);
            self.around(&painter, &screen, &now.cycle);
            self.followed(&painter, &screen, &now.cycle);
        }
        self.measure(&painter, &screen);
        painter.text(
            response.rect.left_top() + Vec2::new(6.0, 4.0),
            Align2::LEFT_TOP,
            self.words(session),
            FontId::proportional(13.0),
            Color32::WHITE,
        );
        match response.hover_pos() {
            Some(pointer) => {
                let at = screen.field(pointer);
                ui.label(format!("{:.2}, {:.2} m{}", at.x, at.y, self.length()));
            }
            None if session.source.simulation().is_some() => {
                ui.weak("Drag a robot or the ball to put it elsewhere; scroll while dragging turns a robot.");
            }
            None => {
                ui.weak("Scroll zooms, drag pans, double-click shows all.");
            }
        }
    }

    fn switches(&mut self, ui: &mut Ui, session: &Session) {
        let shows = &mut self.shows;
        ui.horizontal_wrapped(|ui| {
            ui.menu_button("Layers", |ui| {
                for (name, shown) in [
                    ("Line points", &mut shows.points),
                    ("Trail", &mut shows.trail),
                    ("Truth", &mut shows.truth),
                    ("Covariance", &mut shows.covariance),
                    ("Hypotheses", &mut shows.hypotheses),
                    ("Particles", &mut shows.particles),
                    ("Ball and robots", &mut shows.objects),
                    ("Recomputed run", &mut shows.recomputed),
                ] {
                    ui.checkbox(shown, name);
                }
                ui.add(
                    egui::Slider::new(&mut shows.trail_s, 1.0..=600.0)
                        .logarithmic(true)
                        .suffix(" s")
                        .text("trail"),
                );
            });
            for (name, ground) in [
                ("Carpet", Ground::Carpet),
                ("Distance field", Ground::Distance),
                ("Error landscape", Ground::Landscape),
            ] {
                ui.selectable_value(&mut shows.ground, ground, name);
            }
            if ui.toggle_value(&mut self.measuring, "Measure").clicked() {
                self.measured = None;
            }
            if session.recompute.is_some() {
                ui.toggle_value(&mut shows.recomputed, "Recomputed");
            }
        });
    }

    /// The layer on the carpet; true if there is one.
    fn ground(
        &mut self,
        ui: &Ui,
        painter: &egui::Painter,
        session: &Session,
        (stage, screen): (&Stage, &OnScreen),
    ) -> bool {
        let painted = &session.painted;
        let image = match self.shows.ground {
            Ground::Carpet => None,
            Ground::Distance => painted.distance.as_ref(),
            Ground::Landscape => painted.landscape.as_ref(),
        };
        let Some(image) = image else {
            return false;
        };
        let (known, handle) = self.layer.get_or_insert_with(|| {
            let handle = ui.load_texture("ground", image.clone(), TextureOptions::LINEAR);
            (image.clone(), handle)
        });
        if !Arc::ptr_eq(known, image) {
            handle.set(image.clone(), TextureOptions::LINEAR);
            *known = image.clone();
        }
        let (half_x, half_y) = stage.field.carpet_half_extent();
        let rect = Rect::from_two_pos(
            screen.at(At::new(-half_x, half_y)),
            screen.at(At::new(half_x, -half_y)),
        );
        let uv = Rect::from_min_max(Pos2::ZERO, Pos2::new(1.0, 1.0));
        painter.image(handle.id(), rect, uv, Color32::WHITE);
        true
    }

    fn paths(&self, painter: &egui::Painter, screen: &OnScreen, session: &Session) {
        if !self.shows.trail {
            return;
        }
        let at = session.time().unwrap_or(session.clock.at);
        let recent = session.series.between(at - self.shows.trail_s, at);
        // The one sample beyond the end is the future.
        let past = recent.iter().filter(|sample| sample.time <= at);
        if self.shows.truth {
            let places = past.clone().map(|sample| sample.truth);
            let stroke = Stroke::new(3.0, ink::TRUTH.gamma_multiply(0.7));
            marks::draw_path(painter, screen, places, stroke);
        }
        let places = past.map(|sample| sample.pose);
        marks::draw_path(painter, screen, places, Stroke::new(1.6, ink::ESTIMATE));
        if let (true, Some(recompute)) = (self.shows.recomputed, &session.recompute) {
            let again = recompute.series.between(at - self.shows.trail_s, at);
            let places = again.iter().filter(|s| s.time <= at).map(|s| s.pose);
            marks::draw_path(painter, screen, places, Stroke::new(1.6, ink::PURPLE));
            if let Some(last) = recompute.series.at(at).filter(|s| s.pose[0].is_finite()) {
                let pose = Pose::new(last.pose[0], last.pose[1], last.pose[2]);
                marks::draw_robot(painter, screen, pose, ink::PURPLE, 1.6);
            }
        }
    }

    /// What the robot believes of its place.
    fn beliefs(
        &self,
        painter: &egui::Painter,
        screen: &OnScreen,
        cycle: &Cycle,
        particles: &[Pose],
    ) {
        let estimate = &cycle.estimate;
        if self.shows.particles {
            for particle in particles {
                painter.circle_filled(screen.at(particle.origin()), 1.5, ink::YELLOW);
            }
        }
        if self.shows.hypotheses {
            for other in &estimate.runners_up {
                let colour = ink::PURPLE;
                marks::draw_robot(painter, screen, other.pose, colour, 1.2);
                let text = format!("{:.0} %", 100.0 * other.probability);
                marks::draw_text(painter, screen.at(other.pose.origin()), &text, colour);
            }
        }
        let truth = cycle.inputs.truth.as_ref().filter(|_| self.shows.truth);
        if let Some(truth) = truth {
            marks::draw_robot(painter, screen, truth.pose, ink::TRUTH, 3.0);
        }
        let Some(pose) = estimate.pose else {
            return;
        };
        if self.shows.points {
            for point in &cycle.line_points {
                painter.circle_filled(screen.at(pose * point.at), 1.8, ink::LINE_POINT);
            }
        }
        marks::draw_robot(painter, screen, pose, ink::ESTIMATE, 2.2);
        if let Some([vx, vy]) = velocity(cycle) {
            let (sin, cos) = pose.theta.sin_cos();
            let along = [cos * vx - sin * vy, sin * vx + cos * vy];
            marks::draw_velocity(painter, screen, pose.origin(), along, ink::ESTIMATE);
        }
        if self.shows.covariance {
            marks::draw_covariance(painter, screen, pose, &estimate.covariance, ink::ESTIMATE);
        }
    }

    /// Ball and robots: as they truly are (rims), and as the robot sees them (filled).
    fn around(&self, painter: &egui::Painter, screen: &OnScreen, cycle: &Cycle) {
        if !self.shows.objects {
            return;
        }
        let scale = screen.scale();
        if let Some(truth) = cycle.inputs.truth.as_ref().filter(|_| self.shows.truth) {
            for other in &truth.robots {
                let radius = marks::ROBOT_RADIUS * scale;
                painter.circle_stroke(screen.at(*other), radius, (1.5, ink::GREY));
            }
            if let Some(ball) = truth.ball {
                let radius = (marks::BALL_RADIUS * scale).max(4.0);
                painter.circle_stroke(screen.at(ball), radius, (1.5, ink::BALL));
            }
        }
        let (Some(pose), Some(seen)) = (cycle.estimate.pose, &cycle.detections) else {
            return;
        };
        for robot in &seen.robots {
            let radius = (0.6 * marks::ROBOT_RADIUS * scale).max(3.0);
            painter.circle_filled(screen.at(pose * robot.at), radius, ink::ROBOT);
        }
        if let Some(ball) = &seen.ball {
            let radius = (marks::BALL_RADIUS * scale).max(3.0);
            painter.circle_filled(screen.at(pose * ball.at), radius, ink::BALL);
        }
    }

    /// What is followed from frame to frame, with its velocity a second long, and the team-mates that were heard.
    fn followed(&self, painter: &egui::Painter, screen: &OnScreen, cycle: &Cycle) {
        if !self.shows.objects {
            return;
        }
        for robot in cycle.world.robots.iter().filter_map(|robot| robot.on_field) {
            marks::draw_velocity(painter, screen, robot.at, robot.velocity, ink::ROBOT);
        }
        if let Some(ball) = cycle.world.ball.and_then(|ball| ball.on_field) {
            marks::draw_velocity(painter, screen, ball.at, ball.velocity, ink::BALL);
        }
        if let Some(ball) = &cycle.team.ball {
            let radius = (2.0 * marks::BALL_RADIUS * screen.scale()).max(7.0);
            painter.circle_stroke(screen.at(ball.at), radius, (1.0, ink::BALL));
        }
        for mate in &cycle.team.teammates {
            if let Some(pose) = mate.pose {
                marks::draw_robot(painter, screen, pose, ink::GREEN, 1.6);
                let text = format!("{} ({:.1} s ago)", mate.robot, mate.age);
                marks::draw_text(painter, screen.at(pose.origin()), &text, ink::GREEN);
            }
        }
    }

    fn catch(&mut self, response: &Response, session: &Session, screen: &OnScreen) {
        if !response.drag_started() || self.measuring || session.source.simulation().is_none() {
            return;
        }
        let (Some(pointer), Some(now)) = (response.interact_pointer_pos(), &session.now) else {
            return;
        };
        // Where it was pressed, not where the drag was first noticed.
        let pressed = pointer - response.drag_delta();
        let Some(truth) = &now.cycle.inputs.truth else {
            return;
        };
        let near = |at: At<FieldFrame>, radius: f32| {
            let distance = screen.at(at).distance(pressed);
            (distance < (radius * screen.scale()).max(CATCH)).then_some(distance)
        };
        let robot = near(truth.pose.origin(), marks::ROBOT_RADIUS)
            .map(|distance| (distance, Held::Robot(truth.pose)));
        let ball = truth
            .ball
            .and_then(|at| near(at, marks::BALL_RADIUS))
            .map(|distance| (distance, Held::Ball));
        let others = truth.robots.iter().enumerate().filter_map(|(number, at)| {
            near(*at, marks::ROBOT_RADIUS).map(|distance| (distance, Held::Other(number)))
        });
        let nearest = robot.into_iter().chain(ball).chain(others);
        self.held = nearest
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .map(|(_, held)| held);
    }

    /// Moves what is held, or the tape measure.
    fn drag(&mut self, ui: &Ui, response: &Response, session: &Session, screen: &OnScreen) {
        let Some(pointer) = response.interact_pointer_pos() else {
            self.held = None;
            return;
        };
        let at = screen.field(pointer);
        if self.measuring {
            if response.drag_started() {
                self.measured = Some([screen.field(pointer - response.drag_delta()), at]);
            } else if let (true, Some([_, to])) = (response.dragged(), &mut self.measured) {
                *to = at;
            }
            return;
        }
        let (Some(held), Some(worker)) = (&mut self.held, session.source.simulation()) else {
            return;
        };
        match held {
            Held::Robot(pose) => {
                let turn = ui.input(|input| input.smooth_scroll_delta().y) * TURN_DEG;
                *pose = Pose::new(at.x, at.y, pose.theta + turn.to_radians());
                worker.order(Order::Kidnap(*pose));
            }
            Held::Ball => worker.order(Order::Ball(at, [0.0; 2])),
            Held::Other(number) => {
                worker.order(Order::MoveOther(*number, Pose::new(at.x, at.y, 0.0)));
            }
        }
        if response.drag_stopped() {
            self.held = None;
        }
    }

    fn measure(&self, painter: &egui::Painter, screen: &OnScreen) {
        if let (true, Some([from, to])) = (self.measuring, self.measured) {
            let ends = [from, to].map(|at| screen.at(at));
            painter.line_segment(ends, Stroke::new(2.0, Color32::WHITE));
            let text = format!("{:.2} m", from.distance_to(to));
            marks::draw_text(painter, ends[1], &text, Color32::WHITE);
        }
    }

    fn length(&self) -> String {
        match self.measured {
            Some([from, to]) if self.measuring => format!(
                "   measured {:.3} m (dx {:.3}, dy {:.3})",
                from.distance_to(to),
                to.x - from.x,
                to.y - from.y
            ),
            _ => String::new(),
        }
    }

    fn words(&self, session: &Session) -> String {
        let Some(now) = &session.now else {
            return "no cycle yet".to_owned();
        };
        let estimate = &now.cycle.estimate;
        let mut words = pipeline::log::mode_and_reason(estimate);
        if let Some(pose) = estimate.pose {
            let std = |axis: usize| 100.0 * estimate.covariance[(axis, axis)].max(0.0).sqrt();
            words += &format!(
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
                words += &format!("\noff the truth by {:.1} cm", 100.0 * error);
            }
        }
        words
    }
}

/// How fast odometry says the robot goes, robot frame, m/s.
fn velocity(cycle: &Cycle) -> Option<[f32; 2]> {
    let (first, rest) = cycle.inputs.odometry.split_first()?;
    let span = (rest.last()?.stamp - first.stamp) as f32;
    let sum = |part: fn(&localize::sample::Odometry) -> f32| rest.iter().map(part).sum::<f32>();
    (span > 0.0).then(|| [sum(|o| o.dx) / span, sum(|o| o.dy) / span])
}
