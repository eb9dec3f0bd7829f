//! How are team views converted to their messages and back?

use anyhow::{Context, Result, bail};
use localize::Stamp;
use localize::flight::BallMotionMode;
use localize::frames::At;
use localize::localizer::{SightingDirection, SightingOutcome};
use localize::team::{
    JudgedSighting, ReportedBall, ReportedObstacle, TeamBall, TeamBallInSpace, TeamReport,
    TeamView, Teammate,
};

use super::super::wire;
use super::geometry::{pose_from_wire, pose_to_wire, same_length};
use super::names::names;
use super::world::{airborne_from_wire, airborne_to_wire, sighting_from_wire, sighting_to_wire};

pub(super) fn team_report_to_wire(report: &TeamReport) -> wire::TeamReport {
    let TeamReport {
        robot,
        is_member,
        stamp,
        pose,
        pose_std,
        half_known,
        pose_by_markings,
        ball,
        obstacles,
        ball_sighting,
    } = report;
    let numbers = |ball: &ReportedBall| {
        let ([vx, vy], [xx, xy, yy]) = (ball.velocity, ball.covariance);
        vec![ball.at.x, ball.at.y, vx, vy, xx, xy, yy]
    };
    wire::TeamReport {
        robot: *robot,
        is_member: *is_member,
        stamp_ns: stamp.0,
        pose: pose.map(pose_to_wire),
        pose_std: pose_std.to_vec(),
        half_known: *half_known,
        ball: ball.as_ref().map(numbers).unwrap_or_default(),
        ball_seen_ns: ball.map_or(0, |ball| ball.last_seen.0),
        obstacles_x: obstacles.iter().map(|obstacle| obstacle.at.x).collect(),
        obstacles_y: obstacles.iter().map(|obstacle| obstacle.at.y).collect(),
        obstacles_covariance: obstacles
            .iter()
            .flat_map(|obstacle| obstacle.covariance)
            .collect(),
        pose_by_markings: *pose_by_markings,
        ball_sighting: ball_sighting
            .as_ref()
            .map(sighting_to_wire)
            .unwrap_or_default(),
    }
}

pub(super) fn team_report_from_wire(report: &wire::TeamReport) -> Result<TeamReport> {
    Ok(TeamReport {
        robot: report.robot,
        is_member: report.is_member,
        stamp: Stamp(report.stamp_ns),
        pose: report.pose.as_ref().map(pose_from_wire),
        pose_std: report.pose_std[..]
            .try_into()
            .context("a report has not 3 standard deviations")?,
        half_known: report.half_known,
        pose_by_markings: report.pose_by_markings,
        ball: match report.ball[..] {
            [] => None,
            [x, y, vx, vy, xx, xy, yy] => Some(ReportedBall {
                at: At::new(x, y),
                velocity: [vx, vy],
                covariance: [xx, xy, yy],
                last_seen: Stamp(report.ball_seen_ns),
            }),
            _ => bail!("a reported ball of {} numbers", report.ball.len()),
        },
        obstacles: obstacles_from_wire(report)?,
        ball_sighting: sighting_from_wire(&report.ball_sighting)?,
    })
}

/// Robots that a teammate tracks. Their covariance is infinite in logs of earlier versions.
fn obstacles_from_wire(report: &wire::TeamReport) -> Result<Vec<ReportedObstacle>> {
    let (x, y) = (&report.obstacles_x, &report.obstacles_y);
    same_length("obstacles", &[x.len(), y.len()])?;
    let covariances = &report.obstacles_covariance;
    let covariances: Vec<[f32; 3]> = if covariances.is_empty() {
        vec![[f32::INFINITY, 0.0, f32::INFINITY]; x.len()]
    } else {
        let (covariances, rest) = covariances.as_chunks::<3>();
        same_length("obstacles", &[x.len(), covariances.len() + rest.len()])?;
        covariances.to_vec()
    };
    let places = x.iter().zip(y).map(|(&x, &y)| At::new(x, y));
    Ok(places
        .zip(covariances)
        .map(|(at, covariance)| ReportedObstacle { at, covariance })
        .collect())
}

pub(crate) fn team_to_wire(team: &TeamView) -> wire::TeamView {
    let TeamView {
        ball,
        teammates: mates,
        half_log_odds: half_evidence,
        triangulated,
        pose_by_markings,
        sightings,
    } = team;
    wire::TeamView {
        ball: ball.as_ref().map(ball_to_wire),
        mates: mates.iter().map(teammate_to_wire).collect(),
        half_evidence: *half_evidence,
        triangulated: triangulated.as_ref().map(triangulated_to_wire),
        pose_by_markings: *pose_by_markings,
        sightings: sightings.iter().map(sighting_to_message).collect(),
    }
}

