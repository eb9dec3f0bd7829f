//! How long do an image and a simulated second take on one core?

use std::hint::black_box;
use std::path::Path;

use criterion::{Criterion, criterion_group, criterion_main};
use localize::Field;
use localize::frames::{At, Pose};
use localize::robot::RobotConfig;
use localize::world::TeamColour;
use sim::render::{CameraMotion, Renderer, RendererConfig, Scene, SceneBall};
use sim::world::RobotState;
use sim::{Scenario, SimSample, Simulator};
use vision::Profile;

fn config(name: &str) -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../config")
        .join(name)
}

/// Driving at 1.5 m/s and 60°/s with a tilted body, during the shutter time of the default camera.
const DRIVING: CameraMotion = CameraMotion {
    velocity: [1.4, 0.5],
    yaw_rate: 1.05,
    tilt: [0.006, -0.004],
    tilt_rate: [0.05, 0.02],
    readout: 0.0,
    shutter: 0.008,
};

/// The demo's scenario with nine other robots.
fn game() -> (Scenario, RobotConfig, Field) {
    let (mut scenario, robot) = Scenario::load(&config("scenarios/demo.toml")).expect("a scenario");
    scenario.others.opponents = 5;
    scenario.others.mates = 4;
    let field = Field::load(&robot.field).expect("a field");
    (scenario, robot, field)
}

fn image(c: &mut Criterion) {
    let (scenario, robot, field) = game();
    let camera = robot
        .camera
        .as_ref()
        .and_then(|camera| camera.camera())
        .expect("a camera");
    let profile =
        Profile::load(&robot.mirror.clone().expect("a mirror").profile).expect("a profile");
    let body = robot.body.clone().unwrap_or_default();
    let mut renderer = Renderer::new(&RendererConfig {
        camera: &camera,
        profile: &profile,
        mount: scenario.mount,
        body: &body,
        field: &field,
        light: &scenario.light,
        environment: &scenario.environment,
        image_sensor: &scenario.image_sensor,
        seed: 1,
    })
    .expect("a renderer");
    // Nine robots at distances of 1 to 9 m, the ball at 2 m, a goal 5 m ahead.
    let robots: Vec<RobotState> = (0..9)
        .map(|index| {
            let (sin, cos) = (0.7 * index as f32).sin_cos();
            let distance = 1.0 + index as f32;
            RobotState {
                pose: Pose::new(4.0 - distance * cos, distance * sin * 0.8, index as f32),
                velocity: [0.0; 2],
                yaw_rate: 0.0,
                team: if index % 2 == 0 {
                    TeamColour::Cyan
                } else {
                    TeamColour::Magenta
                },
            }
        })
        .collect();
    let mut rgb = Vec::new();
    c.bench_function("render_480x480_nine_robots", |b| {
        let mut theta = 0.0f32;
        b.iter(|| {
            theta += 0.1;
            let scene = Scene {
                pose: Pose::new(4.0, 0.3, theta),
                robots: &robots,
                motion: DRIVING,
                ball: Some(SceneBall {
                    at: At::new(2.5, 1.5),
                    height: 0.0,
                    diameter: 0.22,
                    colour: [245, 125, 20],
                }),
                ..Scene::default()
            };
            renderer.render(black_box(&scene), &scenario.image_sensor, &mut rgb);
            black_box(&rgb);
        });
    });
}

fn second(c: &mut Criterion) {
    let (mut scenario, robot, field) = game();
    scenario.duration = f64::MAX;
    let mut group = c.benchmark_group("simulated_second");
    group.sample_size(20);
    for (name, frame_rate_hz) in [("camera_30_hz", 30.0), ("without_camera", 1e-3)] {
        let mut scenario = scenario.clone();
        scenario.frame_rate_hz = frame_rate_hz;
        let mut sim = Simulator::new(scenario, robot.clone(), field.clone()).expect("a simulation");
        group.bench_function(name, |b| {
            b.iter(|| {
                let end = sim.time() + 1.0;
                while sim.time() < end {
                    if let SimSample::Image(image) = sim.next_sample() {
                        black_box(&image.rgb);
                    }
                }
            });
        });
    }
}

criterion_group!(benches, image, second);
criterion_main!(benches);
