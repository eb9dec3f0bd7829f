use nalgebra::{Matrix3, Vector3};

use super::*;
use crate::filter::pose_gaussian::{PoseMeasurement, kalman_update};
use crate::filter::{ImuInterval, PredictionInput, TiltPrior, WheelIncrement};
use crate::sensors::attitude::GRAVITY;

const DT: f32 = 0.01;

fn stationary_filter() -> (JointFilter, FilterConfig) {
    let config = FilterConfig::default();
    let covariance = Matrix3::from_diagonal(&Vector3::new(1e-4, 1e-4, 1e-5));
    let origin = Pose::new(0.0, 0.0, 0.0);
    (
        JointFilter::new(
            origin,
            &covariance,
            None,
            &config,
            &OdometryPrior::of_any_base(&config),
        ),
        config,
    )
}

/// One step of `DT`: specific force and rate of the inertial unit, velocity of the wheels.
fn predict_and_update(
    filter: &mut JointFilter,
    force: [f32; 2],
    rate: [f32; 3],
    wheels: [f32; 3],
    config: &FilterConfig,
) {
    let imu = ImuInterval {
        specific_force: force,
        mean_angular_velocity: rate,
        final_yaw_rate: rate[2],
        vibration_std: 0.0,
        sample_period: DT,
    };
    let input = PredictionInput {
        dt: DT,
        imu: Some(imu),
        ..PredictionInput::default()
    };
    filter.predict(&input, config);
    let increment = WheelIncrement {
        motion: wheels.map(|speed| speed * DT),
        dt: DT,
        slip: 0.0,
        imu_active: true,
    };
    filter.update_wheels(&increment, config);
}

/// Noise of unit variance.
fn noise_source() -> impl FnMut() -> f32 {
    let mut state = 1u32;
    move || {
        let uniform = (0..12).map(|_| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1 << 24) as f32 - 0.5
        });
        uniform.sum()
    }
}

#[test]
fn noise_of_slow_wheels_does_not_shrink_their_scale() {
    let (mut filter, config) = stationary_filter();
    let mut noise = noise_source();
    let (amplitude, frequency) = (0.3, std::f32::consts::PI);
    for step in 0..6000 {
        let time = step as f32 * DT;
        let speed = |time: f32| amplitude * (frequency * time).sin();
        let acceleration = (speed(time + DT) - speed(time)) / DT;
        let mean = 0.5 * (speed(time) + speed(time + DT));
        // 2 mm in each sample of 2 mm on average.
        let wheels = [mean + 0.002 * noise() / DT, 0.0, 0.0];
        predict_and_update(&mut filter, [acceleration, 0.0], [0.0; 3], wheels, &config);
    }
    let scale = filter.state[super::odometry_correction::entry(0, 0)];
    assert!((scale - 1.0).abs() < 0.05, "{scale}");
}

/// The scales that a creeping robot learns from ticks of this size: metres, metres, radians.
fn scales_after_creeping(tick: [f32; 3]) -> [f32; 2] {
    let (mut filter, config) = stationary_filter();
    let mut noise = noise_source();
    for _ in 0..50 {
        let force = [0.15 * noise(), 0.15 * noise()];
        predict_and_update(&mut filter, force, [0.0; 3], [0.0; 3], &config);
        filter.zero_velocity_update(DT);
    }
    let velocity = [0.02, 0.008, 0.017_f32];
    let ticks_at = |step: usize| {
        let time = step as f32 * DT;
        [0, 1, 2].map(|k| (velocity[k] * time / tick[k] + 0.3).floor())
    };
    for step in 0..1000 {
        let (before, after) = (ticks_at(step), ticks_at(step + 1));
        let wheels = [0, 1, 2].map(|k| (after[k] - before[k]) * tick[k] / DT);
        let force = [0.15 * noise(), 0.15 * noise()];
        let rates = [0.0, 0.0, velocity[2] + 0.005 * noise()];
        predict_and_update(&mut filter, force, rates, wheels, &config);
    }
    let [vx, vy] = [0, 1].map(|k| filter.state[super::TWIST + k]);
    let error = crate::math::hypot(vx - velocity[0], vy - velocity[1]);
    assert!(error < 0.01, "{tick:?}: {vx} {vy} m/s");
    filter.scales()
}

/// Encoders count whole ticks, so the error of a sample returns with the opposite sign in the next one.
#[test]
fn ticks_of_a_creeping_robot_do_not_shrink_its_scales() {
    for tick in [[5e-5, 5e-5, 2e-4], [7e-4, 7e-4, 2e-3]] {
        for scale in scales_after_creeping(tick) {
            assert!((scale - 1.0).abs() < 0.05, "{tick:?}: {scale}");
        }
    }
}

