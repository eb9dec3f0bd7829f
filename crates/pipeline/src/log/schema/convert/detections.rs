//! How are detections converted to their message and back?

use anyhow::{Context, Result, bail};
use localize::frames::At;
use localize::sample::LinePoint;
use localize::world::TeamColour;
use vision::lines::detection::{LinePointDetection, RejectedCandidate, RejectionReason};
use vision::objects::ball::BallDetection;
use vision::objects::goals::{GoalDetection, GoalKind};
use vision::objects::rejection::{ObjectRejection, RejectedObject};
use vision::objects::robots::{ObstacleKind, RobotDetection};
use vision::process::Detections;

use super::super::wire;
use super::geometry::{line_points_from_wire, line_points_to_wire, same_length};
use super::names::names;
use super::sensors::{windows_from_wire, windows_to_wire};

names!(refusal_name, refusal_named: RejectionReason {
    NoAdjacentCarpet = "no adjacent carpet" | "no carpet beside",
    TooNarrow = "too narrow",
    TooWide = "too wide",
    TooFaint = "too faint",
    NotWhite = "not white",
    BeyondCarpet = "beyond carpet",
});

names!(object_refusal_name, object_refusal_named: ObjectRejection {
    NotABall = "not a ball",
    NotAnObstacle = "not an obstacle",
    OwnBody = "own body",
});

// Logs of earlier versions have no kind: their obstacles are robots.
names!(obstacle_name, obstacle_named: ObstacleKind { Robot = "" | "robot", Person = "person" });
names!(marker_name, marker_named: TeamColour { Cyan = "cyan", Magenta = "magenta" });
names!(goal_name, goal_named: GoalKind { Blue = "blue", Yellow = "yellow", Post = "post" });

pub(crate) fn detections_to_wire(detections: &Detections) -> wire::Detections {
    let Detections {
        line_points,
        rejected_candidates: refused,
        ball,
        other_balls,
        robots,
        rejected_objects,
        goals,
        virtual_sensors: windows,
        carpet_end,
        carpet_share,
        colours_learned: learned,
    } = detections;
    let mut points = wire::Detections::default();
    for &LinePointDetection {
        point: _,
        position_px: [u, v],
        contrast,
        width,
    } in line_points
    {
        points.point_u_px.push(u);
        points.point_v_px.push(v);
        points.point_contrast.push(contrast);
        points.point_width.push(width);
    }
    wire::Detections {
        points: line_points_to_wire(line_points.iter().map(|detection| &detection.point)),
        refused_u_px: refused.iter().map(|run| run.position_px[0]).collect(),
        refused_v_px: refused.iter().map(|run| run.position_px[1]).collect(),
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
        other_balls: other_balls.iter().map(ball_to_wire).collect(),
        rejected_objects: rejected_objects.iter().map(rejection_to_wire).collect(),
        ..points
    }
}

pub(crate) fn detections_from_wire(detections: wire::Detections) -> Result<Detections> {
    let (u, v) = (detections.point_u_px, detections.point_v_px);
    let (contrast, width) = (detections.point_contrast, detections.point_width);
    let points = line_points_from_wire(detections.points)?;
    same_length(
        "seen points",
        &[points.len(), u.len(), v.len(), contrast.len(), width.len()],
    )?;
    let (refused_u, refused_v, reasons) = (
        detections.refused_u_px,
        detections.refused_v_px,
        detections.refused_reason,
    );
    same_length(
        "refused runs",
        &[refused_u.len(), refused_v.len(), reasons.len()],
    )?;
    let place = |(index, point): (usize, LinePoint)| LinePointDetection {
        point,
        position_px: [u[index], v[index]],
        contrast: contrast[index],
        width: width[index],
    };
    let run = |(index, reason): (usize, &String)| {
        Ok(RejectedCandidate {
            position_px: [refused_u[index], refused_v[index]],
            reason: refusal_named(reason)?,
        })
    };
    Ok(Detections {
        line_points: points.into_iter().enumerate().map(place).collect(),
        rejected_candidates: reasons.iter().enumerate().map(run).collect::<Result<_>>()?,
        ball: detections.ball.as_ref().map(ball_from_wire).transpose()?,
        robots: detections
            .robots
            .iter()
            .map(robot_from_wire)
            .collect::<Result<_>>()?,
        goals: detections
            .goals
            .iter()
            .map(goal_from_wire)
            .collect::<Result<_>>()?,
        other_balls: detections
            .other_balls
            .iter()
            .map(ball_from_wire)
            .collect::<Result<_>>()?,
        rejected_objects: detections
            .rejected_objects
            .iter()
            .map(rejection_from_wire)
            .collect::<Result<_>>()?,
        virtual_sensors: windows_from_wire(detections.windows)?,
        carpet_end: detections.carpet_end,
        carpet_share: detections.carpet_share,
        colours_learned: detections.learned,
    })
}

