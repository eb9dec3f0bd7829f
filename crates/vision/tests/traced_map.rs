//! The traced map matches that of an independent path tracer.

use std::path::Path;

use localize::robot::CameraConfig;
use vision::{GroundMap, Mount, Profile, optics};

#[derive(serde::Deserialize)]
struct Robot {
    camera: CameraConfig,
}

#[test]
fn traced_map_matches_the_path_tracer() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../samples/calibration");
    let text = std::fs::read_to_string(folder.join("robot.toml")).expect("robot.toml");
    let robot: Robot = toml::from_str(&text).expect("a robot");
    let profile = Profile::load(&folder.join("mirror.csv")).expect("a profile");
    let exact = GroundMap::load(&folder.join("exact_map.npz")).expect("a map");
    let traced = optics::trace_rays(&robot.camera, &profile, &Mount::default())
        .expect("rays")
        .ground_map();
    assert_eq!(
        (traced.width_px, traced.height_px),
        (exact.width_px, exact.height_px)
    );
    let mut compared = 0;
    for v in 0..exact.height_px {
        for u in 0..exact.width_px {
            let Some(expected) = exact.at(u, v) else {
                continue;
            };
            if expected.distance() > 10.0 {
                continue;
            }
            let ground = traced
                .at(u, v)
                .unwrap_or_else(|| panic!("no ground at ({u}, {v}), expected {expected:?}"));
            let error = ground.distance_to(expected);
            assert!(
                error <= 1e-3 + 1e-3 * expected.distance(),
                "({u}, {v}): {ground:?}, expected {expected:?}"
            );
            compared += 1;
        }
    }
    assert!(compared > 50_000, "only {compared} pixels show ground");
}
