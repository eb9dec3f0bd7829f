//! How fast is the simulator? One image of the demo with nine robots, and seconds of scenarios.

use std::hint::black_box;
use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context, Result};
use localize::robot::BodyConfig;
use localize::robot::CameraConfig;
use localize::world::TeamColour;
use localize::{At, Field, Pose};
use sim::Scenario;
use sim::render::{CameraMotion, Renderer, RendererConfig, Scene, SceneBall};
use sim::world::RobotState;
use vision::Profile;

use super::measure::{BenchFigure, Figures, REPEATS};
use pipeline::paths;
use pipeline::sample::Sample;
use pipeline::setup::Setup;
use pipeline::simulation::Simulation;
use pipeline::{Pipeline, PipelineConfig};

/// Driving at 1.5 m/s and 60°/s with a tilted body, during the shutter time of the default camera.
const DRIVING: CameraMotion = CameraMotion {
    velocity: [1.4, 0.5],
    yaw_rate: 1.05,
    tilt: [0.006, -0.004],
    tilt_rate: [0.05, 0.02],
    readout: 0.0,
    shutter: 0.008,
};

/// Figures of `measure_rendering`.
pub(super) const RENDERING_NAMES: &[&str] = &["render_480_nine_robots"];

/// Figures of `measure_simulation`.
pub(super) const SIMULATION_NAMES: &[&str] = &["simulation_30_hz", "game_all_cores"];

/// The demo's robot with nine robots from 1 to 9 m around it, the ball at 2 m, a goal 5 m ahead.
pub(super) struct DemoScene {
    scenario: Scenario,
    pub(super) field: Field,
    pub(super) camera: CameraConfig,
    pub(super) mirror: PathBuf,
    body: BodyConfig,
    robots: Vec<RobotState>,
}

impl DemoScene {
    /// Loads the scene with a square camera of `side_px` pixels that has the same view as the demo's.
    pub(super) fn load(side_px: usize) -> Result<Self> {
        let (scenario, robot) =
            Scenario::load(&paths::find_resource("config/scenarios/demo.toml")?)?;
        let field = Field::load(&robot.field)?;
        let own = robot
            .camera
            .and_then(|camera| camera.camera())
            .context("the demo's robot has no camera")?;
        let scale = side_px as f32 / own.width_px as f32;
        let camera = CameraConfig {
            width_px: side_px,
            height_px: side_px,
            focal_px: own.focal_px.map(|focal| focal * scale),
            // Integers are pixel centres.
            centre_px: own.centre_px.map(|centre| (centre + 0.5) * scale - 0.5),
            outer_radius_px: own.outer_radius_px.map(|radius| radius * scale),
            ..own
        };
        let mirror = robot.mirror.context("the demo's robot has no mirror")?;
        let robots = (0..9u8)
            .map(|index| {
                let (sin, cos) = (0.7 * f32::from(index)).sin_cos();
                let distance = 1.0 + f32::from(index);
                let pose = Pose::new(4.0 - distance * cos, distance * sin * 0.8, f32::from(index));
                let team = if index % 2 == 0 {
                    TeamColour::Cyan
                } else {
                    TeamColour::Magenta
                };
                RobotState {
                    pose,
                    velocity: [0.0; 2],
                    yaw_rate: 0.0,
                    team,
                }
            })
            .collect();
        Ok(DemoScene {
            scenario,
            field,
            camera,
            mirror: mirror.profile,
            body: robot.body.unwrap_or_default(),
            robots,
        })
    }

    pub(super) fn renderer(&self) -> Result<Renderer> {
        Ok(Renderer::new(&RendererConfig {
            camera: &self.camera,
            profile: &Profile::load(&self.mirror)?,
            mount: self.scenario.mount,
            body: &self.body,
            field: &self.field,
            light: &self.scenario.light,
            environment: &self.scenario.environment,
            image_sensor: &self.scenario.image_sensor,
            seed: self.scenario.seed,
        })?)
    }

    /// Renders the robot's image at a heading (radians).
    pub(super) fn render(&self, renderer: &mut Renderer, heading: f32, rgb: &mut Vec<u8>) {
        let ball = &self.scenario.ball;
        let scene = Scene {
            pose: Pose::new(4.0, 0.3, heading),
            motion: DRIVING,
            robots: &self.robots,
            ball: Some(SceneBall {
                at: At::new(2.5, 1.5),
                height: 0.0,
                diameter: ball.diameter,
                colour: ball.colour,
            }),
            ..Scene::default()
        };
        renderer.render(&scene, &self.scenario.image_sensor, rgb);
    }
}

/// Times one image of the scene.
pub(super) fn measure_rendering(figures: &mut Figures) -> Result<()> {
    let demo = DemoScene::load(480)?;
    let mut renderer = demo.renderer()?;
    let (mut heading, mut rgb) = (0.0f32, Vec::new());
    figures.time_calls("render_480_nine_robots", "<= 2", REPEATS, || {
        heading += 0.1;
        demo.render(&mut renderer, heading, &mut rgb);
        black_box(&rgb);
    });
    Ok(())
}

/// Times the demo on one core, and a full game as `sim` runs it: the simulator prefetches in its own thread.
pub(super) fn measure_simulation(figures: &mut Figures) -> Result<()> {
    let load = |name| Simulation::load(&paths::find_resource(name)?, None, Some(f64::MAX));
    let demo = load("config/scenarios/demo.toml")?;
    let mut setup = demo.setup()?;
    // Without exposure control nobody has to pass commands to the camera.
    setup.robot.exposure = None;
    figures.push(BenchFigure::new(
        "simulation_30_hz",
        real_time_factor(demo, &setup)?,
        "x real time",
        ">= 15",
    ));
    let game = load("config/scenarios/game_18x12.toml")?;
    let mut setup = game.setup()?;
    setup.robot.exposure = None;
    figures.push(BenchFigure::new(
        "game_all_cores",
        real_time_factor(game.prefetch()?, &setup)?,
        "x real time",
        ">= 8",
    ));
    Ok(())
}

fn real_time_factor(mut source: impl Iterator<Item = Sample>, setup: &Setup) -> Result<f64> {
    let mut pipeline = Pipeline::new(setup, &PipelineConfig::default())?;
    let mut next = || {
        source
            .find_map(|sample| pipeline.process_sample(sample))
            .context("the scenario ends before its first image")
    };
    // The first image builds tables and learns colours.
    let first = next()?.stamp;
    let started = Instant::now();
    for _ in 0..300 {
        next()?;
    }
    Ok((next()?.stamp - first) / started.elapsed().as_secs_f64())
}
