//! What does the camera see? Traces every pixel's ray through the mirror, as it is really mounted, into the scene.

mod draw_list;
mod environment;
mod ground;
mod light_buffer;
mod markings;
mod rays;
mod scene;
mod solids;

use localize::field::Field;
use localize::robot::BodyConfig;
use localize::robot::CameraConfig;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use vision::optics::ray_tracing::{OpticsError, trace_rays};
use vision::{Mount, Profile};

pub use scene::Scene;

use crate::image_sensor::{FilmConfig, ImageSensor, Pcg, RUN_PIXELS, Rgbx};
use crate::light::LightConfig;
use draw_list::{DrawList, OwnBody};
use environment::Environment;
use ground::{Ground, Scratch};
use light_buffer::LightBuffer;
use rays::{SortedRays, Tile};

/// Everything that is constant: optics, field, environment, and light on the floor.
#[derive(Debug, Clone, Copy)]
pub struct RendererConfig<'a> {
    /// The real camera, with its real focal length.
    pub camera: &'a CameraConfig,
    /// The mirror's profile.
    pub profile: &'a Profile,
    /// Real mounting of camera and mirror.
    pub mount: Mount,
    /// Parts of the robot in the view.
    pub body: &'a BodyConfig,
    /// The field.
    pub field: &'a Field,
    /// Light on the field.
    pub light: &'a LightConfig,
    /// Blur of the optics, pixels.
    pub blur_px: f32,
    /// Seed of environment, clutter and noise.
    pub seed: u64,
}

/// Linear light outside the mirror, where the camera's hood is.
const HOOD: [f32; 3] = [0.0005, 0.0010, 0.0035];

/// Renders images of one camera on one field.
pub struct Renderer {
    width_px: usize,
    height_px: usize,
    rays: SortedRays,
    ground: Ground,
    environment: Environment,
    own: OwnBody,
    floor_light: LightConfig,
    field: localize::field::FieldConfig,
    /// Vignetting of each ray: squared distance from the image's centre over that of its corners.
    falloff: Vec<f32>,
    image_sensor: ImageSensor,
    pcg: Pcg,
    light_buffer: LightBuffer,
    /// Pixels of one tile in the order of its rays.
    tile_pixels: Vec<Rgbx>,
    scratch: Scratch,
}

impl Renderer {
    /// Traces the rays and prepares the static scene.
    pub fn new(config: &RendererConfig) -> Result<Self, OpticsError> {
        let camera = config.camera;
        let table = trace_rays(camera, config.profile, &config.mount)?;
        let rays = SortedRays::new(&table, config.blur_px);
        let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
        rng.set_stream(1);
        let environment = Environment::new(config.field, &mut rng);
        let ground = Ground::new(&rays, config.field, config.light);
        let corner2 =
            (camera.width_px as f32 / 2.0).powi(2) + (camera.height_px as f32 / 2.0).powi(2);
        let falloff = rays
            .pixel
            .iter()
            .map(|&pixel| {
                let column = pixel as usize % camera.width_px;
                let row = pixel as usize / camera.width_px;
                let (du, dv) = (
                    column as f32 - camera.width_px as f32 / 2.0,
                    row as f32 - camera.height_px as f32 / 2.0,
                );
                (du * du + dv * dv) / corner2
            })
            .collect();
        let image_sensor = ImageSensor::new(&mut rng);
        let tile_sizes = rays.tiles.iter().map(|tile| tile.rays.len());
        let rays_max = tile_sizes.max().unwrap_or(0);
        Ok(Renderer {
            width_px: camera.width_px,
            height_px: camera.height_px,
            own: OwnBody::new(config.body, camera.height.unwrap_or(0.0), &rays),
            floor_light: config.light.clone(),
            field: config.field.config.clone(),
            light_buffer: LightBuffer::new(rays_max),
            tile_pixels: vec![[0; 4]; rays_max],
            scratch: Scratch::new(),
            pcg: Pcg::new(&mut rng),
            rays,
            ground,
            environment,
            falloff,
            image_sensor,
        })
    }

    /// Columns and rows of the image.
    pub fn size_px(&self) -> (usize, usize) {
        (self.width_px, self.height_px)
    }

    /// Renders into `rgb`: three bytes per pixel, row by row.
    pub fn render(&mut self, scene: &Scene, film: &FilmConfig, rgb: &mut Vec<u8>) {
        rgb.resize(3 * self.width_px * self.height_px, 0);
        let (pixels, _) = rgb.as_chunks_mut::<3>();
        let draw_list = DrawList::new(
            scene,
            &self.field,
            &self.environment,
            &self.floor_light,
            &self.rays,
        );
        let Renderer {
            rays,
            light_buffer,
            scratch,
            ..
        } = self;
        for (index, tile) in rays.tiles.iter().enumerate() {
            light_buffer.set_tile(tile);
            self.ground
                .shade(scene.pose, index, tile, scratch, light_buffer);
            self.environment.shade(scene.pose, rays, tile, light_buffer);
            draw_list.draw(rays, tile, &self.ground, light_buffer);
            self.own.draw(tile, light_buffer);
            for &(middle, width) in scene.occlusions {
                draw_occlusion(middle, width, rays, tile, light_buffer);
            }
            let mut tones = [[0; RUN_PIXELS]; 3];
            let mut scale = [0f32; RUN_PIXELS];
            for start in tile.rays.clone().step_by(RUN_PIXELS) {
                let run = start..(start + RUN_PIXELS).min(tile.rays.end);
                for (scale, falloff) in scale.iter_mut().zip(&self.falloff[run.clone()]) {
                    *scale = 1.0 - film.vignetting * falloff;
                }
                let light = light_buffer.planes(&run).map(|plane| &*plane);
                self.image_sensor.expose(
                    film,
                    light,
                    scene.light_colour,
                    &scale[..run.len()],
                    &mut self.pcg,
                    &mut tones,
                );
                let first = start - tile.rays.start;
                self.image_sensor
                    .tone_map(&tones, &mut self.tile_pixels[first..first + run.len()]);
            }
            // In the order of the image, so that writes are sequential.
            for &(pixel, ray) in &tile.by_pixel {
                let [red, green, blue, _] = self.tile_pixels[ray as usize];
                pixels[pixel as usize] = [red, green, blue];
            }
        }
        // The pixels outside the mirror are dark, with sensor noise.
        let dark = (HOOD, scene.light_colour, 1.0 - film.vignetting);
        self.image_sensor
            .fill_dark(film, dark, &mut self.pcg, &rays.blank, pixels);
    }
}

/// Blackens a sector: centre and full width, radians, robot frame.
fn draw_occlusion(
    middle: f32,
    width: f32,
    rays: &SortedRays,
    tile: &Tile,
    light_buffer: &mut LightBuffer,
) {
    let inside = (width / 2.0).min(std::f32::consts::PI).cos();
    let (sin, cos) = middle.sin_cos();
    let range = rays.range_of_sector(middle - width / 2.0, middle + width / 2.0);
    for run in rays.runs_in(&range, tile) {
        for ray in run {
            if cos * rays.direction_x[ray] + sin * rays.direction_y[ray] >= inside {
                light_buffer.blend(ray, 1.0, HOOD);
            }
        }
    }
}

#[cfg(test)]
mod tests;
