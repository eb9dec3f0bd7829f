//! Virtual sensors report what is in their regions.

use localize::robot::CameraConfig;
use vision::colour::lookup_table::ColourClass;
use vision::config::{ImageRect, VirtualSensorConfig};
use vision::{Detections, GroundMap, Image, Vision, VisionConfig, VisionError};

const SIZE: usize = 200;

fn camera() -> CameraConfig {
    CameraConfig {
        width_px: SIZE,
        height_px: SIZE,
        focal_px: None,
        centre_px: [100.0, 100.0],
        height: None,
        forward_deg: 90.0,
        flipped: true,
        outer_radius_px: Some(98.0),
    }
}

/// 4 cm of ground per pixel; forward is up, left is on the right.
fn map() -> GroundMap {
    let place = |pixel: usize, axis: usize| {
        let (u, v) = ((pixel % SIZE) as f32 - 100.0, (pixel / SIZE) as f32 - 100.0);
        [-v, u][axis] * 0.04
    };
    GroundMap {
        width_px: SIZE,
        height_px: SIZE,
        x: (0..SIZE * SIZE).map(|pixel| place(pixel, 0)).collect(),
        y: (0..SIZE * SIZE).map(|pixel| place(pixel, 1)).collect(),
    }
}

/// Carpet with a grid of lines, and a square of a colour around a pixel.
fn detect(
    config: VirtualSensorConfig,
    square: Option<([usize; 2], [u8; 3])>,
) -> Result<Detections, VisionError> {
    let mut rgb = Vec::with_capacity(3 * SIZE * SIZE);
    for pixel in 0..SIZE * SIZE {
        let (u, v) = (pixel % SIZE, pixel / SIZE);
        let line = u % 40 < 3 || v % 40 < 3;
        rgb.extend(match square {
            Some(([su, sv], colour)) if u.abs_diff(su) < 6 && v.abs_diff(sv) < 6 => colour,
            _ if line => [230, 230, 230],
            _ => [60, 140, 70],
        });
    }
    let image = Image {
        width_px: SIZE,
        height_px: SIZE,
        rgb,
    };
    let config = VisionConfig {
        virtual_sensors: config,
        ..VisionConfig::default()
    };
    let mut vision = Vision::new(&map(), &camera(), 0.125, config)?;
    assert_eq!(
        vision
            .virtual_sensor_regions()
            .iter()
            .filter(|(name, _)| *name == "bumper")
            .count(),
        9
    );
    let detections = vision.process(&image.view());
    assert!(
        vision
            .classify_samples(&image.view())?
            .contains(&ColourClass::CARPET)
    );
    detections
}

#[test]
fn obstacle_on_the_left_triggers_the_left_bumper() {
    let free = detect(VirtualSensorConfig::default(), None)
        .expect("detections")
        .virtual_sensors;
    assert!(
        free.bumpers.iter().all(|bumper| !bumper.hit),
        "{:?}",
        free.bumpers
    );
    // 0.6 m to the left is 15 px to the right of the axis.
    let square = Some(([115, 100], [20, 20, 20]));
    let hit = detect(VirtualSensorConfig::default(), square)
        .expect("detections")
        .virtual_sensors;
    let hits: Vec<bool> = hit.bumpers.iter().map(|bumper| bumper.hit).collect();
    assert!(hits[0] && !hits[3] && !hits[5], "{hits:?}");
}

#[test]
fn ball_in_the_kick_region_sets_kick() {
    let orange = [240, 120, 20];
    let config = VirtualSensorConfig {
        kick: Some(ImageRect {
            left_px: 95.0,
            top_px: 70.0,
            width_px: 10.0,
            height_px: 10.0,
        }),
        ..VirtualSensorConfig::default()
    };
    let at = |v| {
        detect(config.clone(), Some(([100, v], orange)))
            .expect("detections")
            .virtual_sensors
            .kick
    };
    assert!(at(75) && !at(130));
}

#[test]
fn region_outside_the_image_is_rejected() {
    let config = VirtualSensorConfig {
        lens: Some(ImageRect {
            left_px: 190.0,
            top_px: 10.0,
            width_px: 40.0,
            height_px: 10.0,
        }),
        ..VirtualSensorConfig::default()
    };
    let message = detect(config, None).expect_err("refused").to_string();
    assert!(message.contains("virtual_sensors"), "{message}");
}
