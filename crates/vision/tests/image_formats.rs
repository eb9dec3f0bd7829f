//! Vision processes grey images, odd sizes, every pixel format and maps with little ground.

use std::path::Path;

use localize::robot::CameraConfig;
use vision::image::{ImageView, PixelFormat};
use vision::{GroundMap, Image, Mount, Profile, Vision, VisionConfig, VisionError, optics};

#[derive(serde::Deserialize)]
struct Robot {
    camera: CameraConfig,
}

const FORMATS: [PixelFormat; 11] = [
    PixelFormat::Rgb8,
    PixelFormat::Bgr8,
    PixelFormat::Grey8,
    PixelFormat::Yuyv,
    PixelFormat::Uyvy,
    PixelFormat::Yuv411,
    PixelFormat::Nv12,
    PixelFormat::BayerRggb,
    PixelFormat::BayerBggr,
    PixelFormat::BayerGrbg,
    PixelFormat::BayerGbrg,
];

fn camera() -> (std::path::PathBuf, CameraConfig) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../samples/sequence");
    let text = std::fs::read_to_string(folder.join("robot.toml")).expect("robot.toml");
    let robot: Robot = toml::from_str(&text).expect("a robot");
    (folder, robot.camera)
}

#[test]
fn lines_are_detected_in_grey_images() {
    let (folder, camera) = camera();
    let profile = Profile::load(&folder.join("mirror.csv")).expect("a profile");
    let map = optics::trace_rays(&camera, &profile, &Mount::default())
        .expect("rays")
        .ground_map();
    let image = Image::load(&folder.join("frames/000.jpg")).expect("an image");
    let mut vision = Vision::new(&map, &camera, 0.125, VisionConfig::default()).expect("vision");
    let coloured = vision
        .process(&image.view())
        .expect("detections")
        .line_points;
    let grey: Vec<u8> = image
        .rgb
        .chunks_exact(3)
        .map(|rgb| (rgb.iter().map(|&c| u32::from(c)).sum::<u32>() / 3) as u8)
        .collect();
    let view = ImageView::packed(image.width_px, image.height_px, PixelFormat::Grey8, &grey);
    let line_points = vision.process(&view).expect("detections").line_points;
    // Most points of the coloured image are detected at the same positions.
    let found = coloured.iter().filter(|point| {
        line_points
            .iter()
            .any(|other| other.point.at.distance_to(point.point.at) < 0.05)
    });
    assert!(2 * found.count() > coloured.len());
}

#[test]
fn vision_accepts_any_size_format_and_map() {
    let (_, camera) = camera();
    let mut processed = 0;
    for (width_px, height_px) in [(1, 1), (2, 3), (9, 7), (33, 64), (61, 45)] {
        let centre_px = [width_px as f32 / 2.0, height_px as f32 / 2.0];
        let camera = CameraConfig {
            width_px,
            height_px,
            centre_px,
            outer_radius_px: None,
            ..camera.clone()
        };
        // Ground in every pixel, in every second or fifth pixel and one corner.
        for every in [1, 2, 5] {
            let place = |index: usize| {
                let (u, v) = (index % width_px, index / width_px);
                let at = [u as f32 - centre_px[0], centre_px[1] - v as f32].map(|a| 0.08 * a);
                if index.is_multiple_of(every) || u < width_px / every && v < height_px / every {
                    at
                } else {
                    [f32::NAN; 2]
                }
            };
            let indices = 0..width_px * height_px;
            let map = GroundMap {
                width_px,
                height_px,
                x: indices.clone().map(|index| place(index)[0]).collect(),
                y: indices.map(|index| place(index)[1]).collect(),
            };
            let Ok(mut vision) = Vision::new(&map, &camera, 0.125, VisionConfig::default()) else {
                continue;
            };
            for format in FORMATS {
                let bytes = format.row_bytes(width_px) * (height_px + height_px.div_ceil(2));
                let data: Vec<u8> = (0..bytes as u32)
                    .map(|index| (index.wrapping_mul(2_654_435_761) >> 24) as u8)
                    .collect();
                match vision.process(&ImageView::packed(width_px, height_px, format, &data)) {
                    Ok(_) => processed += 1,
                    Err(error) => assert!(matches!(error, VisionError::TooDark { .. }), "{error}"),
                }
            }
        }
    }
    assert!(processed > 20, "only {processed} images were processed");
}
