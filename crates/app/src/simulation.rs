//! A simulated robot as a source: the simulator's samples in the spine's words.

use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, Result};
use localize::Field;
use sim::{Sample as Simulated, Scenario, Sim};
use vision::image::Image;

use crate::cycle::merge;
use crate::sample::{Content, Frame, Sample, Truth};
use crate::setup::Setup;

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
        let text = std::fs::read_to_string(scenario)
            .with_context(|| format!("cannot read {}", scenario.display()))?;
        let mut table: toml::Table =
            toml::from_str(&text).with_context(|| scenario.display().to_string())?;
        merge(&mut table, over.clone());
        if let Some(seed) = seed {
            let seed = i64::try_from(seed).context("a scenario's seed ends at 2^63")?;
            table.insert("seed".to_owned(), seed.into());
        }
        let (scenario, robot) = Scenario::from_table(table, scenario)?;
        let field = Field::load(scenario.field.as_ref().unwrap_or(&robot.field))?;
        let duration = duration.unwrap_or(scenario.duration);
        let sim = Sim::new(scenario, robot, field)?;
        Ok(Simulation { sim, duration })
    }

    /// What the simulated robot believes of itself: its file's map, or the one its mirror should have.
    pub fn setup(&self) -> Result<Setup> {
        let scenario = self.sim.scenario();
        let mut robot = self.sim.robot().clone();
        if let Some(field) = &scenario.field {
            robot.field.clone_from(field);
        }
        Setup::new(&scenario.robot, robot, self.sim.field().clone(), None)
    }

    /// The simulator.
    pub fn sim(&self) -> &Sim {
        &self.sim
    }

    /// How long it runs, seconds.
    pub fn duration(&self) -> f64 {
        self.duration
    }
}

impl Iterator for Simulation {
    type Item = Sample;

    fn next(&mut self) -> Option<Sample> {
        let sample = self.sim.next_sample();
        if sample.stamp().seconds() >= self.duration {
            return None;
        }
        Some(match sample {
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
                    content: Content::Image(Arc::new(picture)),
                })
            }
        })
    }
}
