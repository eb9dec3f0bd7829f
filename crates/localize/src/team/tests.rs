//! The fused ball is more accurate than a single robot's, and one faulty robot does not corrupt it.

use nalgebra::{Matrix3, Matrix4};
use proptest::prelude::*;

use super::{
    BallMeasurement, ReportedBall, ReportedObstacle, TeamConfig, TeamModel, TeamReport, fuse_balls,
};
use crate::estimate::Estimate;
use crate::frames::{At, Pose};
use crate::stamp::Stamp;
use crate::synthetic::team_ball::{TeamExperiment, evaluate_team_ball};
use crate::world::{BallSighting, FieldState, TrackedObject, WorldView};

fn measurement(robot: u32, x: f32, y: f32, std: f32) -> BallMeasurement {
    BallMeasurement {
        robot,
        at: At::new(x, y),
        velocity: [0.0; 2],
        covariance: [std * std, 0.0, std * std],
    }
}

fn report(robot: u32, x: f32, y: f32) -> TeamReport {
    TeamReport {
        robot,
        is_member: true,
        stamp: Stamp(0),
        pose: Some(Pose::new(0.0, 0.0, 0.0)),
        pose_std: [0.05, 0.05, 0.02],
        half_known: true,
        pose_by_markings: false,
        ball: Some(ReportedBall {
            at: At::new(x, y),
            velocity: [0.0; 2],
            covariance: [0.02, 0.0, 0.02],
            last_seen: Stamp(0),
        }),
        obstacles: Vec::new(),
        ball_sighting: None,
    }
}

fn estimate(half_known: bool) -> Estimate {
    let covariance = Matrix3::from_diagonal_element(1e-3);
    Estimate {
        half_known,
        ..Estimate::tracked(Stamp(0), Pose::new(1.0, 1.0, 0.0), covariance)
    }
}

fn world_with_ball(x: f32, y: f32) -> WorldView {
    let covariance = Matrix4::from_diagonal_element(0.02);
    let ball = TrackedObject {
        id: 0,
        at: At::new(x - 1.0, y - 1.0),
        velocity: [0.0; 2],
        covariance,
        on_field: Some(FieldState {
            at: At::new(x, y),
            velocity: [0.0; 2],
            covariance,
        }),
        probability: 0.9,
        last_seen: Stamp(0),
        team: None,
    };
    WorldView {
        ball: Some(ball),
        ..WorldView::default()
    }
}

#[test]
fn fused_ball_beats_best_robot_at_20_percent_message_loss() {
    let score = evaluate_team_ball(0..20, &TeamExperiment::default());
    assert!(score.frames > 500, "{score:?}");
    assert!(score.ratio <= 0.6, "{score:?}");
    assert!(score.nees < 4.0, "{score:?}");
}

#[test]
fn one_faulty_robot_does_not_corrupt_the_fused_ball() {
    let honest = evaluate_team_ball(0..4, &TeamExperiment::default());
    let trial = TeamExperiment {
        faulty_robots: 1,
        ..TeamExperiment::default()
    };
    let faulty = evaluate_team_ball(0..4, &trial);
    assert!(faulty.fused < 1.4 * honest.fused, "{honest:?} {faulty:?}");
}

#[test]
fn largest_consistent_group_is_fused_and_outliers_are_listed() {
    let config = TeamConfig::default();
    let all = [
        measurement(1, 2.0, 1.0, 0.2),
        measurement(2, -4.0, 0.0, 0.01),
        measurement(3, 2.1, 1.1, 0.2),
    ];
    let fused = fuse_balls(&all, 2, &config).expect("a fused ball");
    assert_eq!((fused.inliers, fused.outliers), (vec![1, 3], vec![2]));
    assert!(fused.at.distance_to(At::new(2.05, 1.05)) < 1e-3);
    // Of two that disagree the own ball is taken.
    let fused = fuse_balls(&all[..2], 1, &config).expect("a fused ball");
    assert_eq!(fused.inliers, [1]);
    assert_eq!(fuse_balls(&[], 1, &config), None);
}

#[test]
fn team_ball_resolves_the_field_half() {
    for (x, side) in [(3.0, 1.0), (-3.0, -1.0)] {
        let mut team = TeamModel::new(TeamConfig::default());
        team.receive(&report(2, x, side));
        let ambiguous = team.update(Stamp(0), &world_with_ball(3.0, 1.0), &estimate(false));
        assert!(ambiguous.half_log_odds * side > 0.0, "{ambiguous:?}");
        assert_eq!(ambiguous.ball.expect("the team-mate's ball").inliers, [2]);
        let resolved = team.update(Stamp(0), &world_with_ball(3.0, 1.0), &estimate(true));
        assert_eq!(resolved.half_log_odds, 0.0);
    }
    // A ball at the centre, or one at neither point, gives no evidence.
    for (x, y) in [(0.0, 0.0), (0.0, -4.0)] {
        let mut team = TeamModel::new(TeamConfig::default());
        team.receive(&report(2, x, y));
        let own = if y == 0.0 {
            world_with_ball(0.0, 0.0)
        } else {
            world_with_ball(3.0, 1.0)
        };
        let view = team.update(Stamp(0), &own, &estimate(false));
        assert_eq!(view.half_log_odds, 0.0);
    }
}

