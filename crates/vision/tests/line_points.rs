//! Line points of an independently rendered recording lie on its true lines.

use std::path::{Path, PathBuf};

use localize::robot::CameraConfig;
use localize::{Field, Pose};
use vision::overlay::marking_distance;
use vision::scan::pattern::ScanLines;
use vision::{Image, Mount, Profile, Vision, VisionConfig, VisionError, optics};

#[derive(serde::Deserialize)]
struct Robot {
    camera: CameraConfig,
}

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../samples/sequence")
}

fn sample_vision() -> Vision {
    let folder = folder();
    let text = std::fs::read_to_string(folder.join("robot.toml")).expect("robot.toml");
    let robot: Robot = toml::from_str(&text).expect("a robot");
    let profile = Profile::load(&folder.join("mirror.csv")).expect("a profile");
    let map = optics::trace_rays(&robot.camera, &profile, &Mount::default())
        .expect("rays")
        .ground_map();
    Vision::new(&map, &robot.camera, 0.125, VisionConfig::default()).expect("vision")
}

/// Carpet with a line along y = 1 and a white wall from x = 2 on, projected by the sample's mirror.
fn image_with_wall() -> (CameraConfig, vision::GroundMap, Image) {
    let text = std::fs::read_to_string(folder().join("robot.toml")).expect("robot.toml");
    let robot: Robot = toml::from_str(&text).expect("a robot");
    let profile = Profile::load(&folder().join("mirror.csv")).expect("a profile");
    let map = optics::trace_rays(&robot.camera, &profile, &Mount::default())
        .expect("rays")
        .ground_map();
    let pixels = (0..480 * 480).flat_map(|pixel| {
        let grain = (pixel * 7 % 5) as u8;
        match map.at(pixel % 480, pixel / 480) {
            Some(at) if at.x > 2.0 || (at.y - 1.0).abs() < 0.0625 => [220 + grain; 3],
            Some(_) => [30 + grain, 110 + grain, 50 + grain],
            None => [20; 3],
        }
    });
    let image = Image {
        width_px: 480,
        height_px: 480,
        rgb: pixels.collect(),
    };
    (robot.camera, map, image)
}

#[test]
fn wall_base_is_detected_when_enabled() {
    let (camera, map, image) = image_with_wall();
    let feet = |walls: bool| {
        let mut config = VisionConfig::default();
        config.scan.circles = 36;
        config.lines.detect_wall_bases = walls;
        let mut vision = Vision::new(&map, &camera, 0.125, config).expect("vision");
        let detections = vision.process(&image.view()).expect("detections");
        let near = |off: f32| {
            let at_wall = detections.line_points.iter().filter(|point| {
                (point.point.at.x - 2.0).abs() < off && (point.point.at.y - 1.0).abs() > 0.3
            });
            at_wall.count()
        };
        [near(0.03), near(0.3)]
    };
    let [exact, all] = feet(true);
    assert!(exact >= 20 && exact * 10 >= all * 9, "{exact} of {all}");
    assert_eq!(feet(false), [0, 0]);
}

fn image(name: &str) -> Image {
    Image::load(&folder().join("frames").join(name)).expect("an image")
}

#[test]
fn lines_of_a_path_traced_drive_are_detected_without_labels() {
    let field = Field::load(&folder().join("field.toml")).expect("a field");
    let truth = std::fs::read_to_string(folder().join("truth.csv")).expect("truth.csv");
    let mut vision = sample_vision();
    let (mut points, mut right) = (0, 0);
    for (index, line) in truth.lines().skip(1).enumerate() {
        let row: Vec<f32> = line
            .split(',')
            .map(|cell| cell.parse().expect("a number"))
            .collect();
        let pose = Pose::new(row[1], row[2], row[3]);
        let detections = vision
            .process(&image(&format!("{index:03}.jpg")).view())
            .expect("detections");
        for point in detections.line_points {
            if point.point.at.distance() > 5.0 {
                continue;
            }
            let off = field
                .markings
                .iter()
                .map(|marking| marking_distance(marking, pose * point.point.at))
                .fold(f32::INFINITY, f32::min);
            points += 1;
            right += usize::from(off < 0.05);
        }
    }
    assert!(points > 1500, "only {points} points");
    assert!(
        right * 100 >= points * 97,
        "{right} of {points} points on lines"
    );
}

#[test]
fn classification_without_a_colour_model_is_an_error() {
    let image = image("003.jpg");
    let mut vision = sample_vision();
    let error = vision.classify_samples(&image.view()).map(<[_]>::len);
    assert!(
        matches!(error, Err(VisionError::NoColourModel)),
        "{error:?}"
    );
    vision.process(&image.view()).expect("detections");
    assert!(vision.classify_samples(&image.view()).is_ok());
}

#[test]
fn processing_is_bit_reproducible() {
    let image = image("003.jpg");
    let first = sample_vision().process(&image.view()).expect("detections");
    let second = sample_vision().process(&image.view()).expect("detections");
    assert_eq!(first, second);
}

#[test]
fn interlaced_halves_have_all_points_together_and_about_half_each() {
    let mut learned = sample_vision();
    learned
        .process(&image("003.jpg").view())
        .expect("detections");
    let image = image("004.jpg");
    let points = |lines: ScanLines| {
        let found = learned
            .clone()
            .process_with(&image.view(), lines)
            .expect("detections");
        assert!(!found.colours_learned);
        let mut points: Vec<[u32; 2]> = found
            .line_points
            .iter()
            .map(|point| point.position_px.map(f32::to_bits))
            .collect();
        points.sort_unstable();
        (points, found.robots, found.ball)
    };
    let (all, robots, ball) = points(ScanLines::All);
    let [even, odd] = [ScanLines::Even, ScanLines::Odd].map(points);
    for half in [&even, &odd] {
        let share = half.0.len() as f32 / all.len() as f32;
        assert!((0.4..0.6).contains(&share), "{share}");
        // Objects do not depend on the scan lines.
        assert_eq!((&half.1, half.2), (&robots, ball));
    }
    let mut both = [even.0, odd.0].concat();
    both.sort_unstable();
    assert_eq!(both, all);
}

