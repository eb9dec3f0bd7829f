//! Where does a point in space appear on the screen? A camera that orbits around a point of the field.

use eframe::egui::{Pos2, Rect, Response, Ui, Vec2};

use crate::view::panel_command::PanelCommand;

/// Distance in front of the camera from which things are drawn, metres.
const NEAR: f32 = 0.1;
/// Limits of the camera's distance from the point that it looks at, metres.
const DISTANCE_RANGE: [f32; 2] = [0.5, 60.0];
/// Limits of the elevation, radians: below the floor nothing is drawn as it is.
const ELEVATION_RANGE: [f32; 2] = [0.02, 1.57];
/// Rotation of a drag, radians per point.
const RADIANS_PER_POINT: f32 = 0.008;
/// Rotation of a key, radians.
const RADIANS_PER_KEY: f32 = 0.1;
/// Scrolled points per factor of e.
const SCROLL_POINTS_PER_E_FOLD: f32 = 300.0;
/// Focal length as a share of the panel's smaller side.
const FOCAL_SHARE: f32 = 1.1;

/// A point in the field frame: x, y and height, metres.
pub(super) type Point = [f32; 3];

/// The orbiting camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SceneCamera {
    /// Point that it looks at.
    pub(super) target: Point,
    /// Direction from the target to the camera, radians.
    azimuth: f32,
    elevation: f32,
    distance: f32,
}

impl Default for SceneCamera {
    fn default() -> Self {
        SceneCamera {
            target: [0.0; 3],
            azimuth: -1.2,
            elevation: 0.7,
            distance: 25.0,
        }
    }
}

/// Projection onto the screen.
#[derive(Debug, Clone, Copy)]
pub(super) struct Projection {
    position: Point,
    right: Point,
    up: Point,
    forward: Point,
    centre: Pos2,
    focal: f32,
}

impl SceneCamera {
    /// Drag turns, Shift-drag moves, the wheel changes the distance, a double click resets.
    pub(super) fn handle_input(&mut self, ui: &Ui, response: &Response) {
        let (shifted, scrolled) =
            ui.input(|input| (input.modifiers.shift, input.smooth_scroll_delta().y));
        let moved = response.drag_delta();
        if response.dragged() && shifted {
            let per_point =
                self.distance / (FOCAL_SHARE * response.rect.size().min_elem().max(1.0));
            let (sin, cos) = self.azimuth.sin_cos();
            let (right, away) = (-moved.x * per_point, moved.y * per_point);
            self.target[0] += -sin * right - cos * away;
            self.target[1] += cos * right - sin * away;
        } else if response.dragged() {
            self.turn(RADIANS_PER_POINT * moved);
        }
        if response.hovered() && scrolled != 0.0 {
            self.approach((scrolled / SCROLL_POINTS_PER_E_FOLD).exp());
        }
        if response.double_clicked() {
            *self = SceneCamera::default();
        }
    }

    /// Does what keys ask for: moving turns.
    pub(super) fn apply(&mut self, command: PanelCommand) {
        match command {
            PanelCommand::Pan(step) => self.turn(-RADIANS_PER_KEY * Vec2::from(step)),
            PanelCommand::Zoom(factor) => self.approach(factor),
            PanelCommand::ShowAll => *self = SceneCamera::default(),
        }
    }

    /// Turns the scene to the right and down, radians.
    fn turn(&mut self, angles: Vec2) {
        self.azimuth -= angles.x;
        self.elevation = (self.elevation + angles.y).clamp(ELEVATION_RANGE[0], ELEVATION_RANGE[1]);
    }

    /// Divides the distance by a factor.
    fn approach(&mut self, factor: f32) {
        self.distance = (self.distance / factor).clamp(DISTANCE_RANGE[0], DISTANCE_RANGE[1]);
    }

    /// The projection onto a part of the screen.
    pub(super) fn projection(&self, area: Rect) -> Projection {
        let (sin, cos) = self.azimuth.sin_cos();
        let (rise, level) = self.elevation.sin_cos();
        let outward = [cos * level, sin * level, rise];
        let at = |axis: usize| self.target[axis] + self.distance * outward[axis];
        Projection {
            position: [at(0), at(1), at(2)],
            right: [-sin, cos, 0.0],
            up: [-cos * rise, -sin * rise, level],
            forward: outward.map(|value| -value),
            centre: area.center(),
            focal: FOCAL_SHARE * area.size().min_elem().max(1.0),
        }
    }
}

impl Projection {
    /// Right, up and forward of the camera, metres.
    fn seen(&self, point: Point) -> Point {
        let offset = [0, 1, 2].map(|axis| point[axis] - self.position[axis]);
        [self.right, self.up, self.forward].map(|axis| dot(axis, offset))
    }

    fn place(&self, [right, up, forward]: Point) -> Pos2 {
        let scale = self.focal / forward;
        self.centre + Vec2::new(right * scale, -up * scale)
    }

    /// Screen position of a point; None behind the camera.
    pub(super) fn point(&self, point: Point) -> Option<Pos2> {
        let seen = self.seen(point);
        (seen[2] > NEAR).then(|| self.place(seen))
    }

    /// Screen points per metre at a point.
    pub(super) fn scale(&self, point: Point) -> f32 {
        self.focal / self.seen(point)[2].max(NEAR)
    }

    /// The part of a segment in front of the camera.
    pub(super) fn segment(&self, from: Point, to: Point) -> Option<[Pos2; 2]> {
        let (mut from, mut to) = (self.seen(from), self.seen(to));
        if from[2] <= NEAR && to[2] <= NEAR {
            return None;
        }
        if to[2] < from[2] {
            std::mem::swap(&mut from, &mut to);
        }
        if from[2] < NEAR {
            let share = (NEAR - from[2]) / (to[2] - from[2]);
            from = [0, 1, 2].map(|axis| from[axis] + share * (to[axis] - from[axis]));
            from[2] = NEAR;
        }
        Some([self.place(from), self.place(to)])
    }
}

fn dot(a: Point, b: Point) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn target_is_in_the_middle_and_height_is_up_from_every_side() {
        let area = Rect::from_min_size(Pos2::ZERO, Vec2::new(400.0, 300.0));
        for step in 0..12 {
            let camera = SceneCamera {
                target: [1.0, -2.0, 0.0],
                azimuth: 0.5 * step as f32,
                ..SceneCamera::default()
            };
            let projection = camera.projection(area);
            let middle = projection.point([1.0, -2.0, 0.0]).expect("in front");
            assert!(middle.distance(area.center()) < 1e-2, "{middle:?}");
            let above = projection.point([1.0, -2.0, 1.0]).expect("in front");
            assert!((above.x - middle.x).abs() < 1e-2 && above.y < middle.y - 5.0);
        }
    }

    #[test]
    fn a_segment_through_the_camera_is_cut_in_front_of_it() {
        let camera = SceneCamera::default();
        let area = Rect::from_min_size(Pos2::ZERO, Vec2::new(400.0, 300.0));
        let projection = camera.projection(area);
        let behind = [0, 1, 2].map(|axis| projection.position[axis] - projection.forward[axis]);
        assert_eq!(projection.point(behind), None);
        let ends = projection.segment([0.5, 0.0, 0.0], behind).expect("a part");
        assert!(
            ends.iter()
                .all(|end| end.x.is_finite() && end.y.is_finite())
        );
        assert_eq!(projection.segment(behind, behind), None);
    }
}
