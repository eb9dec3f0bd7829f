//! How do several of our robots play on one field, each with its own vision and localization?
//!
//! Each robot has its own simulation, which renders its sensors. The first simulation moves the ball and the opponents.
//! The others are synchronised with it every 10 ms. Messages are the datagrams of [`crate::datagram`]. The scenario
//! determines their loss, delay and reordering. Equal seeds give equal bits with any number of threads.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Result;
use localize::Stamp;
use localize::frames::{At, FieldFrame};
use localize::world::TeamColour;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::Serialize;
use sim::scenario::{PlacedRobot, RadioConfig, Scenario, TeammateConfig};
use sim::{SimSample, Simulator};

use crate::config::PipelineConfig;
use crate::cycle::Cycle;
use crate::datagram::TeamLink;
use crate::datagram::TeamLinkConfig;
use crate::log::start_log;
use crate::log::{LogConfig, Recorder};
use crate::pipeline::Pipeline;
use crate::sample::Sample;
use crate::score::summary::{RunStatistics, Summary, figure};
use crate::score::{self, SampleStatistics};
use crate::setup::Setup;
use crate::simulation::{sample_from_sim, setup_from_sim};

/// Period of synchronisation, in which a robot at 5 m/s moves 5 cm.
const SYNC_PERIOD: Stamp = Stamp(10_000_000);
/// Random stream of the radio; the simulations use lower numbers.
const RADIO_STREAM: u64 = 9;
/// A ball is far if every robot is farther from it than this, metres.
const FAR_BALL_DISTANCE: f32 = 4.0;

/// A simulation of several robots of one team.
pub struct MultiRobotSimulation {
    players: Vec<SimulatedRobot>,
    radio: RadioChannel,
    /// Index of our first teammate among the other robots of each simulation.
    first_teammate: usize,
    now: Stamp,
    duration: f64,
}

struct SimulatedRobot {
    sim: Simulator,
    pipeline: Pipeline,
    team_link: TeamLink,
    /// The next sample, whose stamp is after the current synchronisation.
    pending_sample: Option<SimSample>,
    cycles: Vec<Arc<Cycle>>,
    last_sent: Option<Stamp>,
    statistics: RunStatistics,
    ball_errors: BallErrors,
    far_ball_errors: BallErrors,
    recorder: Option<Recorder>,
    error: Option<anyhow::Error>,
}

/// Errors of the ball on the field, metres.
#[derive(Default)]
struct BallErrors {
    own: Vec<f64>,
    team: Vec<f64>,
}

/// Results of one robot.
#[derive(Debug, Serialize)]
pub struct RobotSummary {
    /// Number of the robot, from 1.
    pub robot: usize,
    /// Statistics of its run.
    #[serde(flatten)]
    pub summary: Summary,
    /// Error of its own ball on the field, metres.
    pub own_ball_m: Option<SampleStatistics>,
    /// Error of the team's fused ball, metres.
    pub team_ball_m: Option<SampleStatistics>,
    /// Error of its own ball while the ball was more than 4 m from every robot, metres.
    pub own_far_ball_m: Option<SampleStatistics>,
    /// Error of the team's fused ball while the ball was more than 4 m from every robot, metres.
    pub team_far_ball_m: Option<SampleStatistics>,
    /// Received team messages.
    pub messages: u64,
}

/// Team messages in transit.
struct RadioChannel {
    config: RadioConfig,
    rng: ChaCha8Rng,
    in_flight: Vec<(Stamp, usize, Vec<u8>)>,
}

