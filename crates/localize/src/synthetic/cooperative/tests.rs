//! Two mates keep a blind robot within 10 cm, and nobody makes it surer than it is.

use super::*;
use crate::localizer::CooperativeConfig;

fn field() -> Field {
    let path =
        std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/fields/msl_18x12.toml");
    Field::load(&path).expect("the field")
}

/// Root mean square error (metres), mean NEES and drives without a pose.
fn run(seeds: u64, trial: &CooperativeExperiment) -> (f64, f64, usize) {
    let field = field();
    let localizer = cooperative_localizer(&field);
    let (mut squared, mut nees, mut count) = (0.0, 0.0, 0);
    for seed in 0..seeds {
        let score = evaluate_cooperative(&field, &localizer, seed, trial);
        if std::env::var("V").is_ok() {
            println!("{seed} {score:?}");
        }
        if let (Some(error), Some(normalized)) = (score.position_error, score.nees) {
            squared += error * error;
            nees += normalized;
            count += 1;
        }
    }
    let scored = count as f64;
    (
        (squared / scored).sqrt(),
        nees / scored,
        seeds as usize - count,
    )
}

#[test]
fn explore() {
    let var = |name: &str, default: f32| {
        std::env::var(name).map_or(default, |v| v.parse().expect("number"))
    };
    let d = CooperativeConfig::default();
    let config = CooperativeConfig {
        enabled: var("ON", 1.0) > 0.0,
        own_std_min: var("MIN", d.own_std_min),
        own_std_max: var("MAX", d.own_std_max),
        error_time: var("TIME", d.error_time),
        position_std_min: var("FLOOR", d.position_std_min),
        gate: var("GATE", d.gate),
        clock_std: var("CLOCK", d.clock_std),
        ambiguity_margin: var("MARGIN", d.ambiguity_margin),
        doubt_after: var("DOUBT", d.doubt_after),
        ..d
    };
    let t = CooperativeExperiment::default();
    let trial = CooperativeExperiment {
        mates: var("MATES", 2.0) as usize,
        opponents: var("OPP", 0.0) as usize,
        liars: var("LIARS", 0.0) as usize,
        lie: var("LIE", 0.5),
        sees_robots: var("SEES", 1.0) > 0.0,
        mates_blind: var("BLIND", 0.0) > 0.0,
        speed_max: f64::from(var("SPEED", 3.0)),
        error_time: var("ETIME", 2.0),
        config,
        ..t
    };
    let (rms, nees, lost) = run(var("SEEDS", 40.0) as u64, &trial);
    println!("RESULT rms {rms:.4} nees {nees:.2} lost {lost}");
}
