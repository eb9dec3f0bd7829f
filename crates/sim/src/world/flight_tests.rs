//! A ball in the air passes over robots and crossbars, bounces off them, and obeys the laws of conservation.

use std::path::Path;

use localize::sensors::attitude::GRAVITY;

use super::*;

fn field() -> Field {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/fields/msl_18x12.toml");
    Field::load(&path).expect("a field")
}

fn world(others: &[(Pose, TeamColour)], ball: &str) -> SimWorld {
    let text =
        format!("robot = \"r\"\nduration = 1.0\nstart = {{ x = -8.0, y = 5.0 }}\n[ball]\n{ball}");
    let scenario: Scenario = toml::from_str(&text).expect("a scenario");
    let (base, body) = (BaseConfig::default(), BodyConfig::default());
    SimWorld::new(&field(), &base, &body, &scenario, others).expect("a world")
}

/// States of the ball at each time step.
fn fly(world: &mut SimWorld, seconds: f32) -> Vec<BallState> {
    (0..(seconds / STEP) as usize)
        .map(|_| {
            world.step(Twist::default());
            world.ball().expect("a ball")
        })
        .collect()
}

fn kick(world: &mut SimWorld, at: [f32; 2], height: f32, velocity: [f32; 3]) {
    world.set_ball_state(&BallState {
        at: At::new(at[0], at[1]),
        height,
        velocity: [velocity[0], velocity[1]],
        vertical_velocity: velocity[2],
    });
}

#[test]
fn chipped_ball_lands_where_the_parabola_ends() {
    let mut world = world(&[], "drag_coefficient = 0.0");
    kick(&mut world, [-4.0, 0.0], 0.0, [4.0, 1.0, 5.0]);
    let duration = 10.0 / GRAVITY;
    let flight = fly(&mut world, duration);
    let last = flight.last().expect("states");
    assert!(
        last.at
            .distance_to(At::new(-4.0 + 4.0 * duration, duration))
            < 0.02
    );
    assert!(last.height < 0.02, "{last:?}");
    let apex = flight.iter().map(|ball| ball.height).fold(0.0, f32::max);
    assert!((apex - 12.5 / GRAVITY).abs() < 1e-3, "{apex}");
}

#[test]
fn ball_flies_over_a_robot_or_bounces_off_it_by_its_height() {
    let robot = [(Pose::new(0.0, 0.0, 0.3), TeamColour::Magenta)];
    let passes = |up: f32| {
        let mut world = world(&robot, "drag_coefficient = 0.0");
        // 0.6 s to the robot.
        kick(&mut world, [-3.0, 0.0], 0.0, [5.0, 0.0, up]);
        let flight = fly(&mut world, 0.8);
        flight.last().expect("states").at.x > 0.5
    };
    assert!(passes(5.0));
    assert!(!passes(3.2) && !passes(0.0));
}

#[test]
fn ball_does_not_rest_on_a_robot_or_on_a_goal() {
    let robot = [(Pose::new(1.0, 1.0, 0.0), TeamColour::Magenta)];
    for (at, height) in [
        ([1.0, 1.0], 1.5),
        ([1.1, 0.9], 1.5),
        ([9.2, 0.3], 2.0),
        ([-9.3, -0.5], 2.0),
    ] {
        let mut world = world(&robot, "drag_coefficient = 0.3");
        kick(&mut world, at, height, [0.0; 3]);
        let flight = fly(&mut world, 8.0);
        let met = flight.windows(2).any(|pair| {
            pair[0].height > 0.5 && pair[1].vertical_velocity > pair[0].vertical_velocity + 0.1
        });
        assert!(met, "{at:?}: it fell through");
        let last = flight.last().expect("states");
        assert!(last.height == 0.0, "{at:?}: {last:?}");
    }
}

#[test]
fn crossbar_returns_a_ball_that_meets_it_and_no_other() {
    let returns = |height: f32| {
        let mut world = world(&[], "drag_coefficient = 0.0");
        kick(&mut world, [7.0, 0.4], height, [10.0, 0.0, 1.0]);
        let flight = fly(&mut world, 0.25);
        let last = flight.last().expect("states");
        (last.velocity[0] < 0.0, last.at.x)
    };
    // Height of a ball's lowest point whose centre is as high as the bar's middle.
    let goal = field().config.goal;
    let middle = goal.height + goal.post / 2.0 - 0.11;
    // In the 0.18 s until it arrives the kick rises by about 2 cm.
    assert!(returns(middle).0);
    let (over, x) = returns(middle + 0.25);
    assert!(!over && x > 9.4, "{x}");
    let (under, x) = returns(middle - 0.4);
    assert!(!under && x > 8.9, "{x}");
}

#[test]
fn ball_in_the_air_never_leaves_the_hall_or_gains_energy() {
    let robots: Vec<(Pose, TeamColour)> = (0..4)
        .map(|i| (Pose::new(2.0 * i as f32 - 3.0, 0.5, 0.4), TeamColour::Cyan))
        .collect();
    for number in 0..48 {
        let (sin, cos) = (7.5 * number as f32 + 2.0).to_radians().sin_cos();
        let mut world = world(&robots, "");
        let up = 2.0 + (number % 7) as f32;
        kick(&mut world, [6.0, 0.3], 0.0, [8.0 * cos, 8.0 * sin, up]);
        let energy = |ball: &BallState| {
            let [x, y] = ball.velocity;
            0.5 * (x * x + y * y + ball.vertical_velocity.powi(2)) + GRAVITY * ball.height
        };
        let first = energy(&world.ball().expect("a ball"));
        for ball in fly(&mut world, 4.0) {
            assert!(
                ball.at.x.abs() < 11.0 && ball.at.y.abs() < 8.0,
                "{number}: {ball:?}"
            );
            // A robot's rim lifts a ball by less than its radius; robots stand.
            assert!(energy(&ball) < first + GRAVITY * 0.11, "{number}: {ball:?}");
            assert!(ball.height >= 0.0 && ball.height < 6.0);
        }
    }
}

#[test]
fn equal_kicks_give_equal_flights() {
    let flight = || {
        let mut world = world(&[(Pose::new(0.0, 0.0, 0.3), TeamColour::Magenta)], "");
        kick(&mut world, [-3.0, 0.1], 0.0, [5.0, 0.0, 4.0]);
        fly(&mut world, 3.0)
    };
    assert_eq!(flight(), flight());
}