impl MultiRobotSimulation {
    /// Sets up the scenario's robots. `record`: path of the first robot's log; the others are numbered in the same folder.
    pub fn new(
        (path, scenario): (&Path, &Scenario),
        config: &PipelineConfig,
        duration: f64,
        record: Option<(&Path, &LogConfig)>,
    ) -> Result<Self> {
        let count = scenario.squad.len() + 1;
        let mut players = Vec::with_capacity(count);
        for index in 0..count {
            let sim = simulator_of_robot(scenario, index)?;
            let setup = setup_from_sim(&sim)?;
            let number = index as u32 + 1;
            let mut config = config.clone();
            config.team.number = number;
            let link = TeamLinkConfig {
                robot: number,
                ..TeamLinkConfig::default()
            };
            let recorder = record
                .map(|(log, log_config)| {
                    let source = format!("sim {} (robot {number})", path.display());
                    let seed = Some(scenario.seed);
                    start_log(
                        &log_path(log, index),
                        &source,
                        seed,
                        (&setup, &config),
                        log_config,
                    )
                })
                .transpose()?;
            players.push(SimulatedRobot {
                sim,
                pipeline: Pipeline::new(&setup, &config)?,
                team_link: TeamLink::new(&link, 1)?,
                pending_sample: None,
                cycles: Vec::new(),
                last_sent: None,
                statistics: RunStatistics::new(&setup),
                ball_errors: BallErrors::default(),
                far_ball_errors: BallErrors::default(),
                recorder,
                error: None,
            });
        }
        let mut rng = ChaCha8Rng::seed_from_u64(scenario.seed);
        rng.set_stream(RADIO_STREAM);
        Ok(MultiRobotSimulation {
            players,
            radio: RadioChannel {
                config: scenario.radio,
                rng,
                in_flight: Vec::new(),
            },
            first_teammate: scenario.others.placed.len(),
            now: Stamp(0),
            duration,
        })
    }

    /// Runs until the end, or until `on_progress` breaks. It receives the simulated time in seconds.
    ///
    /// The logs are complete in both cases.
    pub fn run(
        self,
        on_progress: impl FnMut(f64) -> Result<ControlFlow<()>>,
    ) -> Result<Vec<RobotSummary>> {
        self.run_observed(on_progress, |_, _| {})
    }

    /// The same; `on_cycle` receives each cycle with the index of its robot.
    pub fn run_observed(
        mut self,
        mut on_progress: impl FnMut(f64) -> Result<ControlFlow<()>>,
        mut on_cycle: impl FnMut(usize, &Arc<Cycle>),
    ) -> Result<Vec<RobotSummary>> {
        while self.now.seconds() < self.duration {
            self.tick(&mut on_cycle)?;
            if on_progress(self.now.seconds())?.is_break() {
                break;
            }
        }
        let summarize = |(index, player): (usize, SimulatedRobot)| {
            player.recorder.map(Recorder::finish).transpose()?;
            Ok(RobotSummary {
                robot: index + 1,
                summary: player.statistics.summary(),
                own_ball_m: score::sample_statistics(player.ball_errors.own),
                team_ball_m: score::sample_statistics(player.ball_errors.team),
                own_far_ball_m: score::sample_statistics(player.far_ball_errors.own),
                team_far_ball_m: score::sample_statistics(player.far_ball_errors.team),
                messages: player.team_link.counts().received,
            })
        };
        self.players
            .into_iter()
            .enumerate()
            .map(summarize)
            .collect()
    }

    fn tick(&mut self, on_cycle: &mut impl FnMut(usize, &Arc<Cycle>)) -> Result<()> {
        self.now = Stamp(self.now.0 + SYNC_PERIOD.0);
        let (now, duration) = (self.now, self.duration);
        self.players
            .par_iter_mut()
            .for_each(|player| player.advance(now, duration));
        self.exchange_messages();
        let players = self.players.iter().map(|player| player.sim.truth());
        let truths: Vec<_> = players.collect();
        let others = truths[0].others.clone();
        let from = self.first_teammate;
        for (index, player) in self.players.iter_mut().enumerate() {
            let mut others = others.clone();
            let own = truths.iter().map(|truth| truth.robot);
            let teammates = own.enumerate().filter(|(other, _)| *other != index);
            for (place, (_, teammate)) in others[from..].iter_mut().zip(teammates) {
                *place = teammate;
            }
            let ball = truths[0].ball.filter(|_| index > 0);
            player
                .sim
                .synchronise_others(&others, &truths[0].people, ball);
        }
        for index in 0..self.players.len() {
            self.score_robot(index, on_cycle)?;
        }
        Ok(())
    }