#[test]
fn stale_reordered_and_own_reports_are_ignored() {
    let mut team = TeamModel::new(TeamConfig::default());
    let at = |seconds: f64, x: f32| TeamReport {
        stamp: Stamp::from_seconds(seconds),
        ball: report(2, x, 0.0).ball.map(|ball| ReportedBall {
            last_seen: Stamp::from_seconds(seconds),
            ..ball
        }),
        ..report(2, x, 0.0)
    };
    team.receive(&at(10.0, 1.0));
    team.receive(&at(9.9, 5.0));
    team.receive(&TeamReport {
        robot: 1,
        ..at(10.0, 7.0)
    });
    let now = Stamp::from_seconds(10.05);
    let view = team.update(now, &WorldView::default(), &estimate(true));
    assert!((view.ball.expect("a ball").at.x - 1.0).abs() < 1e-3);
    assert_eq!(view.teammates.len(), 1);
    assert!((view.teammates[0].age - 0.05).abs() < 1e-3);
    let later = Stamp::from_seconds(11.5);
    let view = team.update(later, &WorldView::default(), &estimate(true));
    assert_eq!((view.ball, view.teammates.len()), (None, 1));
    let view = team.update(
        Stamp::from_seconds(30.0),
        &WorldView::default(),
        &estimate(true),
    );
    assert_eq!(view.teammates, []);
}

#[test]
fn members_of_the_team_take_the_places_of_other_numbers() {
    let config = TeamConfig::default();
    let places = config.teammates_max as u32;
    let mut team = TeamModel::new(config);
    for number in 0..places {
        let stamp = Stamp(i64::from(number % 7));
        let stranger = TeamReport {
            is_member: false,
            stamp,
            ..report(100 + number, -4.0, -4.0)
        };
        team.receive(&stranger);
    }
    let numbers = |team: &mut TeamModel| {
        let view = team.update(Stamp(10), &WorldView::default(), &estimate(true));
        let numbers = view.teammates.iter().map(|mate| mate.robot);
        numbers.collect::<Vec<u32>>()
    };
    team.receive(&TeamReport {
        is_member: false,
        ..report(200, 2.0, 1.0)
    });
    assert!(!numbers(&mut team).contains(&200));
    // Of the numbers with the oldest report, 100 and 107, the first one goes.
    team.receive(&report(6, 2.0, 1.0));
    let present = numbers(&mut team);
    assert!(present.contains(&6) && !present.contains(&100) && present.contains(&107));
    assert_eq!(present.len(), places as usize);
    assert!(present.is_sorted(), "{present:?}");
    // Members do not replace one another.
    for number in 10..30 {
        team.receive(&report(number, 2.0, 1.0));
    }
    let present = numbers(&mut team);
    assert!(present.contains(&6) && present.iter().all(|number| *number < 20));
    assert_eq!(present.len(), places as usize);
}

proptest! {
    #[test]
    fn arbitrary_reports_give_finite_balls(
        reports in prop::collection::vec(
            (0_u32..20, any::<i64>(), any::<[f32; 7]>(), any::<i64>(), any::<bool>()), 0..60),
    ) {
        let mut team = TeamModel::new(TeamConfig::default());
        for (robot, stamp, [x, y, vx, vy, xx, xy, yy], last_seen, half_known) in reports {
            team.receive(&TeamReport {
                robot,
                is_member: robot % 2 == 0,
                stamp: Stamp(stamp),
                pose: Some(Pose::new(x, y, vx)),
                pose_std: [xx, xy, yy],
                half_known,
                pose_by_markings: half_known,
                ball: Some(ReportedBall {
                    at: At::new(x, y),
                    velocity: [vx, vy],
                    covariance: [xx, xy, yy],
                    last_seen: Stamp(last_seen),
                }),
                obstacles: vec![ReportedObstacle { at: At::new(y, x), covariance: [xx, xy, yy] }],
                ball_sighting: Some(BallSighting {
                    azimuth: x,
                    elevation: y,
                    std: [xx, yy],
                    viewpoint_height: vx,
                    distance: None,
                }),
            });
            let view = team.update(Stamp(stamp), &world_with_ball(3.0, 1.0), &estimate(half_known));
            let ball = view.ball.expect("our own ball or a team-mate's");
            prop_assert!(ball.at.x.is_finite() && ball.at.y.is_finite());
            prop_assert!(view.teammates.len() <= 10);
        }
    }
}
