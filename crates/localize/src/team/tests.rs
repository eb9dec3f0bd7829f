//! Claims about the team's ball: what several see is known better, and nobody spoils it.

use nalgebra::{Matrix3, Matrix4};
use proptest::prelude::*;

use super::experiment::{Trial, shared_ball};
use super::{Ball, Report, TeamConfig, TeamModel, Witness, merge};
use crate::estimate::{Estimate, Mode};
use crate::frame::{At, Pose};
use crate::stamp::Stamp;
use crate::world::{Object, OnField, World};

fn witness(robot: u32, x: f32, y: f32, std: f32) -> Witness {
    Witness {
        robot,
        at: At::new(x, y),
        velocity: [0.0; 2],
        covariance: [std * std, 0.0, std * std],
    }
}

fn report(robot: u32, x: f32, y: f32) -> Report {
    Report {
        robot,
        stamp: Stamp(0),
        pose: Some(Pose::new(0.0, 0.0, 0.0)),
        pose_std: [0.05, 0.05, 0.02],
        half_known: true,
        ball: Some(Ball {
            at: At::new(x, y),
            velocity: [0.0; 2],
            covariance: [0.02, 0.0, 0.02],
            seen: Stamp(0),
        }),
        obstacles: Vec::new(),
    }
}

fn estimate(half_known: bool) -> Estimate {
    Estimate {
        stamp: Stamp(0),
        pose: Some(Pose::new(1.0, 1.0, 0.0)),
        covariance: Matrix3::from_diagonal_element(1e-3),
        mode: Mode::Tracking,
        reason: None,
        residual: 0.0,
        inlier_share: 1.0,
        line_points: 50,
        lean: [0.0; 2],
        half_known,
        odometry_scales: [1.0; 2],
        twist: None,
        collision: false,
        gyro_bias: 0.0,
        latency: 0.0,
        runners_up: Vec::new(),
    }
}

fn seeing(x: f32, y: f32) -> World {
    let covariance = Matrix4::from_diagonal_element(0.02);
    let ball = Object {
        id: 0,
        at: At::new(x - 1.0, y - 1.0),
        velocity: [0.0; 2],
        covariance,
        on_field: Some(OnField {
            at: At::new(x, y),
            velocity: [0.0; 2],
            covariance,
        }),
        probability: 0.9,
        seen: Stamp(0),
        team: None,
    };
    World {
        ball: Some(ball),
        robots: Vec::new(),
    }
}

#[test]
fn five_robots_know_a_far_ball_better_than_the_best_of_them_with_a_fifth_of_the_words_lost() {
    let score = shared_ball(0..20, &Trial::default());
    assert!(score.frames > 500, "{score:?}");
    assert!(score.ratio <= 0.6, "{score:?}");
    assert!(score.nees < 4.0, "{score:?}");
}

#[test]
fn one_who_lies_does_not_spoil_it() {
    let honest = shared_ball(0..4, &Trial::default());
    let trial = Trial {
        liars: 1,
        ..Trial::default()
    };
    let lied = shared_ball(0..4, &trial);
    assert!(lied.merged < 1.4 * honest.merged, "{honest:?} {lied:?}");
}

#[test]
fn of_three_the_two_who_agree_are_believed_and_the_third_is_named() {
    let config = TeamConfig::default();
    let all = [
        witness(1, 2.0, 1.0, 0.2),
        witness(2, -4.0, 0.0, 0.01),
        witness(3, 2.1, 1.1, 0.2),
    ];
    let merged = merge(&all, 2, &config).expect("merged");
    assert_eq!((merged.witnesses, merged.dissenters), (vec![1, 3], vec![2]));
    assert!(merged.at.distance_to(At::new(2.05, 1.05)) < 1e-3);
    // Of two who disagree we believe our own eyes.
    let merged = merge(&all[..2], 1, &config).expect("merged");
    assert_eq!(merged.witnesses, [1]);
    assert_eq!(merge(&[], 1, &config), None);
}

#[test]
fn a_robot_that_does_not_know_its_half_is_told_by_the_ball() {
    for (x, side) in [(3.0, 1.0), (-3.0, -1.0)] {
        let mut team = TeamModel::new(TeamConfig::default());
        team.hear(&report(2, x, side));
        let unsure = team.view(Stamp(0), &seeing(3.0, 1.0), &estimate(false));
        assert!(unsure.half_evidence * side > 0.0, "{unsure:?}");
        assert_eq!(unsure.ball.expect("theirs").witnesses, [2]);
        let sure = team.view(Stamp(0), &seeing(3.0, 1.0), &estimate(true));
        assert_eq!(sure.half_evidence, 0.0);
    }
    // A ball in the middle, or one that is somewhere else altogether, tells no half.
    for (x, y) in [(0.0, 0.0), (0.0, -4.0)] {
        let mut team = TeamModel::new(TeamConfig::default());
        team.hear(&report(2, x, y));
        let own = if y == 0.0 {
            seeing(0.0, 0.0)
        } else {
            seeing(3.0, 1.0)
        };
        let view = team.view(Stamp(0), &own, &estimate(false));
        assert_eq!(view.half_evidence, 0.0);
    }
}

#[test]
fn old_words_reordered_words_and_our_own_echo_do_not_count() {
    let mut team = TeamModel::new(TeamConfig::default());
    let at = |seconds: f64, x: f32| Report {
        stamp: Stamp::from_seconds(seconds),
        ball: report(2, x, 0.0).ball.map(|ball| Ball {
            seen: Stamp::from_seconds(seconds),
            ..ball
        }),
        ..report(2, x, 0.0)
    };
    team.hear(&at(10.0, 1.0));
    team.hear(&at(9.9, 5.0));
    team.hear(&Report {
        robot: 1,
        ..at(10.0, 7.0)
    });
    let now = Stamp::from_seconds(10.05);
    let view = team.view(now, &World::default(), &estimate(true));
    assert!((view.ball.expect("a ball").at.x - 1.0).abs() < 1e-3);
    assert_eq!(view.mates.len(), 1);
    assert!((view.mates[0].age - 0.05).abs() < 1e-3);
    let later = Stamp::from_seconds(11.5);
    let view = team.view(later, &World::default(), &estimate(true));
    assert_eq!((view.ball, view.mates.len()), (None, 1));
    let view = team.view(
        Stamp::from_seconds(30.0),
        &World::default(),
        &estimate(true),
    );
    assert_eq!(view.mates, []);
}

proptest! {
    #[test]
    fn no_word_breaks_the_team(
        words in prop::collection::vec(
            (0_u32..20, any::<i64>(), any::<[f32; 7]>(), any::<i64>(), any::<bool>()), 0..60),
    ) {
        let mut team = TeamModel::new(TeamConfig::default());
        for (robot, stamp, [x, y, vx, vy, xx, xy, yy], seen, half_known) in words {
            team.hear(&Report {
                robot,
                stamp: Stamp(stamp),
                pose: Some(Pose::new(x, y, vx)),
                pose_std: [xx, xy, yy],
                half_known,
                ball: Some(Ball {
                    at: At::new(x, y),
                    velocity: [vx, vy],
                    covariance: [xx, xy, yy],
                    seen: Stamp(seen),
                }),
                obstacles: vec![At::new(y, x)],
            });
            let view = team.view(Stamp(stamp), &seeing(3.0, 1.0), &estimate(half_known));
            let ball = view.ball.expect("at least our own, or theirs");
            prop_assert!(ball.at.x.is_finite() && ball.at.y.is_finite());
            prop_assert!(view.mates.len() <= 10);
        }
    }
}
