//! Line points of a recording that another program rendered lie on its true lines.

use std::path::{Path, PathBuf};

use localize::{Field, Pose};
use vision::overlay::marking_distance;
use vision::{CameraConfig, Eyes, Image, Mount, Profile, VisionConfig, VisionError, optics};

#[derive(serde::Deserialize)]
struct Robot {
    camera: CameraConfig,
}

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../samples/sequence")
}

fn eyes() -> Eyes {
    let folder = folder();
    let text = std::fs::read_to_string(folder.join("robot.toml")).expect("robot.toml");
    let robot: Robot = toml::from_str(&text).expect("a robot");
    let profile = Profile::load(&folder.join("mirror.csv")).expect("a profile");
    let map = optics::trace_rays(&robot.camera, &profile, &Mount::default())
        .expect("rays")
        .ground_map();
    Eyes::new(&map, &robot.camera, 0.125, VisionConfig::default()).expect("eyes")
}

fn image(name: &str) -> Image {
    Image::load(&folder().join("frames").join(name)).expect("an image")
}

#[test]
fn unlabelled_eyes_find_the_lines_of_a_path_traced_drive() {
    let field = Field::load(&folder().join("field.toml")).expect("a field");
    let truth = std::fs::read_to_string(folder().join("truth.csv")).expect("truth.csv");
    let mut eyes = eyes();
    let (mut points, mut right) = (0, 0);
    for (index, line) in truth.lines().skip(1).enumerate() {
        let row: Vec<f32> = line
            .split(',')
            .map(|cell| cell.parse().expect("a number"))
            .collect();
        let pose = Pose::new(row[1], row[2], row[3]);
        let seen = eyes
            .see(&image(&format!("{index:03}.jpg")).frame())
            .expect("seen");
        for seen in seen.line_points {
            if seen.point.at.distance() > 5.0 {
                continue;
            }
            let off = field
                .markings
                .iter()
                .map(|marking| marking_distance(marking, pose * seen.point.at))
                .fold(f32::INFINITY, f32::min);
            points += 1;
            right += usize::from(off < 0.05);
        }
    }
    assert!(points > 1500, "only {points} points");
    assert!(right * 100 >= points * 97, "{right} of {points} right");
}

#[test]
fn the_same_frame_gives_the_same_bits() {
    let image = image("003.jpg");
    let first = eyes().see(&image.frame()).expect("seen");
    let second = eyes().see(&image.frame()).expect("seen");
    assert_eq!(first, second);
}

#[test]
fn a_frame_of_another_size_is_refused_by_both_sizes() {
    let image = Image {
        width_px: 320,
        height_px: 240,
        rgb: vec![90; 3 * 320 * 240],
    };
    let message = eyes().see(&image.frame()).expect_err("size").to_string();
    assert!(
        message.contains("320 × 240") && message.contains("480 × 480"),
        "{message}"
    );
}

#[test]
fn torn_and_black_frames_are_refused() {
    let image = image("000.jpg");
    let mut torn = image.frame();
    torn.data = &torn.data[..1000];
    assert!(matches!(eyes().see(&torn), Err(VisionError::Torn { .. })));
    let black = Image {
        rgb: vec![3; image.rgb.len()],
        ..image
    };
    assert!(matches!(
        eyes().see(&black.frame()),
        Err(VisionError::Black { .. })
    ));
}
