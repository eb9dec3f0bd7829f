//! Draws detections, rejected candidates and the field's lines at a pose into an image.

use localize::field::Marking;
use localize::frames::{At, FieldFrame, Pose, RobotFrame};
use localize::math;
use localize::tilt::ground_from_map;
use localize::world::TeamColour;

use crate::colour::lookup_table::ColourClass;
use crate::image::Image;
use crate::lines::detection::RejectionReason;
use crate::objects::goals::GoalKind;
use crate::optics::ground_map::GroundMap;
use crate::process::Detections;
use crate::scan::pattern::ScanPattern;

/// Red, green, blue.
pub type Rgb = [u8; 3];

/// Colour of line points.
pub const LINE_POINT_COLOUR: Rgb = [255, 0, 0];
/// Colour of the field's lines.
pub const FIELD_LINE_COLOUR: Rgb = [0, 90, 255];
/// Colour of the ball.
pub const BALL_COLOUR: Rgb = [255, 0, 255];
/// Colour of the carpet's boundary.
pub const CARPET_END_COLOUR: Rgb = [255, 160, 0];

/// Colour of a rejected candidate.
pub fn rejection_colour(reason: RejectionReason) -> Rgb {
    match reason {
        RejectionReason::NoAdjacentCarpet => [90, 90, 90],
        RejectionReason::TooNarrow => [255, 255, 0],
        RejectionReason::TooWide => [0, 255, 255],
        RejectionReason::TooFaint => [160, 160, 255],
        RejectionReason::NotWhite => [255, 0, 255],
        RejectionReason::BeyondCarpet => [255, 128, 0],
    }
}

/// Enlarges the image by an integer factor, so that marks hide less of it.
pub fn upscale(image: &Image, times: usize) -> Image {
    let times = times.max(1);
    let (width_px, height_px) = (image.width_px * times, image.height_px * times);
    let mut rgb = Vec::with_capacity(3 * width_px * height_px);
    for v in 0..height_px {
        for u in 0..width_px {
            let from = 3 * (v / times * image.width_px + u / times);
            rgb.extend_from_slice(&image.rgb[from..from + 3]);
        }
    }
    Image {
        width_px,
        height_px,
        rgb,
    }
}

/// Sets one pixel; ignores pixels outside the image.
pub fn draw_pixel(image: &mut Image, u: i64, v: i64, colour: Rgb) {
    if (0..image.width_px as i64).contains(&u) && (0..image.height_px as i64).contains(&v) {
        let at = 3 * (v as usize * image.width_px + u as usize);
        image.rgb[at..at + 3].copy_from_slice(&colour);
    }
}

/// A plus sign.
pub fn draw_cross(image: &mut Image, [u, v]: [f32; 2], arm: i64, colour: Rgb) {
    let (u, v) = (u.round() as i64, v.round() as i64);
    for step in -arm..=arm {
        draw_pixel(image, u + step, v, colour);
        draw_pixel(image, u, v + step, colour);
    }
}

/// A circle's outline.
pub fn draw_circle(image: &mut Image, [u, v]: [f32; 2], radius: f32, colour: Rgb) {
    let steps = (std::f32::consts::TAU * radius).ceil().max(8.0) as usize;
    for step in 0..steps {
        let (sin, cos) = math::sin_cos(std::f32::consts::TAU * step as f32 / steps as f32);
        let at = [u + radius * cos, v + radius * sin].map(|at| at.round() as i64);
        draw_pixel(image, at[0], at[1], colour);
    }
}

/// Draws all detections on an image enlarged by `times`.
pub fn draw_detections(image: &mut Image, times: usize, detections: &Detections) {
    let place = |[u, v]: [f32; 2]| [u, v].map(|at| (at + 0.5) * times as f32 - 0.5);
    for rejected in &detections.rejected_candidates {
        draw_cross(
            image,
            place(rejected.position_px),
            1,
            rejection_colour(rejected.reason),
        );
    }
    for point in &detections.line_points {
        draw_cross(image, place(point.position_px), 2, LINE_POINT_COLOUR);
    }
    if let Some(ball) = &detections.ball {
        for radius in [9.0, 10.0, 11.0] {
            draw_circle(image, place(ball.position_px), radius, BALL_COLOUR);
        }
    }
    for robot in &detections.robots {
        let colour = match robot.marker {
            Some(TeamColour::Cyan) => [0, 255, 255],
            Some(TeamColour::Magenta) => [255, 0, 255],
            None => [255, 255, 0],
        };
        for radius in [6.0, 7.0] {
            draw_circle(image, place(robot.position_px), radius, colour);
        }
    }
    for goal in &detections.goals {
        let colour = match goal.kind {
            GoalKind::Blue => [0, 0, 255],
            GoalKind::Yellow => [255, 255, 0],
            GoalKind::Post => [255, 255, 255],
        };
        for arm in [6, 7] {
            draw_cross(image, place(goal.position_px), arm, colour);
        }
    }
}

