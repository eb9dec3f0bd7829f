use nalgebra::{Matrix3, Vector3};

use super::*;
use crate::filter::{ImuInterval, PredictionInput, TiltPrior, WheelIncrement};
use crate::sensors::attitude::GRAVITY;

const DT: f32 = 0.01;

fn stationary_filter() -> (JointFilter, FilterConfig) {
    let config = FilterConfig::default();
    let seen = Matrix3::from_diagonal(&Vector3::new(1e-4, 1e-4, 1e-5));
    let origin = Pose::new(0.0, 0.0, 0.0);
    (JointFilter::new(origin, &seen, None, &config), config)
}

/// A hundredth of a second with what is felt and what the wheels counted in it.
fn predict_and_update(
    joint: &mut JointFilter,
    force: [f32; 2],
    rate: [f32; 3],
    rolled: [f32; 3],
    config: &FilterConfig,
) {
    let felt = ImuInterval {
        specific_force: force,
        rate,
        yaw_rate: rate[2],
        vibration_std: 0.0,
        sample_period: DT,
    };
    let span = PredictionInput {
        dt: DT,
        imu: Some(felt),
        ..PredictionInput::default()
    };
    joint.predict(&span, config);
    let way = WheelIncrement {
        motion: rolled.map(|speed| speed * DT),
        dt: DT,
        slip: 0.0,
        imu_active: true,
    };
    joint.update_wheels(&way, config);
}

#[test]
fn wheel_slip_does_not_bias_dead_reckoning_with_an_imu() {
    let (mut joint, config) = stationary_filter();
    let bias = [0.1, -0.08];
    for _ in 0..200 {
        predict_and_update(&mut joint, bias, [0.0; 3], [0.0; 3], &config);
        joint.zero_velocity_update(DT);
    }
    // The carpet gives 3.5 m/s², the motors pull 6 and turn the wheels by 1 rad/s besides, until both drive 2 m/s.
    let (mut x, mut speed, mut rims) = (0.0, 0.0_f32, 0.0_f32);
    for _ in 0..150 {
        let push = if speed < 2.0 { 3.5 } else { 0.0 };
        let slides = push > 0.0;
        rims = (rims + 6.0 * DT).min(2.0);
        x += (speed + 0.5 * push * DT) * DT;
        speed += push * DT;
        let spin = if slides { 1.0 } else { 0.0 };
        predict_and_update(
            &mut joint,
            [bias[0] + push, bias[1]],
            [0.0; 3],
            [rims, 0.0, spin],
            &config,
        );
    }
    // The wheels' own word would be off by 0.24 m and 33°.
    let pose = joint.pose();
    assert!(
        (pose.x - x).abs() < 0.03 && pose.y.abs() < 0.02,
        "{pose:?} {x}"
    );
    assert!(pose.theta.abs() < 0.005, "{pose:?}");
    assert!(
        (joint.scales()[0] - 1.0).abs() < 0.01,
        "{:?}",
        joint.scales()
    );
}

#[test]
fn turning_in_place_separates_accelerometer_bias_from_tilt() {
    let (mut joint, config) = stationary_filter();
    let (lean, bias) = (0.4_f32.to_radians(), 0.12);
    // Turning in place on a slope along the field's x: up turns against the robot.
    let spin = 1.5;
    for k in 0..2000 {
        let (sin, cos) = (spin * (k as f32 + 0.5) * DT).sin_cos();
        let force = [GRAVITY * lean * cos + bias, -GRAVITY * lean * sin];
        let rate = [0.0, 0.0, spin];
        predict_and_update(&mut joint, force, rate, [0.0, 0.0, spin], &config);
    }
    let found = joint.state[ACCELEROMETER_BIAS];
    assert!((found - bias).abs() < 0.02, "{found}");
    let (sin, cos) = (spin * 20.0).sin_cos();
    for (found, wanted) in [
        (joint.state[TILT], lean * cos),
        (joint.state[TILT + 1], -lean * sin),
    ] {
        assert!(
            (found - wanted).abs() < 0.1_f32.to_radians(),
            "{found} {wanted}"
        );
    }
}

#[test]
fn tilt_prior_comes_from_the_state_only_while_the_imu_is_active() {
    let (mut joint, config) = stationary_filter();
    predict_and_update(&mut joint, [0.0; 2], [0.0; 3], [0.0; 3], &config);
    let fresh = joint.predicted_covariance(TiltPrior::Independent(0.01));
    assert!((fresh[(3, 3)] - 1e-4).abs() < 1e-9 && fresh[(0, 3)] == 0.0);
    let own = joint.predicted_covariance(TiltPrior::FromState)[(3, 3)].sqrt();
    let usual = config.tilt_std_deg.to_radians();
    assert!((own - usual).abs() < 0.01 * usual, "{own}");
    assert!(joint.tilt().is_some());
    joint.predict(
        &PredictionInput {
            dt: DT,
            ..PredictionInput::default()
        },
        &config,
    );
    assert!(joint.tilt().is_none());
}
