//! How does a simulated robot yield samples? A scenario runs until its end, and the camera accepts commands.

use std::ops::ControlFlow;
use std::path::Path;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;

use anyhow::{Context, Result, ensure};
use localize::Field;
use localize::advice::{Advice, MotionAdvice};
use localize::omni::Twist;
use localize::robot::CameraControl;
use localize::robot::RobotConfig;
use localize::toml_file;
use sim::scenario::PathConfig;
use sim::{Scenario, SimSample, Simulator};
use vision::exposure::ExposureCommand;
use vision::image::Image;

use crate::config::merge_tables;
use crate::cycle::Cycle;
use crate::pipeline::Pipeline;
use crate::sample::{CameraImage, GroundTruth, ImageContent, Sample};
use crate::setup::Setup;

/// Images by which the simulator may be ahead of the pipeline: one being processed, one in the channel.
const PREFETCHED_IMAGES: usize = 2;

/// Images after which the simulated robot follows an advice.
const ADVICE_DELAY_IMAGES: u64 = 2;

/// Capacity for camera commands: more than a camera's delay plus `PREFETCHED_IMAGES`.
const MAX_PENDING_COMMANDS: usize = 64;

/// A running scenario. It is an iterator of samples; [`Simulation::run`] also connects a pipeline.
///
/// ```
/// # fn main() -> anyhow::Result<()> {
/// use std::ops::ControlFlow;
/// use std::path::Path;
///
/// use pipeline::simulation::Simulation;
/// use pipeline::{Pipeline, PipelineConfig};
///
/// let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config");
/// let scenario = config.join("scenarios/tracks_18x12.toml");
/// let simulation = Simulation::load(&scenario, Some(1), Some(0.2))?;
/// let mut pipeline = Pipeline::new(&simulation.setup()?, &PipelineConfig::default())?;
/// let mut cycles = Vec::new();
/// simulation.run(&mut pipeline, |cycle| {
///     cycles.push(cycle);
///     Ok(ControlFlow::Continue(()))
/// })?;
/// assert!(cycles.iter().all(|cycle| cycle.inputs.truth.is_some()));
/// # Ok(())
/// # }
/// ```
pub struct Simulation {
    sim: Simulator,
    duration: f64,
}

impl Simulation {
    /// Reads a scenario of a single robot. `seed` and `duration` (seconds) override those of the file.
    pub fn load(scenario: &Path, seed: Option<u64>, duration: Option<f64>) -> Result<Self> {
        Simulation::with_overrides(scenario, &toml::Table::new(), seed, duration)
    }

    /// Reads a scenario of a single robot. The values of `overrides` replace those of the file, table by table.
    pub fn with_overrides(
        scenario: &Path,
        overrides: &toml::Table,
        seed: Option<u64>,
        duration: Option<f64>,
    ) -> Result<Self> {
        let (scenario, robot) = load_single_robot_scenario(scenario, overrides, seed)?;
        let field = Field::load(scenario.field.as_ref().unwrap_or(&robot.field))?;
        let duration = duration.unwrap_or(scenario.duration);
        let sim = Simulator::new(scenario, robot, field)?;
        Ok(Simulation { sim, duration })
    }

    /// Setup of the robot: its calibrated ground map, or that of its mirror as designed, without the mounting error.
    pub fn setup(&self) -> Result<Setup> {
        let mut setup = setup_from_sim(&self.sim)?;
        // The camera starts with the exposure and gain of the scenario's sensor.
        setup.robot.exposure = self.sim.robot().exposure.map(|control| {
            let sensor = self.sim.image_sensor();
            CameraControl {
                exposure: sensor.exposure,
                gain: sensor.gain,
                ..control
            }
        });
        Ok(setup)
    }

    /// Changes exposure and gain of the camera, starting with the image that the command names.
    pub fn command_camera(&mut self, command: ExposureCommand) {
        let setting = command.setting;
        self.sim
            .schedule_exposure(command.from_frame, setting.exposure, setting.gain);
    }

