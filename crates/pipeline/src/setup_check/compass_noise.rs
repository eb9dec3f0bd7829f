//! How much do the readings of the compass scatter? Steps between readings, less the turns of the wheels.

use localize::frames::wrap_angle;
use localize::sample::{Compass, Odometry};

use super::measurements::COMPASS_AGE_MAX;
use crate::recording::{RecordedData, Recording};

/// Fewer steps say nothing.
const STEPS_MIN: usize = 10;
/// Median of the magnitudes of a normal distribution over its standard deviation.
const MEDIAN_MAGNITUDE: f32 = 0.6745;

/// Noise of the compass in a recording, radians. None without compass or wheels.
pub(super) fn recording_noise(recording: &Recording) -> Option<f32> {
    let (mut readings, mut odometry) = (Vec::new(), Vec::new());
    for sample in recording.remaining_samples() {
        match &sample.data {
            RecordedData::Compass(reading) => readings.push(*reading),
            RecordedData::Odometry(row) => odometry.push(*row),
            _ => {}
        }
    }
    noise_of_steps(&readings, &odometry)
}

/// Standard deviation of the readings from one to the next, radians. None for too few, or without wheels.
///
/// Wheels in a wrong unit or with a wrong sign make it no larger: the smaller one with and without their turns counts.
fn noise_of_steps(readings: &[Compass], odometry: &[Odometry]) -> Option<f32> {
    let turn_between = |from, to| {
        let [first, end] =
            [from, to].map(|stamp| odometry.partition_point(|row| row.stamp <= stamp));
        let rows = odometry.get(first..end).unwrap_or_default();
        rows.iter().map(|row| row.dtheta).sum::<f32>()
    };
    let steps: Vec<[f32; 2]> = readings
        .array_windows()
        .filter(|[before, after]| after.stamp - before.stamp <= COMPASS_AGE_MAX)
        .map(|[before, after]| {
            let step = after.heading - before.heading;
            let beyond_wheels = step - turn_between(before.stamp, after.stamp);
            [step, beyond_wheels].map(|step| wrap_angle(step).abs())
        })
        .collect();
    if steps.len() < STEPS_MIN || odometry.is_empty() {
        return None;
    }
    let noise = |of: usize| {
        let mut steps: Vec<f32> = steps.iter().map(|step| step[of]).collect();
        steps.sort_by(f32::total_cmp);
        // Two readings make a step.
        steps[steps.len() / 2] / MEDIAN_MAGNITUDE / std::f32::consts::SQRT_2
    };
    Some(noise(0).min(noise(1)))
}

#[cfg(test)]
mod tests {
    use localize::{Stamp, math};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// Noise of a compass with 20 readings a second on a robot that turns fast; `wheels`: measured over true turn.
    fn noise(std: f32, wheels: f32) -> f32 {
        let mut random = ChaCha8Rng::seed_from_u64(5);
        let heading = |time: f64| 2.5 * math::sin(1.2 * time as f32);
        let (mut readings, mut odometry) = (Vec::new(), Vec::new());
        for step in 1..2000 {
            let time = 0.01 * f64::from(step);
            odometry.push(Odometry {
                stamp: Stamp::from_seconds(time),
                dx: 0.0,
                dy: 0.0,
                dtheta: wheels * (heading(time) - heading(time - 0.01)),
                slip: 0.0,
            });
            if step % 5 == 0 {
                let deviations: f32 = (0..12).map(|_| random.random_range(-1.0_f32..1.0)).sum();
                readings.push(Compass {
                    stamp: Stamp::from_seconds(time),
                    heading: wrap_angle(heading(time) + 0.5 * std * deviations),
                    magnetic_field: None,
                });
            }
        }
        noise_of_steps(&readings, &odometry).expect("readings")
    }

    #[test]
    fn noise_of_readings_is_measured_also_with_wrong_wheels() {
        for std in [0.1, 0.7] {
            let right = noise(std, 1.0);
            assert!((0.8 * std..1.2 * std).contains(&right), "{std}: {right}");
        }
        for wheels in [0.0, -1.0, 57.3] {
            assert!(noise(0.1, wheels) < 0.2, "{wheels}");
        }
    }
}