    /// Sends team messages that are due and delivers those that arrive.
    fn exchange_messages(&mut self) {
        let (now, count) = (self.now, self.players.len());
        for from in 0..count {
            let player = &mut self.players[from];
            let Some(cycle) = player.cycles.last() else {
                continue;
            };
            let period = 1.0 / self.radio.config.rate_hz;
            if player.last_sent.is_some_and(|last| now - last < period) {
                continue;
            }
            player.last_sent = Some(now);
            let message = player.team_link.encode_message(cycle, now);
            self.radio.send(now, from, count, &message);
        }
        for (to, message) in self.radio.take_arrived(now) {
            let player = &mut self.players[to];
            // The link counts refusals.
            if let Ok(report) = player.team_link.receive(&message, now) {
                player.pipeline.process_sample(Sample::TeamReport(report));
            }
        }
    }

    fn score_robot(
        &mut self,
        index: usize,
        on_cycle: &mut impl FnMut(usize, &Arc<Cycle>),
    ) -> Result<()> {
        let places = self.players.iter().map(|player| player.sim.truth());
        let places: Vec<_> = places.map(|truth| truth.robot.pose.origin()).collect();
        let player = &mut self.players[index];
        if let Some(fault) = player.error.take() {
            return Err(fault);
        }
        for cycle in std::mem::take(&mut player.cycles) {
            on_cycle(index, &cycle);
            player
                .statistics
                .add_cycle(&cycle, score::cycle_error(&cycle));
            let Some(ball) = cycle.inputs.truth.as_ref().and_then(|truth| truth.ball) else {
                continue;
            };
            player.ball_errors.add_cycle(&cycle, ball);
            if places
                .iter()
                .all(|at| at.distance_to(ball) > FAR_BALL_DISTANCE)
            {
                player.far_ball_errors.add_cycle(&cycle, ball);
            }
        }
        Ok(())
    }
}

impl BallErrors {
    /// Adds the robot's and the team's ball, where they are known, of a cycle with the ball at `truth`.
    fn add_cycle(&mut self, cycle: &Cycle, truth: At<FieldFrame>) {
        let own = cycle.world.ball.and_then(|ball| ball.on_field);
        let own = own.map(|own| f64::from(own.at.distance_to(truth)));
        let team = cycle.team.ball.as_ref();
        let team = team.map(|team| f64::from(team.at.distance_to(truth)));
        self.own.extend(own);
        self.team.extend(team);
    }
}

impl SimulatedRobot {
    /// Runs simulation and pipeline until `now`, and ends before `duration` (seconds) as the run of a single robot does.
    fn advance(&mut self, now: Stamp, duration: f64) {
        loop {
            let sample = match self.pending_sample.take() {
                Some(sample) => sample,
                None => self.sim.next_sample(),
            };
            if sample.stamp() > now || sample.stamp().seconds() >= duration {
                self.pending_sample = Some(sample);
                return;
            }
            let Some(cycle) = self
                .pipeline
                .process_sample(sample_from_sim(sample))
                .map(Arc::new)
            else {
                continue;
            };
            if let Some(recorder) = &mut self.recorder
                && let Err(fault) = recorder.record_cycle(cycle.clone())
            {
                self.error = Some(fault);
            }
            self.cycles.push(cycle);
        }
    }
}

impl RadioChannel {
    fn send(&mut self, now: Stamp, from: usize, count: usize, message: &[u8]) {
        let [soonest, latest] = self.config.delay;
        for to in (0..count).filter(|to| *to != from) {
            let (lost, late) = (self.rng.random::<f32>(), self.rng.random::<f64>());
            if lost >= self.config.loss {
                let delay = soonest + late * (latest - soonest);
                let arrival = Stamp(now.0 + Stamp::from_seconds(delay).0);
                self.in_flight.push((arrival, to, message.to_vec()));
            }
        }
    }

    /// Messages that have arrived, in the order of arrival.
    fn take_arrived(&mut self, now: Stamp) -> Vec<(usize, Vec<u8>)> {
        self.in_flight
            .sort_by_key(|(arrival, to, _)| (*arrival, *to));
        let due = self
            .in_flight
            .partition_point(|(arrival, _, _)| *arrival <= now);
        let messages = self.in_flight.drain(..due);
        messages.map(|(_, to, message)| (to, message)).collect()
    }
}

