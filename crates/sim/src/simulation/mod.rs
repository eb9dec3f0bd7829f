//! What does the robot measure, and when? World and sensors on one clock, as stamped samples in order of time.

mod control;
mod sense;

use std::collections::VecDeque;
use std::path::PathBuf;

use localize::field::Field;
use localize::frames::Pose;
use localize::omni::{OmniError, Twist};
use localize::robot::{CameraConfig, CameraSection, RobotConfig};
use localize::sample::{Compass, Imu, Odometry, VelocityCommand};
use localize::stamp::Stamp;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use vision::optics::mirror::ProfileError;
use vision::optics::ray_tracing::OpticsError;
use vision::{Mount, Profile};

use crate::behaviour::{DECISION_PERIOD, TeamBehaviour};
use crate::image_sensor::ImageSensorConfig;
use crate::path_follower::PathFollower;
use crate::people::{People, Person};
use crate::render::{CameraMotion, Renderer, RendererConfig};
use crate::rocking::Rocking;
use crate::scenario::{FaultKind, Scenario};
use crate::sector::Sector;
use crate::sensors::{CompassModel, ImuModel};
use crate::world::{BallState, RobotState, STEP, STEP_NANOSECONDS, SimWorld};

/// People move at every tenth time step: they are slow.
const PEOPLE_STEPS: i64 = 10;

/// A sensor sample, or the true state.
#[derive(Debug, Clone, PartialEq)]
pub enum SimSample {
    /// Motion measured by the wheel encoders.
    Odometry(Odometry),
    /// Reading of the inertial unit.
    Imu(Imu),
    /// Reading of the compass.
    Compass(Compass),
    /// Velocity commanded to the motors, at the rate of odometry.
    Command(VelocityCommand),
    /// True state at the time of an image, directly before the image.
    Truth(SimTruth),
    /// Camera image.
    Image(SimImage),
}

impl SimSample {
    /// Time of the measurement.
    pub fn stamp(&self) -> Stamp {
        match self {
            SimSample::Odometry(odometry) => odometry.stamp,
            SimSample::Imu(imu) => imu.stamp,
            SimSample::Compass(compass) => compass.stamp,
            SimSample::Command(command) => command.stamp,
            SimSample::Truth(truth) => truth.stamp,
            SimSample::Image(image) => image.stamp,
        }
    }
}

/// A camera image.
#[derive(Debug, Clone, PartialEq)]
pub struct SimImage {
    /// Middle of the exposure.
    pub stamp: Stamp,
    /// Columns.
    pub width_px: usize,
    /// Rows.
    pub height_px: usize,
    /// Red, green, blue bytes, row by row.
    pub rgb: Vec<u8>,
}

/// The true state.
#[derive(Debug, Clone, PartialEq)]
pub struct SimTruth {
    /// Time of the state.
    pub stamp: Stamp,
    /// Our robot.
    pub robot: RobotState,
    /// The ball, if there is one.
    pub ball: Option<BallState>,
    /// The other robots.
    pub others: Vec<RobotState>,
    /// People on and beside the field.
    pub people: Vec<Person>,
    /// Our robot's tilt: x and y components of the vertical in its frame.
    pub tilt: [f32; 2],
}

