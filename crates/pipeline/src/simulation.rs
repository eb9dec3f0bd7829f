//! A simulated robot as a source: the simulator's samples in the spine's words.

use std::ops::ControlFlow;
use std::path::Path;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;

use anyhow::{Context, Result};
use localize::Field;
use localize::robot::CameraControl;
use localize::robot::RobotConfig;
use sim::{Scenario, Sim, SimSample as Simulated};
use vision::exposure::ExposureCommand;
use vision::image::Image;

use crate::config::merge_tables;
use crate::cycle::Cycle;
use crate::pipeline::Pipeline;
use crate::sample::{CameraImage, GroundTruth, ImageContent, Sample};
use crate::setup::Setup;

/// Frames that the simulator may be ahead of whoever looks at them: one to look at, one on its way.
const PREFETCHED_IMAGES: usize = 2;

/// Answers that wait for the simulator: more frames than a camera's delay and `LEAD` together are never under way.
const MAX_PENDING_COMMANDS: usize = 64;

/// A running scenario.
pub struct Simulation {
    sim: Sim,
    duration: f64,
}

impl Simulation {
    /// Reads a scenario; `seed` and `duration` (seconds) override its own.
    pub fn load(scenario: &Path, seed: Option<u64>, duration: Option<f64>) -> Result<Self> {
        let sim = Sim::load(scenario, seed)?;
        let duration = duration.unwrap_or(sim.scenario().duration);
        Ok(Simulation { sim, duration })
    }

    /// A scenario with single values in place of its file's, table by table.
    pub fn with_overrides(
        scenario: &Path,
        over: &toml::Table,
        seed: Option<u64>,
        duration: Option<f64>,
    ) -> Result<Self> {
        let (scenario, robot) = load_scenario_with_overrides(scenario, over, seed)?;
        let field = Field::load(scenario.field.as_ref().unwrap_or(&robot.field))?;
        let duration = duration.unwrap_or(scenario.duration);
        let sim = Sim::new(scenario, robot, field)?;
        Ok(Simulation { sim, duration })
    }

    /// What the simulated robot believes of itself: its file's map, or the one its mirror should have.
    pub fn setup(&self) -> Result<Setup> {
        let mut setup = setup_from_sim(&self.sim)?;
        // The scenario's film is what the camera starts with.
        setup.robot.exposure = self.sim.robot().exposure.map(|control| {
            let film = self.sim.image_sensor();
            CameraControl {
                exposure: film.exposure,
                gain: film.gain,
                ..control
            }
        });
        Ok(setup)
    }

    /// Has the camera's exposure and gain changed as a real one would: from the frame that the command names on.
    pub fn command_camera(&mut self, command: ExposureCommand) {
        let setting = command.setting;
        self.sim
            .schedule_exposure(command.from_frame, setting.exposure, setting.gain);
    }

    /// Plays to the end, or until `also` breaks off: each sample goes through the spine, each cycle to `also`, and
    /// what a cycle commands the camera goes back to it, in force from the frame that the command names.
    ///
    /// The simulator runs ahead in a thread of its own as far as the camera's delay lets it: the same samples, sooner.
    pub fn run(
        self,
        spine: &mut Pipeline,
        mut also: impl FnMut(Cycle) -> Result<ControlFlow<()>>,
    ) -> Result<()> {
        let mut ahead = self.spawn_prefetch(true)?;
        while let Some(sample) = ahead.next() {
            let Some(cycle) = spine.process_sample(sample) else {
                continue;
            };
            ahead.send_camera_command(cycle.camera_command());
            if also(cycle)?.is_break() {
                break;
            }
        }
        Ok(())
    }

    /// The simulator.
    pub fn sim(&self) -> &Sim {
        &self.sim
    }

    /// The simulator, to be meddled with between two samples.
    pub fn sim_mut(&mut self) -> &mut Sim {
        &mut self.sim
    }

    /// How long it runs, seconds.
    pub fn duration(&self) -> f64 {
        self.duration
    }

    /// Runs on in a thread of its own, while what it yielded is being looked at; its camera is not commanded.
    pub fn prefetch(self) -> Result<PrefetchedSimulation> {
        self.spawn_prefetch(false)
    }

