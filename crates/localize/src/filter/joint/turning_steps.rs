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

/// Steps of a drive, and what they tell.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct TurningSteps {
    /// Pose at the start of the present step, and the wheels' way since, field frame, metres.
    present: Option<(Pose, [f32; 2])>,
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
    pub(super) fn add_wheels(&mut self, heading: f32, [x, y]: [f32; 2]) {
        let (sin, cos) = math::sin_cos(heading);
        if let Some((_, way)) = &mut self.present {
            way[0] += cos * x - sin * y;
            way[1] += sin * x + cos * y;
        }
    }

    /// Adds the pose of an image. `since`: way since the last motion of the wheels, field frame.
    pub(super) fn add_pose(&mut self, pose: Pose, since: [f32; 2]) {
        let Some((start, way)) = self.present else {
            // The present motion of the wheels began before.
            self.present = Some((pose, since.map(|value| -value)));
            return;
        };
        let way = [way[0] + since[0], way[1] + since[1]];
        let turn = wrap_angle(pose.theta - start.theta);
        if math::hypot(way[0], way[1]) < STEP_DISTANCE && turn.abs() < STEP_TURN {
            return;
        }
        let (sin, cos) = math::sin_cos(start.theta);
        let from_start = |[x, y]: [f32; 2]| Tf::new(cos * x + sin * y, cos * y - sin * x, turn);
        if self.steps.len() == STEPS_MAX {
            self.steps.pop_front();
        }
        self.steps.push_back(MeasuredStep {
            wheels: from_start(way),
            poses: from_start([pose.x - start.x, pose.y - start.y]),
        });
        self.origin = OriginOffset::measure(self.steps.make_contiguous());
        self.present = Some((pose, since.map(|value| -value)));
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
        if let Some((start, _)) = &mut self.present {
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
