//! Calibration from images and the field alone, against the exact map of the sample.

use std::path::{Path, PathBuf};

use localize::Field;
use localize::field::FieldSize;
use localize::robot::CameraConfig;
use vision::calibrate::{
    CalibrationError, NamedImage, calibrate_lines, calibrate_unknown_field,
    calibrate_unknown_mirror, find_rim,
};
use vision::{GroundMap, Image, VisionConfig};

fn folder(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../samples")
        .join(name)
}

fn images(numbers: impl Iterator<Item = usize>) -> Vec<NamedImage> {
    numbers
        .map(|number| {
            let name = format!("frames/{number:03}.jpg");
            NamedImage {
                image: Image::load(&folder("sequence").join(&name)).expect("an image"),
                name,
            }
        })
        .collect()
}

fn field(name: &str) -> Field {
    Field::load(
        &Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("../..")
            .join(name),
    )
    .expect("a field")
}

/// Median distance between two maps over the pixels whose true range lies in an interval, metres.
fn median_map_error(found: &GroundMap, exact: &GroundMap, from: f32, to: f32) -> f32 {
    let mut offs: Vec<f32> = (0..exact.height_px)
        .flat_map(|v| (0..exact.width_px).map(move |u| (u, v)))
        .filter_map(|(u, v)| {
            let truth = exact.at(u, v)?;
            let inside = (from..to).contains(&truth.distance());
            Some(found.at(u, v)?.distance_to(truth)).filter(|_| inside)
        })
        .collect();
    offs.sort_by(f32::total_cmp);
    offs[offs.len() / 2]
}

#[test]
fn map_is_found_from_ten_images_and_the_field_alone() {
    let exact = GroundMap::load(&folder("calibration").join("exact_map.npz")).expect("a map");
    let found = calibrate_unknown_mirror(
        [480, 480],
        &field("samples/sequence/field.toml"),
        &[],
        &images((0..20).step_by(2)),
        &VisionConfig::default(),
        &|_| (),
    )
    .expect("a map");
    let map = &found.calibration.map;
    // In the robot frame itself: the origin is below the axis, and forward is up in the sample, too.
    let (near, far) = (
        median_map_error(map, &exact, 0.5, 3.0),
        median_map_error(map, &exact, 3.0, 5.0),
    );
    assert!(near <= 0.02, "median {near} m inside 3 m");
    assert!(far <= 0.03, "median {far} m from 3 to 5 m");
    let apart = found
        .calibration
        .disagreement
        .expect("ten images have halves");
    assert!(apart.near < 0.02, "{apart:?}");
}

#[test]
fn wrong_field_is_refused_and_the_right_one_is_named() {
    let others = [("18x12".to_owned(), field("samples/sequence/field.toml"))];
    let refused = calibrate_unknown_mirror(
        [480, 480],
        &field("config/fields/msl_12x8.toml"),
        &others,
        &images((0..20).step_by(3)),
        &VisionConfig::default(),
        &|_| (),
    );
    match refused {
        Err(error @ CalibrationError::WrongField { .. }) => {
            assert!(error.to_string().contains("18x12"), "{error}");
        }
        other => panic!("{other:?}"),
    }
}

/// The image of a camera that sits a little farther right and down over the same robot.
fn shifted(image: &Image, [right, down]: [usize; 2]) -> Image {
    let pixel = |u: usize, v: usize| {
        let from = v.saturating_sub(down) * image.width_px + u.saturating_sub(right);
        &image.rgb[3 * from..][..3]
    };
    let places = (0..image.height_px).flat_map(|v| (0..image.width_px).map(move |u| (u, v)));
    Image {
        rgb: places.flat_map(|(u, v)| pixel(u, v)).copied().collect(),
        ..image.clone()
    }
}

fn calibrate(images: &[NamedImage]) -> Result<(), CalibrationError> {
    calibrate_unknown_mirror(
        [480, 480],
        &field("samples/sequence/field.toml"),
        &[],
        images,
        &VisionConfig::default(),
        &|_| (),
    )
    .map(|_| ())
}

