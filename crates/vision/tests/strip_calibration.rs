//! Calibration from a strip reproduces the exact map, for an upright and for a tilted mirror; mask calibration.

use std::path::{Path, PathBuf};

use localize::math;
use localize::robot::CameraConfig;
use vision::calibrate::{BarColour, Strip, StripImage, calibrate_strip, fit_mount};
use vision::optics::ray_tracing::Tracer;
use vision::{GroundMap, Image, Mount, Profile, optics};

#[derive(serde::Deserialize)]
struct Robot {
    camera: CameraConfig,
}

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../samples/calibration")
}

fn camera() -> CameraConfig {
    let text = std::fs::read_to_string(folder().join("robot.toml")).expect("robot.toml");
    toml::from_str::<Robot>(&text).expect("a robot").camera
}

fn strip() -> Strip {
    let text = std::fs::read_to_string(folder().join("strip.toml")).expect("strip.toml");
    toml::from_str(&text).expect("a strip")
}

fn images() -> Vec<StripImage> {
    let mut reader = csv::Reader::from_path(folder().join("strip.csv")).expect("strip.csv");
    reader
        .records()
        .map(|record| {
            let record = record.expect("a row");
            StripImage {
                name: record[0].to_owned(),
                direction: record[1].parse().expect("an angle"),
                image: Image::load(&folder().join(&record[0])).expect("an image"),
            }
        })
        .collect()
}

/// Median distance between two maps over pixels with ground in from..to, metres.
fn median_map_error(found: &GroundMap, exact: &GroundMap, from: f32, to: f32) -> f32 {
    let mut offs = Vec::new();
    let mut expected = 0;
    for v in 0..exact.height_px {
        for u in 0..exact.width_px {
            let Some(truth) = exact
                .at(u, v)
                .filter(|at| (from..to).contains(&at.distance()))
            else {
                continue;
            };
            expected += 1;
            if let Some(at) = found.at(u, v) {
                offs.push(at.distance_to(truth));
            }
        }
    }
    assert!(
        offs.len() * 10 > expected * 9,
        "{} of {expected} pixels",
        offs.len()
    );
    offs.sort_by(f32::total_cmp);
    offs[offs.len() / 2]
}

#[test]
fn strip_calibration_reproduces_the_exact_map() {
    let found = calibrate_strip(&camera(), &strip(), &images()).expect("a map");
    let exact = GroundMap::load(&folder().join("exact_map.npz")).expect("a map");
    let near = median_map_error(&found.map, &exact, 0.4, 3.0);
    let far = median_map_error(&found.map, &exact, 3.0, 5.0);
    println!("median {near:.4} m inside 3 m, {far:.4} m from 3 to 5 m");
    assert!(near <= 0.01, "median {near} m inside 3 m");
    assert!(far <= 0.03, "median {far} m from 3 to 5 m");
}

/// Ground points of four subpixels of each pixel, row by row.
fn trace_subpixels(
    camera: &CameraConfig,
    profile: &Profile,
    mount: &Mount,
) -> Vec<[Option<[f64; 2]>; 4]> {
    let tracer = Tracer::new(camera, profile, mount).expect("a tracer");
    let at = |u: f64, v: f64| {
        let at = tracer.ray(u, v)?.at_height(0.0)?;
        Some([f64::from(at.x), f64::from(at.y)])
    };
    (0..camera.height_px)
        .flat_map(|v| (0..camera.width_px).map(move |u| (u as f64, v as f64)))
        .map(|(u, v)| {
            [(-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25)]
                .map(|(i, j)| at(u + i, v + j))
        })
        .collect()
}

/// Renders a strip on plain carpet.
fn render_strip(
    camera: &CameraConfig,
    ground: &[[Option<[f64; 2]>; 4]],
    strip: &Strip,
    direction: f64,
) -> Image {
    let shade = |at: &Option<[f64; 2]>| -> [f64; 3] {
        let Some([x, y]) = *at else {
            return [20.0; 3];
        };
        let along = x * math::cos(direction) + y * math::sin(direction);
        let across = y * math::cos(direction) - x * math::sin(direction);
        let bar = (along - strip.first_edge) / strip.spacing;
        if across.abs() > strip.width / 2.0 || bar < 0.0 || bar >= strip.bars as f64 {
            return [90.0, 140.0, 100.0];
        }
        if (bar as usize).is_multiple_of(2) {
            [45.0; 3]
        } else {
            [225.0; 3]
        }
    };
    let mut rgb = Vec::new();
    for pixel in ground {
        let mut sum = [0.0; 3];
        for at in pixel {
            let colour = shade(at);
            for c in 0..3 {
                sum[c] += colour[c] / 4.0;
            }
        }
        rgb.extend(sum.map(|c| c.round() as u8));
    }
    Image {
        width_px: camera.width_px,
        height_px: camera.height_px,
        rgb,
    }
}

