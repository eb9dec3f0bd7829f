use std::path::Path;

use localize::robot::RobotConfig;
use vision::optics::ray_tracing::trace_rays;
use vision::{Mount, Profile};

use super::*;
use crate::image_sensor::ImageSensorConfig;
use crate::render::light_buffer::LightBuffer;
use crate::render::moving_rays::MovedRays;
use crate::render::row_transform::CameraMotion;
use crate::render::solids::{DrawContext, Outline, Primitive, Solid};

/// Rays of the default camera with the default blur.
fn default_rays() -> SortedRays {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config");
    let robot = RobotConfig::load(&folder.join("robots/default.toml")).expect("a robot");
    let camera = (robot.camera.and_then(|camera| camera.camera())).expect("a camera");
    let profile = Profile::load(&robot.mirror.expect("a mirror").profile).expect("a profile");
    let table = trace_rays(&camera, &profile, &Mount::default()).expect("rays");
    let [centre_u, centre_v] = camera.centre_px;
    SortedRays::new(&table, |pixel| {
        let (column, row) = (pixel % camera.width_px, pixel / camera.width_px);
        let radius = (column as f32 - centre_u).hypot(row as f32 - centre_v);
        ImageSensorConfig::default().blur_at(radius / camera.outer_radius_px.unwrap_or(234.0))
    })
}

/// Red light of each ray after a white solid was drawn on black, on some rays.
fn draw(rays: &SortedRays, solid: &Solid, range: &RayRange) -> Vec<f32> {
    let tile = rays.single_tile();
    let mut moved = MovedRays::new(rays.count());
    moved.set_tile(rays, &tile, &rays.transform);
    let mut light_buffer = LightBuffer::new(rays.count());
    light_buffer.set_tile(&tile);
    let context = DrawContext {
        rays,
        moved: &moved,
        tile: &tile,
        light_direction: [0.0, 1.0],
    };
    Primitive::Solid(*solid).draw(range, &context, &mut light_buffer);
    let [red, _, _] = light_buffer.planes(&tile.rays);
    red.to_vec()
}

#[test]
fn object_reaches_no_ray_outside_its_range_when_the_robot_tilts_and_rocks() {
    let mut rays = default_rays();
    for (tilt, tilt_rate, readout, waste_max) in [
        ([0.0, 0.0], [0.0, 0.0], 0.0, 1.3),
        ([0.03, -0.02], [0.0, 0.0], 0.0, 2.5),
        ([-0.01, 0.02], [1.5, -2.0], 0.015, 5.0),
    ] {
        rays.transform = RowTransform::new(
            &CameraMotion {
                velocity: [1.5, -1.0],
                yaw_rate: 2.0,
                tilt,
                tilt_rate,
                readout,
                ..CameraMotion::default()
            },
            rays.origin_height_max,
        );
        let (mut drawn, mut asked) = (0, 0);
        for (x, y, bottom, top) in [
            (1.5, 0.4, 0.0, 0.8),
            (-2.5, 3.0, 0.03, 0.22),
            (0.5, -6.0, 0.72, 0.8),
            (-9.0, -1.0, 0.0, 1.0),
            (11.0, 4.0, 0.4, 0.6),
        ] {
            let solid = Solid {
                x,
                y,
                bottom,
                top,
                outline: Outline::Circle { radius: 0.25 },
                side: [1.0; 3],
                cap: [1.0; 3],
            };
            let range = Primitive::Solid(solid).ray_range(&rays);
            let all_slopes = RayRange {
                slope_min: f32::NEG_INFINITY,
                slope_max: f32::INFINITY,
                level: [f32::NEG_INFINITY, f32::INFINITY],
                ..range
            };
            let (own, all) = (
                draw(&rays, &solid, &range),
                draw(&rays, &solid, &all_slopes),
            );
            for (ray, (own, all)) in own.iter().zip(&all).enumerate() {
                // Where two parts of the mirror meet, and straight down, a pixel sees all distances at once.
                let slope = rays.slope[ray];
                if rays.slope_spacing[ray] < 0.05 * (1.0 + slope.abs()) {
                    assert!((own - all).abs() < 0.01, "{x} {y}: {slope} {own} {all}");
                    drawn += usize::from(*all > 0.01);
                }
            }
            asked += (rays.runs_in(&range, &rays.single_tile()).flatten()).count();
        }
        // The range is not much larger than the object.
        let waste = asked as f32 / drawn as f32;
        assert!(drawn > 1000 && waste < waste_max, "{waste}");
    }
}