    /// Disables images; true states are still sampled at the rate of the camera.
    #[must_use]
    pub fn without_images(self) -> Self {
        Simulation {
            sim: self.sim.without_images(),
            ..self
        }
    }

    /// Sets exposure and gain of the camera from the next image on.
    pub fn set_camera(&mut self, exposure: f32, gain: f32) {
        self.sim.schedule_exposure(0, exposure, gain);
    }

    /// The next sample, also beyond the end of the run.
    pub fn next_sample(&mut self) -> Sample {
        sample_from_sim(self.sim.next_sample())
    }

    /// Runs until the end, or until `on_cycle` breaks.
    ///
    /// Samples go to the pipeline, cycles to `on_cycle`, camera commands back to the simulated camera, and advised motions
    /// to a robot whose path follows them. The simulator runs ahead in its own thread as far as their delays allow. This
    /// does not change the samples.
    pub fn run(
        self,
        pipeline: &mut Pipeline,
        mut on_cycle: impl FnMut(Cycle) -> Result<ControlFlow<()>>,
    ) -> Result<()> {
        let mut samples = self.spawn_prefetch(true)?;
        while let Some(sample) = samples.next() {
            let Some(cycle) = pipeline.process_sample(sample) else {
                continue;
            };
            samples.send_feedback(Feedback {
                camera: cycle.camera_command(),
                advice: cycle.estimate.advice,
            });
            if on_cycle(cycle)?.is_break() {
                break;
            }
        }
        Ok(())
    }

    /// The simulator.
    pub fn sim(&self) -> &Simulator {
        &self.sim
    }

    /// Mutable access to the simulator between two samples.
    pub fn sim_mut(&mut self) -> &mut Simulator {
        &mut self.sim
    }

    /// Length of the run, seconds.
    pub fn duration(&self) -> f64 {
        self.duration
    }

    /// Runs ahead in its own thread while the samples are processed. The camera accepts no commands.
    pub fn prefetch(self) -> Result<PrefetchedSimulation> {
        self.spawn_prefetch(false)
    }

    /// With `commanded`, waits for the camera command of each cycle as far as the camera's delay requires.
    fn spawn_prefetch(mut self, commanded: bool) -> Result<PrefetchedSimulation> {
        let (sender, samples) = sync_channel(PREFETCHED_IMAGES);
        let (command_sender, commands) = sync_channel::<Feedback>(MAX_PENDING_COMMANDS);
        // A camera without exposure control accepts no commands, so the simulator never waits.
        let camera = self.sim.robot().exposure.filter(|_| commanded);
        let camera_delay = camera.map(|camera| camera.delay_frames.max(1));
        let path = self.sim.scenario().path.clone();
        let follows = path.follow_advice && commanded;
        let advice_delay = follows.then_some(ADVICE_DELAY_IMAGES);
        let delay = camera_delay.into_iter().chain(advice_delay).min();
        let run = move || {
            let (mut batch, mut images, mut answered) = (Vec::new(), 0u64, 0u64);
            while let Some(sample) = self.next() {
                let is_image = matches!(sample, Sample::Image(_));
                batch.push(sample);
                if !is_image {
                    continue;
                }
                images += 1;
                // The receiver was dropped: the run was aborted.
                if sender.send(std::mem::take(&mut batch)).is_err() {
                    return;
                }
                // The next image has the number `images`. Commands given at least `delay` images earlier apply to it.
                while delay.is_some_and(|delay| answered + delay <= images) {
                    let Ok(feedback) = commands.recv() else {
                        return;
                    };
                    answered += 1;
                    feedback
                        .camera
                        .into_iter()
                        .for_each(|command| self.command_camera(command));
                    if follows {
                        let twist = advised_twist(feedback.advice, &path);
                        self.sim.set_command(twist);
                    }
                }
            }
            drop(sender.send(batch));
        };
        let thread = std::thread::Builder::new()
            .name("simulator".to_owned())
            .spawn(run)
            .context("cannot start the simulator's thread")?;
        Ok(PrefetchedSimulation {
            samples,
            feedback: command_sender,
            batch: Vec::new().into_iter(),
            thread: Some(thread),
        })
    }
}

