//! `mirrorball sim`: run a scenario as fast as possible and score the localization.

use std::path::{Path, PathBuf};
use std::sync::Arc;
#[cfg(feature = "view")]
use std::time::Duration;
use std::time::Instant;

use anyhow::{Result, ensure};
use hw::config::Bus;
use localize::Field;
use serde::Serialize;
use sim::Sim;
use sim::scenario::Scenario;

use crate::commands::arguments;
use crate::commands::overrides;
use crate::interrupt;
#[cfg(feature = "view")]
use crate::view::{self, AfterRun};
use crate::virtual_hardware;
use pipeline::csv_table::{CsvWriter, format_seconds};
use pipeline::cycle::{Cycle, Pipeline, PipelineConfig, apply_overlay};
use pipeline::log::start_log;
use pipeline::log::{ImageCompression, LogConfig, Recorder};
use pipeline::multi_robot::{self, MultiRobotSimulation};
use pipeline::result_files::CsvOutputs;
use pipeline::score;
use pipeline::score::summary::{RunStatistics, Summary};
use pipeline::simulation::{Simulation, load_scenario_with_overrides};

/// Run a scenario headless, as fast as possible.
#[derive(clap::Args)]
#[command(
    after_help = "Example: mirrorball sim config/scenarios/game_18x12.toml --seed 7 --record game.mcap"
)]
pub(crate) struct Args {
    /// The scenario (TOML).
    scenario: PathBuf,
    /// Seed; overrides the scenario's. Equal seeds give bit-identical runs.
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Seconds to simulate; overrides the scenario's.
    #[arg(long, value_name = "SECONDS", value_parser = arguments::parse_duration, allow_negative_numbers = true)]
    duration: Option<f64>,
    /// Record everything into a log (MCAP).
    #[arg(long, value_name = "LOG")]
    record: Option<PathBuf>,
    /// Image format of the log; only lossless images let `replay --verify` compute vision again.
    #[arg(long, value_parser = arguments::image_mode(), default_value = ImageCompression::default().name(), requires = "record")]
    images: ImageCompression,
    /// Write the estimated poses in the format of `locate`.
    #[arg(long, value_name = "FILE.csv")]
    out: Option<PathBuf>,
    /// Write the true poses: stamp_s,x_m,y_m,theta_rad.
    #[arg(long, value_name = "FILE.csv")]
    truth: Option<PathBuf>,
    /// Simulate the robot's devices in this folder, in real time: serial ports and a camera socket, with the robot.toml
    /// and hardware.toml for `run --robot DIR`. The wheels follow the commands to the base board.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["record", "out", "config", "preset", "set", "set_config"])]
    hardware: Option<PathBuf>,
    /// Fault plan of the hardware (TOML).
    #[arg(long, value_name = "FILE.toml", requires = "hardware")]
    faults: Option<PathBuf>,
    /// The scenario's path moves the robot instead of the commands to the base board.
    #[arg(long, requires = "hardware")]
    own_path: bool,
    /// Bus of the virtual base: our board's protocol, or a VESC for each wheel by UART or by an slcan adapter.
    #[arg(long, value_name = "BUS", value_parser = ["board", "vesc-uart", "vesc-slcan"], default_value = "board", requires = "hardware")]
    base: String,
    /// Pixel format of the virtual camera.
    #[arg(long, value_name = "FORMAT", value_parser = ["RGB3", "YUYV"], default_value = "RGB3", requires = "hardware")]
    format: String,
    /// Images per second of the virtual camera; overrides the scenario's.
    #[arg(long, value_name = "HZ", value_parser = clap::value_parser!(u16).range(1..=1000), requires = "hardware")]
    rate: Option<u16>,
    /// Localization method: the default, or that of a paper (lima2001, minho2016, nubot2013).
    #[arg(long, value_name = "NAME", value_parser = localize::presets::PRESETS, default_value = "default")]
    preset: String,
    /// Override settings of vision and localization by a TOML file.
    #[arg(long, value_name = "FILE.toml")]
    config: Option<PathBuf>,
    /// Override a value of the scenario, as path.speed=2.0; may be given several times.
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Override a setting, as localize.matching.steps_max=20; may be given several times.
    #[arg(long, value_name = "KEY=VALUE")]
    set_config: Vec<String>,
    /// Show the run in a window, at most in real time; closing the window does not end the run.
    #[cfg(feature = "view")]
    #[arg(long)]
    view: bool,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Outcome {
    seed: u64,
    simulated_s: f64,
    times_real_time: f64,
    #[serde(flatten)]
    summary: Summary,
}

/// What `--json` prints for several robots.
#[derive(Serialize)]
struct MultiRobotOutcome {
    seed: u64,
    simulated_s: f64,
    times_real_time: f64,
    robots: Vec<multi_robot::RobotSummary>,
}

/// Simulates several robots of ours, each with its own pipeline.
fn run_multi_robot(args: &Args, scenario: &Scenario, json: bool) -> Result<()> {
    ensure!(
        args.out.is_none() && args.truth.is_none(),
        "--out and --truth need a scenario with one robot: {} has several. Use --record",
        args.scenario.display()
    );
    let config = PipelineConfig::load(&args.preset, args.config.as_deref())?;
    let config = apply_overlay(&config, overrides::parse_overrides(&args.set_config)?)?;
    let duration = args.duration.unwrap_or(scenario.duration);
    let log_config = LogConfig {
        images: args.images,
        ..LogConfig::default()
    };
    let record = args.record.as_deref().map(|log| (log, &log_config));
    let simulation =
        MultiRobotSimulation::new((&args.scenario, scenario), &config, duration, record)?;
    let bar = crate::progress::bar((duration * 1e3) as u64, "ms simulated");
    let started = Instant::now();
    let robots = simulation.run(|seconds| bar.set_position((seconds * 1e3) as u64))?;
    bar.finish_and_clear();
    let times_real_time = duration / started.elapsed().as_secs_f64();
    let seed = scenario.seed;
    if json {
        let outcome = MultiRobotOutcome {
            seed,
            simulated_s: duration,
            times_real_time,
            robots,
        };
        println!("{}", serde_json::to_string(&outcome)?);
    } else {
        multi_robot::print(&robots);
        println!("{duration:.0} s simulated, seed {seed}, {times_real_time:.1} times real time");
    }
    Ok(())
}

/// Runs the virtual hardware; without --duration until a signal.
fn run_hardware(args: &Args, folder: &Path, json: bool) -> Result<()> {
    let (mut scenario, robot) = Scenario::load(&args.scenario)?;
    scenario.seed = args.seed.unwrap_or(scenario.seed);
    if let Some(rate) = args.rate {
        scenario.frame_rate_hz = f64::from(rate);
    }
    let field = Field::load(scenario.field.as_ref().unwrap_or(&robot.field))?;
    let sim = Sim::new(scenario, robot, field)?;
    let options = virtual_hardware::Options {
        folder,
        faults: args.faults.as_deref(),
        own_path: args.own_path,
        bus: match args.base.as_str() {
            "vesc-uart" => Bus::VescUart,
            "vesc-slcan" => Bus::VescSlcan,
            _ => Bus::Board,
        },
        format: &args.format,
        truth: args.truth.as_deref(),
    };
    let duration = args.duration.unwrap_or(f64::INFINITY);
    virtual_hardware::run(sim, duration, &options, json)
}

/// Runs the command.
pub(crate) fn run(args: &Args, json: bool) -> Result<()> {
    arguments::ensure_distinct_outputs([
        args.record.as_deref(),
        args.out.as_deref(),
        args.truth.as_deref(),
    ])?;
    if let Some(folder) = &args.hardware {
        return run_hardware(args, folder, json);
    }
    interrupt::install_handler()?;
    #[cfg(feature = "view")]
    if args.view {
        let changes = overrides::parse_overrides(&args.set)?;
        let simulation = Simulation::with_overrides(&args.scenario, &changes, args.seed, None)?;
        let setup = simulation.setup()?;
        let config = PipelineConfig::load(&args.preset, args.config.as_deref())?;
        let config = apply_overlay(&config, overrides::parse_overrides(&args.set_config)?)?;
        let name = format!("sim {}", args.scenario.display());
        // The window stays open at the last cycle.
        return view::run_with_window(&name, (setup, config), AfterRun::KeepOpen, |feed| {
            let started = Instant::now();
            play(args, json, |cycle| {
                // The window shows the run in real time at most.
                let ahead = cycle.stamp.seconds() - started.elapsed().as_secs_f64();
                std::thread::sleep(Duration::from_secs_f64(ahead.clamp(0.0, 1.0)));
                feed.publish(cycle);
            })
        });
    }
    play(args, json, |_| {})
}

/// Runs the scenario; `watch` gets every cycle.
fn play(args: &Args, json: bool, mut watch: impl FnMut(&Arc<Cycle>)) -> Result<()> {
    let changes = overrides::parse_overrides(&args.set)?;
    let (scenario, _) = load_scenario_with_overrides(&args.scenario, &changes, args.seed)?;
    if !scenario.squad.is_empty() {
        return run_multi_robot(args, &scenario, json);
    }
    let simulation =
        Simulation::with_overrides(&args.scenario, &changes, args.seed, args.duration)?;
    let setup = simulation.setup()?;
    let config = PipelineConfig::load(&args.preset, args.config.as_deref())?;
    let config = apply_overlay(&config, overrides::parse_overrides(&args.set_config)?)?;
    let mut spine = Pipeline::new(&setup, &config)?;
    let (seed, duration) = (simulation.sim().scenario().seed, simulation.duration());
    let mut outputs = CsvOutputs::create(args.out.as_deref(), None, None)?;
    let header = "stamp_s,x_m,y_m,theta_rad";
    let mut truths = args
        .truth
        .as_deref()
        .map(|path| CsvWriter::create(path, header))
        .transpose()?;
    let source = format!("sim {}", args.scenario.display());
    let log_config = LogConfig {
        images: args.images,
        ..LogConfig::default()
    };
    let start = |path| start_log(path, &source, Some(seed), (&setup, &config), &log_config);
    let mut recorder = args.record.as_deref().map(start).transpose()?;
    let mut tally = RunStatistics::default();
    let bar = crate::progress::bar((duration * 1e3) as u64, "ms simulated");
    let started = Instant::now();
    simulation.run(&mut spine, |cycle| {
        let cycle = Arc::new(cycle);
        watch(&cycle);
        tally.add_cycle(&cycle, score::cycle_error(&cycle));
        outputs.write(&cycle)?;
        if let (Some(file), Some(truth)) = (&mut truths, &cycle.inputs.truth) {
            let (stamp, pose) = (format_seconds(truth.stamp), truth.pose);
            file.write_row(format_args!(
                "{stamp},{:.5},{:.5},{:.6}",
                pose.x, pose.y, pose.theta
            ))?;
        }
        bar.set_position((cycle.stamp.seconds() * 1e3) as u64);
        if let Some(recorder) = &mut recorder {
            recorder.record_cycle(cycle)?;
        }
        Ok(interrupt::flow())
    })?;
    bar.finish_and_clear();
    // An interrupted run leaves its log, but no incomplete table.
    recorder.map(Recorder::finish).transpose()?;
    interrupt::check()?;
    outputs.finish()?;
    truths.map_or(Ok(()), CsvWriter::finish)?;
    let times_real_time = duration / started.elapsed().as_secs_f64();
    let summary = tally.summary();
    if json {
        let outcome = Outcome {
            seed,
            simulated_s: duration,
            times_real_time,
            summary,
        };
        println!("{}", serde_json::to_string(&outcome)?);
    } else {
        summary.print();
        println!("{duration:.0} s simulated, seed {seed}, {times_real_time:.1} times real time");
    }
    Ok(())
}
