//! What does localization take from an image? Line points and goals, or the reason why there are none.

use localize::sample::{GoalObservation, LinePoint};
use vision::process::Detections;

use crate::observations::goal_observations;

/// What one image gave: features for localization, or the reason why there are none.
#[derive(Default)]
pub(crate) struct Features {
    /// Those of an earlier run.
    pub(crate) detections: Option<Detections>,
    pub(crate) line_points: Vec<LinePoint>,
    pub(crate) goals: Vec<GoalObservation>,
    pub(crate) fault: Option<String>,
}

impl Features {
    pub(crate) fn from_points(line_points: Vec<LinePoint>) -> Self {
        Features {
            line_points,
            ..Features::default()
        }
    }

    pub(crate) fn from_detections(detections: &Detections) -> Self {
        let points = detections.line_points.iter();
        Features {
            line_points: points.map(|candidate| candidate.point).collect(),
            goals: goal_observations(detections),
            ..Features::default()
        }
    }

    pub(crate) fn from_fault(reason: String) -> Self {
        Features {
            fault: Some(reason),
            ..Features::default()
        }
    }
}