impl Iterator for Simulation {
    type Item = Sample;

    fn next(&mut self) -> Option<Sample> {
        let sample = self.sim.next_sample();
        if sample.stamp().seconds() >= self.duration {
            return None;
        }
        Some(sample_from_sim(sample))
    }
}

/// Loads a scenario and its robot file. The values of `overrides` replace those of the scenario file.
pub fn load_scenario_with_overrides(
    path: &Path,
    overrides: &toml::Table,
    seed: Option<u64>,
) -> Result<(Scenario, RobotConfig)> {
    if overrides.is_empty() {
        let (mut scenario, robot) = Scenario::load(path)?;
        scenario.seed = seed.unwrap_or(scenario.seed);
        return Ok((scenario, robot));
    }
    let (mut table, _): (toml::Table, _) = toml_file::read(path)?;
    merge_tables(&mut table, overrides.clone());
    if let Some(seed) = seed {
        let seed = i64::try_from(seed)
            .with_context(|| format!("invalid seed: {seed} (expected less than 2^63)"))?;
        table.insert("seed".to_owned(), seed.into());
    }
    Scenario::from_table(table, path).with_context(|| {
        format!(
            "with {} in place of the file's",
            dotted_keys(overrides).join(", ")
        )
    })
}

/// The same for where one robot is simulated: a scenario with a `[[squad]]` is refused.
pub fn load_single_robot_scenario(
    path: &Path,
    overrides: &toml::Table,
    seed: Option<u64>,
) -> Result<(Scenario, RobotConfig)> {
    let (scenario, robot) = load_scenario_with_overrides(path, overrides, seed)?;
    ensure!(
        scenario.squad.is_empty(),
        "{}: squad: {} more robots (expected none where one robot is simulated). `mirrorball sim` and `mirrorball.simulate` \
         simulate all and record a log of each; [[others.placed]] places robots without sensors",
        path.display(),
        scenario.squad.len()
    );
    Ok((scenario, robot))
}

/// All values of a table as `key.key = value`.
fn dotted_keys(table: &toml::Table) -> Vec<String> {
    let of_entry = |(key, value): (&String, &toml::Value)| match value {
        toml::Value::Table(inner) => {
            let below = dotted_keys(inner).into_iter();
            below.map(|rest| format!("{key}.{rest}")).collect()
        }
        value => vec![format!("{key} = {value}")],
    };
    table.iter().flat_map(of_entry).collect()
}

/// Setup of a simulated robot, without exposure control.
pub(crate) fn setup_from_sim(sim: &Simulator) -> Result<Setup> {
    let scenario = sim.scenario();
    let mut robot = sim.robot().clone();
    if let Some(field) = &scenario.field {
        robot.field.clone_from(field);
    }
    // Exposure control needs a command channel to the camera, which only `Simulation::run` has.
    robot.exposure = None;
    Setup::new(&scenario.robot, robot, sim.field().clone(), None)
}

/// Converts a sample of the simulator.
pub(crate) fn sample_from_sim(sample: SimSample) -> Sample {
    match sample {
        SimSample::Odometry(odometry) => Sample::Odometry(odometry),
        SimSample::Imu(imu) => Sample::Imu(imu),
        SimSample::Compass(compass) => Sample::Compass(compass),
        SimSample::Command(command) => Sample::Command(command),
        SimSample::Truth(truth) => Sample::GroundTruth(GroundTruth {
            stamp: truth.stamp,
            pose: truth.robot.pose,
            ball: truth.ball.map(|ball| ball.at),
            ball_height: truth.ball.map_or(0.0, |ball| ball.height),
            robots: truth
                .others
                .iter()
                .map(|robot| robot.pose.origin())
                .collect(),
            robot_headings: truth.others.iter().map(|robot| robot.pose.theta).collect(),
            people: truth
                .people
                .iter()
                .map(|person| person.pose.origin())
                .collect(),
        }),
        SimSample::Image(image) => {
            let pixels = Image {
                width_px: image.width_px,
                height_px: image.height_px,
                rgb: image.rgb,
            };
            Sample::Image(CameraImage {
                stamp: image.stamp,
                setting: None,
                content: ImageContent::Pixels(pixels.into()),
            })
        }
    }
}

