//! Which values may the numbers of a scenario have? Bounds far beyond any hall, within which the simulation is sound.

use std::ops::RangeInclusive;

use vision::Mount;

use super::{PathConfig, Placement, Scenario};

/// Largest coordinate, metres.
const COORDINATE_MAX: f64 = 1000.0;
/// Largest direction, degrees.
const DIRECTION_MAX: f64 = 360.0;
/// Largest speed (m/s) of a robot, and of a kicked ball.
const ROBOT_SPEED_MAX: f64 = 20.0;
const BALL_SPEED_MAX: f64 = 100.0;
/// Largest rate of turn, degrees/s: ten turns.
const TURN_RATE_MAX: f64 = 3600.0;
/// Largest height of a ball, metres.
const HEIGHT_MAX: f64 = 100.0;
/// Longest time, seconds: eleven days.
const TIME_MAX: f64 = 1e6;
/// Most entries of a list of events, waypoints or wheels.
const ENTRIES_MAX: usize = 10_000;

/// A key's value with its bounds.
struct Bound {
    key: String,
    value: f32,
    bounds: [f32; 2],
}

/// The numbers of a scenario with their bounds.
#[derive(Default)]
struct Bounds(Vec<Bound>);

impl Bounds {
    fn add(&mut self, key: &str, value: impl Into<f64>, bounds: RangeInclusive<f64>) {
        let (least, most) = bounds.into_inner();
        self.0.push(Bound {
            key: key.to_owned(),
            // Most values are of this precision: a limit of 0.99 is not exceeded by 0.99.
            value: value.into() as f32,
            bounds: [least as f32, most as f32],
        });
    }

    fn add_pair(&mut self, key: &str, pair: [impl Into<f64>; 2], limit: f64) {
        for value in pair {
            self.add(key, value, -limit..=limit);
        }
    }

    fn add_pose(&mut self, key: &str, x: f32, y: f32, theta_deg: f32) {
        for (name, value) in [("x", x), ("y", y)] {
            self.add(
                &format!("{key}.{name}"),
                value,
                -COORDINATE_MAX..=COORDINATE_MAX,
            );
        }
        self.add(
            &format!("{key}.theta_deg"),
            theta_deg,
            -DIRECTION_MAX..=DIRECTION_MAX,
        );
    }

    fn add_placement(&mut self, key: &str, place: Placement) {
        self.add_pose(key, place.x, place.y, place.theta_deg);
    }

    fn add_path(&mut self, key: &str, path: &PathConfig) {
        self.add(&format!("{key}.speed"), path.speed, 1e-3..=ROBOT_SPEED_MAX);
        self.add(
            &format!("{key}.turn_rate_deg"),
            path.turn_rate_deg,
            1e-2..=TURN_RATE_MAX,
        );
        for (index, place) in path.waypoints.iter().enumerate() {
            self.add_placement(&format!("{key}.waypoints[{index}]"), *place);
        }
        for (index, command) in path.commands.iter().enumerate() {
            let key = |name: &str| format!("{key}.commands[{index}].{name}");
            self.add(&key("time"), command.time, 0.0..=TIME_MAX);
            for (name, value) in [("vx", command.vx), ("vy", command.vy)] {
                self.add(&key(name), value, -ROBOT_SPEED_MAX..=ROBOT_SPEED_MAX);
            }
            self.add(
                &key("turn_deg"),
                command.turn_deg,
                -TURN_RATE_MAX..=TURN_RATE_MAX,
            );
        }
    }

    fn add_mount(&mut self, key: &str, mount: &Mount) {
        let key = |name: &str| format!("{key}.{name}");
        self.add_pair(&key("lean_deg"), mount.lean_deg, Mount::TILT_MAX_DEG);
        self.add_pair(
            &key("mirror_tilt_deg"),
            mount.mirror_tilt_deg,
            Mount::TILT_MAX_DEG,
        );
        self.add_pair(
            &key("mirror_offset"),
            mount.mirror_offset,
            Mount::OFFSET_MAX,
        );
        self.add(
            &key("mirror_raise"),
            mount.mirror_raise,
            -Mount::OFFSET_MAX..=Mount::OFFSET_MAX,
        );
    }

    fn add_robots(&mut self, scenario: &Scenario) {
        self.add_placement("start", scenario.start);
        self.add_path("path", &scenario.path);
        self.add_mount("mount", &scenario.mount);
        self.add("focal_scale", scenario.focal_scale, 0.2..=5.0);
        for (index, mate) in scenario.squad.iter().enumerate() {
            let key = |name: &str| format!("squad[{index}].{name}");
            self.add_placement(&key("start"), mate.start);
            self.add_path(&key("path"), &mate.path);
            self.add_mount(&key("mount"), &mate.mount);
        }
        let others = &scenario.others;
        for (index, robot) in others.placed.iter().enumerate() {
            let key = format!("others.placed[{index}]");
            self.add_pose(&key, robot.x, robot.y, robot.theta_deg);
        }
        self.add("others.speed", others.speed, 1e-3..=ROBOT_SPEED_MAX);
        self.add("others.kick_speed", others.kick_speed, 0.0..=BALL_SPEED_MAX);
        self.add("others.lofted_share", others.lofted_share, 0.0..=1.0);
        self.add("others.loft_deg", others.loft_deg, 0.0..=85.0);
        let wheels = &scenario.wheels;
        self.add("wheels.traction", wheels.traction, 1e-3..=10.0);
        self.add("wheels.grip", wheels.grip, 1.0..=1e6);
        for scale in &wheels.radius_scale {
            self.add("wheels.radius_scale", *scale, 0.1..=10.0);
        }
    }

