//! Vector marks over the camera image and the bird's-eye view: points, objects and projected lines.

use std::f32::consts::TAU;

use eframe::egui::{Align2, Color32, FontId, Pos2, Rect, Stroke, Ui, Vec2};
use localize::At;
use localize::frames::RobotFrame;
use localize::world::TeamColour;
use vision::config::ImageRect;
use vision::lines::detection::RejectionReason;
use vision::objects::goals::GoalKind;

use super::camera_layers::CameraLayers;
use super::carpet_boundary::CarpetBoundary;
use super::field_marks::draw_selection;
use super::projected_markings::ProjectedMarkings;
use crate::view::birds_eye::{BIRDS_EYE_HALF_EXTENT, BIRDS_EYE_SIDE_PX};
use crate::view::labels::Labels;
use crate::view::palette;
use crate::view::panzoom::ScreenTransform;
use crate::view::pen::Pen;
use crate::view::selection::Selection;
use crate::view::static_scene::StaticScene;
use pipeline::Cycle;

/// Ranges of the ground grid's rings, metres.
const RINGS: [f32; 7] = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0];
/// Segments of a ring.
const RING_STEPS: usize = 96;
/// Room between a thing and its label, points.
const LABEL_OFFSET: Vec2 = Vec2::new(0.0, -10.0);
/// Bearing rays of the ground grid.
const RAYS: usize = 12;

/// Inputs of the drawing functions.
pub(crate) struct CameraCanvas<'a> {
    pub(crate) pen: &'a Pen,
    pub(crate) transform: ScreenTransform,
    pub(crate) scene: &'a StaticScene,
    pub(crate) cycle: &'a Cycle,
    pub(crate) layers: &'a CameraLayers,
    /// The field's lines in the image of this cycle.
    pub(crate) projected: &'a ProjectedMarkings,
    /// Where the carpet ends in it.
    pub(crate) boundary: &'a CarpetBoundary,
    pub(crate) labels: Labels,
    /// Names and windows of the virtual sensors.
    pub(crate) virtual_sensors: &'a [(&'static str, ImageRect)],
}

impl CameraCanvas<'_> {
    /// Screen position of a pixel's centre.
    fn to_screen(&self, [u, v]: [f32; 2]) -> Pos2 {
        self.transform.to_screen(u + 0.5, v + 0.5)
    }

    /// Screen position of a ground point in the camera image; None if it is not visible.
    fn project_to_screen(&self, at: At<RobotFrame>) -> Option<Pos2> {
        let camera = self.scene.camera.as_ref()?;
        let pixel = camera.project(at, self.cycle.estimate.tilt, None)?;
        Some(self.to_screen(pixel))
    }

    /// Rings the selected object.
    pub(crate) fn draw_selection(&self, selection: Option<Selection>, birds_eye: bool) {
        let height = self.scene.camera.as_ref();
        let height = height.map(|camera| camera.viewpoint_height);
        let place = selection.and_then(|selection| selection.place(self.cycle, height));
        let Some((place, pose)) = place.zip(self.cycle.estimate.pose) else {
            return;
        };
        let on_robot = pose.inverse() * place;
        let at = if birds_eye {
            Some(self.birds_eye_to_screen(on_robot))
        } else {
            self.project_to_screen(on_robot)
        };
        if let Some(at) = at {
            draw_selection(self.pen, at);
        }
    }

    /// Screen position of a ground point in the bird's-eye view.
    fn birds_eye_to_screen(&self, at: At<RobotFrame>) -> Pos2 {
        let per_metre = BIRDS_EYE_SIDE_PX as f32 / (2.0 * BIRDS_EYE_HALF_EXTENT);
        self.transform.to_screen(
            (BIRDS_EYE_HALF_EXTENT - at.y) * per_metre,
            (BIRDS_EYE_HALF_EXTENT - at.x) * per_metre,
        )
    }

    fn draw_plus(&self, at: Pos2, arm: f32, colour: Color32) {
        self.pen.plus(at, arm, Stroke::new(1.6, colour));
    }

    fn draw_x(&self, at: Pos2, arm: f32, colour: Color32) {
        self.pen.diagonal_cross(at, arm, Stroke::new(1.2, colour));
    }

    fn label(&self, at: Pos2, text: String, colour: Color32) {
        let place = (at, LABEL_OFFSET);
        self.labels
            .add(self.pen, place, Align2::CENTER_BOTTOM, text, colour);
    }
}

/// Draws the marks over the camera image.
pub(crate) fn draw_image_overlay(canvas: &CameraCanvas<'_>) {
    draw_image_marks(canvas);
    canvas.labels.draw(canvas.pen);
}