    /// `commanded`: waits for what each frame's cycle says to the camera, as far as the camera's delay asks for it.
    fn spawn_prefetch(mut self, commanded: bool) -> Result<PrefetchedSimulation> {
        let (sender, samples) = sync_channel(PREFETCHED_IMAGES);
        let (answers, commands) = sync_channel::<Option<ExposureCommand>>(MAX_PENDING_COMMANDS);
        // A camera without control is never commanded: nobody needs to be waited for.
        let camera = self.sim.robot().exposure.filter(|_| commanded);
        let delay = camera.map(|camera| camera.delay_frames.max(1));
        let run = move || {
            let (mut parcel, mut taken, mut answered) = (Vec::new(), 0u64, 0u64);
            while let Some(sample) = self.next() {
                let ends = matches!(sample, Sample::Image(_));
                parcel.push(sample);
                if !ends {
                    continue;
                }
                taken += 1;
                // Nobody listens any more: the run was given up.
                if sender.send(std::mem::take(&mut parcel)).is_err() {
                    return;
                }
                // The next frame is number `taken`; what was commanded `delay` frames before it is in force there.
                while delay.is_some_and(|delay| answered + delay <= taken) {
                    let Ok(command) = commands.recv() else { return };
                    answered += 1;
                    command
                        .into_iter()
                        .for_each(|command| self.command_camera(command));
                }
            }
            drop(sender.send(parcel));
        };
        let thread = std::thread::Builder::new()
            .name("simulator".to_owned())
            .spawn(run)
            .context("cannot start the simulator's thread")?;
        Ok(PrefetchedSimulation {
            samples,
            camera_commands: answers,
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

/// A scenario and its robot file, with single values in place of the file's.
pub fn load_scenario_with_overrides(
    path: &Path,
    over: &toml::Table,
    seed: Option<u64>,
) -> Result<(Scenario, RobotConfig)> {
    if over.is_empty() {
        let (mut scenario, robot) = Scenario::load(path)?;
        scenario.seed = seed.unwrap_or(scenario.seed);
        return Ok((scenario, robot));
    }
    let text =
        std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let mut table: toml::Table =
        toml::from_str(&text).with_context(|| path.display().to_string())?;
    merge_tables(&mut table, over.clone());
    if let Some(seed) = seed {
        let seed = i64::try_from(seed).context("a scenario's seed ends at 2^63")?;
        table.insert("seed".to_owned(), seed.into());
    }
    Ok(Scenario::from_table(table, path)?)
}

/// What the robot of a simulation believes of itself.
pub(crate) fn setup_from_sim(sim: &Sim) -> Result<Setup> {
    let scenario = sim.scenario();
    let mut robot = sim.robot().clone();
    if let Some(field) = &scenario.field {
        robot.field.clone_from(field);
    }
    // Only where commands go back to the camera may it be commanded.
    robot.exposure = None;
    Setup::new(&scenario.robot, robot, sim.field().clone(), None)
}

/// A simulator's sample in the spine's words.
pub(crate) fn sample_from_sim(sample: Simulated) -> Sample {
    match sample {
        Simulated::Odometry(odometry) => Sample::Odometry(odometry),
        Simulated::Imu(imu) => Sample::Imu(imu),
        Simulated::Compass(compass) => Sample::Compass(compass),
        Simulated::Command(command) => Sample::Command(command),
        Simulated::Truth(truth) => Sample::GroundTruth(GroundTruth {
            stamp: truth.stamp,
            pose: truth.robot.pose,
            ball: truth.ball.map(|ball| ball.at),
            robots: truth
                .others
                .iter()
                .map(|robot| robot.pose.origin())
                .collect(),
            robot_headings: truth.others.iter().map(|robot| robot.pose.theta).collect(),
        }),
        Simulated::Image(image) => {
            let picture = Image {
                width_px: image.width_px,
                height_px: image.height_px,
                rgb: image.rgb,
            };
            Sample::Image(CameraImage {
                stamp: image.stamp,
                content: ImageContent::Pixels(picture.into()),
            })
        }
    }
}

/// A scenario that runs in a thread of its own, a few frames ahead.
pub struct PrefetchedSimulation {
    samples: Receiver<Vec<Sample>>,
    /// One answer a frame: what to set the camera to, if anything.
    camera_commands: SyncSender<Option<ExposureCommand>>,
    batch: std::vec::IntoIter<Sample>,
    thread: Option<JoinHandle<()>>,
}

impl PrefetchedSimulation {
    /// Says what a frame's cycle commands; once a frame, in their order.
    fn send_camera_command(&self, command: Option<ExposureCommand>) {
        // A simulator that has ended needs no answer.
        let _ = self.camera_commands.try_send(command);
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
                Ok(parcel) => self.batch = parcel.into_iter(),
                Err(_) => break,
            }
        }
        if let Some(Err(panic)) = self.thread.take().map(JoinHandle::join) {
            std::panic::resume_unwind(panic);
        }
        None
    }
}
