//! What does the robot sense, and when? The world and all sensors on one clock, as stamped samples in time order.

mod control;
mod sense;

use std::collections::VecDeque;
use std::path::PathBuf;

use localize::field::{Field, FieldError};
use localize::frames::Pose;
use localize::omni::{OmniError, Twist};
use localize::robot::{CameraConfig, RobotConfig};
use localize::sample::{Compass, Imu, Odometry, VelocityCommand};
use localize::stamp::Stamp;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use vision::Profile;
use vision::optics::mirror::ProfileError;
use vision::optics::ray_tracing::OpticsError;

use crate::behaviour::{DECISION_PERIOD, TeamBehaviour};
use crate::image_sensor::FilmConfig;
use crate::path_follower::PathFollower;
use crate::render::{Renderer, RendererConfig};
use crate::scenario::{FaultKind, Scenario, ScenarioError};
use crate::sensors::{CompassModel, ImuModel};
use crate::world::{BallState, RobotState, STEP, STEP_NANOSECONDS, SimWorld};

/// What a sensor says, or what is true.
#[derive(Debug, Clone, PartialEq)]
pub enum SimSample {
    /// Wheel encoders.
    Odometry(Odometry),
    /// Inertial unit.
    Imu(Imu),
    /// Compass.
    Compass(Compass),
    /// What the motors are told, whenever odometry is due.
    Command(VelocityCommand),
    /// What is true at the time of an image; it comes just before the image.
    Truth(SimTruth),
    /// The camera.
    Image(SimImage),
}

