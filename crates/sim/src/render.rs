//! What does the camera show? Every pixel's ray through the mirror as it is really mounted, into the scene.

mod cast;
mod ground;
mod hall;
mod paint;
mod plate;
mod rays;
mod solids;

use localize::field::Field;
use localize::frame::{At, FieldFrame, Pose};
use localize::robot::BodyConfig;
use localize::robot::CameraConfig;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use vision::optics::{OpticsError, trace_rays};
use vision::{Mount, Profile};

use crate::film::{Film, FilmConfig, Pcg, Print, RUN, decode};
use crate::light::LightConfig;
use crate::world::RobotState;
use cast::{OwnBody, Stage};
use ground::{Ground, Scratch};
use hall::Hall;
use plate::Plate;
use rays::{Rays, Tile};

/// What moves: where everything is at the time of an image.
#[derive(Debug, Clone, Copy)]
pub struct Scene<'a> {
    /// Our robot.
    pub pose: Pose,
    /// The others.
    pub robots: &'a [RobotState],
    /// Where the ball touches the ground, its diameter (metres), and its colour (sRGB).
    pub ball: Option<(At<FieldFrame>, f32, [u8; 3])>,
    /// Light: red, green, blue, relative to white light of level 1.
    pub lamp: [f32; 3],
    /// Black sectors: middle and whole width, radians, robot frame.
    pub occlusions: &'a [(f32, f32)],
}

/// What never moves: optics, field, hall, and the light on the floor.
#[derive(Debug, Clone, Copy)]
pub struct Setting<'a> {
    /// The camera as it really is (its focal length included).
    pub camera: &'a CameraConfig,
    /// The mirror's profile.
    pub profile: &'a Profile,
    /// How both are really mounted.
    pub mount: Mount,
    /// What of the robot stands in the view.
    pub body: &'a BodyConfig,
    /// The field.
    pub field: &'a Field,
    /// Where more light falls.
    pub light: &'a LightConfig,
    /// The optics' blur, pixels.
    pub blur_px: f32,
    /// Chance for hall, clutter and noise.
    pub seed: u64,
}

/// Linear light outside the mirror: the camera's hood.
const HOOD: [f32; 3] = [0.0005, 0.0010, 0.0035];

/// Renders images of one camera on one field.
pub struct Renderer {
    width_px: usize,
    height_px: usize,
    rays: Rays,
    ground: Ground,
    hall: Hall,
    own: OwnBody,
    light_on_floor: LightConfig,
    goals: localize::field::FieldConfig,
    /// Vignetting of each ray, and of the pixels without one: one at the image's centre, nought at its corners.
    falloff: Vec<f32>,
    film: Film,
    pcg: Pcg,
    plate: Plate,
    /// One tile's pixels in the order of its rays.
    prints: Vec<Print>,
    scratch: Scratch,
}

impl Renderer {
    /// Traces the mirror and lays out the scene.
    pub fn new(setting: &Setting) -> Result<Self, OpticsError> {
        let camera = setting.camera;
        let table = trace_rays(camera, setting.profile, &setting.mount)?;
        let rays = Rays::new(&table, setting.blur_px);
        let mut rng = ChaCha8Rng::seed_from_u64(setting.seed);
        rng.set_stream(1);
        let hall = Hall::new(setting.field, &mut rng);
        let ground = Ground::new(&rays, setting.field, setting.light);
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
        let film = Film::new(&mut rng);
        let most_rays = rays.tiles.iter().map(|tile| tile.rays.len()).max();
        let most_rays = most_rays.unwrap_or(0);
        Ok(Renderer {
            width_px: camera.width_px,
            height_px: camera.height_px,
            own: OwnBody::new(setting.body, camera.height.unwrap_or(0.0), &rays),
            light_on_floor: setting.light.clone(),
            goals: setting.field.config.clone(),
            plate: Plate::new(most_rays),
            prints: vec![[0; 4]; most_rays],
            scratch: Scratch::new(),
            pcg: Pcg::new(&mut rng),
            rays,
            ground,
            hall,
            falloff,
            film,
        })
    }

    /// Columns and rows of the image.
    pub fn size_px(&self) -> (usize, usize) {
        (self.width_px, self.height_px)
    }

    /// Renders into `rgb`: three bytes a pixel, row by row.
    pub fn render(&mut self, scene: &Scene, film: &FilmConfig, rgb: &mut Vec<u8>) {
        rgb.resize(3 * self.width_px * self.height_px, 0);
        let (pixels, _) = rgb.as_chunks_mut::<3>();
        let stage = Stage::new(
            scene,
            &self.goals,
            &self.hall,
            &self.light_on_floor,
            &self.rays,
        );
        let Renderer {
            rays,
            plate,
            scratch,
            ..
        } = self;
        for (index, tile) in rays.tiles.iter().enumerate() {
            plate.hold(tile);
            self.ground.shade(scene.pose, index, tile, scratch, plate);
            self.hall.shade(scene.pose, rays, tile, plate);
            stage.draw(rays, tile, &self.ground, plate);
            self.own.draw(tile, plate);
            for &(middle, width) in scene.occlusions {
                occlude(middle, width, rays, tile, plate);
            }
            let mut tones = [[0; RUN]; 3];
            let mut scale = [0f32; RUN];
            for start in tile.rays.clone().step_by(RUN) {
                let run = start..(start + RUN).min(tile.rays.end);
                for (scale, falloff) in scale.iter_mut().zip(&self.falloff[run.clone()]) {
                    *scale = 1.0 - film.vignetting * falloff;
                }
                let light = plate.run(&run).map(|plane| &*plane);
                self.film.develop(
                    film,
                    light,
                    scene.lamp,
                    &scale[..run.len()],
                    &mut self.pcg,
                    &mut tones,
                );
                let first = start - tile.rays.start;
                self.film
                    .print(&tones, &mut self.prints[first..first + run.len()]);
            }
            // In the image's own order: what is written together lies together.
            for &(pixel, ray) in &tile.by_pixel {
                let [red, green, blue, _] = self.prints[ray as usize];
                pixels[pixel as usize] = [red, green, blue];
            }
        }
        // The pixels around the mirror: dark, with the sensor's noise.
        let dark = (HOOD, scene.lamp, 1.0 - film.vignetting);
        self.film
            .fill(film, dark, &mut self.pcg, &rays.blank, pixels);
    }
}

/// Blackens a sector: its middle and whole width, radians.
fn occlude(middle: f32, width: f32, rays: &Rays, tile: &Tile, plate: &mut Plate) {
    let inside = (width / 2.0).min(std::f32::consts::PI).cos();
    let (sin, cos) = middle.sin_cos();
    let reach = rays.sector(middle - width / 2.0, middle + width / 2.0);
    for run in rays.within(&reach, tile) {
        for ray in run {
            if cos * rays.towards_x[ray] + sin * rays.towards_y[ray] >= inside {
                plate.blend(ray, 1.0, HOOD);
            }
        }
    }
}

/// Linear colours of an sRGB triple.
fn linear(colour: [u8; 3]) -> [f32; 3] {
    colour.map(decode)
}

#[cfg(test)]
mod tests;