#[test]
fn colours_are_learned_along_all_scan_lines() {
    let image = image("003.jpg");
    let all = sample_vision().process(&image.view()).expect("detections");
    let half = sample_vision()
        .process_with(&image.view(), ScanLines::Odd)
        .expect("detections");
    assert!(half.colours_learned);
    assert_eq!(half, all);
}

#[test]
fn wrong_image_size_is_rejected_naming_both_sizes() {
    let image = Image {
        width_px: 320,
        height_px: 240,
        rgb: vec![90; 3 * 320 * 240],
    };
    let message = sample_vision()
        .process(&image.view())
        .expect_err("size")
        .to_string();
    assert!(
        message.contains("320 × 240") && message.contains("480 × 480"),
        "{message}"
    );
}

#[test]
fn truncated_and_dark_images_are_rejected() {
    let image = image("000.jpg");
    let mut truncated = image.view();
    truncated.data = &truncated.data[..1000];
    assert!(matches!(
        sample_vision().process(&truncated),
        Err(VisionError::Truncated { .. })
    ));
    let black = Image {
        rgb: vec![3; image.rgb.len()],
        ..image
    };
    assert!(matches!(
        sample_vision().process(&black.view()),
        Err(VisionError::TooDark { .. })
    ));
}

/// Encodes an image as YUYV, as USB cameras send it.
fn encode_yuyv(image: &Image) -> Vec<u8> {
    let frame = image.view();
    let mut data = Vec::new();
    for v in 0..image.height_px {
        for u in (0..image.width_px).step_by(2) {
            let a = vision::image::rgb_to_yuv(frame.rgb(u, v));
            let b = vision::image::rgb_to_yuv(frame.rgb(u + 1, v));
            let mean = |i: usize| ((u16::from(a[i]) + u16::from(b[i])) / 2) as u8;
            data.extend([a[0], mean(1), b[0], mean(2)]);
        }
    }
    data
}

#[test]
fn yuyv_and_rgb_images_yield_the_same_lines() {
    let image = image("000.jpg");
    let data = encode_yuyv(&image);
    let frame = vision::ImageView::packed(480, 480, vision::PixelFormat::Yuyv, &data);
    let rgb = sample_vision()
        .process(&image.view())
        .expect("detections")
        .line_points;
    let yuv = sample_vision()
        .process(&frame)
        .expect("detections")
        .line_points;
    assert!(
        yuv.len() * 10 >= rgb.len() * 9,
        "{} of {}",
        yuv.len(),
        rgb.len()
    );
    let near = rgb.iter().filter(|a| {
        yuv.iter()
            .any(|b| a.point.at.distance_to(b.point.at) < 0.03)
    });
    let near = near.count();
    assert!(near * 10 >= rgb.len() * 9, "{near} of {}", rgb.len());
}

#[test]
fn four_labelled_pixels_suffice_to_detect_lines() {
    use vision::colour::colour_table::{ColourTable, Label, TableKind};
    let image = image("000.jpg");
    let unlabelled = sample_vision()
        .process(&image.view())
        .expect("detections")
        .line_points
        .len();
    let label = |u, v, class: &str| Label {
        rgb: image.view().rgb(u, v),
        class: class.to_owned(),
    };
    let labels = [
        label(300, 200, "carpet"),
        label(180, 150, "carpet"),
        label(330, 330, "carpet"),
        label(260, 118, "line"),
    ];
    let table = ColourTable::learn(&labels, TableKind::Yuv).expect("a table");
    let mut vision = sample_vision();
    vision.set_colour_table(table);
    let labelled = vision
        .process(&image.view())
        .expect("detections")
        .line_points
        .len();
    assert!(
        labelled * 10 >= unlabelled * 7,
        "{labelled} of {unlabelled}"
    );
}

#[test]
fn lines_are_found_in_coloured_and_in_clipped_light() {
    let first = image("000.jpg");
    let count = |change: fn([f32; 3]) -> [f32; 3]| {
        let pixels = first.rgb.as_chunks::<3>().0.iter();
        let changed = pixels.flat_map(|rgb| change(rgb.map(f32::from)).map(|level| level as u8));
        let image = Image {
            rgb: changed.collect(),
            ..first.clone()
        };
        let found = sample_vision().process(&image.view()).expect("detections");
        found.line_points.len()
    };
    fn clipped(level: f32) -> f32 {
        level.min(255.0)
    }
    let plain = count(|rgb| rgb);
    let yellow = count(|[r, g, b]| [clipped(1.1 * r), g, 0.45 * b]);
    let magenta = count(|[r, g, b]| [clipped(1.1 * r), 0.6 * g, clipped(1.1 * b)]);
    assert!(
        10 * yellow.min(magenta) > 8 * plain,
        "{yellow}, {magenta} of {plain}"
    );
    // White is hardly brighter than the carpet's green, and bright carpet is white.
    let overexposed = count(|rgb| rgb.map(|level| 0.3 * clipped(2.5 * level)));
    assert!(2 * overexposed > plain, "{overexposed} of {plain}");
}