/// The scenario of robot `index`: that robot is simulated, and its teammates are obstacles that the caller moves.
fn scenario_for_robot(scenario: &Scenario, index: usize) -> Scenario {
    let first = TeammateConfig {
        start: scenario.start,
        path: scenario.path.clone(),
        mount: scenario.mount,
    };
    let team: Vec<&TeammateConfig> = std::iter::once(&first).chain(&scenario.squad).collect();
    let mut own = scenario.clone();
    let teammate = team[index];
    (own.start, own.mount) = (teammate.start, teammate.mount);
    own.path.clone_from(&teammate.path);
    own.squad.clear();
    // Each robot has its own sensor noise. The first simulation alone determines the opponents' behaviour.
    own.seed = scenario.seed.wrapping_add(index as u64);
    if index > 0 {
        own.kidnaps.clear();
        own.knocks.clear();
        own.pushes.clear();
        own.occlusions.clear();
        own.faults.clear();
    }
    let teammates = team.iter().enumerate().filter(|(other, _)| *other != index);
    own.others
        .placed
        .extend(teammates.map(|(_, teammate)| PlacedRobot {
            x: teammate.start.x,
            y: teammate.start.y,
            theta_deg: teammate.start.theta_deg,
            team: TeamColour::Cyan,
            stands: true,
        }));
    own
}

/// The simulation of robot `index`.
fn simulator_of_robot(scenario: &Scenario, index: usize) -> Result<Simulator> {
    let own = scenario_for_robot(scenario, index);
    let robot = localize::robot::RobotConfig::load(&own.robot)?;
    let field = localize::Field::load(own.field.as_ref().unwrap_or(&robot.field))?;
    Ok(Simulator::new(own, robot, field)?)
}

/// Setup of the first robot.
pub fn first_setup(scenario: &Scenario) -> Result<Setup> {
    setup_from_sim(&simulator_of_robot(scenario, 0)?)
}

/// `game.mcap`, `game-2.mcap`, `game-3.mcap`, …
fn log_path(log: &Path, index: usize) -> PathBuf {
    if index == 0 {
        return log.to_owned();
    }
    let stem = log.file_stem().unwrap_or_default().to_string_lossy();
    let mut name = format!("{stem}-{}", index + 1);
    if let Some(ending) = log.extension() {
        name = format!("{name}.{}", ending.to_string_lossy());
    }
    log.with_file_name(name)
}

/// Prints the results of all robots.
pub fn print(summaries: &[RobotSummary]) {
    println!("{}", table(summaries));
}

/// One row for each robot: mean errors in metres and degrees.
fn table(summaries: &[RobotSummary]) -> String {
    let mut lines = vec![
        "robot  frames  tracking  position  heading  ball: own    team  far: own    team  messages"
            .to_owned(),
    ];
    for robot in summaries {
        let summary = &robot.summary;
        let mean = |statistics: Option<SampleStatistics>, decimals, unit, scale: f64| {
            let mean = statistics.map(|statistics| scale * statistics.mean);
            let unit = if mean.is_some() { unit } else { "" };
            format!("{}{unit}", figure(mean, decimals))
        };
        let metres = |statistics| mean(statistics, 3, " m", 1.0);
        let degrees = |statistics| mean(statistics, 2, "°", 1f64.to_degrees());
        lines.push(format!(
            "{:>5} {:>7} {:>9} {:>9} {:>8} {:>10} {:>7} {:>9} {:>7} {:>9}",
            robot.robot,
            summary.frames,
            summary.tracking,
            metres(summary.position_error_m),
            degrees(summary.heading_error_rad),
            metres(robot.own_ball_m),
            metres(robot.team_ball_m),
            metres(robot.own_far_ball_m),
            metres(robot.team_far_ball_m),
            robot.messages
        ));
    }
    lines.push(format!(
        "means; far: while the ball is more than {FAR_BALL_DISTANCE} m from every robot"
    ));
    lines.join("\n")
}

#[cfg(test)]
mod tests;
