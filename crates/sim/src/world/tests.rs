use std::path::Path;

use super::*;

fn field() -> Field {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/fields/msl_18x12.toml");
    Field::load(&path).expect("a field")
}

fn world_with(scenario: &str) -> SimWorld {
    let text = format!("robot = \"r\"\nduration = 1.0\n{scenario}");
    let scenario: Scenario = toml::from_str(&text).expect("a scenario");
    let (base, body) = (BaseConfig::default(), BodyConfig::default());
    SimWorld::new(&field(), &base, &body, &scenario, &[]).expect("a world")
}

fn ball_world(ball: &str) -> SimWorld {
    world_with(&format!("start = {{ x = -8.0, y = 5.0 }}\n[ball]\n{ball}"))
}

#[test]
fn fast_ball_never_tunnels_through_walls_nets_or_posts() {
    let field = field();
    for direction_deg in 0..36 {
        let (sin, cos) = (10.0 * direction_deg as f32 + 3.0).to_radians().sin_cos();
        let mut world = ball_world(
            "position = [6.0, 0.3]\nsliding_friction = 0.0001\nrolling_deceleration = 0.0",
        );
        world.place_ball(At::new(6.0, 0.3), [12.0 * cos, 12.0 * sin]);
        let mut was_in_goal = false;
        for _ in 0..1000 {
            world.step(Twist::default());
            let at = world.ball().expect("a ball").at;
            let (half_x, half_y) = field.carpet_half_extent();
            assert!(
                at.x.abs() < half_x + 0.6 && at.y.abs() < half_y + 0.6,
                "{direction_deg}: {at:?}"
            );
            // A ball inside the goal can leave it only through the mouth.
            let (line, goal) = (field.config.length / 2.0, &field.config.goal);
            let in_goal =
                at.x > line + 0.15 && at.x < line + goal.depth && at.y.abs() < goal.width / 2.0;
            if was_in_goal && !in_goal {
                assert!(
                    at.x < line + 0.2 && at.y.abs() < goal.width / 2.0,
                    "{direction_deg}: {at:?}"
                );
            }
            was_in_goal = in_goal;
        }
    }
}

#[test]
fn wall_bounce_has_the_configured_restitution() {
    let mut world = ball_world(
        "position = [0.0, 6.0]\nvelocity = [0.0, 5.0]\nsliding_friction = 0.0001\nrolling_deceleration = 0.0\nrestitution = 0.7",
    );
    for _ in 0..300 {
        world.step(Twist::default());
    }
    let [_, vy] = world.ball().expect("a ball").velocity;
    assert!((vy + 3.5).abs() < 0.05, "{vy}");
}

#[test]
fn sliding_ball_rolls_at_three_fifths_of_its_speed() {
    let mut world = ball_world(
        "position = [0.0, 0.0]\nvelocity = [4.0, 0.0]\nsliding_friction = 0.4\nrolling_deceleration = 0.0",
    );
    for _ in 0..500 {
        world.step(Twist::default());
    }
    let [vx, _] = world.ball().expect("a ball").velocity;
    assert!((vx - 2.4).abs() < 0.03, "{vx}");
}

#[test]
fn robot_reaches_commanded_twist_and_odometry_is_within_3_percent() {
    let mut world =
        world_with("start = { x = -6.0, y = -3.0, theta_deg = 30.0 }\n[ball]\npresent = false");
    let wanted = Twist {
        x: 1.5,
        y: 0.5,
        theta: 0.4,
    };
    let mut counted = world.robot().pose;
    let start = counted;
    for step in 1..=1500 {
        world.step(wanted);
        if step % 5 == 0 {
            let Odometry { dx, dy, dtheta, .. } = world.read_encoders(Stamp(0), None);
            counted = counted * localize::Tf::new(dx, dy, dtheta);
        }
    }
    let robot = world.robot();
    let (sin, cos) = robot.pose.theta.sin_cos();
    let [vx, vy] = robot.velocity;
    assert!((cos * vx + sin * vy - 1.5).abs() < 0.05 && (cos * vy - sin * vx - 0.5).abs() < 0.05);
    assert!((robot.yaw_rate - 0.4).abs() < 0.02, "{}", robot.yaw_rate);
    let error = counted.origin().distance_to(robot.pose.origin());
    let distance = 1.5f32.hypot(0.5) * 3.0;
    assert!(robot.pose.origin().distance_to(start.origin()) > 3.0);
    assert!(error < 0.03 * distance, "{error} m of {distance} m");
}

#[test]
fn wheel_slip_makes_odometry_overestimate() {
    let text =
        "robot = \"r\"\nduration = 1.0\nstart = { x = -6.0, y = 0.0 }\n[ball]\npresent = false";
    let scenario: Scenario = toml::from_str(text).expect("a scenario");
    let slip = |acceleration_max| {
        let base = BaseConfig {
            acceleration_max,
            ..BaseConfig::default()
        };
        let mut world = SimWorld::new(&field(), &base, &BodyConfig::default(), &scenario, &[])
            .expect("a world");
        let wanted = Twist {
            x: 3.0,
            ..Twist::default()
        };
        let mut counted = 0.0;
        for _ in 0..400 {
            world.step(wanted);
            counted += world.read_encoders(Stamp(0), None).dx;
        }
        counted - (world.robot().pose.x + 6.0)
    };
    assert!(
        slip(2.0) < 0.03 && slip(9.0) > 0.15,
        "{} {}",
        slip(2.0),
        slip(9.0)
    );
}

#[test]
fn push_is_not_measured_by_encoders() {
    let mut world = world_with("start = { x = 0.0, y = 0.0 }\n[ball]\npresent = false");
    world.apply_impulse([90.0, 0.0]);
    let mut counted = 0.0;
    for _ in 0..500 {
        world.step(Twist::default());
        counted += world.read_encoders(Stamp(0), None).dx;
    }
    assert!(world.robot().pose.x > 0.2, "{}", world.robot().pose.x);
    assert!(counted.abs() < 0.02, "{counted}");
}

#[test]
fn push_gives_an_acceleration_peak() {
    let mut world = world_with("start = { x = 0.0, y = 0.0 }\n[ball]\npresent = false");
    world.step(Twist::default());
    world.apply_impulse([30.0, 0.0]);
    world.step(Twist::default());
    // 30 N s on 30 kg: 1 m/s within a step of 2 ms, less the friction of the wheels.
    let [ax, _] = world.acceleration();
    assert!((450.0..=500.0).contains(&ax), "{ax}");
}

#[test]
fn kidnap_moves_only_our_robot() {
    let mut world = world_with("start = { x = 0.0, y = 0.0 }\n[ball]\nposition = [2.0, 1.0]");
    let ball = world.ball();
    world.kidnap(Pose::new(5.0, -3.0, 1.0));
    let pose = world.robot().pose;
    assert!(
        pose.origin().distance_to(At::new(5.0, -3.0)) < 1e-6 && (pose.theta - 1.0).abs() < 1e-6
    );
    assert_eq!(world.ball(), ball);
    let counted = world.read_encoders(Stamp(0), None);
    assert_eq!((counted.dx, counted.dy, counted.dtheta), (0.0, 0.0, 0.0));
}
