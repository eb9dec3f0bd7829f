//! Does the map heal while the robot drives?

mod mount_drive;

use localize::{Field, LocalizeConfig, Localizer};
use mount_drive::{DriveConfig, Optics, Scored, TrueMount, config_folder, drive};
use vision::Mount;
use vision::optics::map_basis::basis_from_profile;

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

fn mean(scored: &[Scored], from: f64, to: f64) -> (f32, f32, f32, usize) {
    let part: Vec<_> = scored
        .iter()
        .filter(|s| s.seconds >= from && s.seconds < to)
        .collect();
    let found: Vec<_> = part
        .iter()
        .filter_map(|s| s.error.map(|e| (e, s.nees, s.std)))
        .collect();
    let n = found.len().max(1) as f32;
    (
        found.iter().map(|f| f.0).sum::<f32>() / n,
        found.iter().map(|f| f.1).sum::<f32>() / n,
        found.iter().map(|f| f.2).sum::<f32>() / n,
        part.iter().filter(|s| s.lost).count(),
    )
}

#[test]
fn table() {
    let field = Field::load(&config_folder().join("fields/msl_18x12.toml")).expect("field");
    for robot in ["default.toml", "hyperbolic.toml"] {
        let optics = Optics::load(robot);
        for (name, mount, tilt) in [
            ("right", TrueMount::default(), 0.0),
            ("wrong", wrong(), 0.0),
            ("right tilting", TrueMount::default(), 0.45),
            ("wrong tilting", wrong(), 0.45),
        ] {
            for enabled in [false, true] {
                let mut all = vec![];
                let mut localizer = localizer(&optics, &field, enabled);
                let config = DriveConfig {
                    tilt_std_deg: tilt,
                    mounts: vec![(0.0, mount)],
                    ..DriveConfig::default()
                };
                let started = std::time::Instant::now();
                all.extend(drive(&optics, &field, &mut localizer, &config));
                println!(
                    "{robot} {name} heal {enabled} ({:.2} s)",
                    started.elapsed().as_secs_f32()
                );
                for (from, to) in [
                    (0.0, 1.0),
                    (1.0, 3.0),
                    (3.0, 10.0),
                    (10.0, 30.0),
                    (30.0, 60.0),
                ] {
                    let (error, nees, std, lost) = mean(&all, from, to);
                    println!(
                        "   {from:>4}..{to:>4} s: {:.2} cm nees {nees:.2} std {:.2} cm lost {lost}",
                        error * 100.0,
                        100.0 * std
                    );
                }
                if let Some(map) = localizer.map_correction() {
                    let e = map.estimate();
                    for t in &e.terms {
                        println!("      {} {:.5} ± {:.5}", t.kind.name(), t.value, t.std);
                    }
                    println!("      images {} knocks {}", e.images, e.knocks);
                }
            }
        }
    }
}
