//! Line points of a recording that another program rendered lie on its true lines.

use std::path::{Path, PathBuf};

use localize::robot::CameraConfig;
use localize::{Field, Pose};
use vision::overlay::marking_distance;
use vision::{Eyes, Image, Mount, Profile, VisionConfig, VisionError, optics};

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

/// Carpet with a line along y = 1 and a white wall from x = 2 on, as the sample's mirror shows it.
fn walled() -> (CameraConfig, vision::GroundMap, Image) {
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
fn the_foot_of_a_white_wall_is_seen_where_walls_are_wanted() {
    let (camera, map, image) = walled();
    let feet = |walls: bool| {
        let mut config = VisionConfig::default();
        config.scan.circles = 36;
        config.lines.walls = walls;
        let mut eyes = Eyes::new(&map, &camera, 0.125, config).expect("eyes");
        let seen = eyes.see(&image.frame()).expect("seen");
        let near = |off: f32| {
            let at_wall = seen.line_points.iter().filter(|one| {
                (one.point.at.x - 2.0).abs() < off && (one.point.at.y - 1.0).abs() > 0.3
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

/// The image as a USB camera would send it.
fn yuyv(image: &Image) -> Vec<u8> {
    let frame = image.frame();
    let mut data = Vec::new();
    for v in 0..image.height_px {
        for u in (0..image.width_px).step_by(2) {
            let a = vision::image::yuv_of_rgb(frame.rgb(u, v));
            let b = vision::image::yuv_of_rgb(frame.rgb(u + 1, v));
            let mean = |i: usize| ((u16::from(a[i]) + u16::from(b[i])) / 2) as u8;
            data.extend([a[0], mean(1), b[0], mean(2)]);
        }
    }
    data
}

#[test]
fn a_yuyv_camera_sees_the_lines_that_an_rgb_camera_sees() {
    let image = image("000.jpg");
    let data = yuyv(&image);
    let frame = vision::Frame::packed(480, 480, vision::PixelFormat::Yuyv, &data);
    let rgb = eyes().see(&image.frame()).expect("seen").line_points;
    let yuv = eyes().see(&frame).expect("seen").line_points;
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
fn labels_of_a_few_pixels_are_enough_to_see_lines() {
    use vision::labels::{ColourTable, Label, TableKind};
    let image = image("000.jpg");
    let unlabelled = eyes().see(&image.frame()).expect("seen").line_points.len();
    let label = |u, v, class: &str| Label {
        rgb: image.frame().rgb(u, v),
        class: class.to_owned(),
    };
    let labels = [
        label(300, 200, "carpet"),
        label(180, 150, "carpet"),
        label(330, 330, "carpet"),
        label(260, 118, "line"),
    ];
    let table = ColourTable::learn(&labels, TableKind::Yuv).expect("a table");
    let mut eyes = eyes();
    eyes.set_colours(table);
    let labelled = eyes.see(&image.frame()).expect("seen").line_points.len();
    assert!(
        labelled * 10 >= unlabelled * 7,
        "{labelled} of {unlabelled}"
    );
}