#[test]
fn wheel_slip_does_not_bias_dead_reckoning_with_an_imu() {
    let (mut filter, config) = stationary_filter();
    let bias = [0.1, -0.08];
    for _ in 0..200 {
        predict_and_update(&mut filter, bias, [0.0; 3], [0.0; 3], &config);
        filter.zero_velocity_update(DT);
    }
    // The carpet transmits 3.5 m/s². The motors accelerate the rims by 6 m/s² and rotate them by 1 rad/s, up to 2 m/s.
    let (mut x, mut speed, mut rim_speed) = (0.0, 0.0_f32, 0.0_f32);
    for _ in 0..150 {
        let acceleration = if speed < 2.0 { 3.5 } else { 0.0 };
        rim_speed = (rim_speed + 6.0 * DT).min(2.0);
        x += (speed + 0.5 * acceleration * DT) * DT;
        speed += acceleration * DT;
        let yaw_rate = if acceleration > 0.0 { 1.0 } else { 0.0 };
        predict_and_update(
            &mut filter,
            [bias[0] + acceleration, bias[1]],
            [0.0; 3],
            [rim_speed, 0.0, yaw_rate],
            &config,
        );
    }
    // Wheel odometry alone would be wrong by 0.24 m and 33°.
    let pose = filter.pose();
    assert!(
        (pose.x - x).abs() < 0.03 && pose.y.abs() < 0.02,
        "{pose:?} {x}"
    );
    assert!(pose.theta.abs() < 0.005, "{pose:?}");
    assert!(
        (filter.scales()[0] - 1.0).abs() < 0.015,
        "{:?}",
        filter.scales()
    );
}

#[test]
fn turning_in_place_separates_accelerometer_bias_from_tilt() {
    let (mut filter, config) = stationary_filter();
    let (tilt, bias) = (0.4_f32.to_radians(), 0.12);
    // The robot rotates on a slope along the field's x.
    let yaw_rate = 1.5;
    for k in 0..2000 {
        let (sin, cos) = (yaw_rate * (k as f32 + 0.5) * DT).sin_cos();
        let force = [GRAVITY * tilt * cos + bias, -GRAVITY * tilt * sin];
        let rate = [0.0, 0.0, yaw_rate];
        predict_and_update(&mut filter, force, rate, [0.0, 0.0, yaw_rate], &config);
    }
    let estimated = filter.state[ACCELEROMETER_BIAS];
    assert!((estimated - bias).abs() < 0.02, "{estimated}");
    let (sin, cos) = (yaw_rate * 20.0).sin_cos();
    for (estimated, expected) in [
        (filter.state[TILT], tilt * cos),
        (filter.state[TILT + 1], -tilt * sin),
    ] {
        assert!(
            (estimated - expected).abs() < 0.1_f32.to_radians(),
            "{estimated} {expected}"
        );
    }
}

#[test]
fn tilt_prior_comes_from_the_state_only_while_the_imu_is_active() {
    let (mut filter, config) = stationary_filter();
    predict_and_update(&mut filter, [0.0; 2], [0.0; 3], [0.0; 3], &config);
    let independent = filter.predicted_covariance(TiltPrior::Independent(0.01));
    assert!((independent[(3, 3)] - 1e-4).abs() < 1e-9 && independent[(0, 3)] == 0.0);
    let from_state = filter.predicted_covariance(TiltPrior::STATE)[(3, 3)].sqrt();
    let expected = config.tilt_std_deg.to_radians();
    assert!(
        (from_state - expected).abs() < 0.01 * expected,
        "{from_state}"
    );
    assert!(filter.tilt().is_some());
    filter.predict(
        &PredictionInput {
            dt: DT,
            ..PredictionInput::default()
        },
        &config,
    );
    assert!(filter.tilt().is_none());
}

#[test]
fn velocity_that_a_saturated_inertial_unit_missed_is_learned_from_images() {
    let (mut filter, config) = stationary_filter();
    for _ in 0..100 {
        predict_and_update(&mut filter, [0.0; 2], [0.0; 3], [0.0; 3], &config);
    }
    // A push that no reading showed: 1.4 m/s from now on, until the wheels roll with it. They count as spinning.
    let shown = |images: u32| 1.4 * DT * 3.0 * images as f32;
    for image in 1..=15 {
        for _ in 0..3 {
            predict_and_update(&mut filter, [0.0; 2], [0.0; 3], [1.4, 0.0, 0.0], &config);
        }
        let pose = Pose::new(shown(image), 0.0, 0.0);
        let motion = pose.difference(filter.pose());
        if motion.x.abs() > 0.01 {
            filter.admit_motion(motion.x.abs(), 0.0);
        }
        let predicted = filter.predicted_covariance(TiltPrior::STATE);
        let measured = PoseMeasurement {
            pose,
            covariance: Matrix3::from_diagonal(&Vector3::new(1e-4, 1e-4, 1e-5)),
        };
        let posterior = kalman_update(filter.pose(), &predicted, &measured).expect("a posterior");
        filter.update(&posterior, TiltPrior::STATE, &config);
    }
    let speed = filter.twist().x;
    assert!((speed - 1.4).abs() < 0.1, "{speed}");
    assert!(!filter.in_collision());
}
