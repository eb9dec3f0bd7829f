use localize::robot::{CameraConfig, CameraControl};

use super::histogram::Histogram;
use super::*;
use crate::config::AutoExposureConfig;
use crate::image::Image;
use crate::optics::ground_map::GroundMap;

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

/// 0.1 m of ground per pixel; pixels within 8 px of the centre show the robot itself.
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

/// Body, textured carpet, lines and a bright wall, shifted slightly from image to image.
fn synthetic_image(light: f32, gamma: f32, index: usize) -> Image {
    image_with_wall(light, 1.0, gamma, index)
}

/// `wall`: brightness of the wall over its usual one.
fn image_with_wall(light: f32, wall: f32, gamma: f32, index: usize) -> Image {
    let mut rgb = Vec::with_capacity(3 * SIZE * SIZE);
    for pixel in 0..SIZE * SIZE {
        let (u, v) = (pixel % SIZE, pixel / SIZE);
        let radius = (u as f32 - 60.0).hypot(v as f32 - 60.0);
        let grain = 1.0 + 0.3 * (((u * 7 + v * 13 + index) % 11) as f32 / 11.0 - 0.5);
        let colour = match radius {
            r if r < 8.0 => [0.03, 0.03, 0.035],
            r if r > 50.0 => [0.5, 0.45, 0.4].map(|c| wall * c * (0.3 + 0.02 * (u % 30) as f32)),
            _ if (u + index).is_multiple_of(19) => [0.7; 3],
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

/// Simulates a camera with a command delay of two images; returns the light each image was taken with.
fn simulate_exposure(
    gamma: f32,
    frames: usize,
    light: impl Fn(usize) -> f32,
) -> (Vec<f32>, AutoExposure) {
    simulate_images(frames, light, |taken, index| {
        synthetic_image(taken, gamma, index)
    })
}

/// The same with other images; `image`: by the light it is taken with, and its number.
fn simulate_images(
    frames: usize,
    light: impl Fn(usize) -> f32,
    image: impl Fn(f32, usize) -> Image,
) -> (Vec<f32>, AutoExposure) {
    let control = control();
    let mut auto_exposure = AutoExposure::new(
        &map(),
        &camera(),
        None,
        Some(control),
        &AutoExposureConfig::default(),
    )
    .expect("a control");
    let mut setting = auto_exposure.state.setting;
    let mut commands: Vec<ExposureCommand> = Vec::new();
    let mut lights = Vec::new();
    for index in 0..frames {
        for command in commands.iter().filter(|c| c.from_frame == index as u64) {
            setting = command.setting;
        }
        let taken = control.light(setting) * light(index);
        lights.push(taken);
        let status = auto_exposure.process(&image(taken, index).view(), None);
        commands.extend(status.and_then(|status| status.command));
    }
    (lights, auto_exposure)
}

/// An image that is dark in this angle of the view, as behind robots that stand close.
fn covered_image(light: f32, index: usize, angle_deg: f32) -> Image {
    let mut image = synthetic_image(light, 0.45, index);
    for (pixel, rgb) in image.rgb.chunks_exact_mut(3).enumerate() {
        let (u, v) = ((pixel % SIZE) as f32 - 60.0, (pixel / SIZE) as f32 - 60.0);
        if u.hypot(v) > 8.0 && v.atan2(u).to_degrees() + 180.0 < angle_deg {
            rgb.fill((255.0 * (0.02 * light).powf(0.45)).min(255.0) as u8);
        }
    }
    image
}

#[test]
fn exposure_settles_within_10_images_after_a_light_step() {
    for gamma in [0.45, 1.0] {
        for factor in [0.25, 4.0] {
            let light = |index| if index < 60 { 1.0 } else { factor };
            let (lights, auto_exposure) = simulate_exposure(gamma, 100, light);
            let before = lights[59];
            let after = lights[70];
            assert!(
                (after / before).ln().abs() < 0.35,
                "gamma {gamma}, light × {factor}: exposed {before} before, {after} ten frames later: {:?}",
                &lights[55..]
            );
            assert!(
                auto_exposure.state.reference_level.is_some(),
                "still searching"
            );
        }
    }
}

#[test]
fn objects_that_cover_half_of_the_view_do_not_change_the_exposure() {
    for angle in [90.0, 150.0, 210.0] {
        let (lights, _) = simulate_images(
            160,
            |_| 1.0,
            |light, index| {
                let covered = (60..110).contains(&index);
                covered_image(light, index, if covered { angle } else { 0.0 })
            },
        );
        let ratios = lights[60..].iter().map(|light| (light / lights[59]).ln());
        let worst = ratios.fold(0.0f32, |worst, ratio| worst.max(ratio.abs()));
        assert!(worst < 0.25, "{angle} degrees: {worst} {:?}", &lights[55..]);
    }
}

#[test]
fn light_that_falls_or_rises_while_half_of_the_view_is_covered_is_followed() {
    for factor in [0.25, 4.0] {
        let (lights, _) = simulate_images(
            130,
            |index| if index < 90 { 1.0 } else { factor },
            |light, index| covered_image(light, index, if index < 60 { 0.0 } else { 180.0 }),
        );
        let rest = (lights[105] / lights[59]).ln();
        assert!(rest.abs() < 0.35, "{factor}: {:?}", &lights[55..]);
    }
}

#[test]
fn brightness_returns_after_each_of_many_light_changes() {
    for gamma in [0.45, 1.0] {
        // Down in steps of a third, up in ramps.
        let light = |index: usize| match index % 120 {
            _ if index < 60 => 1.0,
            phase if phase < 60 => 0.3,
            phase => (0.3 + (phase - 60) as f32 / 30.0).min(1.0),
        };
        let (lights, _) = simulate_exposure(gamma, 1200, light);
        for index in (179..1200).step_by(60) {
            let rest = gamma * (lights[index] / lights[59]).ln();
            assert!(
                rest.abs() < 1.1f32.ln(),
                "gamma {gamma}, image {index}: {rest}"
            );
        }
    }
}

#[test]
fn another_optimum_is_found_if_the_old_level_gives_less_entropy() {
    let control = control();
    let config = AutoExposureConfig::default();
    let mut auto_exposure =
        AutoExposure::new(&map(), &camera(), None, Some(control), &config).expect("a control");
    let (mut setting, mut entropies) = (auto_exposure.state.setting, Vec::new());
    let mut commands: Vec<ExposureCommand> = Vec::new();
    for index in 0..160 {
        for command in commands.iter().filter(|c| c.from_frame == index as u64) {
            setting = command.setting;
        }
        // The sun: the wall is clipped at the old level.
        let (light, wall) = if index < 60 { (1.0, 1.0) } else { (0.6, 12.0) };
        let taken = control.light(setting) * light;
        let image = image_with_wall(taken, wall, 0.45, index);
        let status = auto_exposure.process(&image.view(), None);
        commands.extend(status.and_then(|status| status.command));
        entropies.extend(status.map(|status| (index, taken, status.entropy)));
    }
    let old = entropies
        .iter()
        .rfind(|(index, ..)| *index < 60)
        .expect("measured")
        .1;
    let (_, light, entropy) = *entropies.last().expect("measured");
    let pixels: Vec<[u16; 2]> = (0..SIZE as u16)
        .flat_map(|u| (0..SIZE as u16).map(move |v| [u, v]))
        .collect();
    let image = image_with_wall(old, 12.0, 0.45, 0);
    let at_old_level = Histogram::from_pixels(&image.view(), &pixels).entropy(1.0);
    assert!(
        light < 0.8 * old,
        "{old} before, {light} after: {entropies:?}"
    );
    assert!(entropy > at_old_level, "{entropy} {at_old_level}");
}

#[test]
fn reported_settings_replace_assumed_delays_limits_and_starting_values() {
    let control = control();
    let config = AutoExposureConfig::default();
    let mut auto_exposure =
        AutoExposure::new(&map(), &camera(), None, Some(control), &config).expect("a control");
    // The camera starts at half the configured light, needs 5 images for a command and cannot exceed 3 times the light.
    let mut setting = control.setting(0.5 * control.light(auto_exposure.state.setting));
    let mut commands: Vec<(usize, ExposureCommand)> = Vec::new();
    let limit = 3.0 * control.light(auto_exposure.state.setting);
    let (mut levels, mut late_commands) = (Vec::new(), 0);
    for index in 0..200 {
        for (_, command) in commands.iter().filter(|(at, _)| at + 5 == index) {
            setting = control.setting(control.light(command.setting).min(limit));
        }
        let light = if index < 60 { 1.0 } else { 0.05 };
        let taken = control.light(setting) * light;
        levels.push(taken);
        let image = synthetic_image(taken, 0.45, index);
        let status = auto_exposure.process(&image.view(), Some(setting));
        if let Some(status) = status {
            assert_eq!(status.applied_setting, Some(setting), "image {index}");
            late_commands += usize::from(index > 180 && status.command.is_some());
            commands.extend(status.command.map(|command| (index, command)));
        }
    }
    // At its limit the camera gives what it can, and the search ends.
    assert!(
        (control.light(setting) / limit - 1.0).abs() < 1e-3,
        "{levels:?}"
    );
    assert!(auto_exposure.state.reference_level.is_some() && late_commands == 0);
}

/// Light of 120 images whose settings are reported `images_early` too early. From image 60 on the scene has a quarter of it.
fn lights_with_early_reports(images_early: usize) -> Vec<f32> {
    let control = control();
    let config = AutoExposureConfig::default();
    let mut auto_exposure =
        AutoExposure::new(&map(), &camera(), None, Some(control), &config).expect("a control");
    let (mut reported, mut in_force) = (auto_exposure.state.setting, auto_exposure.state.setting);
    let mut changes: Vec<(usize, ExposureCommand)> = Vec::new();
    let mut lights = Vec::new();
    for index in 0..120 {
        for (at, command) in &changes {
            if at + 1 == index {
                reported = command.setting;
            }
            if at + 1 + images_early == index {
                in_force = command.setting;
            }
        }
        let taken = control.light(in_force) * if index < 60 { 1.0 } else { 0.25 };
        lights.push(taken);
        let image = synthetic_image(taken, 0.45, index);
        let status = auto_exposure.process(&image.view(), Some(reported));
        let command = status.and_then(|status| status.command);
        changes.extend(command.map(|command| (index, command)));
    }
    lights
}

fn check_no_runaway(images_early: usize) {
    let lights = lights_with_early_reports(images_early);
    let worst = lights[..59].iter().chain(&lights[90..]);
    let worst = worst.fold(0.0f32, |worst, light| worst.max(light / lights[59]));
    assert!(worst < 1.6, "{images_early} images early: {lights:?}");
}

#[test]
fn settings_that_are_reported_too_early_do_not_make_the_control_run_away() {
    for images_early in [1, 2] {
        check_no_runaway(images_early);
    }
}

#[test]
fn settings_that_are_reported_four_images_early_do_not_make_the_control_run_away() {
    check_no_runaway(4);
}

#[test]
fn settings_that_are_reported_too_early_lead_to_the_same_light() {
    for images_early in [1, 2, 4] {
        let lights = lights_with_early_reports(images_early);
        assert!((lights[119] / lights[59]).ln().abs() < 0.35, "{lights:?}");
    }
}

#[test]
fn exposure_is_constant_under_constant_light() {
    let (lights, _) = simulate_exposure(0.45, 200, |_| 1.0);
    assert!(
        lights[20..].iter().all(|&light| light == lights[20]),
        "{lights:?}"
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
fn mirror_that_shows_no_near_carpet_measures_its_nearest_one() {
    let mut map = map();
    for index in 0..map.x.len() {
        if map.x[index].hypot(map.y[index]) < 1.5 {
            (map.x[index], map.y[index]) = (f32::NAN, f32::NAN);
        }
    }
    let config = AutoExposureConfig::default();
    assert!(map.nearest_ground() > config.centre_range_max);
    let measured = |map: &GroundMap| {
        let mut control =
            AutoExposure::new(map, &camera(), None, None, &config).expect("a control");
        let status = control.process(&synthetic_image(1.0, 0.45, 0).view(), None);
        status.expect("measured").centre_brightness
    };
    assert!(measured(&map) > 0.0);
}

#[test]
fn light_change_without_control_warns_once() {
    let config = AutoExposureConfig::default();
    let mut auto_exposure =
        AutoExposure::new(&map(), &camera(), None, None, &config).expect("a control");
    let mut warnings = 0;
    for index in 0..60 {
        let light = if index < 20 { 1.0 } else { 0.3 };
        let status = auto_exposure.process(&synthetic_image(light, 0.45, index).view(), None);
        warnings += status.map_or(0, |status| {
            assert!(status.command.is_none());
            usize::from(status.uncontrolled_light_change)
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