    fn add_ball(&mut self, scenario: &Scenario) {
        let ball = &scenario.ball;
        self.add_pair("ball.position", ball.position, COORDINATE_MAX);
        self.add_pair("ball.velocity", ball.velocity, BALL_SPEED_MAX);
        for (name, value, bounds) in [
            ("diameter", ball.diameter, 0.02..=1.0),
            ("mass", ball.mass, 1e-3..=100.0),
            ("restitution", ball.restitution, 0.0..=1.0),
            ("sliding_friction", ball.sliding_friction, 0.0..=10.0),
            (
                "rolling_deceleration",
                ball.rolling_deceleration,
                0.0..=100.0,
            ),
            ("height", ball.height, 0.0..=HEIGHT_MAX),
            (
                "vertical_velocity",
                ball.vertical_velocity,
                -BALL_SPEED_MAX..=BALL_SPEED_MAX,
            ),
            ("floor_restitution", ball.floor_restitution, 0.0..=0.99),
            ("drag_coefficient", ball.drag_coefficient, 0.0..=100.0),
        ] {
            self.add(&format!("ball.{name}"), value, bounds);
        }
        for (index, kick) in scenario.kicks.iter().enumerate() {
            let key = |name: &str| format!("kicks[{index}].{name}");
            self.add(&key("time"), kick.time, 0.0..=TIME_MAX);
            self.add_pair(
                &key("position"),
                kick.position.unwrap_or_default(),
                COORDINATE_MAX,
            );
            self.add(&key("height"), kick.height, 0.0..=HEIGHT_MAX);
            self.add_pair(&key("velocity"), kick.velocity, BALL_SPEED_MAX);
            self.add(
                &key("vertical_velocity"),
                kick.vertical_velocity,
                -BALL_SPEED_MAX..=BALL_SPEED_MAX,
            );
        }
    }

    fn add_events(&mut self, scenario: &Scenario) {
        for (index, kidnap) in scenario.kidnaps.iter().enumerate() {
            let key = format!("kidnaps[{index}]");
            self.add(&format!("{key}.time"), kidnap.time, 0.0..=TIME_MAX);
            self.add_pose(&key, kidnap.x, kidnap.y, kidnap.theta_deg);
        }
        for (index, knock) in scenario.knocks.iter().enumerate() {
            let key = |name: &str| format!("knocks[{index}].{name}");
            self.add(&key("time"), knock.time, 0.0..=TIME_MAX);
            self.add_mount(&key("mount"), &knock.mount);
        }
        for (index, push) in scenario.pushes.iter().enumerate() {
            let key = |name: &str| format!("pushes[{index}].{name}");
            self.add(&key("time"), push.time, 0.0..=TIME_MAX);
            // A robot of 40 kg leaves at 25 m/s.
            self.add_pair(&key("impulse"), push.impulse, 1000.0);
        }
        for (index, occlusion) in scenario.occlusions.iter().enumerate() {
            let key = |name: &str| format!("occlusions[{index}].{name}");
            self.add(&key("start"), occlusion.start, 0.0..=TIME_MAX);
            self.add(&key("stop"), occlusion.stop, occlusion.start..=TIME_MAX);
            self.add(
                &key("direction_deg"),
                occlusion.direction_deg,
                -DIRECTION_MAX..=DIRECTION_MAX,
            );
            self.add(&key("width_deg"), occlusion.width_deg, 0.0..=DIRECTION_MAX);
        }
        for (index, fault) in scenario.faults.iter().enumerate() {
            let key = |name: &str| format!("faults[{index}].{name}");
            self.add(&key("start"), fault.start, 0.0..=TIME_MAX);
            self.add(&key("stop"), fault.stop, fault.start..=TIME_MAX);
        }
    }

    fn add_radio(&mut self, scenario: &Scenario) {
        let radio = scenario.radio;
        self.add("radio.rate_hz", radio.rate_hz, 0.1..=1000.0);
        self.add("radio.loss", radio.loss, 0.0..=1.0);
        let [shortest, longest] = radio.delay;
        self.add("radio.delay", shortest, 0.0..=10.0);
        self.add("radio.delay", longest, shortest..=10.0);
    }

    /// The first key whose value is out of its bounds, and the reason.
    fn check(self) -> Result<(), (String, String)> {
        for Bound { key, value, bounds } in self.0 {
            let [least, most] = bounds;
            if !(least..=most).contains(&value) {
                return Err((
                    key,
                    format!("invalid value: {value} (expected {least} to {most})"),
                ));
            }
        }
        Ok(())
    }
}