/// What the simulated robot learns from the cycle of one image.
#[derive(Debug, Clone, Copy)]
struct Feedback {
    /// The new camera setting, if it changes.
    camera: Option<ExposureCommand>,
    advice: Option<Advice>,
}

/// The velocity by which a robot follows an advice at its path's speed. None: it stays on its path.
fn advised_twist(advice: Option<Advice>, path: &PathConfig) -> Option<Twist> {
    let Some(Advice::Move(MotionAdvice {
        motion: [x, y, turn],
        ..
    })) = advice
    else {
        return None;
    };
    let distance = localize::math::hypot(x, y);
    let speed = path.speed / distance.max(1e-3);
    Some(if distance > 1e-3 {
        Twist {
            x: x * speed,
            y: y * speed,
            theta: 0.0,
        }
    } else {
        Twist {
            x: 0.0,
            y: 0.0,
            theta: path.turn_rate_deg.to_radians().copysign(turn),
        }
    })
}

/// A scenario that runs in its own thread, a few images ahead.
pub struct PrefetchedSimulation {
    samples: Receiver<Vec<Sample>>,
    /// One message per image.
    feedback: SyncSender<Feedback>,
    batch: std::vec::IntoIter<Sample>,
    thread: Option<JoinHandle<()>>,
}

impl PrefetchedSimulation {
    /// Sends the feedback of a cycle. Must be called once per image, in order.
    fn send_feedback(&self, feedback: Feedback) {
        // A simulator that has ended ignores it.
        let _ = self.feedback.try_send(feedback);
    }
}

impl Iterator for PrefetchedSimulation {
    type Item = Sample;

    fn next(&mut self) -> Option<Sample> {
        loop {
            if let Some(sample) = self.batch.next() {
                return Some(sample);
            }
            match self.samples.recv() {
                Ok(batch) => self.batch = batch.into_iter(),
                Err(_) => break,
            }
        }
        if let Some(Err(panic)) = self.thread.take().map(JoinHandle::join) {
            std::panic::resume_unwind(panic);
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn twist(motion: [f32; 3]) -> Option<Twist> {
        let path = PathConfig {
            speed: 1.5,
            turn_rate_deg: 90.0,
            ..PathConfig::default()
        };
        let advice = Advice::Move(MotionAdvice {
            motion,
            expected_log_odds: 3.0,
        });
        advised_twist(Some(advice), &path)
    }

    #[test]
    fn scenario_of_several_robots_is_refused_where_one_is_simulated() {
        let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/scenarios");
        let squad = Simulation::load(&config.join("squad.toml"), None, None);
        let message = format!("{:#}", squad.err().expect("refused"));
        for part in [
            "squad.toml: squad: 4 more robots",
            "`mirrorball sim`",
            "[[others.placed]]",
        ] {
            assert!(message.contains(part), "{message}");
        }
        let alone = toml::toml! { squad = [] };
        Simulation::with_overrides(&config.join("squad.toml"), &alone, None, None)
            .expect("one robot");
    }

    #[test]
    fn an_advised_displacement_is_driven_at_the_speed_of_the_path() {
        let found = twist([0.3, -0.4, 0.0]).expect("a velocity");
        assert!((found.x - 0.9).abs() < 1e-5 && (found.y + 1.2).abs() < 1e-5);
        assert_eq!(found.theta, 0.0);
    }

    #[test]
    fn an_advised_turn_has_its_sign_and_the_rate_of_the_path() {
        let found = twist([0.0, 0.0, -0.5]).expect("a velocity");
        assert_eq!([found.x, found.y], [0.0, 0.0]);
        assert!((found.theta + std::f32::consts::FRAC_PI_2).abs() < 1e-5);
    }

    #[test]
    fn a_half_turn_leaves_the_robot_on_its_path() {
        let path = PathConfig::default();
        assert_eq!(advised_twist(Some(Advice::ObserveHalf), &path), None);
        assert_eq!(advised_twist(None, &path), None);
    }
}