/// Why a simulation cannot be set up.
#[derive(Debug, thiserror::Error)]
pub enum SimError {
    /// The mirror's profile.
    #[error(transparent)]
    Profile(#[from] ProfileError),
    /// Camera and mirror do not match.
    #[error("{}: {source}", path.display())]
    Optics {
        /// The robot file.
        path: PathBuf,
        /// What is wrong.
        source: OpticsError,
    },
    /// Wheels that cannot drive in every direction.
    #[error("{}: base.wheel_angles_deg: {source}", path.display())]
    Base {
        /// The robot file.
        path: PathBuf,
        /// What is wrong.
        source: OmniError,
    },
    /// The robot file lacks a table that a simulation needs.
    #[error("{}: missing {what} (required for simulation)", path.display())]
    Missing {
        /// The robot file.
        path: PathBuf,
        /// What is missing.
        what: &'static str,
    },
}

/// A running simulation. `Iterator` yields its samples until the scenario's end.
pub struct Simulator {
    scenario: Scenario,
    robot: RobotConfig,
    field: Field,
    world: SimWorld,
    rocking: Rocking,
    people: People,
    behaviour: TeamBehaviour,
    follower: PathFollower,
    command_override: Option<Twist>,
    /// Last command to the motors.
    command: Twist,
    renderer: Renderer,
    /// The real camera, with its real focal length, and the mirror.
    camera: CameraConfig,
    profile: Profile,
    image_sensor: ImageSensorConfig,
    /// Scheduled settings and their first image, counted from 0 without dropped ones.
    pending_sensor_configs: VecDeque<(u64, ImageSensorConfig)>,
    images: u64,
    /// True if images are rendered.
    renders_images: bool,
    /// Overrides the scenario's light level.
    light_override: Option<f32>,
    /// Additional black sector: centre and full width, degrees.
    occlusion_override: Option<Sector>,
    imu: Option<(ImuModel, SampleTimer)>,
    compass: Option<(CompassModel, SampleTimer)>,
    odometry_timer: SampleTimer,
    camera_timer: SampleTimer,
    behaviour_timer: SampleTimer,
    steps: i64,
    next_kidnap: usize,
    next_push: usize,
    next_kick: usize,
    next_knock: usize,
    /// Sum of accelerations since the last IMU sample, and the number of steps.
    acceleration_sum: ([f64; 2], u32),
    frozen_heading: Option<f32>,
    frozen_image: Option<Vec<u8>>,
    behaviour_rng: ChaCha8Rng,
    sensor_rng: ChaCha8Rng,
    people_rng: ChaCha8Rng,
    pending_samples: VecDeque<SimSample>,
}

/// Ticks at a fixed rate; counting them avoids accumulated rounding.
#[derive(Debug, Clone, Copy)]
struct SampleTimer {
    rate_hz: f64,
    ticks: u64,
}

impl SampleTimer {
    fn new(rate_hz: f64) -> Self {
        SampleTimer { rate_hz, ticks: 0 }
    }

