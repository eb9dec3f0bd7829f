//! How are poses, line points and lists converted to messages and back?

use anyhow::{Context, Result, bail};
use localize::Pose;
use localize::frames::At;
use localize::sample::LinePoint;
use nalgebra::Matrix3;

use super::super::wire;
use crate::pose_error::PoseError;

pub(super) fn pose_to_wire(pose: Pose) -> wire::Pose {
    wire::Pose {
        x: pose.x,
        y: pose.y,
        theta: pose.theta,
    }
}

pub(crate) fn pose_error_to_wire(error: &PoseError) -> wire::PoseError {
    let [x, y, theta] = error.difference.into();
    wire::PoseError {
        x: x as f32,
        y: y as f32,
        theta: theta as f32,
        distance: error.distance() as f32,
        nees: error.nees.map_or(f32::NAN, |nees| nees as f32),
    }
}

pub(super) fn pose_from_wire(pose: &wire::Pose) -> Pose {
    Pose::new(pose.x, pose.y, pose.theta)
}

pub(super) fn line_points_to_wire<'a>(
    points: impl Iterator<Item = &'a LinePoint>,
) -> wire::LinePoints {
    let mut lists = wire::LinePoints::default();
    for &LinePoint {
        at,
        std_radial,
        std_tangential,
    } in points
    {
        lists.x.push(at.x);
        lists.y.push(at.y);
        lists.std_radial.push(std_radial);
        lists.std_tangential.push(std_tangential);
    }
    lists
}

pub(super) fn line_points_from_wire(lists: wire::LinePoints) -> Result<Vec<LinePoint>> {
    let wire::LinePoints {
        x,
        y,
        std_radial,
        std_tangential,
    } = lists;
    same_length(
        "line points",
        &[x.len(), y.len(), std_radial.len(), std_tangential.len()],
    )?;
    let point = |index: usize| LinePoint {
        at: At::new(x[index], y[index]),
        std_radial: std_radial[index],
        std_tangential: std_tangential[index],
    };
    Ok((0..x.len()).map(point).collect())
}

pub(super) fn matrix(values: &[f32]) -> Result<Matrix3<f32>> {
    let values: &[f32; 9] = values
        .try_into()
        .context("a covariance of the log has not 9 entries")?;
    Ok(Matrix3::from_row_slice(values))
}

pub(super) fn pair(values: &[f32]) -> Result<[f32; 2]> {
    values
        .try_into()
        .context("a pair of the log has not 2 entries")
}

pub(super) fn same_length(what: &str, lengths: &[usize]) -> Result<()> {
    if lengths.iter().any(|length| *length != lengths[0]) {
        bail!("the log's lists of {what} differ in length: {lengths:?}");
    }
    Ok(())
}