/// The first number out of its bounds, and the reason.
pub(super) fn check_numbers(scenario: &Scenario) -> Result<(), (String, String)> {
    check_lengths(scenario)?;
    let mut bounds = Bounds::default();
    bounds.add("duration", scenario.duration, 1e-3..=TIME_MAX);
    bounds.add_robots(scenario);
    bounds.add_ball(scenario);
    bounds.add_events(scenario);
    bounds.add_radio(scenario);
    bounds.check()
}

/// The first list that is too long, and the reason.
fn check_lengths(scenario: &Scenario) -> Result<(), (String, String)> {
    for (key, length) in [
        ("path.waypoints", scenario.path.waypoints.len()),
        ("path.commands", scenario.path.commands.len()),
        ("wheels.radius_scale", scenario.wheels.radius_scale.len()),
        ("kidnaps", scenario.kidnaps.len()),
        ("knocks", scenario.knocks.len()),
        ("pushes", scenario.pushes.len()),
        ("kicks", scenario.kicks.len()),
        ("occlusions", scenario.occlusions.len()),
        ("faults", scenario.faults.len()),
    ] {
        if length > ENTRIES_MAX {
            let reason = format!("too many entries: {length} (expected at most {ENTRIES_MAX})");
            return Err((key.to_owned(), reason));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::scenario::{Fault, FaultKind, Kidnap, Knock, Push};

    const DEMO: &str = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../config/scenarios/demo.toml"
    );

    /// Key and reason with which a changed scenario is refused.
    fn refused(change: impl FnOnce(&mut Scenario)) -> (String, String) {
        let (mut scenario, _) = Scenario::load(Path::new(DEMO)).expect("a scenario");
        change(&mut scenario);
        check_numbers(&scenario).expect_err("refused")
    }

    #[test]
    fn numbers_beyond_any_hall_are_refused_by_their_key() {
        let kidnap = Kidnap {
            time: 1.0,
            x: 1e30,
            y: 0.0,
            theta_deg: 0.0,
        };
        let (key, reason) = refused(|scenario| scenario.kidnaps = vec![kidnap]);
        assert_eq!(key, "kidnaps[0].x");
        assert!(reason.contains("expected -1000 to 1000"), "{reason}");
        let (key, _) = refused(|scenario| scenario.mount.lean_deg = [0.0, 80.0]);
        assert_eq!(key, "mount.lean_deg");
        let knock = Knock {
            time: f64::NAN,
            mount: Mount::default(),
        };
        assert_eq!(
            refused(|scenario| scenario.knocks = vec![knock]).0,
            "knocks[0].time"
        );
        let push = Push {
            time: 0.0,
            impulse: [0.0, f32::INFINITY],
        };
        assert_eq!(
            refused(|scenario| scenario.pushes = vec![push]).0,
            "pushes[0].impulse"
        );
        assert_eq!(refused(|scenario| scenario.duration = 1e300).0, "duration");
        let (key, reason) = refused(|scenario| scenario.pushes = vec![push; 20_000]);
        assert_eq!(key, "pushes");
        assert!(reason.contains("too many entries: 20000"), "{reason}");
    }

    #[test]
    fn limits_themselves_are_accepted() {
        let (mut scenario, _) = Scenario::load(Path::new(DEMO)).expect("a scenario");
        scenario.ball.floor_restitution = 0.99;
        scenario.ball.diameter = 0.02;
        scenario.mount.mirror_offset = [0.2, -0.2];
        assert_eq!(check_numbers(&scenario), Ok(()));
    }

    /// Why the demo with another value of a key is refused.
    fn refusal_of_demo(key: &str, value: toml::Value) -> String {
        let text = std::fs::read_to_string(DEMO).expect("a scenario");
        let mut table: toml::Table = toml::from_str(&text).expect("a table");
        table.insert(key.to_owned(), value);
        let refused = Scenario::from_table(table, Path::new(DEMO)).expect_err("refused");
        refused.to_string()
    }

    #[test]
    fn fault_of_a_wheel_that_is_not_there_is_refused() {
        let fault = Fault {
            kind: FaultKind::WheelStuck,
            start: 0.0,
            stop: 1.0,
            wheel: 7,
        };
        let fault = toml::Value::try_from([fault]).expect("a value");
        let message = refusal_of_demo("faults", fault);
        assert!(
            message.contains("faults[0].wheel: no such wheel: 7 (the robot has 3"),
            "{message}"
        );
    }

    #[test]
    fn radius_of_a_wheel_that_is_not_there_is_refused() {
        let wheels = toml::toml! { radius_scale = [1.0, 1.0, 1.0, 1.0] };
        let message = refusal_of_demo("wheels", wheels.into());
        assert!(
            message.contains("wheels.radius_scale: 4 numbers (the robot has 3 wheels)"),
            "{message}"
        );
    }
}
