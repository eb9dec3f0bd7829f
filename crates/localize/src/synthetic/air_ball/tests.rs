//! A ball in the air is distinguished from one on the ground, located, and given a consistent covariance.

use super::*;

fn sum(trial: &AirExperiment, seeds: u64) -> AirScore {
    let mut sum = AirScore::default();
    for seed in 0..seeds {
        let score = evaluate_air_ball(seed, trial);
        sum.images += score.images;
        sum.airborne += score.airborne;
        sum.misplaced += score.misplaced;
        sum.airborne_found += score.airborne_found;
        sum.false_alarms += score.false_alarms;
        sum.on_ground += score.on_ground;
        sum.error_sum += score.error_sum;
        sum.errors += score.errors;
        sum.nees_sum += score.nees_sum;
        sum.covered += score.covered;
        sum.landing_sum += score.landing_sum;
        sum.landings += score.landings;
        sum.faulty_images += score.faulty_images;
        sum.faulty_named += score.faulty_named;
    }
    sum
}

#[test]
fn one_robot_tells_flight_from_ground() {
    let flight = sum(&AirExperiment::default(), 40);
    let ground = sum(
        &AirExperiment {
            motion: BallMotion::Ground,
            ..AirExperiment::default()
        },
        40,
    );
    assert!(
        5 * flight.airborne_found > 3 * flight.airborne,
        "{flight:?}"
    );
    assert!(50 * ground.false_alarms < ground.on_ground, "{ground:?}");
}

#[test]
fn three_robots_find_a_ball_in_the_air() {
    for (motion, error_max) in [(BallMotion::Held, 0.13), (BallMotion::Flight, 0.2)] {
        let trial = AirExperiment {
            motion,
            robots: 3,
            ..AirExperiment::default()
        };
        let score = sum(&trial, 40);
        assert!(
            score.error().is_some_and(|error| error < error_max),
            "{score:?}"
        );
    }
}

#[test]
fn covariance_of_a_held_ball_is_honest() {
    let trial = AirExperiment {
        motion: BallMotion::Held,
        robots: 3,
        ..AirExperiment::default()
    };
    let nees = sum(&trial, 40).nees().expect("errors");
    assert!((1.0..6.0).contains(&nees), "{nees}");
}

#[test]
fn covariance_in_flight_is_honest() {
    for robots in [1, 2, 3] {
        for error_time in [0.15, 0.5, 2.0] {
            let trial = AirExperiment {
                robots,
                error_time,
                ..AirExperiment::default()
            };
            let score = sum(&trial, 40);
            let covered = score.covered as f64 / score.errors as f64;
            assert!(covered > 0.88, "{robots} {error_time} {covered}");
            let nees = score.nees().expect("errors");
            assert!((1.0..6.0).contains(&nees), "{robots} {error_time} {nees}");
        }
    }
}

#[test]
fn one_faulty_robot_of_three_is_named() {
    let trial = AirExperiment {
        motion: BallMotion::Held,
        robots: 3,
        faulty_robots: 1,
        ..AirExperiment::default()
    };
    let score = sum(&trial, 20);
    assert!(
        10 * score.faulty_named > 8 * score.faulty_images,
        "{score:?}"
    );
}

#[test]
fn ball_in_a_hand_that_lifts_it_does_not_roll_away() {
    for robots in [1, 3] {
        let trial = AirExperiment {
            motion: BallMotion::Carried,
            robots,
            ..AirExperiment::default()
        };
        let score = sum(&trial, 40);
        assert!(
            10 * score.airborne_found > 9 * score.airborne,
            "{robots} {score:?}"
        );
        assert!(50 * score.misplaced < score.images, "{robots} {score:?}");
        assert!(
            score.covered as f64 > 0.9 * score.errors as f64,
            "{robots} {score:?}"
        );
    }
}
