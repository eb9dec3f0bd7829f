//! How does a sight become its message and come back?

use anyhow::{Context, Result};
use localize::frame::At;
use localize::sample::LinePoint;
use vision::ball::Ball;
use vision::eyes::Seen;
use vision::goals::{Goal, GoalKind};
use vision::line_points::{Refusal, RefusedRun, SeenLinePoint};
use vision::robots::{Marker, Robot};

use super::super::wire;
use super::sensors::{windows_from_wire, windows_to_wire};
use super::{names, points_from_wire, points_to_wire, same_length};

names!(refusal_name, refusal_named: Refusal {
    NoCarpetBeside = "no carpet beside",
    TooNarrow = "too narrow",
    TooWide = "too wide",
    TooFaint = "too faint",
    NotWhite = "not white",
    BeyondCarpet = "beyond carpet",
});

names!(marker_name, marker_named: Marker { Cyan = "cyan", Magenta = "magenta" });
names!(goal_name, goal_named: GoalKind { Blue = "blue", Yellow = "yellow", Post = "post" });

pub(crate) fn seen_to_wire(seen: &Seen) -> wire::Seen {
    let Seen {
        line_points,
        refused,
        ball,
        robots,
        goals,
        windows,
        carpet_end,
        carpet_share,
        learned,
    } = seen;
    let mut points = wire::Seen::default();
    for &SeenLinePoint {
        point: _,
        at_px: [u, v],
        contrast,
        width,
    } in line_points
    {
        points.point_u_px.push(u);
        points.point_v_px.push(v);
        points.point_contrast.push(contrast);
        points.point_width.push(width);
    }
    wire::Seen {
        points: points_to_wire(line_points.iter().map(|seen| &seen.point)),
        refused_u_px: refused.iter().map(|run| run.at_px[0]).collect(),
        refused_v_px: refused.iter().map(|run| run.at_px[1]).collect(),
        refused_reason: refused
            .iter()
            .map(|run| refusal_name(run.reason).to_owned())
            .collect(),
        ball: ball.as_ref().map(ball_to_wire),
        robots: robots.iter().map(robot_to_wire).collect(),
        goals: goals.iter().map(goal_to_wire).collect(),
        carpet_end: carpet_end.clone(),
        carpet_share: *carpet_share,
        learned: *learned,
        windows: windows_to_wire(windows),
        ..points
    }
}

pub(crate) fn seen_from_wire(seen: wire::Seen) -> Result<Seen> {
    let (u, v) = (seen.point_u_px, seen.point_v_px);
    let (contrast, width) = (seen.point_contrast, seen.point_width);
    let points = points_from_wire(seen.points)?;
    same_length(
        "seen points",
        &[points.len(), u.len(), v.len(), contrast.len(), width.len()],
    )?;
    let (refused_u, refused_v, reasons) =
        (seen.refused_u_px, seen.refused_v_px, seen.refused_reason);
    same_length(
        "refused runs",
        &[refused_u.len(), refused_v.len(), reasons.len()],
    )?;
    let place = |(index, point): (usize, LinePoint)| SeenLinePoint {
        point,
        at_px: [u[index], v[index]],
        contrast: contrast[index],
        width: width[index],
    };
    let run = |(index, reason): (usize, &String)| {
        Ok(RefusedRun {
            at_px: [refused_u[index], refused_v[index]],
            reason: refusal_named(reason)?,
        })
    };
    Ok(Seen {
        line_points: points.into_iter().enumerate().map(place).collect(),
        refused: reasons.iter().enumerate().map(run).collect::<Result<_>>()?,
        ball: seen.ball.as_ref().map(ball_from_wire).transpose()?,
        robots: seen
            .robots
            .iter()
            .map(robot_from_wire)
            .collect::<Result<_>>()?,
        goals: seen
            .goals
            .iter()
            .map(goal_from_wire)
            .collect::<Result<_>>()?,
        windows: windows_from_wire(seen.windows)?,
        carpet_end: seen.carpet_end,
        carpet_share: seen.carpet_share,
        learned: seen.learned,
    })
}

pub(crate) fn ball_to_wire(ball: &Ball) -> wire::Ball {
    let &Ball {
        at,
        covariance,
        on_ground,
        score,
        at_px: [u_px, v_px],
        pixels,
    } = ball;
    wire::Ball {
        x: at.x,
        y: at.y,
        covariance: covariance.to_vec(),
        on_ground,
        score,
        u_px,
        v_px,
        pixels: pixels as u32,
    }
}

fn ball_from_wire(ball: &wire::Ball) -> Result<Ball> {
    Ok(Ball {
        at: At::new(ball.x, ball.y),
        covariance: triple(&ball.covariance)?,
        on_ground: ball.on_ground,
        score: ball.score,
        at_px: [ball.u_px, ball.v_px],
        pixels: ball.pixels as usize,
    })
}

pub(crate) fn robot_to_wire(robot: &Robot) -> wire::Robot {
    let &Robot {
        at,
        edge,
        covariance,
        width,
        marker,
        score,
        at_px: [u_px, v_px],
    } = robot;
    wire::Robot {
        x: at.x,
        y: at.y,
        edge_x: edge.x,
        edge_y: edge.y,
        covariance: covariance.to_vec(),
        width,
        marker: marker.map_or("", marker_name).to_owned(),
        score,
        u_px,
        v_px,
    }
}

fn robot_from_wire(robot: &wire::Robot) -> Result<Robot> {
    Ok(Robot {
        at: At::new(robot.x, robot.y),
        edge: At::new(robot.edge_x, robot.edge_y),
        covariance: triple(&robot.covariance)?,
        width: robot.width,
        marker: match robot.marker.as_str() {
            "" => None,
            marker => Some(marker_named(marker)?),
        },
        score: robot.score,
        at_px: [robot.u_px, robot.v_px],
    })
}

fn goal_to_wire(goal: &Goal) -> wire::Goal {
    let &Goal {
        kind,
        at,
        covariance,
        width,
        score,
        at_px: [u_px, v_px],
    } = goal;
    wire::Goal {
        kind: goal_name(kind).to_owned(),
        x: at.x,
        y: at.y,
        covariance: covariance.to_vec(),
        width,
        score,
        u_px,
        v_px,
    }
}

fn goal_from_wire(goal: &wire::Goal) -> Result<Goal> {
    Ok(Goal {
        kind: goal_named(&goal.kind)?,
        at: At::new(goal.x, goal.y),
        covariance: triple(&goal.covariance)?,
        width: goal.width,
        score: goal.score,
        at_px: [goal.u_px, goal.v_px],
    })
}

fn triple(values: &[f32]) -> Result<[f32; 3]> {
    values
        .try_into()
        .context("a covariance of the log has not 3 entries")
}
