//! Experiment: how soon and how well is a ball in the air known, by one robot and by several?
//!
//! Equal seeds give equal scores. The ball moves by [`super::flying_ball`], whose drag and lift the estimators do not
//! know. Tilt, pose and clock errors last; some rays point anywhere.

mod ball_path;
mod observer;
mod score;
mod settings;
#[cfg(test)]
mod tests;

use rand::rngs::Xoshiro256PlusPlus;
use rand::{Rng, RngExt, SeedableRng};

pub use score::AirScore;
pub use settings::{AirExperiment, BallMotion};

use ball_path::TruePath;
use observer::{CLOCK_STD, FAULT, HEADING_STD, LastingErrors, Observer, POSITION_STD, SIZE_BIAS};

use settings::{HEIGHT, RATE};

use crate::flight::{
    BallMotionMode, FlightConfig, FlightTracker, RobotRay, TeamFlightTracker, predict_landing,
};
use crate::math;
use crate::random::standard_normal;
use crate::stamp::Stamp;

/// Runs one seed.
pub fn evaluate_air_ball(seed: u64, trial: &AirExperiment) -> AirScore {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
    let path = TruePath::new(trial, &mut rng);
    if trial.robots <= 1 {
        evaluate_one(&path, trial, &mut rng)
    } else {
        evaluate_team(&path, trial, &mut rng)
    }
}

fn evaluate_one(path: &TruePath, trial: &AirExperiment, rng: &mut impl Rng) -> AirScore {
    let config = FlightConfig::default();
    let mut observer = Observer {
        at: [0.0, 0.0],
        errors: LastingErrors::new(rng),
        size_scale: 1.0 + SIZE_BIAS * standard_normal(rng),
    };
    let mut tracker = FlightTracker::new(config.clone());
    let mut score = AirScore::default();
    let landing = path.first_landing();
    for image in 0..path.images() {
        observer.errors.step(trial.error_time, rng);
        let stamp = Stamp::from_seconds(image as f64 / RATE);
        let truth = path.at(image, 0.0);
        // One mirror sees no ball above its horizon.
        if truth[2] > HEIGHT - 0.05 || rng.random::<f32>() < 0.05 {
            continue;
        }
        let ray = observer.ray(truth, stamp, trial, false, rng);
        let Some(tracked) = tracker.update(&ray) else {
            continue;
        };
        score.images += 1;
        let (high, called) = (truth[2] > 0.22, tracked.airborne_probability > 0.5);
        if high {
            score.airborne += 1;
            score.airborne_found += usize::from(called);
        } else if truth[2] < 0.111 {
            score.on_ground += 1;
            score.false_alarms += usize::from(called);
        }
        let called_path = if called {
            tracked.in_air
        } else {
            tracked.ground
        };
        let Some(state) = called_path else {
            continue;
        };
        score.add_place(&state, truth);
        if high && called {
            score.add_error(&state, truth);
            if let (Some((end, at)), Some(flight)) = (landing, tracked.flight)
                && let Some(predicted) = predict_landing(&flight, &config)
                && image + 8 <= end
            {
                let [x, y] = predicted.at.map(f64::from);
                score.landing_sum += math::hypot(x - at[0], y - at[1]);
                score.landings += 1;
            }
        }
    }
    score
}

fn evaluate_team(path: &TruePath, trial: &AirExperiment, rng: &mut impl Rng) -> AirScore {
    let mut tracker = TeamFlightTracker::new(FlightConfig::default());
    let turn = std::f64::consts::TAU * f64::from(rng.random::<f32>());
    let mut observers: Vec<Observer> = (0..trial.robots)
        .map(|robot| {
            let angle = turn
                + std::f64::consts::TAU * robot as f64 / trial.robots as f64
                + 0.5 * f64::from(rng.random::<f32>());
            let range = 3.0 + f64::from(rng.random::<f32>());
            Observer {
                at: [range * math::cos(angle), range * math::sin(angle)],
                errors: LastingErrors::new(rng),
                size_scale: 1.0 + SIZE_BIAS * standard_normal(rng),
            }
        })
        .collect();
    let mut score = AirScore::default();
    for image in 0..path.images() {
        let stamp = Stamp::from_seconds(image as f64 / RATE);
        let truth = path.at(image, 0.0);
        for (number, observer) in observers.iter_mut().enumerate() {
            observer.errors.step(trial.error_time, rng);
            // The own ray comes with each image, those of team-mates with every second one, and a fifth is lost.
            let observed = number == 0 || image % 2 == number % 2 && rng.random::<f32>() > 0.2;
            if !observed {
                continue;
            }
            let late = CLOCK_STD * observer.errors.0[5];
            let seen = path.at(image, late);
            let mut ray = observer.ray(seen, stamp, trial, true, rng);
            if number < trial.faulty_robots {
                ray.azimuth += FAULT;
                ray.elevation -= 0.5 * FAULT;
            }
            tracker.add(&RobotRay {
                robot: number as u32 + 1,
                ray,
                pose_std: [POSITION_STD, HEADING_STD],
            });
        }
        let found = tracker.ball();
        if image < 8 {
            continue;
        }
        score.images += 1;
        score.faulty_images += usize::from(trial.faulty_robots > 0);
        let Some(found) = found else {
            continue;
        };
        let expected: Vec<u32> = (1..=trial.faulty_robots as u32).collect();
        score.faulty_named += usize::from(trial.faulty_robots > 0 && found.outliers == expected);
        let (high, called) = (truth[2] > 0.22, found.mode != BallMotionMode::Ground);
        if high {
            score.airborne += 1;
            score.airborne_found += usize::from(called);
        } else if truth[2] < 0.111 {
            score.on_ground += 1;
            score.false_alarms += usize::from(called);
        }
        // The newest ray that agrees may be that of an image before.
        let image = (found.state.stamp.seconds() * RATE).round() as usize;
        score.add_place(&found.state, path.at(image, 0.0));
        if high {
            score.add_error(&found.state, path.at(image, 0.0));
        }
    }
    score
}
