//! How large are the errors of estimated poses? Errors against ground truth, and their statistics.

pub mod detections;
pub mod object_labels;
pub mod summary;
pub mod visibility;

use localize::frames::wrap_angle;
use localize::math;
use localize::{Pose, Stamp};
use serde::Serialize;

use crate::cycle::Cycle;
use crate::sample::GroundTruth;

/// Longest gap between truth rows that is interpolated, seconds.
const MAX_INTERPOLATION_GAP: f64 = 0.25;

/// Pose error of one image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseError {
    /// Distance, metres.
    pub position: f32,
    /// Error along the field's x axis, metres.
    pub x: f32,
    /// Error along the field's y axis, metres.
    pub y: f32,
    /// Heading error, wrapped, radians.
    pub heading: f32,
}

/// Error of an estimated pose against the ground truth at `stamp`. None if there is no truth for that time.
pub fn pose_error(truth: &[GroundTruth], stamp: Stamp, estimate: Pose) -> Option<PoseError> {
    let true_pose = true_pose_at(truth, stamp)?;
    let (x, y) = (estimate.x - true_pose.x, estimate.y - true_pose.y);
    Some(PoseError {
        position: math::hypot(x, y),
        x,
        y,
        heading: wrap_angle(estimate.theta - true_pose.theta),
    })
}

/// Error of a cycle's pose against the ground truth in its inputs.
pub fn cycle_error(cycle: &Cycle) -> Option<PoseError> {
    let truth = cycle.inputs.truth.as_ref()?;
    pose_error(
        std::slice::from_ref(truth),
        cycle.stamp,
        cycle.estimate.pose?,
    )
}

/// The true pose at a stamp, interpolated between the rows around it.
pub fn true_pose_at(truth: &[GroundTruth], stamp: Stamp) -> Option<Pose> {
    let after = truth.partition_point(|row| row.stamp < stamp);
    let later = truth.get(after);
    if let Some(row) = later.filter(|row| row.stamp == stamp) {
        return Some(row.pose);
    }
    let earlier = truth.get(after.checked_sub(1)?)?;
    // Stamps may be rounded differently in the two files.
    if stamp - earlier.stamp < 1e-3 {
        return Some(earlier.pose);
    }
    let later = later?;
    let gap = later.stamp - earlier.stamp;
    if gap > MAX_INTERPOLATION_GAP {
        return (later.stamp - stamp < 1e-3).then_some(later.pose);
    }
    let share = ((stamp - earlier.stamp) / gap) as f32;
    let (a, b) = (earlier.pose, later.pose);
    let turned = wrap_angle(b.theta - a.theta);
    Some(Pose::new(
        a.x + share * (b.x - a.x),
        a.y + share * (b.y - a.y),
        a.theta + share * turned,
    ))
}

/// Four statistics of a list of magnitudes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SampleStatistics {
    /// Arithmetic mean.
    pub mean: f64,
    /// Median.
    pub median: f64,
    /// 95th percentile.
    pub p95: f64,
    /// Maximum.
    pub max: f64,
}

/// Computes the statistics. None for an empty list.
pub fn sample_statistics(values: impl IntoIterator<Item = f64>) -> Option<SampleStatistics> {
    let mut values: Vec<f64> = values.into_iter().collect();
    values.sort_by(f64::total_cmp);
    let last = values.len().checked_sub(1)?;
    let at = |share: f64| values[(share * last as f64).round() as usize];
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    Some(SampleStatistics {
        mean,
        median: at(0.5),
        p95: at(0.95),
        max: values[last],
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn truth(seconds: f64, x: f32, theta: f32) -> GroundTruth {
        GroundTruth {
            stamp: Stamp::from_seconds(seconds),
            pose: Pose::new(x, 0.0, theta),
            ball: None,
            ball_height: 0.0,
            robots: Vec::new(),
            robot_headings: Vec::new(),
            people: Vec::new(),
        }
    }

    #[test]
    fn true_pose_interpolates_heading_across_pi() {
        let rows = [truth(0.0, 0.0, 3.1), truth(0.1, 1.0, -3.1)];
        let pose = true_pose_at(&rows, Stamp::from_seconds(0.05)).expect("a pose");
        assert!((pose.x - 0.5).abs() < 1e-6 && pose.theta.abs() > 3.13);
    }

    #[test]
    fn true_pose_is_none_inside_long_gaps() {
        let rows = [truth(0.0, 0.0, 0.0), truth(40.0, 1.0, 0.0)];
        assert_eq!(true_pose_at(&rows, Stamp::from_seconds(20.0)), None);
        assert!(true_pose_at(&rows, Stamp::from_seconds(40.0)).is_some());
    }

    #[test]
    fn statistics_of_an_empty_list_are_none() {
        assert_eq!(sample_statistics([]), None);
        assert_eq!(
            sample_statistics([3.0, 1.0, 2.0]),
            Some(SampleStatistics {
                mean: 2.0,
                median: 2.0,
                p95: 3.0,
                max: 3.0
            })
        );
    }
}