    /// True if the next tick is due; then counts it.
    fn take_due(&mut self, time: f64) -> bool {
        // Half a time step early or late is the best possible.
        let due = time + f64::from(STEP) / 2.0 >= self.ticks as f64 / self.rate_hz;
        self.ticks += u64::from(due);
        due
    }
}

impl Simulator {
    /// Sets up a simulation. The robot needs a camera and a mirror profile.
    #[expect(
        clippy::too_many_lines,
        reason = "a list of parts, one after the other"
    )]
    pub fn new(scenario: Scenario, robot: RobotConfig, field: Field) -> Result<Self, SimError> {
        let missing = |what| SimError::Missing {
            path: scenario.robot.clone(),
            what,
        };
        let camera = robot
            .camera
            .as_ref()
            .and_then(CameraSection::camera)
            .ok_or_else(|| missing("[camera] with centre_px"))?;
        let mirror = robot.mirror.as_ref().ok_or_else(|| missing("[mirror]"))?;
        let profile = Profile::load(&mirror.profile)?;
        let (base, body) = (
            robot.base.clone().unwrap_or_default(),
            robot.body.clone().unwrap_or_default(),
        );
        let real_camera = CameraConfig {
            focal_px: camera
                .focal_px
                .map(|focal| focal * scenario.focal_scale as f32),
            // A longer focal length also enlarges the image of the mirror's rim.
            outer_radius_px: camera
                .outer_radius_px
                .map(|rim| rim * scenario.focal_scale as f32),
            ..camera.clone()
        };
        let optics_error = |source| SimError::Optics {
            path: scenario.robot.clone(),
            source,
        };
        let renderer_config = RendererConfig {
            camera: &real_camera,
            profile: &profile,
            mount: scenario.mount,
            body: &body,
            field: &field,
            light: &scenario.light,
            environment: &scenario.environment,
            image_sensor: &scenario.image_sensor,
            seed: scenario.seed,
        };
        let renderer = Renderer::new(&renderer_config).map_err(optics_error)?;
        let rng_stream = |number| {
            let mut rng = ChaCha8Rng::seed_from_u64(scenario.seed);
            rng.set_stream(number);
            rng
        };
        let (mut behaviour_rng, mut sensor_rng) = (rng_stream(2), rng_stream(3));
        let start = scenario.start.pose();
        let (behaviour, others) =
            TeamBehaviour::new(&field, &scenario.others, start, &mut behaviour_rng);
        let world = SimWorld::new(&field, &base, &body, &scenario, &others).map_err(|source| {
            SimError::Base {
                path: scenario.robot.clone(),
                source,
            }
        })?;
        let mut people_rng = rng_stream(5);
        let imu = robot.imu.as_ref().map(|config| {
            (
                ImuModel::new(config, &mut sensor_rng),
                SampleTimer::new(config.rate_hz.into()),
            )
        });
        let compass = robot.compass.as_ref().map(|config| {
            (
                CompassModel::new(config, &mut sensor_rng),
                SampleTimer::new(config.rate_hz.into()),
            )
        });
        Ok(Simulator {
            world,
            rocking: Rocking::new(scenario.rocking, start, &mut rng_stream(6)),
            people: People::new(&field, scenario.people, &mut people_rng),
            people_rng,
            behaviour,
            follower: PathFollower::new(scenario.path.clone()),
            command_override: None,
            command: Twist::default(),
            renderer,
            camera: real_camera,
            profile,
            image_sensor: scenario.image_sensor,
            pending_sensor_configs: VecDeque::new(),
            images: 0,
            renders_images: true,
            light_override: None,
            occlusion_override: None,
            imu,
            compass,
            odometry_timer: SampleTimer::new(base.rate_hz.into()),
            camera_timer: SampleTimer::new(scenario.frame_rate_hz),
            behaviour_timer: SampleTimer::new(1.0 / f64::from(DECISION_PERIOD)),
            steps: 0,
            next_kidnap: 0,
            next_push: 0,
            next_kick: 0,
            next_knock: 0,
            acceleration_sum: ([0.0; 2], 0),
            frozen_heading: None,
            frozen_image: None,
            behaviour_rng,
            sensor_rng,
            pending_samples: VecDeque::new(),
            scenario: sorted(scenario),
            robot,
            field,
        })
    }

    /// Disables images; true states are still sampled at the rate of the camera.
    pub fn without_images(mut self) -> Self {
        self.renders_images = false;
        self
    }

    /// The scenario, its paths resolved.
    pub fn scenario(&self) -> &Scenario {
        &self.scenario
    }

    /// The robot file, which vision uses.
    pub fn robot(&self) -> &RobotConfig {
        &self.robot
    }

    /// The field.
    pub fn field(&self) -> &Field {
        &self.field
    }

    /// Seconds since the start.
    pub fn time(&self) -> f64 {
        self.stamp().seconds()
    }

    /// Time since the start, a multiple of the time step.
    fn stamp(&self) -> Stamp {
        Stamp(self.steps * STEP_NANOSECONDS)
    }

    /// The true state now.
    pub fn truth(&self) -> SimTruth {
        SimTruth {
            stamp: self.stamp(),
            robot: self.world.robot(),
            ball: self.world.ball(),
            others: self.world.others().collect(),
            people: self.people.all().to_vec(),
            tilt: self.rocking.tilt(),
        }
    }

    /// The next sample, also beyond the scenario's duration.
    pub fn next_sample(&mut self) -> SimSample {
        loop {
            if let Some(sample) = self.pending_samples.pop_front() {
                return sample;
            }
            if self.steps > 0 || self.odometry_timer.ticks > 0 {
                self.step();
            }
            self.sample_sensors();
        }
    }

    fn active_fault(&self, kind: FaultKind) -> Option<&crate::scenario::Fault> {
        let time = self.time();
        let fails = |fault: &&crate::scenario::Fault| {
            fault.kind == kind && fault.start <= time && time < fault.stop
        };
        self.scenario.faults.iter().find(fails)
    }

    /// Renders images with another mounting from now on.
    fn remount(&mut self, mount: Mount) {
        let renderer = Renderer::new(&RendererConfig {
            camera: &self.camera,
            profile: &self.profile,
            mount,
            body: &self.robot.body.clone().unwrap_or_default(),
            field: &self.field,
            light: &self.scenario.light,
            environment: &self.scenario.environment,
            image_sensor: &self.scenario.image_sensor,
            seed: self.scenario.seed,
        });
        // Camera and mirror were checked when the simulation was set up.
        if let Ok(renderer) = renderer {
            self.renderer = renderer;
        }
    }

    fn step(&mut self) {
        let time = self.time();
        while let Some(kidnap) = self.scenario.kidnaps.get(self.next_kidnap) {
            if kidnap.time > time {
                break;
            }
            self.next_kidnap += 1;
            let pose = Pose::new(kidnap.x, kidnap.y, kidnap.theta_deg.to_radians());
            self.kidnap(pose);
        }
        while let Some(push) = self.scenario.pushes.get(self.next_push) {
            if push.time > time {
                break;
            }
            self.next_push += 1;
            self.world.apply_impulse(push.impulse);
        }
        while let Some(&kick) = self.scenario.kicks.get(self.next_kick) {
            if kick.time > time {
                break;
            }
            self.next_kick += 1;
            self.kick_from_scenario(&kick);
        }
        while let Some(knock) = self.scenario.knocks.get(self.next_knock) {
            if knock.time > time {
                break;
            }
            self.next_knock += 1;
            self.remount(knock.mount);
        }
        if self.behaviour_timer.take_due(time) {
            self.behaviour
                .update(&self.field, &mut self.world, &mut self.behaviour_rng);
        }
        let command = match self.command_override {
            Some(twist) => twist,
            None => {
                let pose = self.world.robot().pose;
                let others = self.world.others().map(|state| state.pose);
                self.follower.command(time, STEP, pose, others)
            }
        };
        self.command = command;
        self.world.step(command);
        let [ax, ay] = self.world.acceleration();
        self.acceleration_sum.0[0] += f64::from(ax);
        self.acceleration_sum.0[1] += f64::from(ay);
        self.acceleration_sum.1 += 1;
        let pose = self.world.robot().pose;
        let (sin, cos) = pose.theta.sin_cos();
        self.rocking
            .step([cos * ax + sin * ay, cos * ay - sin * ax], pose, STEP);
        if self.steps % PEOPLE_STEPS == 0 && !self.people.all().is_empty() {
            let others = self.world.others().map(|state| state.pose);
            let robots: Vec<Pose> = others.chain([pose]).collect();
            let step = PEOPLE_STEPS as f32 * STEP;
            self.people.step(step, &robots, &mut self.people_rng);
        }
        self.steps += 1;
    }

    /// How the camera moves while it takes an image now.
    fn camera_motion(&self) -> CameraMotion {
        let robot = self.world.robot();
        let (sin, cos) = robot.pose.theta.sin_cos();
        let [vx, vy] = robot.velocity;
        let image_sensor = &self.image_sensor;
        let longest = 1.0 / self.scenario.frame_rate_hz as f32;
        CameraMotion {
            velocity: [cos * vx + sin * vy, cos * vy - sin * vx],
            yaw_rate: robot.yaw_rate,
            tilt: self.rocking.tilt(),
            tilt_rate: self.rocking.tilt_rate(),
            // A camera exposes and reads out within the time between two images.
            readout: image_sensor.rolling_shutter.min(longest),
            shutter: (image_sensor.shutter * image_sensor.exposure).min(longest),
        }
    }
}

/// The scenario with its kidnaps, pushes, kicks and knocks in order of time.
fn sorted(mut scenario: Scenario) -> Scenario {
    scenario.kidnaps.sort_by(|a, b| a.time.total_cmp(&b.time));
    scenario.pushes.sort_by(|a, b| a.time.total_cmp(&b.time));
    scenario.kicks.sort_by(|a, b| a.time.total_cmp(&b.time));
    scenario.knocks.sort_by(|a, b| a.time.total_cmp(&b.time));
    scenario
}

impl Iterator for Simulator {
    type Item = SimSample;

    /// The next sample; `None` at the end of the scenario.
    fn next(&mut self) -> Option<SimSample> {
        let end = Stamp::from_seconds(self.scenario.duration);
        if self.pending_samples.is_empty() && self.stamp() > end {
            return None;
        }
        let sample = self.next_sample();
        (sample.stamp() <= end).then_some(sample)
    }
}

#[cfg(test)]
mod tests;