pub(crate) fn ball_to_wire(ball: &BallDetection) -> wire::Ball {
    let &BallDetection {
        at,
        covariance,
        on_ground,
        score,
        position_px: [u_px, v_px],
        pixels,
        distance,
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
        distance: distance.map_or_else(Vec::new, |distance| distance.to_vec()),
    }
}

fn ball_from_wire(ball: &wire::Ball) -> Result<BallDetection> {
    Ok(BallDetection {
        at: At::new(ball.x, ball.y),
        covariance: triple(&ball.covariance)?,
        on_ground: ball.on_ground,
        score: ball.score,
        position_px: [ball.u_px, ball.v_px],
        pixels: ball.pixels as usize,
        distance: match ball.distance[..] {
            [] => None,
            [distance, std] => Some([distance, std]),
            _ => bail!("a ball's distance of {} numbers", ball.distance.len()),
        },
    })
}

fn rejection_to_wire(rejected: &RejectedObject) -> wire::RejectedObject {
    let &RejectedObject {
        position_px: [u_px, v_px],
        reason,
        probability,
    } = rejected;
    wire::RejectedObject {
        reason: object_refusal_name(reason).to_owned(),
        u_px,
        v_px,
        probability,
    }
}

fn rejection_from_wire(rejected: &wire::RejectedObject) -> Result<RejectedObject> {
    Ok(RejectedObject {
        position_px: [rejected.u_px, rejected.v_px],
        reason: object_refusal_named(&rejected.reason)?,
        probability: rejected.probability,
    })
}

pub(crate) fn robot_to_wire(robot: &RobotDetection) -> wire::Robot {
    let &RobotDetection {
        at,
        edge,
        covariance,
        width,
        marker,
        score,
        position_px: [u_px, v_px],
        kind,
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
        kind: obstacle_name(kind).to_owned(),
    }
}

fn robot_from_wire(robot: &wire::Robot) -> Result<RobotDetection> {
    Ok(RobotDetection {
        at: At::new(robot.x, robot.y),
        edge: At::new(robot.edge_x, robot.edge_y),
        covariance: triple(&robot.covariance)?,
        width: robot.width,
        marker: match robot.marker.as_str() {
            "" => None,
            marker => Some(marker_named(marker)?),
        },
        score: robot.score,
        position_px: [robot.u_px, robot.v_px],
        kind: obstacle_named(&robot.kind)?,
    })
}

fn goal_to_wire(goal: &GoalDetection) -> wire::Goal {
    let &GoalDetection {
        kind,
        at,
        covariance,
        width,
        score,
        position_px: [u_px, v_px],
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

fn goal_from_wire(goal: &wire::Goal) -> Result<GoalDetection> {
    Ok(GoalDetection {
        kind: goal_named(&goal.kind)?,
        at: At::new(goal.x, goal.y),
        covariance: triple(&goal.covariance)?,
        width: goal.width,
        score: goal.score,
        position_px: [goal.u_px, goal.v_px],
    })
}

fn triple(values: &[f32]) -> Result<[f32; 3]> {
    values
        .try_into()
        .context("a covariance of the log has not 3 entries")
}
