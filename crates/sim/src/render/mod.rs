//! What does the camera see? Traces every pixel's ray through the mirror, as it is really mounted, into the scene.

mod blocks;
mod cables;
mod culling;
mod development;
mod draw_list;
mod environment;
mod field_from_robot;
mod floor;
mod floor_light;
mod image;
mod lanes;
mod lattice;
mod motion_blur;
mod moving_rays;
mod own_body;
mod paint;
mod panels;
mod row_transform;
mod scatter;
mod scene;
mod shadows;
mod solids;
mod spacing;
mod spheres;
mod stroke_culling;
mod strokes;
mod walls;

use std::ops::Range;

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
use crate::image_sensor::ImageSensorConfig;
use crate::light::LightConfig;
use crate::sector::Sector;
use blocks::Blocks;
use culling::ReachMargins;
use development::Development;
use draw_list::DrawList;
use environment::Environment;
use field_from_robot::FieldFromRobot;
use floor::{Floor, FloorView};
use floor_light::FloorLight;
use image::{LightImage, hood};
use lanes::LANES;
use lattice::Lattice;
use motion_blur::MotionBlur;
use moving_rays::MovedBlock;
use own_body::OwnBody;
use row_transform::RowTransform;

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

/// Renders images of one camera on one field.
pub struct Renderer {
    size_px: [usize; 2],
    blocks: Blocks,
    lattice: Lattice,
    floor: Floor,
    floor_light: FloorLight,
    environment: Environment,
    light: LightConfig,
    field: localize::field::FieldConfig,
    moved: MovedBlock,
    /// Objects that the current block may see.
    found: Vec<u32>,
    /// Light of the scene.
    image: LightImage,
    /// Pixels without a ray in blocks that have rays.
    rim: Vec<Range<usize>>,
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
        let lattice = Lattice::new(&table);
        let view = |column: usize, row: usize| lattice.rest_view(column, row);
        let blocks = Blocks::new(&table, view, |pixel| {
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
        let camera_height = camera.height.unwrap_or(0.0);
        let own = OwnBody::new(config.body, camera_height, &blocks, &lattice, height_px);
        let image = LightImage::new(width_px, height_px);
        Ok(Renderer {
            size_px: [width_px, height_px],
            lattice,
            floor: Floor::new(
                config.field,
                config.environment.floor_rgb,
                &cables,
                blocks.footprint(),
            ),
            floor_light: FloorLight::new(config.field, config.light, config.environment),
            light: config.light.clone(),
            field: config.field.config.clone(),
            moved: MovedBlock::new(),
            found: Vec::new(),
            rim: blocks.rim(image.stride),
            image,
            development: Development::new(
                [width_px, height_px],
                MotionBlur::new(&table),
                own,
                blocks.blank.clone(),
                &mut rng,
            ),
            blocks,
            environment,
        })
    }

    /// Columns and rows of the image.
    pub fn size_px(&self) -> (usize, usize) {
        (self.size_px[0], self.size_px[1])
    }

    /// Renders into `rgb`: three bytes per pixel, row by row.
    pub fn render(&mut self, scene: &Scene, image_sensor: &ImageSensorConfig, rgb: &mut Vec<u8>) {
        rgb.resize(3 * self.size_px[0] * self.size_px[1], 0);
        let (pixels, _) = rgb.as_chunks_mut::<3>();
        self.draw_scene(scene);
        self.development.clear_occluded();
        for sector in scene.occluded_sectors {
            self.occlude(sector);
        }
        for run in &self.rim {
            self.image.fill(run.clone(), hood());
        }
        self.development.develop(
            &self.image,
            &scene.motion,
            image_sensor,
            scene.light_colour,
            pixels,
        );
    }

    /// Draws the light of each block.
    fn draw_scene(&mut self, scene: &Scene) {
        let pose = FieldFromRobot::new(scene.pose);
        let origins = &self.blocks.origins;
        let transform = RowTransform::new(&scene.motion, origins.height_max);
        let margins = ReachMargins::new(origins, &transform);
        let draw_list = DrawList::new(scene, &self.field, &self.environment, &self.light, &margins);
        self.lattice.update(&transform, pose, &self.floor_light);
        self.floor.merge_cables(pose);
        let Renderer {
            lattice,
            floor,
            environment,
            moved,
            found,
            ..
        } = self;
        let mut lit = [[[0.0; LANES]; LANES]; 2];
        for (block, rays) in self.blocks.blocks.iter().zip(&self.blocks.rays) {
            let view = lattice.view(block);
            let [hall, field_walls] = environment.visible_walls(pose, &view, &margins);
            let mut light = [[[0.0; LANES]; LANES]; 3];
            moved.clear();
            // Rays above the horizon meet a wall.
            let sees_floor = !(hall && view.slope[0] >= 0.0);
            if sees_floor {
                lattice.light(block, self.floor_light.is_glossy(), &mut lit);
                match floor.view(pose, &view) {
                    FloorView::Bare { on_carpet } => floor.shade_bare(on_carpet, &lit, &mut light),
                    FloorView::Edges { on_carpet } => {
                        let rays = moved.of(block, rays, &transform, self.size_px[1]);
                        floor.shade_edges(pose, on_carpet, rays, &lit, &mut light);
                    }
                }
            }
            if hall {
                let rays = moved.of(block, rays, &transform, self.size_px[1]);
                environment.draw_walls(pose, rays, &mut light);
            }
            if field_walls {
                let rays = moved.of(block, rays, &transform, self.size_px[1]);
                environment.draw_field_walls(pose, rays, &mut light);
            }
            found.clear();
            if sees_floor {
                draw_list.shadow_culling.find(&view, found);
            }
            for shadow in &*found {
                let rays = moved.of(block, rays, &transform, self.size_px[1]);
                draw_list.shadows[*shadow as usize].draw(rays, &mut light);
            }
            draw_list.primitive_culling.find(&view, found);
            for primitive in &*found {
                let rays = moved.of(block, rays, &transform, self.size_px[1]);
                let index = *primitive as usize;
                let rows = rays.rows_between(draw_list.slopes[index]);
                let (_, primitive) = &draw_list.primitives[index];
                primitive.draw(rays, rows, draw_list.light_direction, &mut light);
            }
            self.image.write([block.column, block.row], &light);
        }
    }

    /// Blackens a sector.
    fn occlude(&mut self, &Sector { centre, width }: &Sector) {
        let inside = (width / 2.0).min(std::f32::consts::PI).cos();
        let (sin, cos) = centre.sin_cos();
        for (block, rays) in self.blocks.blocks.iter().zip(&self.blocks.rays) {
            let [x, y] = &rays.direction;
            for lane in 0..LANES * LANES {
                let (row, column) = (lane / LANES, lane % LANES);
                if cos * x[row][column] + sin * y[row][column] >= inside {
                    let (row, column) = (block.row * LANES + row, block.column * LANES + column);
                    let pixel = row * self.image.stride + column;
                    self.image.fill(pixel..pixel + 1, hood());
                    self.development.occlude(column, row);
                }
            }
        }
    }
}

#[cfg(test)]
mod block_tests;
#[cfg(test)]
mod tests;
