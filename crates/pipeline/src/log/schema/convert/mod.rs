//! How is a cycle converted to its message and back? Without loss of a bit. Every field is named, so none is missed.

mod detections;
mod estimate;
mod geometry;
mod names;
mod sensors;
mod team;
mod world;

use anyhow::{Context, Result, bail};
use localize::Stamp;
use localize::frames::At;
use localize::map_correction::MapFit;
use localize::omni::Twist;
use localize::sample::{Compass, Imu, Odometry, VelocityCommand};
use nalgebra::Matrix3;

pub(crate) use detections::{
    ball_to_wire, detections_from_wire, detections_to_wire, robot_to_wire,
};
pub(crate) use estimate::{estimate_from_wire, estimate_to_wire, map_correction_to_wire};
pub use estimate::{mode_and_advice, mode_and_reason, reason_text};
pub(crate) use geometry::pose_error_to_wire;
use geometry::{
    line_points_from_wire, line_points_to_wire, pose_from_wire, pose_to_wire, same_length,
};
use sensors::exposure_from_wire;
pub(crate) use sensors::{exposure_to_wire, windows_to_wire};
pub(crate) use team::team_to_wire;

use super::wire;
use crate::cycle::{Cycle, Inputs, Timings};
use crate::sample::GroundTruth;
use crate::warm_start::WarmStart;

/// Converts a cycle to its message. `image`: format of its message on /camera/image.
pub(crate) fn cycle_to_wire(index: u64, cycle: &Cycle, image: &str) -> wire::Cycle {
    let Cycle {
        stamp,
        inputs,
        detections,
        line_points: points,
        estimate,
        world,
        team,
        exposure,
        image_fault: fault,
        timings,
    } = cycle;
    let Inputs {
        odometry,
        compass,
        imu,
        commands,
        reports,
        truth,
        image: _,
        exposure_setting: setting,
        changed_config_toml: settings,
        warm_start,
        setup_doubt,
        map_fit,
    } = inputs;
    wire::Cycle {
        index,
        stamp_ns: stamp.0,
        image: image.to_owned(),
        odometry: odometry.iter().map(odometry_to_wire).collect(),
        compass: compass.iter().map(compass_to_wire).collect(),
        imu: imu.iter().map(imu_to_wire).collect(),
        truth: truth.as_ref().map(ground_truth_to_wire),
        points: line_points_to_wire(points.iter()),
        seen: detections.as_ref().map(detections_to_wire),
        estimate: estimate_to_wire(estimate),
        fault: fault.clone(),
        see_ms: timings.see_ms,
        localize_ms: timings.localize_ms,
        exposure: exposure.as_ref().map(exposure_to_wire),
        commands: commands.iter().map(command_to_wire).collect(),
        reports: reports.iter().map(team::team_report_to_wire).collect(),
        world: world::world_to_wire(world),
        team: team_to_wire(team),
        reported_exposure: setting.map(|setting| setting.exposure),
        reported_gain: setting.map(|setting| setting.gain),
        settings: settings.as_ref().map(|settings| settings.to_string()),
        warm_start: warm_start.as_ref().map(WarmStart::to_toml),
        setup_doubt: setup_doubt.map_or_else(Vec::new, |doubt| doubt.as_slice().to_vec()),
        // Numbers alone: nothing that TOML lacks.
        map_fit: map_fit.as_deref().and_then(|fit| toml::to_string(fit).ok()),
    }
}

/// Converts a message to its cycle, without the image.
pub(crate) fn cycle_from_wire(cycle: wire::Cycle) -> Result<Cycle> {
    let odometry = |one: wire::Odometry| Odometry {
        stamp: Stamp(one.stamp_ns),
        dx: one.dx,
        dy: one.dy,
        dtheta: one.dtheta,
        slip: one.slip,
    };
    let command = |one: wire::Command| VelocityCommand {
        stamp: Stamp(one.stamp_ns),
        twist: Twist {
            x: one.x,
            y: one.y,
            theta: one.theta,
        },
    };
    let compass = |one: wire::Compass| Compass {
        stamp: Stamp(one.stamp_ns),
        heading: one.heading,
        magnetic_field: one.field.first_chunk().copied(),
    };
    let imu = |one: wire::Imu| Imu {
        stamp: Stamp(one.stamp_ns),
        specific_force: [one.acceleration_x, one.acceleration_y, one.acceleration_z],
        angular_velocity: [one.rate_x, one.rate_y, one.rate_z],
    };
    Ok(Cycle {
        stamp: Stamp(cycle.stamp_ns),
        inputs: Inputs {
            odometry: cycle.odometry.into_iter().map(odometry).collect(),
            compass: cycle.compass.into_iter().map(compass).collect(),
            imu: cycle.imu.into_iter().map(imu).collect(),
            commands: cycle.commands.into_iter().map(command).collect(),
            reports: cycle
                .reports
                .iter()
                .map(team::team_report_from_wire)
                .collect::<Result<_>>()?,
            truth: cycle.truth.map(ground_truth_from_wire).transpose()?,
            image: None,
            exposure_setting: sensors::camera_setting(cycle.reported_exposure, cycle.reported_gain),
            changed_config_toml: cycle.settings.map(Into::into),
            warm_start: cycle
                .warm_start
                .as_deref()
                .map(WarmStart::from_toml)
                .transpose()?,
            setup_doubt: cycle
                .setup_doubt
                .first_chunk::<9>()
                .map(|doubt| Matrix3::from_column_slice(doubt)),
            map_fit: cycle
                .map_fit
                .as_deref()
                .map(map_fit_from_toml)
                .transpose()?,
        },
        detections: cycle.seen.map(detections_from_wire).transpose()?,
        line_points: line_points_from_wire(cycle.points)?,
        estimate: estimate_from_wire(cycle.estimate)?,
        world: world::world_from_wire(&cycle.world)?,
        team: team::team_from_wire(&cycle.team)?,
        exposure: cycle.exposure.as_ref().map(exposure_from_wire),
        image_fault: cycle.fault,
        timings: Timings {
            see_ms: cycle.see_ms,
            localize_ms: cycle.localize_ms,
        },
    })
}