fn draw_image_marks(canvas: &CameraCanvas<'_>) {
    let layers = canvas.layers;
    if layers.grid {
        grid(canvas);
    }
    if layers.field_lines {
        let stroke = Stroke::new(1.4, palette::PROJECTED_LINE);
        for line in canvas.projected.lines() {
            let places = line.iter().map(|at| canvas.to_screen(*at));
            canvas.pen.line(places, stroke);
        }
    }
    if layers.virtual_sensors {
        draw_virtual_sensors(canvas);
    }
    let Some(detections) = &canvas.cycle.detections else {
        if layers.line_points {
            // Line points of an external vision have no pixel position.
            for point in &canvas.cycle.line_points {
                if let Some(at) = canvas.project_to_screen(point.at) {
                    canvas.draw_plus(at, 3.0, palette::LINE_POINT);
                }
            }
        }
        return;
    };
    if layers.carpet_end {
        for at in canvas.boundary.places() {
            canvas.pen.disc(canvas.to_screen(*at), 1.8, palette::ORANGE);
        }
    }
    if layers.rejected_candidates {
        for candidate in &detections.rejected_candidates {
            let (colour, _) = palette::rejection_style(candidate.reason);
            canvas.draw_x(canvas.to_screen(candidate.position_px), 2.5, colour);
        }
    }
    if layers.line_points {
        for point in &detections.line_points {
            canvas.draw_plus(
                canvas.to_screen(point.position_px),
                3.0,
                palette::LINE_POINT,
            );
        }
    }
    objects(canvas);
}

fn objects(canvas: &CameraCanvas<'_>) {
    let (layers, pen) = (canvas.layers, canvas.pen);
    let Some(detections) = &canvas.cycle.detections else {
        return;
    };
    if let (true, Some(ball)) = (layers.ball, &detections.ball) {
        let at = canvas.to_screen(ball.position_px);
        pen.circle(at, 9.0, (2.5, palette::BALL));
        let air = if ball.on_ground { "" } else { ", in the air" };
        let text = format!("ball {:.1} m{air}", ball.at.distance());
        canvas.label(at, text, palette::BALL);
    }
    if layers.robots {
        for robot in &detections.robots {
            let at = canvas.to_screen(robot.position_px);
            let half = Vec2::splat(7.0);
            pen.rect_rim(
                Rect::from_min_max(at - half, at + half),
                (2.0, palette::ROBOT),
            );
            let team = match robot.marker {
                Some(TeamColour::Cyan) => " cyan",
                Some(TeamColour::Magenta) => " magenta",
                None => "",
            };
            let text = format!("robot{team} {:.1} m", robot.at.distance());
            canvas.label(at, text, palette::ROBOT);
        }
    }
    if layers.goals {
        for goal in &detections.goals {
            let at = canvas.to_screen(goal.position_px);
            canvas.draw_plus(at, 8.0, palette::GOAL);
            let kind = match goal.kind {
                GoalKind::Blue => "blue goal",
                GoalKind::Yellow => "yellow goal",
                GoalKind::Post => "post",
            };
            canvas.label(at, kind.to_owned(), palette::GOAL);
        }
    }
}

/// Draws the marks over the bird's-eye view.
pub(crate) fn draw_birds_eye_overlay(canvas: &CameraCanvas<'_>) {
    draw_birds_eye_marks(canvas);
    canvas.labels.draw(canvas.pen);
}