pub(super) fn team_from_wire(team: &wire::TeamView) -> Result<TeamView> {
    Ok(TeamView {
        ball: team.ball.as_ref().map(ball_from_wire).transpose()?,
        teammates: team
            .mates
            .iter()
            .map(teammate_from_wire)
            .collect::<Result<_>>()?,
        half_log_odds: team.half_evidence,
        triangulated: team
            .triangulated
            .as_ref()
            .map(triangulated_from_wire)
            .transpose()?,
        pose_by_markings: team.pose_by_markings,
        sightings: team
            .sightings
            .iter()
            .map(sighting_from_message)
            .collect::<Result<_>>()?,
    })
}

names!(direction_name, direction_named: SightingDirection { ByMate = "by_mate", OfMate = "of_mate" });
names!(outcome_name, outcome_named: SightingOutcome {
    Used = "used",
    NoPose = "no_pose",
    TooUncertain = "too_uncertain",
    NotSeen = "not_seen",
    PoseDoubted = "pose_doubted",
    Distrusted = "distrusted",
    Ambiguous = "ambiguous",
    Late = "late",
    TooManyMates = "too_many_mates",
});

fn sighting_to_message(sighting: &JudgedSighting) -> wire::JudgedSighting {
    wire::JudgedSighting {
        robot: sighting.robot,
        direction: direction_name(sighting.direction).to_owned(),
        outcome: outcome_name(sighting.outcome).to_owned(),
    }
}

fn sighting_from_message(sighting: &wire::JudgedSighting) -> Result<JudgedSighting> {
    Ok(JudgedSighting {
        robot: sighting.robot,
        direction: direction_named(&sighting.direction)?,
        outcome: outcome_named(&sighting.outcome)?,
    })
}

names!(mode_name, mode_named: BallMotionMode { Ground = "ground", Flight = "flight", Held = "held" });

fn triangulated_to_wire(ball: &TeamBallInSpace) -> wire::TriangulatedBall {
    wire::TriangulatedBall {
        mode: mode_name(ball.mode).to_owned(),
        state: airborne_to_wire(&ball.state),
        witnesses: ball.inliers.clone(),
        dissenters: ball.outliers.clone(),
    }
}

fn triangulated_from_wire(ball: &wire::TriangulatedBall) -> Result<TeamBallInSpace> {
    Ok(TeamBallInSpace {
        mode: mode_named(&ball.mode)?,
        state: airborne_from_wire(&ball.state)?,
        inliers: ball.witnesses.clone(),
        outliers: ball.dissenters.clone(),
    })
}

fn ball_to_wire(ball: &TeamBall) -> wire::SharedBall {
    let TeamBall {
        at,
        velocity: [velocity_x, velocity_y],
        covariance,
        inliers: witnesses,
        outliers: dissenters,
    } = ball;
    wire::SharedBall {
        x: at.x,
        y: at.y,
        velocity_x: *velocity_x,
        velocity_y: *velocity_y,
        covariance: covariance.to_vec(),
        witnesses: witnesses.clone(),
        dissenters: dissenters.clone(),
    }
}

fn ball_from_wire(ball: &wire::SharedBall) -> Result<TeamBall> {
    Ok(TeamBall {
        at: At::new(ball.x, ball.y),
        velocity: [ball.velocity_x, ball.velocity_y],
        covariance: ball.covariance[..]
            .try_into()
            .context("a shared ball's covariance has not 3 entries")?,
        inliers: ball.witnesses.clone(),
        outliers: ball.dissenters.clone(),
    })
}

fn teammate_to_wire(mate: &Teammate) -> wire::Teammate {
    let Teammate {
        robot,
        age,
        pose,
        ball_agrees: agrees,
    } = mate;
    wire::Teammate {
        robot: *robot,
        age: *age,
        pose: pose.map(pose_to_wire),
        agrees: agrees
            .map_or("", |agrees| if agrees { "yes" } else { "no" })
            .to_owned(),
    }
}

fn teammate_from_wire(mate: &wire::Teammate) -> Result<Teammate> {
    Ok(Teammate {
        robot: mate.robot,
        age: mate.age,
        pose: mate.pose.as_ref().map(pose_from_wire),
        ball_agrees: match mate.agrees.as_str() {
            "" => None,
            "yes" => Some(true),
            "no" => Some(false),
            other => bail!("a team-mate agrees {other:?}"),
        },
    })
}
