//! Does the map heal while the robot drives? Line points of a wrong mount, traced pixel by pixel.

mod mount_drive;

use localize::{Field, LocalizeConfig, Localizer};
use mount_drive::{DriveConfig, Optics, Scored, Starvation, TrueMount, config_folder, drive};
use vision::Mount;
use vision::optics::map_basis::basis_from_profile;

fn field() -> Field {
    Field::load(&config_folder().join("fields/msl_18x12.toml")).expect("a field")
}

fn localizer(optics: &Optics, field: &Field, enabled: bool) -> Localizer {
    let mut config = LocalizeConfig::default();
    config.map_correction.enabled = enabled;
    config.matching.viewpoint_height = optics.height;
    let settings = config.map_correction.clone();
    let mut localizer = Localizer::new(field, config);
    let basis = basis_from_profile(&optics.camera, &optics.profile, optics.height, &settings);
    localizer.set_map_basis(Some(basis.expect("a basis")));
    localizer
}

fn run(robot: &str, enabled: bool, config: &DriveConfig) -> Vec<Scored> {
    let (optics, field) = (Optics::load(robot), field());
    let mut localizer = localizer(&optics, &field, enabled);
    drive(&optics, &field, &mut localizer, config)
}

/// Mirror tilt 0.3° and −0.2°, offset 1 mm, focal length 1 % more than the map says.
fn wrong() -> TrueMount {
    TrueMount {
        mount: Mount {
            mirror_tilt_deg: [0.3, -0.2],
            mirror_offset: [0.001, 0.0],
            ..Mount::default()
        },
        focal_scale: 1.01,
    }
}

/// Mean position error (metres) and normalised error squared from a time on.
fn mean_from(scored: &[Scored], from: f64) -> (f32, f32) {
    let part: Vec<&Scored> = scored
        .iter()
        .filter(|image| image.seconds >= from)
        .collect();
    let mean = |value: fn(&Scored) -> f32| {
        part.iter().map(|image| value(image)).sum::<f32>() / part.len() as f32
    };
    (
        mean(|image| image.error.unwrap_or(f32::INFINITY)),
        mean(|image| image.nees),
    )
}

fn check_unknown_mount(robot: &str) {
    let config = DriveConfig {
        seconds: 15.0,
        mounts: vec![(0.0, wrong())],
        ..DriveConfig::default()
    };
    let (before, _) = mean_from(&run(robot, false, &config), 8.0);
    let healed = run(robot, true, &config);
    let (after, nees) = mean_from(&healed, 8.0);
    assert!(before > 0.025, "{robot}: {before} m without the correction");
    assert!(after < 0.015, "{robot}: {after} m, {before} m without");
    assert!(nees < 2.0, "{robot}: {nees}");
    // In every part of the drive, before anything is learned too: points that scatter little do not make a wrong map right.
    for window in healed.chunks(30) {
        let (error, nees) = mean_from(window, 0.0);
        let from = window[0].seconds;
        assert!(nees < 3.0, "{robot}: {nees} from {from} s on, {error} m");
    }
    let (_, nees) = mean_from(&healed[..90], 0.0);
    assert!(nees < 2.0, "{robot}: {nees} in the first 3 s");
    assert!(healed.iter().all(|image| !image.lost), "{robot}");
}

#[test]
fn an_unknown_mount_is_learned_while_driving() {
    check_unknown_mount("default.toml");
}

#[test]
fn an_unknown_mount_of_a_hyperbolic_mirror_is_learned_while_driving() {
    check_unknown_mount("hyperbolic.toml");
}

/// A mirror far off its axis, millimetres.
fn displaced(millimetres: [f64; 2]) -> TrueMount {
    TrueMount {
        mount: Mount {
            mirror_offset: millimetres.map(|part| part * 1e-3),
            ..Mount::default()
        },
        focal_scale: 1.0,
    }
}

