//! Which parts of the robot itself are in the view? Body, camera box and rods, which move with the camera.

use localize::robot::BodyConfig;

use super::draw_list::linear;
use super::light_buffer::LightBuffer;
use super::motion_blur::LightPixel;
use super::moving_rays::MovedRays;
use super::rays::SortedRays;
use super::row_transform::RowTransform;
use super::solids::{DrawContext, Outline, Primitive, Solid};
use crate::image_sensor::TONES;

/// The robot's own parts in the view: equal in every image, so they are drawn once,
/// and never smeared by motion.
pub(super) struct OwnBody {
    /// Pixels that show it, the visible share of the scene, and the added light.
    overlay: Vec<(u32, f32, [f32; 3])>,
}

/// Height of the rods, metres: more than any mirror's.
const ROD_HEIGHT: f32 = 3.0;

impl OwnBody {
    pub(super) fn new(body: &BodyConfig, camera_height: f32, rays: &SortedRays) -> Self {
        let solids = own_solids(body, camera_height);
        let (tile, light_direction) = (rays.single_tile(), [0.0, 1.0]);
        let mut moved = MovedRays::new(rays.count());
        moved.set_tile(rays, &tile, &RowTransform::default());
        let context = DrawContext {
            rays,
            moved: &moved,
            tile: &tile,
            light_direction,
        };
        // The difference between drawing over white and over black is the visible share of the scene.
        let mut over = [0.0, 1.0].map(|level| {
            let mut light_buffer = LightBuffer::new(rays.count());
            light_buffer.set_tile(&tile);
            for plane in light_buffer.planes(&tile.rays) {
                plane.fill(level);
            }
            for solid in &solids {
                let primitive = Primitive::Solid(*solid);
                primitive.draw(&primitive.ray_range(rays), &context, &mut light_buffer);
            }
            light_buffer
        });
        let [black, white] = over
            .each_mut()
            .map(|light_buffer| light_buffer.planes(&tile.rays));
        let overlay = (0..rays.count())
            .filter_map(|ray| {
                let left = white[0][ray] - black[0][ray];
                let adds = [0, 1, 2].map(|colour| black[colour][ray]);
                (left < 0.999).then_some((rays.pixel[ray], left, adds))
            })
            .collect();
        OwnBody { overlay }
    }

    /// Draws it over an image.
    pub(super) fn draw(&self, image: &mut [LightPixel]) {
        for (pixel, left, adds) in &self.overlay {
            let pixel = &mut image[*pixel as usize];
            for (light, adds) in pixel.iter_mut().zip(adds) {
                *light = (f32::from(*light) * left + adds * TONES as f32) as u16;
            }
        }
    }
}

fn own_solids(body: &BodyConfig, camera_height: f32) -> Vec<Solid> {
    let solid = |x: f32, y: f32, top: f32, outline: Outline, colour: [u8; 3], cap: [u8; 3]| Solid {
        x,
        y,
        bottom: 0.0,
        top,
        outline,
        side: linear(colour),
        cap: linear(cap),
    };
    let square = |half: f32| Outline::Box {
        half: [half; 2],
        cos: 1.0,
        sin: 0.0,
    };
    let round = |radius: f32| Outline::Circle { radius };
    let mut solids = Vec::new();
    if body.radius > 0.0 && body.height > 0.0 {
        solids.push(solid(
            0.0,
            0.0,
            body.height,
            round(body.radius),
            [30, 30, 33],
            [52, 53, 58],
        ));
    }
    if body.camera_side > 0.0 {
        let half = body.camera_side / 2.0;
        solids.push(solid(
            0.0,
            0.0,
            camera_height,
            square(half),
            [70, 70, 74],
            [120, 118, 122],
        ));
        solids.push(solid(
            0.0,
            0.0,
            camera_height + 0.002,
            round(half * 0.45),
            [40, 40, 44],
            [28, 26, 30],
        ));
    }
    if body.rod_radius > 0.0 {
        for angle_deg in &body.rod_angles_deg {
            let (sin, cos) = angle_deg.to_radians().sin_cos();
            let (x, y) = (body.rod_distance * cos, body.rod_distance * sin);
            solids.push(solid(
                x,
                y,
                ROD_HEIGHT,
                round(body.rod_radius),
                [22, 22, 24],
                [22, 22, 24],
            ));
        }
    }
    solids
}