#[test]
fn images_of_a_robot_whose_camera_sits_two_pixels_off_are_told_apart() {
    let mut all = images(0..20);
    for other in all.iter_mut().skip(1).step_by(3) {
        other.image = shifted(&other.image, [2, 1]);
    }
    let start = GroundMap::load(&folder("calibration").join("exact_map.npz")).expect("a map");
    let camera = CameraConfig {
        width_px: 480,
        height_px: 480,
        focal_px: None,
        centre_px: [238.9, 241.3],
        height: None,
        forward_deg: 90.0,
        flipped: true,
        outer_radius_px: Some(234.0),
    };
    let sequence_field = field("samples/sequence/field.toml");
    let config = VisionConfig::default();
    let from_map = calibrate_lines(
        &camera,
        &start,
        &sequence_field,
        &[],
        &all,
        &config,
        &|_| (),
    );
    for refused in [calibrate(&all), from_map.map(|_| ())] {
        assert_groups(refused, &all);
    }
}

/// Every third image is of another robot, from the second on.
fn assert_groups(refused: Result<(), CalibrationError>, all: &[NamedImage]) {
    let Err(CalibrationError::TwoCameras {
        sign,
        first,
        second,
    }) = refused
    else {
        panic!("two cameras in one folder: {refused:?}");
    };
    assert!(sign.contains("rods"), "{sign}");
    let names = |of: &dyn Fn(usize) -> bool| -> Vec<String> {
        let chosen = all.iter().enumerate().filter(|(index, _)| of(*index));
        chosen.map(|(_, image)| image.name.clone()).collect()
    };
    assert_eq!(second, names(&|index| index % 3 == 1));
    assert_eq!(first, names(&|index| index % 3 != 1));
}

#[test]
fn folder_of_black_images_is_not_one_of_two_robots() {
    let mut all = images(0..8);
    for black in &mut all {
        black.image.rgb.fill(0);
    }
    let refused = calibrate(&all);
    assert!(
        matches!(refused, Err(ref error) if !matches!(error, CalibrationError::TwoCameras { .. })),
        "{refused:?}"
    );
}

