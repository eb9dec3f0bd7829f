//! What does the camera see? Traces every pixel's ray through the mirror, as it is really mounted, into the scene.

mod cables;
mod draw_list;
mod environment;
mod ground;
mod lanes;
mod light_buffer;
mod markings;
mod motion_blur;
mod moving_rays;
mod own_body;
mod rays;
mod row_transform;
mod scatter;
mod scene;
mod slope_reach;
mod solids;

use localize::field::Field;
use localize::robot::BodyConfig;
use localize::robot::CameraConfig;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use vision::optics::ray_tracing::{OpticsError, trace_rays};
use vision::{Mount, Profile};

pub use row_transform::CameraMotion;
pub(crate) use row_transform::level_from_body;
pub use scene::{Scene, SceneBall};

use crate::environment::EnvironmentConfig;
use crate::image_sensor::{
    ImageSensor, ImageSensorConfig, JpegCompression, Pcg, Raw, SiteGains, TONES, demosaic_row,
    site_colours,
};
use crate::light::LightConfig;
use crate::sector::Sector;
use draw_list::DrawList;
use environment::Environment;
use ground::{Ground, Scratch};
use light_buffer::LightBuffer;
use motion_blur::{LightPixel, MotionBlur};
use moving_rays::MovedRays;
use own_body::OwnBody;
use rays::SortedRays;
use row_transform::RowTransform;
use scatter::Scatter;

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
    /// Floor, windows and cables.
    pub environment: &'a EnvironmentConfig,
    /// The camera; its blur and defocus are those of all images.
    pub image_sensor: &'a ImageSensorConfig,
    /// Seed of environment, clutter and noise.
    pub seed: u64,
}

/// Linear light outside the mirror, where the camera's hood is.
const HOOD: [f32; 3] = [0.0005, 0.0010, 0.0035];

/// A pixel that shows the hood.
fn hood() -> LightPixel {
    let [red, green, blue] = HOOD.map(tones);
    [red, green, blue, 0]
}

/// Renders images of one camera on one field.
pub struct Renderer {
    width_px: usize,
    height_px: usize,
    rays: SortedRays,
    ground: Ground,
    environment: Environment,
    own: OwnBody,
    motion_blur: MotionBlur,
    floor_light: LightConfig,
    field: localize::field::FieldConfig,
    light_buffer: LightBuffer,
    moved: MovedRays,
    scratch: Scratch,
    /// Linear light of one tile, by ray.
    tile_light: Vec<LightPixel>,
    /// Linear light of the scene, and smeared by motion.
    sharp: Vec<LightPixel>,
    blurred: Vec<LightPixel>,
    development: Development,
}

impl Renderer {
    /// Traces the rays and prepares the static scene.
    pub fn new(config: &RendererConfig) -> Result<Self, OpticsError> {
        let camera = config.camera;
        let (width_px, height_px) = (camera.width_px, camera.height_px);
        let table = trace_rays(camera, config.profile, &config.mount)?;
        let [centre_u, centre_v] = camera.centre_px;
        let rim = camera
            .outer_radius_px
            .unwrap_or(width_px.min(height_px) as f32 / 2.0);
        let rays = SortedRays::new(&table, |pixel| {
            let (column, row) = ((pixel % width_px) as f32, (pixel / width_px) as f32);
            let radius = (column - centre_u).hypot(row - centre_v);
            config.image_sensor.blur_at(radius / rim)
        });
        let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
        rng.set_stream(1);
        let environment = Environment::new(config.field, config.environment, &mut rng);
        let (half_x, half_y) = config.field.carpet_half_extent();
        let mut cable_rng = ChaCha8Rng::seed_from_u64(config.seed);
        cable_rng.set_stream(4);
        let cables = cables::lay_cables(config.environment, [half_x, half_y], &mut cable_rng);
        let ground = Ground::new(
            &rays,
            config.field,
            config.light,
            (config.environment, &cables),
        );
        let tile_sizes = rays.tiles.iter().map(|tile| tile.rays.len());
        let rays_max = tile_sizes.max().unwrap_or(0);
        // Nothing else writes the pixels outside the mirror.
        Ok(Renderer {
            width_px,
            height_px,
            own: OwnBody::new(config.body, camera.height.unwrap_or(0.0), &rays),
            motion_blur: MotionBlur::new(&table),
            floor_light: config.light.clone(),
            field: config.field.config.clone(),
            light_buffer: LightBuffer::new(rays_max),
            moved: MovedRays::new(rays_max),
            scratch: Scratch::new(),
            tile_light: vec![[0; 4]; rays_max],
            sharp: vec![hood(); width_px * height_px],
            blurred: Vec::new(),
            development: Development::new(width_px, height_px, &mut rng),
            rays,
            ground,
            environment,
        })
    }

