//! A simulated robot as a source: the simulator's samples in the spine's words.

use std::path::Path;
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread::JoinHandle;

use anyhow::{Context, Result};
use localize::Field;
use sim::{Sample as Simulated, Scenario, Sim};
use vision::RobotConfig;
use vision::image::Image;

use crate::cycle::merge;
use crate::sample::{Content, Frame, Sample, Truth};
use crate::setup::Setup;

/// Frames that the simulator may be ahead of whoever looks at them: one to look at, one on its way.
const LEAD: usize = 2;

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
    pub fn changed(
        scenario: &Path,
        over: &toml::Table,
        seed: Option<u64>,
        duration: Option<f64>,
    ) -> Result<Self> {
        let (scenario, robot) = changed_scenario(scenario, over, seed)?;
        let field = Field::load(scenario.field.as_ref().unwrap_or(&robot.field))?;
        let duration = duration.unwrap_or(scenario.duration);
        let sim = Sim::new(scenario, robot, field)?;
        Ok(Simulation { sim, duration })
    }

    /// What the simulated robot believes of itself: its file's map, or the one its mirror should have.
    pub fn setup(&self) -> Result<Setup> {
        setup_of(&self.sim)
    }

    /// The simulator.
    pub fn sim(&self) -> &Sim {
        &self.sim
    }

    /// How long it runs, seconds.
    pub fn duration(&self) -> f64 {
        self.duration
    }

    /// Runs on in a thread of its own, while what it yielded is being looked at: the same samples, sooner.
    pub fn ahead(self) -> Result<Ahead> {
        let (sender, samples) = sync_channel(LEAD);
        let run = move || {
            let mut parcel = Vec::new();
            for sample in self {
                let ends = matches!(sample, Sample::Frame(_));
                parcel.push(sample);
                // Nobody listens any more: the run was given up.
                if ends && sender.send(std::mem::take(&mut parcel)).is_err() {
                    return;
                }
            }
            drop(sender.send(parcel));
        };
        let thread = std::thread::Builder::new()
            .name("simulator".to_owned())
            .spawn(run)
            .context("cannot start the simulator's thread")?;
        Ok(Ahead {
            samples,
            parcel: Vec::new().into_iter(),
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
        Some(translated(sample))
    }
}

/// A scenario and its robot file, with single values in place of the file's.
pub(crate) fn changed_scenario(
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
    merge(&mut table, over.clone());
    if let Some(seed) = seed {
        let seed = i64::try_from(seed).context("a scenario's seed ends at 2^63")?;
        table.insert("seed".to_owned(), seed.into());
    }
    Ok(Scenario::from_table(table, path)?)
}

/// What the robot of a simulation believes of itself.
pub(crate) fn setup_of(sim: &Sim) -> Result<Setup> {
    let scenario = sim.scenario();
    let mut robot = sim.robot().clone();
    if let Some(field) = &scenario.field {
        robot.field.clone_from(field);
    }
    Setup::new(&scenario.robot, robot, sim.field().clone(), None)
}

/// A simulator's sample in the spine's words.
pub(crate) fn translated(sample: Simulated) -> Sample {
    match sample {
        Simulated::Odometry(odometry) => Sample::Odometry(odometry),
        Simulated::Imu(imu) => Sample::Imu(imu),
        Simulated::Compass(compass) => Sample::Compass(compass),
        Simulated::Command(command) => Sample::Command(command),
        Simulated::Truth(truth) => Sample::Truth(Truth {
            stamp: truth.stamp,
            pose: truth.robot.pose,
            ball: truth.ball.map(|ball| ball.at),
            robots: truth
                .others
                .iter()
                .map(|robot| robot.pose.origin())
                .collect(),
        }),
        Simulated::Image(image) => {
            let picture = Image {
                width_px: image.width_px,
                height_px: image.height_px,
                rgb: image.rgb,
            };
            Sample::Frame(Frame {
                stamp: image.stamp,
                content: Content::Image(picture.into()),
            })
        }
    }
}

/// A scenario that runs in a thread of its own, a few frames ahead.
pub struct Ahead {
    samples: Receiver<Vec<Sample>>,
    parcel: std::vec::IntoIter<Sample>,
    thread: Option<JoinHandle<()>>,
}

impl Iterator for Ahead {
    type Item = Sample;

    fn next(&mut self) -> Option<Sample> {
        loop {
            if let Some(sample) = self.parcel.next() {
                return Some(sample);
            }
            match self.samples.recv() {
                Ok(parcel) => self.parcel = parcel.into_iter(),
                Err(_) => break,
            }
        }
        if let Some(Err(panic)) = self.thread.take().map(JoinHandle::join) {
            std::panic::resume_unwind(panic);
        }
        None
    }
}