#[test]
fn images_without_lines_are_refused_by_name() {
    let mut images = images(0..4);
    for image in &mut images {
        image
            .image
            .rgb
            .chunks_exact_mut(3)
            .for_each(|pixel| pixel.copy_from_slice(&[60, 140, 80]));
    }
    let refused = calibrate_unknown_mirror(
        [480, 480],
        &field("samples/sequence/field.toml"),
        &[],
        &images,
        &VisionConfig::default(),
        &|_| (),
    );
    match refused {
        Err(error @ CalibrationError::TooFewImages { .. }) => {
            assert!(error.to_string().contains("frames/000.jpg"), "{error}");
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn rim_of_one_image_is_within_three_pixels() {
    for image in images([0, 7, 13].into_iter()) {
        let rim = find_rim(&[&image.image]).expect("a rim");
        // robot.toml of the sample: centre 238.9, 241.3 and radius 234.
        let [u, v] = rim.centre_px;
        assert!(
            (u - 238.9).abs() < 2.0 && (v - 241.3).abs() < 2.0,
            "{rim:?}"
        );
        assert!((rim.radius_px - 234.0).abs() < 3.0, "{rim:?}");
    }
}

/// A disc of several greys. `beyond`: level at a distance beyond its rim (pixels) and a column.
fn disc(
    [width_px, height_px]: [usize; 2],
    centre: [f32; 2],
    radius: f32,
    beyond: impl Fn(f32, usize) -> f32,
) -> Image {
    let mut rgb = Vec::new();
    for (v, u) in (0..height_px).flat_map(|v| (0..width_px).map(move |u| (v, u))) {
        let outside = localize::math::hypot(u as f32 - centre[0], v as f32 - centre[1]) - radius;
        let level = if outside < 0.0 {
            70 + (u * 7 + v * 13) as u8 % 90
        } else {
            beyond(outside, u) as u8
        };
        rgb.extend([level; 3]);
    }
    Image {
        width_px,
        height_px,
        rgb,
    }
}

#[test]
fn rim_that_the_image_cuts_is_found_from_its_corners() {
    let image = disc([160, 120], [82.0, 57.5], 90.0, |_, _| 9.0);
    let rim = find_rim(&[&image]).expect("a rim");
    let [u, v] = rim.centre_px;
    assert!((u - 82.0).abs() < 1.5 && (v - 57.5).abs() < 1.5, "{rim:?}");
    assert!((rim.radius_px - 90.0).abs() < 1.5, "{rim:?}");
}

#[test]
fn rim_is_found_although_a_picture_in_nine_is_bright_everywhere() {
    let own = disc([160, 120], [82.0, 57.5], 90.0, |_, _| 9.0);
    let foreign = disc([160, 120], [70.0, 50.0], 400.0, |_, _| 9.0);
    let pictures = [&own, &own, &own, &foreign, &own, &own, &own, &own, &own];
    assert_eq!(find_rim(&pictures), find_rim(&[&own]));
}

#[test]
fn image_without_a_dark_border_has_no_rim() {
    assert!(find_rim(&[&disc([160, 120], [80.0, 60.0], 400.0, |_, _| 9.0)]).is_err());
}

#[test]
fn field_a_fifth_smaller_is_refused_in_favour_of_the_right_one() {
    let calibrate = |name: &str, other: &str| {
        let other = format!("config/fields/{other}");
        calibrate_unknown_mirror(
            [480, 480],
            &field(&format!("config/fields/{name}")),
            &[(other.clone(), field(&other))],
            &images(0..20),
            &VisionConfig::default(),
            &|_| (),
        )
    };
    let refused = calibrate("custom.toml", "msl_18x12.toml");
    assert!(
        matches!(refused, Err(CalibrationError::WrongField { ref hint, .. }) if hint.contains("msl_18x12.toml")),
        "{:?}",
        refused.map(|_| ())
    );
    let accepted = calibrate("msl_18x12.toml", "custom.toml");
    assert!(accepted.is_ok(), "{:?}", accepted.err());
}

#[test]
fn sizes_of_the_field_are_found_with_the_map() {
    let exact = GroundMap::load(&folder("calibration").join("exact_map.npz")).expect("a map");
    let real = field("samples/sequence/field.toml").config;
    let mut given = real.clone();
    given.width = 11.0;
    given.centre_circle_radius = 1.7;
    given.penalty_area.width = 7.2;
    let given = Field::new(given).expect("a field");
    let found = calibrate_unknown_field(
        [480, 480],
        &given,
        &images(0..20),
        &VisionConfig::default(),
        &|_| (),
    )
    .expect("a map");
    let texts = || found.told.iter().chain(&found.untold);
    let precise = [
        "length",
        "width",
        "centre_circle_radius",
        "penalty_area.width",
    ];
    for size in FieldSize::all(&real) {
        let (wanted, got) = (size.get(&real), size.get(&found.field.config));
        let text = size.text(&given.config, &found.field.config);
        // The sizes of few lines, in the scale that the median size has by chance.
        let is_precise = precise.iter().any(|name| text.starts_with(name));
        let bound = if is_precise { 0.02 * wanted } else { 0.1 };
        assert!((got - wanted).abs() < bound, "{text}, not {wanted}");
        assert!(
            texts().any(|named| *named == text) || size.get(&given.config) == got,
            "{text}"
        );
    }
    let near = median_map_error(&found.mirror.calibration.map, &exact, 0.5, 3.0);
    assert!(near <= 0.04, "median {near} m inside 3 m");
}

#[test]
fn halo_of_stray_light_beyond_the_rim_moves_neither_centre_nor_radius() {
    let centre = [251.0, 238.0];
    // Brighter on the right, where a window is.
    let halo = |outside: f32, column: usize| {
        6.0 + (20.0 + 0.08 * column as f32) * localize::math::exp(-outside / 9.0)
    };
    let rim = find_rim(&[&disc([500, 480], centre, 220.0, halo)]).expect("a rim");
    let [u, v] = rim.centre_px;
    assert!(
        (u - centre[0]).abs() < 0.5 && (v - centre[1]).abs() < 0.5,
        "{rim:?}"
    );
    assert!((rim.radius_px - 220.0).abs() < 1.0, "{rim:?}");
}