    /// Columns and rows of the image.
    pub fn size_px(&self) -> (usize, usize) {
        (self.width_px, self.height_px)
    }

    /// Renders into `rgb`: three bytes per pixel, row by row.
    pub fn render(&mut self, scene: &Scene, image_sensor: &ImageSensorConfig, rgb: &mut Vec<u8>) {
        rgb.resize(3 * self.width_px * self.height_px, 0);
        let (pixels, _) = rgb.as_chunks_mut::<3>();
        self.draw_scene(scene);
        let smeared = self
            .motion_blur
            .apply(&scene.motion, &self.sharp, &mut self.blurred);
        let image = if smeared {
            // The rim moves with the camera: nothing smears over it.
            for run in &self.rays.blank {
                self.blurred[run.clone()].fill(hood());
            }
            &mut self.blurred
        } else {
            &mut self.sharp
        };
        self.own.draw(image);
        for sector in scene.occluded_sectors {
            draw_occlusion(sector, &self.rays, image);
        }
        self.development
            .develop(image_sensor, scene.light_colour, image, pixels);
    }

    /// The linear light of each pixel.
    fn draw_scene(&mut self, scene: &Scene) {
        self.rays.transform = RowTransform::new(&scene.motion, self.rays.origin_height_max);
        let draw_list = DrawList::new(
            scene,
            &self.field,
            &self.environment,
            &self.floor_light,
            &self.rays,
        );
        let Renderer {
            rays,
            ground,
            light_buffer,
            moved,
            scratch,
            ..
        } = self;
        for (index, tile) in rays.tiles.iter().enumerate() {
            light_buffer.set_tile(tile);
            moved.set_tile(rays, tile, &rays.transform);
            ground.shade(scene.pose, index, tile, moved, scratch, light_buffer);
            self.environment
                .shade(scene.pose, rays, tile, moved, light_buffer);
            draw_list.draw(rays, tile, moved, light_buffer);
            let [red, green, blue] = light_buffer.planes(&tile.rays);
            let planes = red.iter().zip(green).zip(blue);
            for (pixel, ((red, green), blue)) in self.tile_light.iter_mut().zip(planes) {
                *pixel = [tones(*red), tones(*green), tones(*blue), 0];
            }
            tile.write(&self.tile_light, &mut self.sharp);
        }
    }
}

/// Linear light as a fixed-point number.
#[inline(always)]
fn tones(light: f32) -> u16 {
    // Adding 2²³ leaves the rounded value in the lowest bits, without the NaN check of a cast.
    ((light * TONES as f32).clamp(0.0, 65_535.0) + 8_388_608.0).to_bits() as u16
}

/// From light to bytes: scattering, exposure, mosaic, tone curve, compression.
struct Development {
    width_px: usize,
    scatter: Scatter,
    image_sensor: ImageSensor,
    pcg: Pcg,
    raw: Raw,
    /// All bits set in even columns, none in odd ones.
    even: Vec<u16>,
    /// Squared distance from the image's centre over that of its corners, by columns and by rows.
    falloff: [Vec<f32>; 2],
    light_row: Vec<f32>,
    scale_row: Vec<f32>,
    tone_rows: [Vec<u16>; 3],
    jpeg: Option<JpegCompression>,
}

impl Development {
    fn new(width_px: usize, height_px: usize, rng: &mut ChaCha8Rng) -> Self {
        let (middle_u, middle_v) = (width_px as f32 / 2.0, height_px as f32 / 2.0);
        let corner2 = middle_u * middle_u + middle_v * middle_v;
        let falloff = |count: usize, middle: f32| {
            (0..count)
                .map(|pixel| (pixel as f32 - middle).powi(2) / corner2)
                .collect()
        };
        Development {
            width_px,
            scatter: Scatter::default(),
            image_sensor: ImageSensor::new(width_px, rng),
            pcg: Pcg::new(rng),
            raw: Raw::new(width_px, height_px),
            even: (0..width_px)
                .map(|column| if column % 2 == 0 { u16::MAX } else { 0 })
                .collect(),
            falloff: [falloff(width_px, middle_u), falloff(height_px, middle_v)],
            light_row: vec![0.0; width_px],
            scale_row: vec![0.0; width_px],
            tone_rows: [0; 3].map(|_| vec![0; width_px]),
            jpeg: None,
        }
    }

