//! What does the camera show? Every pixel's ray through the mirror as it is really mounted, into the scene.

mod cast;
mod ground;
mod hall;
mod paint;
mod rays;
mod solids;

use localize::field::Field;
use localize::frame::{At, FieldFrame, Pose};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use vision::optics::{OpticsError, trace_rays};
use vision::robot::BodyConfig;
use vision::{CameraConfig, Mount, Profile};

use crate::film::{Film, FilmConfig, Pcg, RUN, decode};
use crate::light::LightConfig;
use crate::world::RobotState;
use cast::{OwnBody, Stage};
use ground::Ground;
use hall::Hall;
use rays::Rays;

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
    /// Linear light of each ray, one plane a colour.
    light: [Vec<f32>; 3],
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
        Ok(Renderer {
            width_px: camera.width_px,
            height_px: camera.height_px,
            own: OwnBody::new(setting.body, camera.height.unwrap_or(0.0), &rays),
            light_on_floor: setting.light.clone(),
            goals: setting.field.config.clone(),
            light: [0; 3].map(|_| vec![0.0; rays.count()]),
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
        self.ground.shade(scene.pose, &mut self.light);
        self.hall.shade(scene.pose, &self.rays, &mut self.light);
        let stage = Stage::new(scene, &self.goals, &self.hall, &self.light_on_floor);
        stage.draw(&self.rays, &self.ground, &mut self.light);
        self.own.draw(&mut self.light);
        for &(middle, width) in scene.occlusions {
            self.occlude(middle, width);
        }
        rgb.resize(3 * self.width_px * self.height_px, 0);
        self.develop(scene.lamp, film, rgb);
    }

    fn occlude(&mut self, middle: f32, width: f32) {
        let inside = (width / 2.0).min(std::f32::consts::PI).cos();
        let (sin, cos) = middle.sin_cos();
        for run in self.rays.sector(middle - width / 2.0, middle + width / 2.0) {
            for ray in run {
                if cos * self.rays.towards_x[ray] + sin * self.rays.towards_y[ray] >= inside {
                    for (plane, dark) in self.light.iter_mut().zip(HOOD) {
                        plane[ray] = dark;
                    }
                }
            }
        }
    }

    fn develop(&mut self, lamp: [f32; 3], film: &FilmConfig, rgb: &mut [u8]) {
        let (pixels, _) = rgb.as_chunks_mut::<3>();
        let mut bytes = [[0u8; RUN]; 3];
        let mut scale = [0f32; RUN];
        let mut start = 0;
        while start < self.rays.count() {
            let count = RUN.min(self.rays.count() - start);
            let run = start..start + count;
            for (scale, falloff) in scale.iter_mut().zip(&self.falloff[run.clone()]) {
                *scale = 1.0 - film.vignetting * falloff;
            }
            let light = [0, 1, 2].map(|colour| &self.light[colour][run.clone()]);
            self.film.develop(
                film,
                light,
                lamp,
                &scale[..count],
                &mut self.pcg,
                &mut bytes,
            );
            for (i, &pixel) in self.rays.pixel[run].iter().enumerate() {
                pixels[pixel as usize] = [bytes[0][i], bytes[1][i], bytes[2][i]];
            }
            start += count;
        }
        let dark = HOOD.map(|part| [part; RUN]);
        scale.fill(1.0 - film.vignetting);
        for run in self.rays.blank.chunks(RUN) {
            let light = [0, 1, 2].map(|colour| &dark[colour][..run.len()]);
            self.film.develop(
                film,
                light,
                lamp,
                &scale[..run.len()],
                &mut self.pcg,
                &mut bytes,
            );
            for (i, &pixel) in run.iter().enumerate() {
                pixels[pixel as usize] = [bytes[0][i], bytes[1][i], bytes[2][i]];
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