fn draw_birds_eye_marks(canvas: &CameraCanvas<'_>) {
    let per_metre = BIRDS_EYE_SIDE_PX as f32 / (2.0 * BIRDS_EYE_HALF_EXTENT);
    let to_screen = |at: At<RobotFrame>| canvas.birds_eye_to_screen(at);
    let layers = canvas.layers;
    let scale = per_metre * canvas.transform.scale;
    if layers.grid {
        for ring in RINGS {
            let stroke = Stroke::new(1.0, palette::PROJECTED_LINE.gamma_multiply(0.6));
            let centre = to_screen(At::new(0.0, 0.0));
            canvas.pen.circle(centre, ring * scale, stroke);
            let at = to_screen(At::new(ring, 0.0));
            canvas.label(at, format!("{ring:.0} m"), palette::PROJECTED_LINE);
        }
    }
    if let (true, Some(pose)) = (layers.field_lines, canvas.cycle.estimate.pose) {
        let robot_from_field = pose.inverse();
        let stroke = Stroke::new(1.4, palette::PROJECTED_LINE);
        for [from, to] in super::field_drawing::marking_segments(&canvas.scene.field) {
            let ends = [from, to].map(|at| to_screen(robot_from_field * at));
            canvas.pen.segment(ends, stroke);
        }
    }
    if layers.line_points {
        let correction = canvas.cycle.estimate.map_correction.as_ref();
        let camera = canvas.scene.camera.as_ref();
        let correction = camera.and_then(|camera| camera.prepare_correction(correction));
        for point in &canvas.cycle.line_points {
            let at = correction.as_ref().map_or(point.at, |correction| {
                let [x, y] = correction.displace([point.at.x, point.at.y]).at;
                At::new(x, y)
            });
            canvas.draw_plus(to_screen(at), 3.0, palette::LINE_POINT);
        }
    }
    let Some(detections) = &canvas.cycle.detections else {
        return;
    };
    if let (true, Some(ball)) = (layers.ball, &detections.ball) {
        let stroke = (2.0, palette::BALL);
        canvas.pen.circle(to_screen(ball.at), 0.11 * scale, stroke);
    }
    if layers.robots {
        for robot in &detections.robots {
            let stroke = (2.0, palette::ROBOT);
            canvas.pen.circle(to_screen(robot.at), 0.25 * scale, stroke);
        }
    }
}

/// Draws the windows of the virtual sensors; active ones are highlighted.
fn draw_virtual_sensors(canvas: &CameraCanvas<'_>) {
    let readings = canvas
        .cycle
        .detections
        .as_ref()
        .map(|detections| &detections.virtual_sensors);
    let mut bumpers = readings
        .map(|readings| readings.bumpers.iter())
        .into_iter()
        .flatten();
    for (name, window) in canvas.virtual_sensors {
        let active = match *name {
            "bumper" => bumpers.next().is_some_and(|bumper| bumper.hit),
            "kick" => readings.is_some_and(|readings| readings.kick),
            "ball" => readings.is_some_and(|readings| readings.ball_px.is_some()),
            "lens" => readings.is_some_and(|readings| readings.lens_centred == Some(true)),
            _ => readings.is_some_and(|readings| {
                let inside = |goal: Option<[f32; 2]>| goal.is_some_and(|at| window.contains(at));
                inside(readings.blue_goal_px) || inside(readings.yellow_goal_px)
            }),
        };
        let (left, top) = (window.left_px, window.top_px);
        let corners = [
            [left, top],
            [left + window.width_px, top + window.height_px],
        ];
        let [from, to] = corners.map(|[u, v]| canvas.transform.to_screen(u, v));
        let rect = Rect::from_two_pos(from, to);
        let (width, colour) = if active {
            (3.0, palette::YELLOW)
        } else {
            (1.2, palette::SKY)
        };
        canvas.pen.rect_rim(rect, (width, colour));
        let font = FontId::proportional(11.0);
        let place = rect.left_top();
        canvas
            .pen
            .text(place, Align2::LEFT_BOTTOM, *name, font, colour);
    }
}

fn grid(canvas: &CameraCanvas<'_>) {
    let stroke = Stroke::new(1.0, palette::PROJECTED_LINE.gamma_multiply(0.6));
    let join = |points: &mut dyn Iterator<Item = At<RobotFrame>>| {
        let mut last = None;
        for at in points {
            let here = canvas.project_to_screen(at);
            if let (Some(from), Some(to)) = (last, here) {
                canvas.pen.segment([from, to], stroke);
            }
            last = here;
        }
    };
    let polar = |range: f32, angle: f32| At::new(range * angle.cos(), range * angle.sin());
    for ring in RINGS {
        let angle = |step: usize| TAU * step as f32 / RING_STEPS as f32;
        join(&mut (0..=RING_STEPS).map(|step| polar(ring, angle(step))));
        if let Some(at) = canvas.project_to_screen(polar(ring, 0.0)) {
            canvas.label(at, format!("{ring:.0} m"), palette::PROJECTED_LINE);
        }
    }
    for ray in 0..RAYS {
        let angle = TAU * ray as f32 / RAYS as f32;
        join(&mut (1..=20).map(|step| polar(0.4 * step as f32, angle)));
    }
}

/// Draws the legend of the marks and colours.
pub(crate) fn show_legend(ui: &mut Ui) {
    let row = |ui: &mut Ui, symbol: &str, colour: Color32, text: &str| {
        ui.horizontal(|ui| {
            ui.colored_label(colour, symbol);
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
        row(ui, "x", colour, &format!("rejected: {text}"));
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
