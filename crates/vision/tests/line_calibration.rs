//! Calibration from the field's lines: unknown poses, initial map a fifth too long.

use std::path::{Path, PathBuf};

use localize::Field;
use localize::field::FieldConfig;
use localize::robot::CameraConfig;
use vision::calibrate::{CalibrationError, LinesCalibration, NamedImage, calibrate_lines};
use vision::{GroundMap, Image, VisionConfig};

#[derive(serde::Deserialize)]
struct Robot {
    camera: CameraConfig,
}

fn folder(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../samples")
        .join(name)
}

fn camera() -> CameraConfig {
    let text = std::fs::read_to_string(folder("sequence").join("robot.toml")).expect("robot.toml");
    toml::from_str::<Robot>(&text).expect("a robot").camera
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

fn calibrate(
    start: &GroundMap,
    field: &Field,
    others: &[(String, Field)],
    images: &[NamedImage],
) -> Result<LinesCalibration, CalibrationError> {
    let config = VisionConfig::default();
    calibrate_lines(&camera(), start, field, others, images, &config, &|_| ())
}

fn exact_map() -> GroundMap {
    GroundMap::load(&folder("calibration").join("exact_map.npz")).expect("a map")
}

/// The field of the images with other sides, metres.
fn field_of(length: f32, width: f32) -> Field {
    let right = Field::load(&folder("sequence").join("field.toml")).expect("a field");
    let config = FieldConfig {
        length,
        width,
        ..right.config
    };
    Field::new(config).expect("a field")
}

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
fn line_calibration_corrects_a_20_percent_range_error() {
    let field = Field::load(&folder("sequence").join("field.toml")).expect("a field");
    let exact = GroundMap::load(&folder("calibration").join("exact_map.npz")).expect("a map");
    let stretched = |values: &[f32]| values.iter().map(|value| 1.2 * value).collect();
    let start = GroundMap {
        x: stretched(&exact.x),
        y: stretched(&exact.y),
        ..exact.clone()
    };
    let images = images((0..20).step_by(2));
    let found = calibrate(&start, &field, &[], &images).expect("a map");
    let (near, far) = (
        median_map_error(&found.map, &exact, 0.0, 3.0),
        median_map_error(&found.map, &exact, 3.0, 5.0),
    );
    assert!(near <= 0.02, "median {near} m inside 3 m");
    assert!(far <= 0.06, "median {far} m from 3 to 5 m");
}

#[test]
fn line_calibration_reaches_beyond_the_end_of_its_start_map() {
    let field = Field::load(&folder("sequence").join("field.toml")).expect("a field");
    let mut start = exact_map();
    for (x, y) in start.x.iter_mut().zip(&mut start.y) {
        if localize::math::hypot(*x, *y) > 3.5 {
            (*x, *y) = (f32::NAN, f32::NAN);
        }
    }
    let images = images((0..20).step_by(2));
    let found = calibrate(&start, &field, &[], &images).expect("a map");
    let off = median_map_error(&found.map, &exact_map(), 4.0, 6.0);
    assert!(off <= 0.15, "median {off} m from 4 to 6 m");
}

#[test]
fn images_without_lines_are_named_in_the_error() {
    let field = Field::load(&folder("sequence").join("field.toml")).expect("a field");
    let exact = GroundMap::load(&folder("calibration").join("exact_map.npz")).expect("a map");
    let mut images = images(0..3);
    for image in &mut images {
        image
            .image
            .rgb
            .chunks_exact_mut(3)
            .for_each(|pixel| pixel.copy_from_slice(&[60, 140, 80]));
    }
    let refused = calibrate(&exact, &field, &[], &images);
    let message = match refused {
        Err(error @ CalibrationError::TooFewImages { .. }) => error.to_string(),
        other => panic!("{other:?}"),
    };
    assert!(message.contains("frames/000.jpg"), "{message}");
}

#[test]
fn map_of_a_field_of_other_sides_is_refused() {
    let images = images(0..20);
    let refused = calibrate(&exact_map(), &field_of(14.0, 9.0), &[], &images);
    let message = refused.expect_err("another field").to_string();
    assert!(
        message.starts_with("the images do not show this field: 66 %"),
        "{message}"
    );
    // The markings of a larger field can be bent to most of the points: the right one is named.
    let right = [("right.toml".to_owned(), field_of(18.0, 12.0))];
    let refused = calibrate(&exact_map(), &field_of(22.0, 14.0), &right, &images);
    let message = refused.expect_err("another field").to_string();
    assert!(message.contains("right.toml fits better"), "{message}");
    let larger = [("larger.toml".to_owned(), field_of(22.0, 14.0))];
    calibrate(&exact_map(), &field_of(18.0, 12.0), &larger, &images).expect("the right field");
}

#[test]
fn copies_of_an_image_count_once() {
    let field = field_of(18.0, 12.0);
    let mut copies = images((0..3).cycle().take(20));
    for (number, copy) in copies.iter_mut().enumerate() {
        copy.name = format!("copy {number}");
    }
    let message = match calibrate(&exact_map(), &field, &[], &copies) {
        Err(error @ CalibrationError::TooFewImages { used: 3, .. }) => error.to_string(),
        other => panic!("{other:?}"),
    };
    assert!(
        message.contains("copy 3: the same picture as copy 0"),
        "{message}"
    );
}
