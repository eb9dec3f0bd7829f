//! Time of processing one 480 × 480 image, with and without a known colour model.

use std::hint::black_box;
use std::path::Path;

use criterion::{Criterion, criterion_group, criterion_main};
use localize::robot::CameraConfig;
use vision::{Image, Mount, Profile, Vision, VisionConfig, optics};

#[derive(serde::Deserialize)]
struct Robot {
    camera: CameraConfig,
}

fn process(criterion: &mut Criterion) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../samples/sequence");
    let text = std::fs::read_to_string(folder.join("robot.toml")).expect("robot.toml");
    let robot: Robot = toml::from_str(&text).expect("a robot");
    let profile = Profile::load(&folder.join("mirror.csv")).expect("a profile");
    let map = optics::trace_rays(&robot.camera, &profile, &Mount::default())
        .expect("rays")
        .ground_map();
    let mut vision =
        Vision::new(&map, &robot.camera, 0.125, VisionConfig::default()).expect("vision");
    let image = Image::load(&folder.join("frames/000.jpg")).expect("an image");
    criterion.bench_function("see_480", |bencher| {
        bencher.iter(|| {
            vision
                .process(black_box(&image.view()))
                .expect("detections")
        })
    });
    criterion.bench_function("see_480_in_new_light", |bencher| {
        bencher.iter(|| {
            vision.reset_colour_model();
            vision
                .process(black_box(&image.view()))
                .expect("detections")
        })
    });
}

criterion_group!(benches, process);
criterion_main!(benches);