#[test]
fn two_degree_mirror_tilt_is_recovered_by_strip_and_mount_fit() {
    let (camera, strip) = (camera(), strip());
    let profile = Profile::load(&folder().join("mirror.csv")).expect("a profile");
    let mount = Mount {
        mirror_tilt_deg: [1.6, -1.2],
        ..Mount::default()
    };
    let ground = trace_subpixels(&camera, &profile, &mount);
    let images: Vec<StripImage> = (0..24)
        .map(|step| {
            let direction = f64::from(step) * 15f64.to_radians();
            StripImage {
                name: format!("{step}"),
                direction,
                image: render_strip(&camera, &ground, &strip, direction),
            }
        })
        .collect();
    let exact = optics::trace_rays(&camera, &profile, &mount)
        .expect("rays")
        .ground_map();
    let found = calibrate_strip(&camera, &strip, &images).expect("a map");
    let near = median_map_error(&found.map, &exact, 0.4, 3.0);
    let far = median_map_error(&found.map, &exact, 3.0, 5.0);
    println!("median {near:.4} m inside 3 m, {far:.4} m from 3 to 5 m");
    assert!(near <= 0.01, "median {near} m inside 3 m");
    assert!(far <= 0.03, "median {far} m from 3 to 5 m");
    let fitted = fit_mount(&camera, &profile, &found.points).expect("a fit");
    assert!((fitted.mount.mirror_tilt_deg[0] - 1.6).abs() < 0.1);
    assert!((fitted.mount.mirror_tilt_deg[1] + 1.2).abs() < 0.1);
    let fitted_off = median_map_error(&fitted.map, &exact, 0.4, 5.0);
    println!("fitted to the profile: median {fitted_off:.4} m inside 5 m");
    assert!(fitted_off <= 0.01);
}

#[test]
fn image_without_strip_is_excluded_and_named() {
    let mut images = images();
    let (width_px, height_px) = (images[3].image.width_px, images[3].image.height_px);
    images[3].image.rgb = vec![90; 3 * width_px * height_px];
    let found = calibrate_strip(&camera(), &strip(), &images).expect("a map");
    assert!(found.images[3].left_out.is_some());
    assert_eq!(
        found
            .images
            .iter()
            .filter(|image| image.left_out.is_some())
            .count(),
        1
    );
}

#[test]
fn mask_covers_rods_but_not_floor() {
    let images: Vec<Image> = images().into_iter().map(|image| image.image).collect();
    let camera = camera();
    let mask = vision::calibrate::calibrate_mask(&camera, &images).expect("a mask");
    let free = |u: usize, v: usize| mask[v * camera.width_px + u];
    // A rod extends straight down from the centre.
    assert!((320..460).filter(|&v| free(239, v)).count() < 15);
    let floor = (60..420)
        .step_by(3)
        .flat_map(|v| (60..420).step_by(3).map(move |u| (u, v)));
    let (mut unmasked, mut all) = (0, 0);
    for (u, v) in floor {
        all += 1;
        unmasked += usize::from(free(u, v));
    }
    assert!(
        unmasked * 100 >= all * 94,
        "{unmasked} of {all} floor pixels are unmasked"
    );
}

#[test]
fn first_bar_of_the_wrong_colour_is_noticed() {
    let strip = Strip {
        first_bar: BarColour::White,
        ..strip()
    };
    let error = calibrate_strip(&camera(), &strip, &images()).expect_err("refused");
    let message = error.to_string();
    assert!(message.contains("farther from the robot"), "{message}");
}

#[test]
fn strip_that_begins_elsewhere_than_described_is_noticed() {
    for first_edge in [0.2, 0.6] {
        let strip = Strip {
            first_edge,
            ..strip()
        };
        let error = calibrate_strip(&camera(), &strip, &images()).expect_err("refused");
        let message = error.to_string();
        let wanted = if first_edge < 0.4 {
            "farther from"
        } else {
            "nearer to"
        };
        assert!(message.contains(wanted), "{message}");
    }
}
