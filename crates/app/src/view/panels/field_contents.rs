//! What lies on the field: trails, estimate, truth, objects, team and other runs.

use eframe::egui::{Align2, Color32, Stroke};
use localize::frames::wrap_angle;
use localize::{At, FieldFrame, Pose};
use pipeline::Cycle;

use super::field_drawing::{self as drawing, FieldTransform};
use super::field_layers::FieldLayers;
use super::field_marks;
use crate::view::ground_placement::GroundPlacement;
use crate::view::labels::Labels;
use crate::view::palette;
use crate::view::pen::Pen;
use crate::view::session::{NO_ESTIMATE, Session};

/// Inputs of the drawing functions.
pub(super) struct FieldCanvas<'a> {
    pub(super) pen: &'a Pen,
    pub(super) screen: &'a FieldTransform,
    pub(super) layers: &'a FieldLayers,
    pub(super) session: &'a Session,
    pub(super) labels: &'a Labels,
}

impl FieldCanvas<'_> {
    /// Draws the trails of estimate, truth and recomputed run.
    pub(super) fn draw_trails(&self) {
        let FieldCanvas {
            pen,
            screen,
            layers,
            session,
            ..
        } = *self;
        if !layers.trail {
            return;
        }
        let at = session.shown_time().unwrap_or(session.playback.time);
        let recent = session.series.between(at - layers.trail_s, at);
        // `between` returns one sample after `at`, which must not be drawn.
        let past = recent.iter().filter(|sample| sample.time <= at);
        if layers.truth {
            let places = past.clone().map(|sample| sample.truth);
            let stroke = Stroke::new(3.0, palette::TRUTH.gamma_multiply(0.7));
            drawing::draw_trail(pen, screen, places, stroke);
        }
        let places = past.map(|sample| sample.pose);
        drawing::draw_trail(pen, screen, places, Stroke::new(1.6, palette::ESTIMATE));
        if let (true, Some(recompute)) = (layers.recomputed, &session.recompute) {
            let recomputed = recompute.series.between(at - layers.trail_s, at);
            let places = recomputed.iter().filter(|s| s.time <= at).map(|s| s.pose);
            drawing::draw_trail(pen, screen, places, Stroke::new(1.6, palette::PURPLE));
            if let Some(last) = recompute.series.at(at).filter(|s| s.pose[0].is_finite()) {
                let pose = Pose::new(last.pose[0], last.pose[1], last.pose[2]);
                drawing::draw_robot(pen, screen, pose, palette::PURPLE, 1.6);
            }
        }
    }

    /// Draws the estimate: particles, hypotheses, pose, velocity and covariance.
    pub(super) fn draw_estimate(&self, cycle: &Cycle, particles: &[Pose]) {
        let FieldCanvas {
            pen,
            screen,
            layers,
            session,
            ..
        } = *self;
        let estimate = &cycle.estimate;
        if layers.particles {
            for particle in particles {
                pen.disc(screen.to_screen(particle.origin()), 1.5, palette::YELLOW);
            }
        }
        if layers.hypotheses {
            for other in &estimate.runners_up {
                let colour = palette::PURPLE;
                drawing::draw_robot(pen, screen, other.pose, colour, 1.2);
                let text = format!("{:.0} %", 100.0 * other.probability);
                self.label(other.pose.origin(), text, colour);
            }
        }
        let truth = cycle.inputs.truth.as_ref().filter(|_| layers.truth);
        if let Some(truth) = truth {
            drawing::draw_robot(pen, screen, truth.pose, palette::TRUTH, 3.0);
        }
        let Some(pose) = estimate.pose else {
            return;
        };
        let seen = GroundPlacement::of(cycle, session.viewpoint_height());
        if let (true, Some(seen)) = (layers.line_points, seen) {
            for point in &cycle.line_points {
                let place = screen.to_screen(seen.place(point.at));
                pen.disc(place, 1.8, palette::LINE_POINT);
            }
        }
        drawing::draw_robot(pen, screen, pose, palette::ESTIMATE, 2.2);
        if let Some([vx, vy]) = odometry_velocity(cycle) {
            let (sin, cos) = pose.theta.sin_cos();
            let along = [cos * vx - sin * vy, sin * vx + cos * vy];
            drawing::draw_velocity(pen, screen, pose.origin(), along, palette::ESTIMATE);
        }
        if layers.covariance {
            drawing::draw_covariance(pen, screen, pose, &estimate.covariance, palette::ESTIMATE);
        }
    }

    /// Draws ball and robots: ground truth as circles, detections as discs.
    pub(super) fn draw_objects(&self, cycle: &Cycle) {
        let FieldCanvas {
            pen,
            screen,
            layers,
            session,
            ..
        } = *self;
        if !layers.objects {
            return;
        }
        let scale = screen.scale();
        if let Some(truth) = cycle.inputs.truth.as_ref().filter(|_| layers.truth) {
            for other in &truth.robots {
                let radius = drawing::ROBOT_RADIUS * scale;
                pen.circle(screen.to_screen(*other), radius, (1.5, palette::GREY));
            }
            if let Some(ball) = truth.ball {
                let radius = (drawing::BALL_RADIUS * scale).max(4.0);
                pen.circle(screen.to_screen(ball), radius, (1.5, palette::BALL));
            }
        }
        let seen = GroundPlacement::of(cycle, session.viewpoint_height());
        let (Some(seen), Some(detections)) = (seen, &cycle.detections) else {
            return;
        };
        for robot in &detections.robots {
            let radius = (0.6 * drawing::ROBOT_RADIUS * scale).max(3.0);
            pen.disc(
                screen.to_screen(seen.place(robot.at)),
                radius,
                palette::ROBOT,
            );
        }
        if let Some(ball) = &detections.ball {
            let radius = (drawing::BALL_RADIUS * scale).max(3.0);
            pen.disc(screen.to_screen(seen.place(ball.at)), radius, palette::BALL);
        }
    }

    /// Draws the tracked objects' velocities (length: one second), the team ball and the teammates.
    pub(super) fn draw_tracks(&self, cycle: &Cycle) {
        let FieldCanvas {
            pen,
            screen,
            layers,
            ..
        } = *self;
        if !layers.objects {
            return;
        }
        for robot in cycle.world.robots.iter().filter_map(|robot| robot.on_field) {
            drawing::draw_velocity(pen, screen, robot.at, robot.velocity, palette::ROBOT);
        }
        if let Some(ball) = cycle.world.ball.and_then(|ball| ball.on_field) {
            drawing::draw_velocity(pen, screen, ball.at, ball.velocity, palette::BALL);
        }
        if let Some(flight) = cycle.world.ball_in_air.and_then(|ball| ball.on_field) {
            let [x, y, height] = flight.at;
            let at = screen.to_screen(At::new(x, y));
            let text = format!("{height:.1} m up");
            self.label(At::new(x, y), text, palette::BALL);
            if let Some(landing) = flight.landing {
                let [x, y] = landing.at;
                let end = screen.to_screen(At::new(x, y));
                pen.segment([at, end], (1.0, palette::BALL));
                pen.circle(end, 4.0, (1.0, palette::BALL));
            }
        }
        if let Some(ball) = &cycle.team.ball {
            let radius = (2.0 * drawing::BALL_RADIUS * screen.scale()).max(7.0);
            pen.circle(screen.to_screen(ball.at), radius, (1.0, palette::BALL));
        }
        for mate in &cycle.team.teammates {
            if let Some(pose) = mate.pose {
                drawing::draw_robot(pen, screen, pose, palette::GREEN, 1.6);
                let text = format!("{} ({:.1} s ago)", mate.robot, mate.age);
                self.label(pose.origin(), text, palette::GREEN);
            }
        }
    }

    /// Draws the poses and trails of the other runs.
    pub(super) fn draw_other_runs(&self) {
        let FieldCanvas {
            pen,
            screen,
            layers,
            session,
            ..
        } = *self;
        let at = session.shown_time().unwrap_or(session.playback.time);
        let from = at - if layers.trail { layers.trail_s } else { 0.0 };
        let pose = session
            .shown
            .as_ref()
            .and_then(|now| now.cycle.estimate.pose);
        for (number, other) in session.others.iter().enumerate() {
            let colour = palette::run_colour(number);
            let recent = other.series.between(from, at);
            let places = recent.iter().filter(|s| s.time <= at).map(|s| s.pose);
            drawing::draw_trail(pen, screen, places, Stroke::new(1.6, colour));
            if let Some(cycle) = &other.cycle {
                field_marks::draw_other_run(pen, screen, cycle, colour);
                let robot = session.source_config.team.number;
                let first = pose.filter(|_| !other.is_another_robot(&session.source, robot));
                self.label_other_run((&other.name, colour), cycle, first);
            }
        }
    }

    /// Names another run at its pose, with its difference from the `first` one's if both are runs of one robot.
    fn label_other_run(&self, (name, colour): (&str, Color32), cycle: &Cycle, first: Option<Pose>) {
        let Some(pose) = cycle.estimate.pose else {
            return;
        };
        let text = match first {
            Some(first) => format!(
                "{name}: {:.1} cm, {:.1}° apart",
                100.0 * pose.origin().distance_to(first.origin()),
                wrap_angle(pose.theta - first.theta).to_degrees().abs()
            ),
            None => name.to_owned(),
        };
        self.label(pose.origin(), text, colour);
    }

    fn label(&self, at: At<FieldFrame>, text: String, colour: Color32) {
        let place = (self.screen.to_screen(at), drawing::LABEL_OFFSET);
        self.labels
            .add(self.pen, place, Align2::LEFT_BOTTOM, text, colour);
    }
}

/// Mode, pose, its standard deviation and error of the shown cycle.
pub(super) fn status_text(session: &Session) -> String {
    let Some(now) = &session.shown else {
        return "no cycle yet".to_owned();
    };
    let estimate = &now.cycle.estimate;
    if !session.holds_poses {
        return NO_ESTIMATE.to_owned();
    }
    let mut text = pipeline::log::mode_and_advice(estimate);
    if let Some(certificate) = &estimate.certificate {
        text += &format!(
            "\nexplains {:.0} % of the points, no other pose more than {:.0} %",
            100.0 * certificate.answer_share,
            100.0 * certificate.others_share_max
        );
    }
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

/// Velocity from the cycle's odometry, robot frame, m/s.
fn odometry_velocity(cycle: &Cycle) -> Option<[f32; 2]> {
    let (first, rest) = cycle.inputs.odometry.split_first()?;
    let span = (rest.last()?.stamp - first.stamp) as f32;
    let sum = |part: fn(&localize::sample::Odometry) -> f32| rest.iter().map(part).sum::<f32>();
    (span > 0.0).then(|| [sum(|o| o.dx) / span, sum(|o| o.dy) / span])
}