impl SimSample {
    /// When it was taken.
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

/// Where everything really is.
#[derive(Debug, Clone, PartialEq)]
pub struct SimTruth {
    /// When.
    pub stamp: Stamp,
    /// Our robot.
    pub robot: RobotState,
    /// The ball, where there is one.
    pub ball: Option<BallState>,
    /// The other robots.
    pub others: Vec<RobotState>,
}

/// Why there is no simulation.
#[derive(Debug, thiserror::Error)]
pub enum SimError {
    /// The scenario or robot file.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// The field file.
    #[error(transparent)]
    Field(#[from] FieldError),
    /// The mirror's profile.
    #[error(transparent)]
    Profile(#[from] ProfileError),
    /// Camera and mirror do not go together.
    #[error("{}: {source}", path.display())]
    Optics {
        /// The robot file.
        path: PathBuf,
        /// What is wrong.
        source: OpticsError,
    },
    /// The wheels are no base.
    #[error("{}: base.wheel_angles_deg: {source}", path.display())]
    Base {
        /// The robot file.
        path: PathBuf,
        /// What is wrong.
        source: OmniError,
    },
    /// Something that a simulation needs is not in the robot file.
    #[error("{}: a simulated robot needs {what}", path.display())]
    Missing {
        /// The robot file.
        path: PathBuf,
        /// What is missing.
        what: &'static str,
    },
}

/// A running simulation. `Iterator` yields its samples until the scenario's end.
pub struct Sim {
    scenario: Scenario,
    robot: RobotConfig,
    field: Field,
    world: SimWorld,
    behaviour: TeamBehaviour,
    follower: PathFollower,
    command_override: Option<Twist>,
    /// What the motors were told last.
    command: Twist,
    renderer: Renderer,
    image_sensor: FilmConfig,
    /// Settings to come: from which image on, counted from 0, those that were dropped not.
    pending_sensor_configs: VecDeque<(u64, FilmConfig)>,
    images: u64,
    /// Are images rendered?
    renders_images: bool,
    /// Light set by hand, in place of the scenario's.
    light_override: Option<f32>,
    /// A sector occluded by hand, degrees.
    occlusion_override: Option<(f32, f32)>,
    imu: Option<(ImuModel, SampleTimer)>,
    compass: Option<(CompassModel, SampleTimer)>,
    odometry_timer: SampleTimer,
    camera_timer: SampleTimer,
    behaviour_timer: SampleTimer,
    steps: i64,
    next_kidnap: usize,
    next_push: usize,
    /// Sum of accelerations since the last IMU sample, and of how many steps.
    acceleration_sum: ([f64; 2], u32),
    frozen_heading: Option<f32>,
    frozen_image: Option<Vec<u8>>,
    behaviour_rng: ChaCha8Rng,
    sensor_rng: ChaCha8Rng,
    pending_samples: VecDeque<SimSample>,
}

/// Ticks at a fixed rate, counted so that rounding never adds up.
#[derive(Debug, Clone, Copy)]
struct SampleTimer {
    rate_hz: f64,
    ticks: u64,
}

impl SampleTimer {
    fn new(rate_hz: f64) -> Self {
        SampleTimer { rate_hz, ticks: 0 }
    }

    /// True once a tick: when the time for it has come.
    fn take_due(&mut self, time: f64) -> bool {
        // Half a step early or late is as near as steps allow.
        let due = time + f64::from(STEP) / 2.0 >= self.ticks as f64 / self.rate_hz;
        self.ticks += u64::from(due);
        due
    }
}

impl Sim {
    /// Reads a scenario and all that it names; `seed` overrides the scenario's.
    pub fn load(path: &std::path::Path, seed: Option<u64>) -> Result<Self, SimError> {
        let (mut scenario, robot) = Scenario::load(path)?;
        scenario.seed = seed.unwrap_or(scenario.seed);
        let field = Field::load(scenario.field.as_ref().unwrap_or(&robot.field))?;
        Sim::new(scenario, robot, field)
    }

    /// Sets everything up. The robot needs a camera and a mirror profile; its file is named in errors.
    pub fn new(scenario: Scenario, robot: RobotConfig, field: Field) -> Result<Self, SimError> {
        let missing = |what| SimError::Missing {
            path: scenario.robot.clone(),
            what,
        };
        let camera = robot.camera.as_ref().ok_or_else(|| missing("[camera]"))?;
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
            // What a longer focal length enlarges, the rim's image included.
            outer_radius_px: camera
                .outer_radius_px
                .map(|rim| rim * scenario.focal_scale as f32),
            ..camera.clone()
        };
        let renderer = Renderer::new(&RendererConfig {
            camera: &real_camera,
            profile: &profile,
            mount: scenario.mount,
            body: &body,
            field: &field,
            light: &scenario.light,
            blur_px: scenario.film.blur_px,
            seed: scenario.seed,
        })
        .map_err(|source| SimError::Optics {
            path: scenario.robot.clone(),
            source,
        })?;
        let stream = |number| {
            let mut rng = ChaCha8Rng::seed_from_u64(scenario.seed);
            rng.set_stream(number);
            rng
        };
        let (mut chance_play, mut chance_sensors) = (stream(2), stream(3));
        let start = scenario.start.pose();
        let (play, places) = TeamBehaviour::new(&field, &scenario.others, start, &mut chance_play);
        let world = SimWorld::new(&field, &base, &body, &scenario, &places).map_err(|source| {
            SimError::Base {
                path: scenario.robot.clone(),
                source,
            }
        })?;
        let imu = robot.imu.as_ref().map(|config| {
            (
                ImuModel::new(config, &mut chance_sensors),
                SampleTimer::new(config.rate_hz.into()),
            )
        });
        let compass = robot.compass.as_ref().map(|config| {
            (
                CompassModel::new(config, &mut chance_sensors),
                SampleTimer::new(config.rate_hz.into()),
            )
        });
        Ok(Sim {
            world,
            behaviour: play,
            follower: PathFollower::new(scenario.path.clone()),
            command_override: None,
            command: Twist::default(),
            renderer,
            image_sensor: scenario.film,
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
            acceleration_sum: ([0.0; 2], 0),
            frozen_heading: None,
            frozen_image: None,
            behaviour_rng: chance_play,
            sensor_rng: chance_sensors,
            pending_samples: VecDeque::new(),
            scenario: sorted(scenario),
            robot,
            field,
        })
    }

    /// The same without images: truth still comes when one would.
    pub fn without_images(mut self) -> Self {
        self.renders_images = false;
        self
    }

    /// The scenario, its paths resolved.
    pub fn scenario(&self) -> &Scenario {
        &self.scenario
    }

    /// The robot's file: what vision believes.
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

    /// Time since the start: a whole number of steps.
    fn stamp(&self) -> Stamp {
        Stamp(self.steps * STEP_NANOSECONDS)
    }

    /// What is true now.
    pub fn truth(&self) -> SimTruth {
        SimTruth {
            stamp: self.stamp(),
            robot: self.world.robot(),
            ball: self.world.ball(),
            others: self.world.others().collect(),
        }
    }

    /// The next sample, whatever the time; the world stands still in between.
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

    fn step(&mut self) {
        let time = self.time();
        while let Some(kidnap) = self.scenario.kidnaps.get(self.next_kidnap) {
            if kidnap.time > time {
                break;
            }
            self.next_kidnap += 1;
            self.world
                .kidnap(Pose::new(kidnap.x, kidnap.y, kidnap.theta_deg.to_radians()));
        }
        while let Some(push) = self.scenario.pushes.get(self.next_push) {
            if push.time > time {
                break;
            }
            self.next_push += 1;
            self.world.apply_impulse(push.impulse);
        }
        if self.behaviour_timer.take_due(time) {
            self.behaviour
                .update(&mut self.world, &mut self.behaviour_rng);
        }
        let wanted = match self.command_override {
            Some(twist) => twist,
            None => {
                let pose = self.world.robot().pose;
                let others = self.world.others().map(|state| state.pose);
                self.follower.command(time, STEP, pose, others)
            }
        };
        self.command = wanted;
        self.world.step(wanted);
        let [ax, ay] = self.world.acceleration();
        self.acceleration_sum.0[0] += f64::from(ax);
        self.acceleration_sum.0[1] += f64::from(ay);
        self.acceleration_sum.1 += 1;
        self.steps += 1;
    }
}

/// Kidnaps and pushes in the order in which they happen.
fn sorted(mut scenario: Scenario) -> Scenario {
    scenario.kidnaps.sort_by(|a, b| a.time.total_cmp(&b.time));
    scenario.pushes.sort_by(|a, b| a.time.total_cmp(&b.time));
    scenario
}

impl Iterator for Sim {
    type Item = SimSample;

    /// The next sample; none once the scenario's duration is over.
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
