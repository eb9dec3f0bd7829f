use localize::config::{
    Bound, LOCALIZE_BOUNDS, TEAM_BOUNDS, WORLD_BOUNDS, check_bounds, unbounded_settings,
};
use localize::presets::PRESETS;
use localize::sensors::compass_calibration::CompassCalibration;
use toml::{Table, Value};
use vision::config::{ImageRect, VISION_BOUNDS};

use super::*;

/// The sections with their bounds.
const SECTIONS: [(&str, &[Bound]); 4] = [
    ("vision", VISION_BOUNDS),
    ("localize", LOCALIZE_BOUNDS),
    ("world", WORLD_BOUNDS),
    ("team", TEAM_BOUNDS),
];

/// The default configuration with every optional setting.
fn all_settings() -> PipelineConfig {
    let mut config = PipelineConfig::default();
    let window = ImageRect {
        left_px: 1.0,
        top_px: 2.0,
        width_px: 10.0,
        height_px: 10.0,
    };
    let sensors = &mut config.vision.virtual_sensors;
    (sensors.bumpers, sensors.goals) = (vec![window; 2], vec![window]);
    (sensors.ball, sensors.kick, sensors.lens) = (Some(window), Some(window), Some(window));
    config.localize.compass.calibration = Some(CompassCalibration {
        hard: [0.1, 0.2],
        soft: [[1.0, 0.0], [0.0, 1.0]],
        radius: 0.4,
        north_deg: 10.0,
    });
    config
}

fn section(config: &PipelineConfig, name: &str) -> Value {
    let mut table = Table::try_from(config).expect("a table");
    table.remove(name).expect("a section")
}

/// The first number that a bound covers.
fn number_mut<'a>(value: &'a mut Value, path: &[&str]) -> &'a mut Value {
    match (value, path) {
        (Value::Array(values), path) => number_mut(&mut values[0], path),
        (Value::Table(table), [name, rest @ ..]) => {
            let wanted = match *name {
                // The bumpers are the first list of windows; ball and robots share their bounds.
                "*" if table.contains_key("bumpers") => "bumpers",
                "*" => "ball",
                name => name,
            };
            number_mut(table.get_mut(wanted).expect(wanted), rest)
        }
        (value, _) => value,
    }
}

#[test]
fn every_number_has_a_bound_and_every_preset_lies_inside() {
    for (name, bounds) in SECTIONS {
        let missing = unbounded_settings(&section(&all_settings(), name), bounds);
        assert!(missing.is_empty(), "{name} without bounds: {missing:?}");
    }
    assert_eq!(all_settings().check(), Ok(()));
    for name in PRESETS {
        let config = PipelineConfig::preset(name).expect("a preset");
        assert_eq!(config.check(), Ok(()), "{name}");
    }
}

#[test]
fn every_bound_refuses_what_lies_outside() {
    for (name, bounds) in SECTIONS {
        for bound in bounds {
            let path: Vec<&str> = bound.key.split('.').collect();
            let check = |change: &dyn Fn(&Value) -> Value| {
                let mut settings = section(&all_settings(), name);
                let number = number_mut(&mut settings, &path);
                *number = change(number);
                check_bounds(name, &settings, bounds)
            };
            let put = |outside: f64, whole: f64| {
                check(&|number| match number {
                    Value::Integer(_) => Value::Integer(whole as i64),
                    _ => Value::Float(outside),
                })
            };
            let (min, max) = (bound.min, bound.max);
            let step = |value: f64| value.abs() * 1e-3 + 1e-12;
            assert_eq!(put(min, min), Ok(()), "{name}.{}", bound.key);
            assert_eq!(put(max, max), Ok(()), "{name}.{}", bound.key);
            for outside in [
                put(min - step(min), min - 1.0 - step(min)),
                put(max + step(max), max + 1.0 + step(max)),
                check(&|_| Value::Float(f64::NAN)),
            ] {
                let error = outside.expect_err(bound.key);
                assert_eq!((error.min, error.max), (min, max), "{error}");
                assert!(!error.why.is_empty(), "{error}");
            }
        }
    }
}

#[test]
fn related_settings_are_checked_together() {
    let mut config = PipelineConfig::default();
    config.vision.objects.ball_radius = 0.5;
    let error = config
        .check()
        .expect_err("the ball is higher than the mirror");
    assert_eq!(error.key, "vision.objects.viewpoint_height");
    let mut config = PipelineConfig::default();
    let scan = &mut config.vision.scan;
    (scan.radial_lines, scan.spirals_each_way, scan.circles) = (0, 0, 0);
    let error = config.check().expect_err("no scan line");
    assert_eq!(error.key, "vision.scan.radial_lines");
}

#[test]
fn an_overlay_that_is_refused_is_named_with_its_line() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("own.toml");
    for (text, message) in [
        (
            "[localize.branch_and_bound]\npoints_max = 50\ncell = 0\n",
            "own.toml: line 3: localize.branch_and_bound.cell = 0: must be between 0.02 and 1 ",
        ),
        (
            "[vision]\nscan.circles = 3000\n",
            "own.toml: line 2: vision.scan.circles = 3000: must be between 0 and 2000 ",
        ),
        (
            "world.ball.gate = nan\n",
            "own.toml: line 1: world.ball.gate = NaN: must be between 0.1 and 10000 ",
        ),
        (
            "[team]\n\nteammates_max = 13\n",
            "own.toml: line 3: team.teammates_max = 13: must be between 0 and 12 ",
        ),
        (
            "[[vision.virtual_sensors.bumpers]]\nleft_px = 1\ntop_px = 1\nwidth_px = 0\nheight_px = 4\n",
            "own.toml: line 4: vision.virtual_sensors.bumpers[0].width_px = 0: must be between 1 and 65535 ",
        ),
        (
            "[localize.mode]\nrule = 'evidence'\n",
            "own.toml: line 2: unknown setting localize.mode.rule (renamed localize.mode.suspect_rule)",
        ),
        (
            "[localize.matching]\nminimiser = 'newton'\n",
            "own.toml: line 2: localize.matching.minimiser = \"newton\": unknown value (renamed \"gauss_newton\")",
        ),
    ] {
        std::fs::write(&path, text).expect("written");
        let error = PipelineConfig::load("default", Some(&path)).expect_err(text);
        let error = format!("{error:#}");
        assert!(error.contains(message), "{error}\nexpected {message}");
    }
    std::fs::write(&path, "[vision]\nsacn = 1\n").expect("written");
    let error = PipelineConfig::load("default", Some(&path)).expect_err("an unknown key");
    let error = format!("{error:#}");
    assert!(
        error.contains("own.toml") && error.contains("line 2"),
        "{error}"
    );
}
