//! What does dragging on the field do? It moves an object of the view's own simulation, or measures a distance.

use eframe::egui::{Color32, Response, Stroke, Ui};
use localize::frames::FieldFrame;
use localize::{At, Pose};

use super::field_drawing::{self as drawing, FieldTransform};
use crate::view::pen::Pen;
use crate::view::session::Session;
use crate::view::source::sim_worker::SourceRequest;

/// Least pick radius of the pointer, points.
const PICK_RADIUS: f32 = 18.0;
/// Rotation of a dragged robot, degrees per scrolled point.
const TURN_DEG_PER_SCROLL_POINT: f32 = 0.5;

/// The object that the pointer drags.
#[derive(Debug, Clone, Copy, PartialEq)]
enum DraggedObject {
    Robot(Pose),
    Ball,
    OtherRobot(usize),
}

/// What the pointer drags or measures.
#[derive(Default)]
pub(super) struct FieldDrag {
    dragged: Option<DraggedObject>,
    pub(super) measuring: bool,
    /// Start and end of the measured distance.
    pub(super) measurement: Option<[At<FieldFrame>; 2]>,
}

impl FieldDrag {
    /// True if dragging moves the picture.
    pub(super) fn pans(&self) -> bool {
        self.dragged.is_none() && !self.measuring
    }

    /// Takes the object that the pointer presses.
    pub(super) fn start(
        &mut self,
        response: &Response,
        session: &Session,
        screen: &FieldTransform,
    ) {
        if !response.drag_started() || self.measuring || session.source.simulation().is_none() {
            return;
        }
        let (Some(pointer), Some(now)) = (response.interact_pointer_pos(), &session.shown) else {
            return;
        };
        // Use the press position: egui reports a drag only after some movement.
        let pressed = pointer - response.drag_delta();
        let Some(truth) = &now.cycle.inputs.truth else {
            return;
        };
        let distance_if_near = |at: At<FieldFrame>, radius: f32| {
            let distance = screen.to_screen(at).distance(pressed);
            (distance < (radius * screen.scale()).max(PICK_RADIUS)).then_some(distance)
        };
        let robot = distance_if_near(truth.pose.origin(), drawing::ROBOT_RADIUS)
            .map(|distance| (distance, DraggedObject::Robot(truth.pose)));
        let ball = truth
            .ball
            .and_then(|at| distance_if_near(at, drawing::BALL_RADIUS))
            .map(|distance| (distance, DraggedObject::Ball));
        let others = truth.robots.iter().enumerate().filter_map(|(number, at)| {
            distance_if_near(*at, drawing::ROBOT_RADIUS)
                .map(|distance| (distance, DraggedObject::OtherRobot(number)))
        });
        let nearest = robot.into_iter().chain(ball).chain(others);
        self.dragged = nearest
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .map(|(_, object)| object);
    }

    /// Moves the dragged object or the measured distance.
    pub(super) fn update(
        &mut self,
        ui: &Ui,
        response: &Response,
        session: &Session,
        screen: &FieldTransform,
    ) {
        let Some(pointer) = response.interact_pointer_pos() else {
            self.dragged = None;
            return;
        };
        let at = screen.to_field(pointer);
        if self.measuring {
            if response.drag_started() {
                self.measurement = Some([screen.to_field(pointer - response.drag_delta()), at]);
            } else if let (true, Some([_, to])) = (response.dragged(), &mut self.measurement) {
                *to = at;
            }
            return;
        }
        let (Some(object), Some(worker)) = (&mut self.dragged, session.source.simulation()) else {
            return;
        };
        match object {
            DraggedObject::Robot(pose) => {
                let rotation_deg =
                    ui.input(|input| input.smooth_scroll_delta().y) * TURN_DEG_PER_SCROLL_POINT;
                *pose = Pose::new(at.x, at.y, pose.theta + rotation_deg.to_radians());
                worker.request(SourceRequest::Kidnap(*pose));
            }
            DraggedObject::Ball => worker.request(SourceRequest::PlaceBall(at, [0.0; 2])),
            DraggedObject::OtherRobot(number) => {
                worker.request(SourceRequest::PlaceOther(
                    *number,
                    Pose::new(at.x, at.y, 0.0),
                ));
            }
        }
        if response.drag_stopped() {
            self.dragged = None;
        }
    }

    pub(super) fn draw_measurement(&self, pen: &Pen, screen: &FieldTransform) {
        if let (true, Some([from, to])) = (self.measuring, self.measurement) {
            let ends = [from, to].map(|at| screen.to_screen(at));
            pen.segment(ends, Stroke::new(2.0, Color32::WHITE));
            let text = format!("{:.2} m", from.distance_to(to));
            drawing::draw_text(pen, ends[1], &text, Color32::WHITE);
        }
    }

    /// Text of the measured distance.
    pub(super) fn length(&self) -> String {
        match self.measurement {
            Some([from, to]) if self.measuring => format!(
                "   measured {:.3} m (dx {:.3}, dy {:.3})",
                from.distance_to(to),
                to.x - from.x,
                to.y - from.y
            ),
            _ => String::new(),
        }
    }
}