    fn develop(
        &mut self,
        image_sensor: &ImageSensorConfig,
        light_colour: [f32; 3],
        image: &[LightPixel],
        pixels: &mut [[u8; 3]],
    ) {
        let scattered = image_sensor.bloom + image_sensor.glare > 0.0;
        if scattered {
            self.scatter.update(image, self.width_px, image_sensor);
        }
        let width_px = self.width_px;
        if image_sensor.bayer {
            let gains = [0, 1]
                .map(|row| SiteGains::new(image_sensor, light_colour, site_colours(row), width_px));
            for (row, light) in image.chunks(width_px).enumerate() {
                self.set_scale(image_sensor, row);
                self.set_light(image_sensor, scattered, row, light, site_colours(row));
                self.image_sensor.expose_row(
                    image_sensor.haze,
                    &gains[row % 2],
                    &self.light_row,
                    &self.scale_row,
                    &mut self.pcg,
                    self.raw.row_mut(row),
                );
            }
            self.raw.fill_border();
            for (row, pixels) in pixels.chunks_mut(width_px).enumerate() {
                let planes = self.tone_rows.each_mut().map(|plane| &mut plane[..]);
                demosaic_row(row, self.raw.neighbourhood(row), &self.even, planes);
                let tones = self.tone_rows.each_ref().map(|plane| &plane[..]);
                self.image_sensor.tone_map(tones, pixels);
            }
        } else {
            let gains = [0, 1, 2]
                .map(|colour| SiteGains::new(image_sensor, light_colour, [colour; 2], width_px));
            let rows = image.chunks(width_px).zip(pixels.chunks_mut(width_px));
            for (row, (light, pixels)) in rows.enumerate() {
                self.set_scale(image_sensor, row);
                for (colour, gains) in gains.iter().enumerate() {
                    self.set_light(image_sensor, scattered, row, light, [colour; 2]);
                    self.image_sensor.expose_row(
                        image_sensor.haze,
                        gains,
                        &self.light_row,
                        &self.scale_row,
                        &mut self.pcg,
                        &mut self.tone_rows[colour],
                    );
                }
                let tones = self.tone_rows.each_ref().map(|plane| &plane[..]);
                self.image_sensor.tone_map(tones, pixels);
            }
        }
        self.compress(image_sensor.jpeg_quality, pixels);
    }

    /// Vignetting of a row.
    fn set_scale(&mut self, image_sensor: &ImageSensorConfig, row: usize) {
        let [columns, rows] = &self.falloff;
        for (scale, column) in self.scale_row.iter_mut().zip(columns) {
            *scale = 1.0 - image_sensor.vignetting * (column + rows[row]);
        }
    }

    /// Light on a row of pixels that measure `colours` in even and odd columns.
    fn set_light(
        &mut self,
        image_sensor: &ImageSensorConfig,
        scattered: bool,
        row: usize,
        light: &[LightPixel],
        [even, odd]: [usize; 2],
    ) {
        let direct = 1.0 - image_sensor.bloom - image_sensor.glare;
        match (even, odd) {
            (0, 1) => extract_colours::<0, 1>(light, direct, &mut self.light_row),
            (1, 2) => extract_colours::<1, 2>(light, direct, &mut self.light_row),
            (0, _) => extract_colours::<0, 0>(light, direct, &mut self.light_row),
            (1, _) => extract_colours::<1, 1>(light, direct, &mut self.light_row),
            _ => extract_colours::<2, 2>(light, direct, &mut self.light_row),
        }
        if scattered {
            self.scatter.add_to(row, [even, odd], &mut self.light_row);
        }
    }

    fn compress(&mut self, quality: u8, pixels: &mut [[u8; 3]]) {
        if quality == 0 {
            return;
        }
        let jpeg = match &mut self.jpeg {
            Some(jpeg) if jpeg.quality() == quality => jpeg,
            other => other.insert(JpegCompression::new(quality)),
        };
        jpeg.compress(pixels, self.width_px);
    }
}

/// The light of a row's pixels in colour `EVEN` or `ODD`, by column.
fn extract_colours<const EVEN: usize, const ODD: usize>(
    light: &[LightPixel],
    direct: f32,
    out: &mut [f32],
) {
    let (pairs, rest) = light.as_chunks::<2>();
    let (out_pairs, out_rest) = out.as_chunks_mut::<2>();
    for (out, [even, odd]) in out_pairs.iter_mut().zip(pairs) {
        *out = [direct * f32::from(even[EVEN]), direct * f32::from(odd[ODD])];
    }
    for (out, pixel) in out_rest.iter_mut().zip(rest) {
        *out = direct * f32::from(pixel[EVEN]);
    }
}

/// Blackens a sector.
fn draw_occlusion(&Sector { centre, width }: &Sector, rays: &SortedRays, image: &mut [LightPixel]) {
    let inside = (width / 2.0).min(std::f32::consts::PI).cos();
    let (sin, cos) = centre.sin_cos();
    let range = rays.range_of_sector(centre - width / 2.0, centre + width / 2.0);
    for tile in &rays.tiles {
        for ray in rays.runs_in(&range, tile).flatten() {
            if cos * rays.direction_x[ray] + sin * rays.direction_y[ray] >= inside {
                image[rays.pixel[ray] as usize] = hood();
            }
        }
    }
}

#[cfg(test)]
mod tests;
