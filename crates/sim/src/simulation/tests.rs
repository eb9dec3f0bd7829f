use std::path::Path;

use localize::frames::At;

use super::*;
use crate::scenario::Kidnap;

/// The demo scenario, shortened to a second, with a camera of 120 × 120 pixels.
fn small_simulation(change: impl FnOnce(&mut Scenario)) -> Simulator {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/scenarios/demo.toml");
    let (mut scenario, mut robot) = Scenario::load(&path).expect("a scenario");
    let camera = robot.camera.as_mut().expect("a camera");
    (camera.width_px, camera.height_px) = (120, 120);
    camera.focal_px = camera.focal_px.map(|focal| focal / 4.0);
    camera.centre_px = Some([59.5, 59.5]);
    camera.outer_radius_px = Some(58.5);
    scenario.duration = 1.0;
    change(&mut scenario);
    let field = Field::load(scenario.field.as_ref().expect("a field")).expect("a field");
    Simulator::new(scenario, robot, field).expect("a simulation")
}

#[test]
fn samples_are_bit_reproducible_per_seed() {
    let first: Vec<SimSample> = small_simulation(|_| {}).collect();
    let again: Vec<SimSample> = small_simulation(|_| {}).collect();
    let other: Vec<SimSample> = small_simulation(|scenario| scenario.seed += 1).collect();
    assert!(first == again);
    assert!(first != other);
}

#[test]
fn samples_are_ordered_and_at_their_rates() {
    let samples: Vec<SimSample> = small_simulation(|_| {}).collect();
    assert!(
        samples
            .windows(2)
            .all(|pair| pair[0].stamp() <= pair[1].stamp())
    );
    let count =
        |wanted: fn(&SimSample) -> bool| samples.iter().filter(|sample| wanted(sample)).count();
    assert_eq!(
        count(|sample| matches!(sample, SimSample::Odometry(_))),
        101
    );
    assert_eq!(count(|sample| matches!(sample, SimSample::Imu(_))), 101);
    assert_eq!(count(|sample| matches!(sample, SimSample::Compass(_))), 31);
    assert_eq!(count(|sample| matches!(sample, SimSample::Image(_))), 31);
    for pair in samples.windows(2) {
        if let SimSample::Image(image) = &pair[1] {
            assert!(matches!(&pair[0], SimSample::Truth(truth) if truth.stamp == image.stamp));
        }
    }
}

#[test]
fn stamps_are_multiples_of_the_time_step() {
    let mut sim = small_simulation(|_| {});
    sim.steps = 8_467;
    assert_eq!(sim.truth().stamp, Stamp(16_934_000_000));
    assert_eq!(sim.time(), 16.934);
    let mut stamps = small_simulation(|scenario| scenario.frame_rate_hz = 1.0);
    assert!(stamps.all(|sample| sample.stamp().0 % STEP_NANOSECONDS == 0));
}

#[test]
fn kidnap_moves_only_our_robot() {
    let kidnap = Kidnap {
        time: 0.5,
        x: 3.0,
        y: 2.0,
        theta_deg: 90.0,
    };
    let truths = |sim: Simulator| -> Vec<SimTruth> {
        sim.filter_map(|sample| match sample {
            SimSample::Truth(truth) => Some(truth),
            _ => None,
        })
        .collect()
    };
    let at_rest = |scenario: &mut Scenario| {
        scenario.path.waypoints.clear();
        scenario.duration = 0.55;
    };
    let stayed = truths(small_simulation(at_rest));
    let taken = truths(small_simulation(|scenario| {
        at_rest(scenario);
        scenario.kidnaps.push(kidnap);
    }));
    let (stayed, taken) = (stayed.last().expect("truth"), taken.last().expect("truth"));
    assert!(taken.robot.pose.origin().distance_to(At::new(3.0, 2.0)) < 0.05);
    assert_eq!(stayed.ball, taken.ball);
    for (a, b) in stayed.others.iter().zip(&taken.others) {
        // They evade our robot slightly earlier or later.
        assert!(a.pose.origin().distance_to(b.pose.origin()) < 0.02);
    }
}

#[test]
fn dropped_images_are_missing_and_frozen_compass_repeats() {
    let fault = |kind| crate::scenario::Fault {
        kind,
        start: 0.3,
        stop: 0.7,
        wheel: 0,
    };
    let samples: Vec<SimSample> = small_simulation(|scenario| {
        scenario.faults = vec![
            fault(FaultKind::FramesDropped),
            fault(FaultKind::CompassFrozen),
        ];
    })
    .collect();
    let during = |sample: &&SimSample| (0.31..0.69).contains(&sample.stamp().seconds());
    let mut headings: Vec<f32> = Vec::new();
    for sample in samples.iter().filter(during) {
        match sample {
            SimSample::Image(image) => panic!("an image at {:?}", image.stamp),
            SimSample::Compass(compass) => headings.push(compass.heading),
            _ => {}
        }
    }
    assert!(headings.len() > 8 && headings.windows(2).all(|pair| pair[0] == pair[1]));
    assert!(
        samples
            .iter()
            .any(|sample| matches!(sample, SimSample::Image(_)) && sample.stamp().seconds() > 0.7)
    );
}

#[test]
fn every_scenario_in_config_loads() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/scenarios");
    let mut loaded = 0;
    for entry in std::fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        Scenario::load(&path).expect("a scenario");
        loaded += 1;
    }
    assert!(loaded >= 6);
}

#[test]
fn unknown_key_is_rejected_with_file_and_line() {
    let folder = std::env::temp_dir().join(format!("mirrorball-sim-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    let path = folder.join("wrong.toml");
    std::fs::write(
        &path,
        "robot = \"r.toml\"\nduration = 1.0\nstart = { x = 0, y = 0 }\nwind = 3\n",
    )
    .expect("written");
    let message = Scenario::load(&path).expect_err("unknown key").to_string();
    std::fs::remove_dir_all(&folder).expect("removed");
    assert!(
        message.contains("wrong.toml") && message.contains("line 4") && message.contains("wind"),
        "{message}"
    );
}

#[test]
fn scheduled_exposure_takes_effect_at_its_image() {
    let mut sim = small_simulation(|_| {});
    sim.schedule_exposure(2, 0.25, 1.0);
    let level = |image: &SimImage| -> u64 { image.rgb.iter().map(|&byte| u64::from(byte)).sum() };
    let images = sim.filter_map(|sample| match sample {
        SimSample::Image(image) => Some(level(&image)),
        _ => None,
    });
    let levels: Vec<u64> = images.take(4).collect();
    assert!(10 * levels[1] > 9 * levels[0], "{levels:?}");
    assert!(
        10 * levels[2] < 8 * levels[1] && 10 * levels[3] < 8 * levels[1],
        "{levels:?}"
    );
}
