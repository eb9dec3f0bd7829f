//! Steps of a drive between images, by the wheels and by the poses, and the origin of the poses that they tell (docs/methods.md 2.13).
//!
//! Not a state of the filter: wheels that slip or are wrong would pass for an offset, and a robust fit sees through them.

use std::collections::VecDeque;

use crate::frames::{Pose, Tf, wrap_angle};
use crate::math;
use crate::wheel_steps::{MeasuredStep, OriginOffset};

/// A step ends after this way or turn, metres and radians. Longer ones add the wheels' errors, shorter ones the images'.
const STEP_DISTANCE: f32 = 0.4;
const STEP_TURN: f32 = 0.4;
/// Most steps kept: half a minute of play.
const STEPS_MAX: usize = 64;

/// A step that has not ended.
#[derive(Debug, Clone, Copy, PartialEq)]
struct PresentStep {
    start: Pose,
    /// Way of the wheels since, field frame, metres.
    way: [f32; 2],
    /// Turn of the wheels since, radians.
    turn: f32,
}

/// Steps of a drive, and what they tell.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct TurningSteps {
    present: Option<PresentStep>,
    steps: VecDeque<MeasuredStep>,
    origin: Option<OriginOffset>,
}

impl TurningSteps {
    /// Where the origin lies about the point that the wheels turn about. None before enough steps.
    pub(super) fn origin(&self) -> Option<OriginOffset> {
        self.origin
    }

    /// Begins a new step with the next image.
    pub(super) fn interrupt(&mut self) {
        self.present = None;
    }

    /// Adds a motion of the wheels, robot frame, at a heading.
    pub(super) fn add_wheels(&mut self, heading: f32, [x, y, turn]: [f32; 3]) {
        let (sin, cos) = math::sin_cos(heading);
        if let Some(present) = &mut self.present {
            present.way[0] += cos * x - sin * y;
            present.way[1] += sin * x + cos * y;
            present.turn += turn;
        }
    }

    /// Adds the pose of an image. `since`: motion since the last one of the wheels, field frame.
    pub(super) fn add_pose(&mut self, pose: Pose, since: [f32; 3]) {
        // The present motion of the wheels began before.
        let next = PresentStep {
            start: pose,
            way: [-since[0], -since[1]],
            turn: -since[2],
        };
        let Some(PresentStep { start, way, turn }) = self.present else {
            self.present = Some(next);
            return;
        };
        let way = [way[0] + since[0], way[1] + since[1]];
        let turn_of_poses = wrap_angle(pose.theta - start.theta);
        if math::hypot(way[0], way[1]) < STEP_DISTANCE && turn_of_poses.abs() < STEP_TURN {
            return;
        }
        let (sin, cos) = math::sin_cos(start.theta);
        let from_start =
            |[x, y]: [f32; 2], turn: f32| Tf::new(cos * x + sin * y, cos * y - sin * x, turn);
        if self.steps.len() == STEPS_MAX {
            self.steps.pop_front();
        }
        self.steps.push_back(MeasuredStep {
            wheels: from_start(way, turn + since[2]),
            poses: from_start([pose.x - start.x, pose.y - start.y], turn_of_poses),
        });
        self.origin = OriginOffset::measure(self.steps.make_contiguous());
        self.present = Some(next);
    }

    /// The map moved the origin by this in the robot frame, metres: earlier steps were seen from another one.
    pub(super) fn shift(&mut self, [x, y]: [f32; 2]) {
        let turned = |angle: f32| {
            let (sin, cos) = math::sin_cos(angle);
            [cos * x - sin * y, sin * x + cos * y]
        };
        for step in &mut self.steps {
            let [end_x, end_y] = turned(step.poses.theta);
            step.poses.x += end_x - x;
            step.poses.y += end_y - y;
        }
        if let Some(PresentStep { start, .. }) = &mut self.present {
            let [x, y] = turned(start.theta);
            start.x += x;
            start.y += y;
        }
        if let Some(origin) = &mut self.origin {
            origin.at.x += x;
            origin.at.y += y;
        }
    }
}