/// Far points then lie on other markings, at many centimetres from every pose that the given map allows.
#[test]
fn a_mirror_far_off_its_axis_is_found_and_the_pose_is_uncertain_until_then() {
    for (seed, millimetres) in [(2, [-6.4, 0.0]), (3, [0.0, 3.6]), (4, [-3.5, -3.5])] {
        let config = DriveConfig {
            seconds: 10.0,
            seed,
            mounts: vec![(0.0, displaced(millimetres))],
            ..DriveConfig::default()
        };
        let scored = run("default.toml", true, &config);
        for second in scored.chunks(30) {
            let (error, nees) = mean_from(second, 0.0);
            let from = second[0].seconds;
            assert!(
                nees < 10.0 / 3.0,
                "{millimetres:?}: {nees} from {from} s on, {error} m"
            );
        }
        let (error, _) = mean_from(&scored, 8.0);
        assert!(error < 0.02, "{millimetres:?}: {error} m");
    }
}

/// A mirror that a knock has tilted by 0.5°.
fn knocked() -> TrueMount {
    TrueMount {
        mount: Mount {
            mirror_tilt_deg: [0.5, 0.0],
            ..Mount::default()
        },
        focal_scale: 1.0,
    }
}

#[test]
fn a_knock_is_noticed_and_healed() {
    let config = DriveConfig {
        seconds: 25.0,
        mounts: vec![(0.0, TrueMount::default()), (10.0, knocked())],
        ..DriveConfig::default()
    };
    let scored = run("default.toml", true, &config);
    let noticed = scored.iter().find(|image| image.knocks > 0);
    let noticed = noticed.map_or(f64::INFINITY, |image| image.seconds);
    assert!((10.0..15.0).contains(&noticed), "{noticed} s");
    assert!(mean_from(&scored, 20.0).0 < 0.02);
    assert!(scored.iter().filter(|image| image.lost).count() < 30);
}

#[test]
fn a_right_map_costs_no_accuracy_and_a_standing_robot_learns_nothing_wrong() {
    let config = DriveConfig {
        seconds: 15.0,
        ..DriveConfig::default()
    };
    let (without, _) = mean_from(&run("default.toml", false, &config), 3.0);
    let (with, nees) = mean_from(&run("default.toml", true, &config), 3.0);
    assert!(with < without + 0.001, "{with} m, {without} m without");
    assert!(nees < 2.0, "{nees}");
    let standing = DriveConfig {
        seconds: 10.0,
        speed: 0.0,
        ..DriveConfig::default()
    };
    let scored = run("default.toml", true, &standing);
    assert!(mean_from(&scored, 1.0).1 < 2.0);
    assert!(scored.iter().all(|image| image.knocks == 0));
}

/// A drive on a computer that is too busy: half of the images are dropped, the others are up to 0.3 s late, and the wheels'
/// samples arrive in bursts.
fn starved(seed: u64, stamped_on_arrival: bool, turn_error_deg: f32) -> DriveConfig {
    DriveConfig {
        seconds: 15.0,
        tilt_std_deg: 0.3,
        seed,
        starvation: Some(Starvation {
            kept_share: 0.5,
            delay_max: 0.3,
            burst_max: 0.2,
            stamped_on_arrival,
            turn_error_deg,
        }),
        ..DriveConfig::default()
    }
}

#[test]
fn late_and_missing_samples_are_no_knock_and_a_knock_among_them_is_noticed() {
    for (seed, arrival, turn_error_deg) in [(0, false, 0.0), (1, false, 2.0), (2, true, 0.0)] {
        let scored = run(
            "default.toml",
            true,
            &starved(seed, arrival, turn_error_deg),
        );
        let knocks = scored.last().expect("images").knocks;
        assert_eq!(knocks, 0, "seed {seed}");
    }
    let mut config = starved(3, false, 1.0);
    config.mounts.push((6.0, knocked()));
    let scored = run("default.toml", true, &config);
    let noticed = scored.iter().find(|image| image.knocks > 0);
    let noticed = noticed.map_or(f64::INFINITY, |image| image.seconds);
    assert!((6.0..11.0).contains(&noticed), "{noticed} s");
}
