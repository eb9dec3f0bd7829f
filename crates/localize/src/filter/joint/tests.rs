use nalgebra::{Matrix3, Vector3};

use super::*;
use crate::attitude::GRAVITY;
use crate::filter::{Felt, LeanPrior, Span, Way};

const DT: f32 = 0.01;

fn standing() -> (Joint, FilterConfig) {
    let config = FilterConfig::default();
    let seen = Matrix3::from_diagonal(&Vector3::new(1e-4, 1e-4, 1e-5));
    let origin = Pose::new(0.0, 0.0, 0.0);
    (Joint::new(origin, &seen, None, &config), config)
}

/// A hundredth of a second with what is felt and what the wheels counted in it.
fn pass(
    joint: &mut Joint,
    force: [f32; 2],
    rate: [f32; 3],
    rolled: [f32; 3],
    config: &FilterConfig,
) {
    let felt = Felt {
        force,
        rate,
        spin: rate[2],
        rattle: 0.0,
        interval: DT,
    };
    let span = Span {
        seconds: DT,
        felt: Some(felt),
        ..Span::default()
    };
    joint.advance(&span, config);
    let way = Way {
        motion: rolled.map(|speed| speed * DT),
        seconds: DT,
        slip: 0.0,
        watched: true,
    };
    joint.wheels(&way, config);
}

#[test]
fn sliding_wheels_neither_draw_nor_turn_a_blind_robot() {
    let (mut joint, config) = standing();
    let bias = [0.1, -0.08];
    for _ in 0..200 {
        pass(&mut joint, bias, [0.0; 3], [0.0; 3], &config);
        joint.rest(DT);
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
        pass(
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
fn what_gravity_says_at_every_heading_alike_is_bias_and_what_turns_is_lean() {
    let (mut joint, config) = standing();
    let (lean, bias) = (0.4_f32.to_radians(), 0.12);
    // Turning in place on a slope along the field's x: up turns against the robot.
    let spin = 1.5;
    for k in 0..2000 {
        let (sin, cos) = (spin * (k as f32 + 0.5) * DT).sin_cos();
        let force = [GRAVITY * lean * cos + bias, -GRAVITY * lean * sin];
        let rate = [0.0, 0.0, spin];
        pass(&mut joint, force, rate, [0.0, 0.0, spin], &config);
    }
    let found = joint.state[ACCELEROMETER_BIAS];
    assert!((found - bias).abs() < 0.02, "{found}");
    let (sin, cos) = (spin * 20.0).sin_cos();
    for (found, wanted) in [
        (joint.state[LEAN], lean * cos),
        (joint.state[LEAN + 1], -lean * sin),
    ] {
        assert!(
            (found - wanted).abs() < 0.1_f32.to_radians(),
            "{found} {wanted}"
        );
    }
}

#[test]
fn a_frame_s_lean_is_the_belief_s_own_only_while_a_unit_tells() {
    let (mut joint, config) = standing();
    pass(&mut joint, [0.0; 2], [0.0; 3], [0.0; 3], &config);
    let fresh = joint.sight_covariance(LeanPrior::Fresh(0.01));
    assert!((fresh[(3, 3)] - 1e-4).abs() < 1e-9 && fresh[(0, 3)] == 0.0);
    let own = joint.sight_covariance(LeanPrior::Own)[(3, 3)].sqrt();
    let usual = config.lean_std_deg.to_radians();
    assert!((own - usual).abs() < 0.01 * usual, "{own}");
    assert!(joint.lean().is_some());
    joint.advance(
        &Span {
            seconds: DT,
            ..Span::default()
        },
        &config,
    );
    assert!(joint.lean().is_none());
}