/// Draws the carpet's boundary in each direction on an image enlarged by `times`.
pub fn draw_carpet_end(
    image: &mut Image,
    times: usize,
    pattern: &ScanPattern,
    detections: &Detections,
) {
    for sample in &pattern.samples {
        let place = sample.azimuth_turns * detections.carpet_end.len() as f32;
        let nearest = place.round();
        let Some(&end) = detections
            .carpet_end
            .get(nearest as usize % detections.carpet_end.len().max(1))
        else {
            continue;
        };
        if (place - nearest).abs() < 0.2 && (sample.range - end).abs() < sample.radial_footprint {
            let at = [sample.u, sample.v].map(|at| (f32::from(at) + 0.5) * times as f32 - 0.5);
            draw_cross(image, at, 1, CARPET_END_COLOUR);
        }
    }
}

/// Where a robot sees the field from.
#[derive(Debug, Clone, Copy)]
pub struct FieldView<'a> {
    /// Of the upright robot.
    pub map: &'a GroundMap,
    /// x and y components of "up", radians.
    pub tilt: [f32; 2],
    /// Above the ground, metres.
    pub viewpoint_height: f32,
    /// On the field.
    pub pose: Pose,
}

impl FieldView<'_> {
    /// The point of the field at a pixel. None outside the map.
    fn at(&self, u: f32, v: f32) -> Option<At<FieldFrame>> {
        let ground = self.map.interpolate(u, v)?;
        let [x, y] = ground_from_map([ground.x, ground.y], self.tilt, self.viewpoint_height);
        Some(self.pose * At::<RobotFrame>::new(x, y))
    }
}

/// Draws the markings' centre lines as a robot sees them, on an image enlarged by `times`.
pub fn draw_field(image: &mut Image, times: usize, view: FieldView<'_>, markings: &[Marking]) {
    let field = |u: i64, v: i64| {
        let scale = |at: i64| (at as f32 + 0.5) / times as f32 - 0.5;
        view.at(scale(u), scale(v))
    };
    for v in 0..image.height_px as i64 {
        for u in 0..image.width_px as i64 {
            let Some(here) = field(u, v) else { continue };
            let step = [field(u + 1, v), field(u, v + 1)]
                .iter()
                .flatten()
                .map(|next| next.distance_to(here))
                .fold(0.0, f32::max);
            let nearest = markings
                .iter()
                .map(|marking| marking_distance(marking, here))
                .fold(f32::INFINITY, f32::min);
            if nearest < 0.6 * step {
                draw_pixel(image, u, v, FIELD_LINE_COLOUR);
            }
        }
    }
}

/// Distance of a point from a marking's centre line (or a spot's disc), metres.
pub fn marking_distance(marking: &Marking, point: At<FieldFrame>) -> f32 {
    match *marking {
        Marking::Line { from, to } => {
            let (dx, dy) = (to.x - from.x, to.y - from.y);
            let length2 = dx * dx + dy * dy;
            let along = if length2 > 0.0 {
                (((point.x - from.x) * dx + (point.y - from.y) * dy) / length2).clamp(0.0, 1.0)
            } else {
                0.0
            };
            point.distance_to(At::new(from.x + along * dx, from.y + along * dy))
        }
        Marking::Arc {
            centre,
            radius,
            start,
            sweep,
        } => {
            let angle = math::atan2(point.y - centre.y, point.x - centre.x);
            let turned = (angle - start).rem_euclid(std::f32::consts::TAU);
            if turned <= sweep {
                return (point.distance_to(centre) - radius).abs();
            }
            let end = |angle: f32| {
                let (sin, cos) = math::sin_cos(angle);
                point.distance_to(At::new(centre.x + radius * cos, centre.y + radius * sin))
            };
            end(start).min(end(start + sweep))
        }
        Marking::Spot { centre, radius } => (point.distance_to(centre) - radius).max(0.0),
    }
}

/// Colour of a class.
pub fn class_colour(class: ColourClass) -> Rgb {
    match class {
        ColourClass::BLACK => [0, 0, 0],
        ColourClass::WHITE => [255, 255, 255],
        ColourClass::CARPET => [0, 160, 0],
        ColourClass::RED => [200, 0, 0],
        ColourClass::BLUE => [0, 0, 255],
        ColourClass::CYAN => [0, 255, 255],
        ColourClass::MAGENTA => [255, 0, 255],
        ColourClass::YELLOW => [255, 255, 0],
        ColourClass::BALL => [255, 128, 0],
        _ => [128, 128, 128],
    }
}
