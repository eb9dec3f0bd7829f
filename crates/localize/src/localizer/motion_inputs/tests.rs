//! Readings of the inertial unit between their stamps.

use super::MotionInputs;
use crate::sample::Imu;
use crate::sensors::attitude::AttitudeConfig;
use crate::sensors::collision::CollisionConfig;
use crate::stamp::Stamp;

/// Yaw acceleration of the robot, rad/s², and time between readings, seconds.
const YAW_ACCELERATION: f64 = 4.0;
const PERIOD: f64 = 0.005;

/// Largest error of the yaw rate that is extrapolated for 10 ms, rad/s, if the reading `k` is stamped at `stamp(k)`.
fn largest_yaw_rate_error(stamp: impl Fn(i32) -> f64) -> f32 {
    let (attitude, collision) = (AttitudeConfig::default(), CollisionConfig::default());
    let mut inputs = MotionInputs::default();
    let at = |seconds: f64| Stamp((seconds * 1e9) as i64);
    let mut largest = 0.0_f32;
    let mut before = at(0.0);
    for k in 1..400 {
        // The rate swings, so that it stays within what robots do.
        let phase = f64::from(k) * PERIOD * YAW_ACCELERATION;
        let imu = Imu {
            stamp: at(stamp(k)),
            angular_velocity: [0.0, 0.0, phase.sin() as f32],
            specific_force: [0.0; 3],
        };
        inputs.receive_imu(&imu, before, &attitude, &collision);
        before = imu.stamp;
        if stamp(k + 1) - stamp(k) > 0.6 * PERIOD && k > 200 {
            let after = at(stamp(k) + 0.01);
            let input = inputs.clone().prediction_input(before, after, &attitude);
            let rate = input
                .imu
                .expect("a reading within the timeout")
                .final_yaw_rate;
            let truth = phase + 0.01 * YAW_ACCELERATION;
            largest = largest.max((rate - truth.sin() as f32).abs());
        }
    }
    largest
}

#[test]
fn readings_that_arrive_together_do_not_multiply_the_yaw_acceleration() {
    let regular = largest_yaw_rate_error(|k| f64::from(k) * PERIOD);
    // Four readings are stamped within a millisecond, at the end of 20 ms.
    let bursts = largest_yaw_rate_error(|k| {
        let (burst, place) = ((k + 3) / 4, (k + 3) % 4);
        f64::from(burst) * 4.0 * PERIOD + f64::from(place) * 0.0002
    });
    assert!(regular < 0.03, "{regular}");
    assert!(bursts < 0.06, "{bursts}");
}