fn map_fit_from_toml(text: &str) -> Result<Box<MapFit>> {
    toml::from_str(text).context("invalid errors of the ground map")
}

pub(crate) fn odometry_to_wire(
    &Odometry {
        stamp,
        dx,
        dy,
        dtheta,
        slip,
    }: &Odometry,
) -> wire::Odometry {
    wire::Odometry {
        stamp_ns: stamp.0,
        dx,
        dy,
        dtheta,
        slip,
    }
}

pub(crate) fn command_to_wire(
    &VelocityCommand { stamp, twist }: &VelocityCommand,
) -> wire::Command {
    let Twist { x, y, theta } = twist;
    wire::Command {
        stamp_ns: stamp.0,
        x,
        y,
        theta,
    }
}

pub(crate) fn compass_to_wire(
    &Compass {
        stamp,
        heading,
        magnetic_field: field,
    }: &Compass,
) -> wire::Compass {
    wire::Compass {
        stamp_ns: stamp.0,
        heading,
        field: field.map_or_else(Vec::new, Vec::from),
    }
}

pub(crate) fn imu_to_wire(
    &Imu {
        stamp,
        specific_force: acceleration,
        angular_velocity: rate,
    }: &Imu,
) -> wire::Imu {
    let [acceleration_x, acceleration_y, acceleration_z] = acceleration;
    let [rate_x, rate_y, rate_z] = rate;
    let stamp_ns = stamp.0;
    wire::Imu {
        stamp_ns,
        acceleration_x,
        acceleration_y,
        acceleration_z,
        rate_x,
        rate_y,
        rate_z,
    }
}

fn ground_truth_to_wire(truth: &GroundTruth) -> wire::GroundTruth {
    let GroundTruth {
        stamp,
        pose,
        ball,
        ball_height,
        robots,
        robot_headings,
        people,
    } = truth;
    wire::GroundTruth {
        stamp_ns: stamp.0,
        pose: pose_to_wire(*pose),
        ball: ball.map_or_else(Vec::new, |ball| vec![ball.x, ball.y]),
        robots_x: robots.iter().map(|robot| robot.x).collect(),
        robots_y: robots.iter().map(|robot| robot.y).collect(),
        ball_height: *ball_height,
        robot_headings: robot_headings.clone(),
        people_x: people.iter().map(|person| person.x).collect(),
        people_y: people.iter().map(|person| person.y).collect(),
    }
}

fn ground_truth_from_wire(truth: wire::GroundTruth) -> Result<GroundTruth> {
    same_length("robots", &[truth.robots_x.len(), truth.robots_y.len()])?;
    if !truth.robot_headings.is_empty() {
        let lengths = [truth.robots_x.len(), truth.robot_headings.len()];
        same_length("headings of robots", &lengths)?;
    }
    same_length("people", &[truth.people_x.len(), truth.people_y.len()])?;
    let positions = |x: &[f32], y: &[f32]| {
        let pairs = x.iter().zip(y);
        pairs.map(|(&x, &y)| At::new(x, y)).collect()
    };
    Ok(GroundTruth {
        stamp: Stamp(truth.stamp_ns),
        pose: pose_from_wire(&truth.pose),
        ball: match truth.ball[..] {
            [] => None,
            [x, y] => Some(At::new(x, y)),
            _ => bail!(
                "a true ball of the log has {} coordinates",
                truth.ball.len()
            ),
        },
        ball_height: truth.ball_height,
        robots: positions(&truth.robots_x, &truth.robots_y),
        robot_headings: truth.robot_headings,
        people: positions(&truth.people_x, &truth.people_y),
    })
}
