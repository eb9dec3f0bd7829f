//! Two mates keep a blind robot within 10 cm with an honest covariance, and blind mates make nobody surer.

use super::*;

fn field() -> Field {
    let path =
        std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/fields/msl_18x12.toml");
    Field::load(&path).expect("the field")
}

fn run(seeds: u64, trial: &CooperativeExperiment) -> Vec<CooperativeScore> {
    let field = field();
    let localizer = cooperative_localizer(&field);
    (0..seeds)
        .map(|seed| evaluate_cooperative(&field, &localizer, seed, trial))
        .collect()
}

/// Root of the mean square error, metres, and mean NEES, of drives that all kept their pose.
fn error_and_nees(scores: &[CooperativeScore]) -> (f64, f64) {
    let count = scores.len() as f64;
    let squared = |score: &CooperativeScore| score.position_error.expect("a pose").powi(2);
    let error = (scores.iter().map(squared).sum::<f64>() / count).sqrt();
    let nees = scores.iter().map(|score| score.nees.expect("a pose"));
    (error, nees.sum::<f64>() / count)
}

fn alone() -> CooperativeExperiment {
    let mut trial = CooperativeExperiment::default();
    trial.config.enabled = false;
    trial
}

#[test]
fn two_mates_keep_a_blind_robot_within_10_cm_and_honest() {
    let (error, nees) = error_and_nees(&run(20, &CooperativeExperiment::default()));
    assert!(error < 0.075, "{error} m");
    // 2 is honest. Half of the mates' errors never changes, whatever the filter assumes.
    assert!((0.8..3.5).contains(&nees), "{nees}");
    let lost_or_wrong = run(20, &alone())
        .iter()
        .filter(|score| score.position_error.is_none_or(|error| error > 0.1))
        .count();
    assert!(lost_or_wrong >= 15, "{lost_or_wrong} of 20 without mates");
}

#[test]
fn honesty_does_not_depend_on_how_long_errors_last() {
    for error_time in [0.3, 10.0] {
        let trial = CooperativeExperiment {
            error_time,
            ..CooperativeExperiment::default()
        };
        let (error, nees) = error_and_nees(&run(20, &trial));
        assert!(
            error < 0.08 && nees < 3.5,
            "{error_time} s: {error} m, {nees}"
        );
    }
}

#[test]
fn blind_mates_make_nobody_surer() {
    let trial = CooperativeExperiment {
        mates_blind: true,
        ..CooperativeExperiment::default()
    };
    let among_blind = run(6, &trial);
    assert_eq!(among_blind, run(6, &alone()));
    assert!(among_blind.iter().all(|score| score.used == 0));
}

#[test]
fn opponents_nearby_are_not_taken_for_the_robot_while_it_sees_them() {
    let trial = CooperativeExperiment {
        opponents: 4,
        ..CooperativeExperiment::default()
    };
    let scores = run(20, &trial);
    assert!(scores.iter().map(|score| score.ambiguous).sum::<usize>() > 20);
    let errors = scores
        .iter()
        .map(|score| score.position_error.unwrap_or(1.0));
    let far = errors.filter(|error| *error > 0.15).count();
    assert!(far <= 2, "{far} of 20");
}

#[test]
fn one_mate_of_three_that_is_elsewhere_does_not_move_the_robot() {
    for lie in [0.5, 2.0] {
        let trial = CooperativeExperiment {
            mates: 3,
            liars: 1,
            lie,
            ..CooperativeExperiment::default()
        };
        let (error, _) = error_and_nees(&run(20, &trial));
        assert!(error < 0.1, "{lie} m off: {error} m");
    }
}
