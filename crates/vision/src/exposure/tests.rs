use super::*;
use crate::image::Image;

const SIZE: usize = 120;

fn camera() -> CameraConfig {
    CameraConfig {
        width_px: SIZE,
        height_px: SIZE,
        focal_px: None,
        centre_px: [60.0, 60.0],
        height: None,
        forward_deg: 90.0,
        flipped: true,
        outer_radius_px: Some(58.0),
    }
}

/// 0.1 m of ground a pixel; the innermost eight pixels show the robot itself.
fn map() -> GroundMap {
    let place = |pixel: usize, axis: usize| {
        let (u, v) = ((pixel % SIZE) as f32 - 60.0, (pixel / SIZE) as f32 - 60.0);
        let ground = [-v, u][axis] * 0.1;
        if u.hypot(v) < 8.0 { f32::NAN } else { ground }
    };
    GroundMap {
        width_px: SIZE,
        height_px: SIZE,
        x: (0..SIZE * SIZE).map(|pixel| place(pixel, 0)).collect(),
        y: (0..SIZE * SIZE).map(|pixel| place(pixel, 1)).collect(),
    }
}

fn control() -> CameraControl {
    CameraControl {
        exposure: 1.0,
        gain: 1.0,
        exposure_min: 0.02,
        exposure_max: 4.0,
        gain_min: 1.0,
        gain_max: 8.0,
        path_slope: 1.0,
        path_offset: 0.0,
        gain_db_per_unit: 0.0,
        delay_frames: 2,
    }
}

/// Body, carpet with grain, lines and a bright wall, moved on a little from frame to frame.
fn synthetic_image(light: f32, gamma: f32, frame: usize) -> Image {
    let mut rgb = Vec::with_capacity(3 * SIZE * SIZE);
    for pixel in 0..SIZE * SIZE {
        let (u, v) = (pixel % SIZE, pixel / SIZE);
        let radius = (u as f32 - 60.0).hypot(v as f32 - 60.0);
        let grain = 1.0 + 0.3 * (((u * 7 + v * 13 + frame) % 11) as f32 / 11.0 - 0.5);
        let colour = match radius {
            r if r < 8.0 => [0.03, 0.03, 0.035],
            r if r > 50.0 => [0.5, 0.45, 0.4].map(|c| c * (0.3 + 0.02 * (u % 30) as f32)),
            _ if (u + frame).is_multiple_of(19) => [0.7; 3],
            _ => [0.05, 0.2, 0.07],
        };
        rgb.extend(
            colour.map(|c| (255.0 * (light * c * grain).min(1.0).powf(gamma)).round() as u8),
        );
    }
    Image {
        width_px: SIZE,
        height_px: SIZE,
        rgb,
    }
}

/// Runs a camera whose commands take two frames; light by frame; gives the light each frame was taken with.
fn simulate_exposure(
    gamma: f32,
    frames: usize,
    light: impl Fn(usize) -> f32,
) -> (Vec<f32>, AutoExposure) {
    let control = control();
    let mut eye = AutoExposure::new(
        &map(),
        &camera(),
        None,
        Some(control),
        &AutoExposureConfig::default(),
    )
    .expect("a control");
    let mut setting = eye.setting;
    let mut commands: Vec<ExposureCommand> = Vec::new();
    let mut seen = Vec::new();
    for frame in 0..frames {
        for command in commands.iter().filter(|c| c.from_frame == frame as u64) {
            setting = command.setting;
        }
        let taken = control.light(setting) * light(frame);
        seen.push(taken);
        let reading = eye.process(&synthetic_image(taken, gamma, frame).view());
        commands.extend(reading.and_then(|reading| reading.command));
    }
    (seen, eye)
}

#[test]
fn exposure_settles_within_10_images_after_a_light_step() {
    for gamma in [0.45, 1.0] {
        for factor in [0.25, 4.0] {
            let light = |frame| if frame < 60 { 1.0 } else { factor };
            let (seen, eye) = simulate_exposure(gamma, 100, light);
            let before = seen[59];
            let after = seen[70];
            assert!(
                (after / before).ln().abs() < 0.35,
                "gamma {gamma}, light × {factor}: exposed {before} before, {after} ten frames later: {:?}",
                &seen[55..]
            );
            assert!(eye.reference_level.is_some(), "still searching");
        }
    }
}

#[test]
fn exposure_is_constant_under_constant_light() {
    let (seen, _) = simulate_exposure(0.45, 200, |_| 1.0);
    assert!(
        seen[20..].iter().all(|&light| light == seen[20]),
        "{seen:?}"
    );
}

#[test]
fn settings_stay_on_the_path_within_camera_limits() {
    let control = control();
    let dark = control.setting(1e-9);
    assert_eq!((dark.exposure, dark.gain), (0.02, 1.0));
    let bright = control.setting(1e9);
    assert_eq!((bright.exposure, bright.gain), (4.0, 8.0));
    let between = control.setting(4.0);
    assert!((between.exposure - 2.0).abs() < 1e-3 && (between.gain - 2.0).abs() < 1e-3);
}

#[test]
fn light_change_without_control_warns_once() {
    let config = AutoExposureConfig::default();
    let mut eye = AutoExposure::new(&map(), &camera(), None, None, &config).expect("a control");
    let mut warnings = 0;
    for frame in 0..60 {
        let light = if frame < 20 { 1.0 } else { 0.3 };
        let reading = eye.process(&synthetic_image(light, 0.45, frame).view());
        warnings += reading.map_or(0, |reading| {
            assert!(reading.command.is_none());
            usize::from(reading.warning)
        });
    }
    assert_eq!(warnings, 1);
}

#[test]
fn predicted_entropy_matches_a_brighter_image() {
    let pixels: Vec<[u16; 2]> = (0..SIZE as u16)
        .flat_map(|u| (0..SIZE as u16).map(move |v| [u, v]))
        .collect();
    let entropy = |light: f32, scale: f32| {
        let image = synthetic_image(light, 0.45, 0);
        Histogram::from_pixels(&image.view(), &pixels).entropy(scale)
    };
    let (predicted, real) = (entropy(0.5, 2f32.powf(0.45)), entropy(1.0, 1.0));
    assert!((predicted - real).abs() < 0.6, "{predicted} {real}");
    assert!(real > entropy(0.1, 1.0) && real > entropy(20.0, 1.0));
}
