//! `mirrorball sim`: run a scenario as fast as possible and score the localization.

use std::path::{Path, PathBuf};
use std::sync::Arc;
#[cfg(feature = "view")]
use std::time::{Duration, Instant};

use anyhow::{Result, ensure};
use hw::config::Bus;
use localize::Field;
use sim::Simulator;

use crate::commands::arguments;
use crate::commands::inputs::Inputs;
use crate::commands::overrides;
use crate::interrupt;
#[cfg(feature = "view")]
use crate::view::{self, AfterRun};
use crate::virtual_hardware;
use pipeline::config::apply_overlay;
use pipeline::csv_table::{CsvWriter, format_seconds};
use pipeline::log::{ImageCompression, LogConfig};
use pipeline::multi_robot;
use pipeline::result_files::CsvOutputs;
use pipeline::run::{RunScores, ScenarioOptions, ScenarioRun};
use pipeline::simulation::load_single_robot_scenario;
use pipeline::{Cycle, PipelineConfig};

/// Run a scenario headless, as fast as possible.
#[derive(clap::Args)]
#[command(
    after_help = "Example: mirrorball sim config/scenarios/game_18x12.toml --seed 7 --record game.mcap"
)]
pub(crate) struct Args {
    /// The scenario (TOML).
    scenario: PathBuf,
    /// Seed, in place of the scenario's; the same seed gives the same run, bit for bit.
    #[arg(long, value_name = "N", value_parser = arguments::parse_seed, allow_negative_numbers = true)]
    seed: Option<u64>,
    /// Seconds to simulate; overrides the scenario's.
    #[arg(long, value_name = "SECONDS", value_parser = arguments::parse_duration, allow_negative_numbers = true)]
    duration: Option<f64>,
    /// Record everything into a log (MCAP).
    #[arg(long, value_name = "LOG")]
    record: Option<PathBuf>,
    /// Image compression in the log; `replay --verify` recomputes vision from png only.
    #[arg(long, value_parser = arguments::image_mode(), default_value = ImageCompression::default().name(), requires = "record")]
    images: ImageCompression,
    /// Write the estimated poses in the format of `locate`.
    #[arg(long, value_name = "FILE.csv")]
    out: Option<PathBuf>,
    /// Write the true poses: stamp_s,x_m,y_m,theta_rad.
    #[arg(long, value_name = "FILE.csv")]
    truth: Option<PathBuf>,
    /// Simulate the robot's hardware in real time: serial lines and a camera socket in this folder, with the robot.toml
    /// and hardware.toml for `run --robot DIR`. The base board drives the wheels. Excludes `--record`, `--out`, `--config`,
    /// `--preset`, `--set` and `--set-config`: values of the scenario are changed in its file.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["record", "out", "config", "preset", "set", "set_config"])]
    hardware: Option<PathBuf>,
    /// Faults of the hardware and their times (TOML).
    #[arg(long, value_name = "FILE.toml", requires = "hardware")]
    faults: Option<PathBuf>,
    /// Move the robot on the scenario's path; commands to the base board have no effect.
    #[arg(long, requires = "hardware")]
    own_path: bool,
    /// Protocol of the virtual base: our board's, or a VESC per wheel by UART or by an slcan adapter.
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
    /// Override a value of the scenario, as path.speed=2.0; may be given several times. Not with `--hardware`.
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Override a setting, as localize.matching.steps_max=20; may be given several times.
    #[arg(long, value_name = "KEY=VALUE")]
    set_config: Vec<String>,
    /// Show the run in a window, at most in real time; closing the window does not change the run.
    #[cfg(feature = "view")]
    #[arg(long)]
    view: bool,
}

/// Rejects outputs that would replace the scenario or a file that it names.
fn ensure_inputs_kept(args: &Args) -> Result<()> {
    let folder = args.scenario.parent().unwrap_or(Path::new(""));
    let changes = overrides::parse_overrides(&args.set)?;
    let inputs = Inputs::of([&*args.scenario])
        .with_file(args.config.as_deref(), "")
        .with_file(args.faults.as_deref(), "")
        .with_table(&changes, folder);
    let devices = args.hardware.as_deref();
    let [robot, hardware] = ["robot.toml", "hardware.toml"].map(|name| Some(devices?.join(name)));
    inputs.ensure_kept([
        args.record.as_deref(),
        args.out.as_deref(),
        args.truth.as_deref(),
        robot.as_deref(),
        hardware.as_deref(),
    ])
}

/// Simulates the hardware; without --duration until a signal.
fn run_hardware(args: &Args, folder: &Path, json: bool) -> Result<()> {
    let (mut scenario, robot) =
        load_single_robot_scenario(&args.scenario, &toml::Table::new(), args.seed)?;
    if let Some(rate) = args.rate {
        scenario.frame_rate_hz = f64::from(rate);
    }
    let field = Field::load(scenario.field.as_ref().unwrap_or(&robot.field))?;
    let sim = Simulator::new(scenario, robot, field)?;
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
    ensure_inputs_kept(args)?;
    if let Some(folder) = &args.hardware {
        return run_hardware(args, folder, json);
    }
    interrupt::install_handler()?;
    #[cfg(feature = "view")]
    if args.view {
        let run = load_run(args)?;
        let (setup, config) = (run.setup()?, load_config(args)?);
        let robot = if run.is_multi_robot() {
            " (robot 1)"
        } else {
            ""
        };
        let name = format!("sim {}{robot}", args.scenario.display());
        // The window stays open on the last cycle.
        return view::run_with_window(&name, (setup, config), AfterRun::KeepOpen, |feed| {
            let started = Instant::now();
            play(run, args, json, |cycle| {
                // At most real time, for the person who watches.
                let ahead = cycle.stamp.seconds() - started.elapsed().as_secs_f64();
                std::thread::sleep(Duration::from_secs_f64(ahead.clamp(0.0, 1.0)));
                feed.publish(cycle);
            })
        });
    }
    play(load_run(args)?, args, json, |_| {})
}

/// The pipeline's settings: preset, overlay file, single values.
fn load_config(args: &Args) -> Result<PipelineConfig> {
    let config = PipelineConfig::load(&args.preset, args.config.as_deref())?;
    apply_overlay(&config, overrides::parse_overrides(&args.set_config)?)
}

/// Reads and checks the scenario.
fn load_run(args: &Args) -> Result<ScenarioRun> {
    let log_config = LogConfig {
        images: args.images,
        ..LogConfig::default()
    };
    let run = ScenarioRun::load(ScenarioOptions {
        scenario: args.scenario.clone(),
        changes: overrides::parse_overrides(&args.set)?,
        seed: args.seed,
        duration: args.duration,
        config: load_config(args)?,
        record: args.record.clone().map(|path| (path, log_config)),
    })?;
    ensure!(
        !run.is_multi_robot() || (args.out.is_none() && args.truth.is_none()),
        "--out and --truth need a single robot: {} has several. Use --record",
        args.scenario.display()
    );
    Ok(run)
}

/// Runs the scenario; `on_cycle` gets every cycle of the robot, or of the first of several.
fn play(
    run: ScenarioRun,
    args: &Args,
    json: bool,
    mut on_cycle: impl FnMut(&Arc<Cycle>),
) -> Result<()> {
    let mut outputs = CsvOutputs::create(args.out.as_deref(), None, None)?;
    let header = "stamp_s,x_m,y_m,theta_rad";
    let mut truths = args
        .truth
        .as_deref()
        .map(|path| CsvWriter::create(path, header))
        .transpose()?;
    let bar = crate::progress::bar((run.duration() * 1e3) as u64, "ms of play");
    let result = run.run(|progress| {
        bar.set_position((progress.seconds * 1e3) as u64);
        if let Some(cycle) = progress.cycle {
            on_cycle(cycle);
            outputs.write(cycle)?;
            write_truth(&mut truths, cycle)?;
        }
        Ok(interrupt::flow())
    })?;
    bar.finish_and_clear();
    // An interrupted run leaves a complete log, but no incomplete table.
    interrupt::check()?;
    outputs.finish()?;
    truths.map_or(Ok(()), CsvWriter::finish)?;
    for warning in &result.warnings {
        stderr_line!("warning: {warning}");
    }
    if json {
        println!("{}", serde_json::to_string(&result)?);
    } else {
        if let Some(figures) = &result.setup {
            println!("{}", figures.text());
        }
        match &result.scores {
            RunScores::SingleRobot(summary) => summary.print(),
            RunScores::MultiRobot { robots } => multi_robot::print(robots),
        }
        println!(
            "{:.0} s of play, seed {}, {:.1} times real time",
            result.simulated_s, result.seed, result.times_real_time
        );
    }
    Ok(())
}

fn write_truth(truths: &mut Option<CsvWriter>, cycle: &Cycle) -> Result<()> {
    if let (Some(file), Some(truth)) = (truths, &cycle.inputs.truth) {
        let (stamp, pose) = (format_seconds(truth.stamp), truth.pose);
        file.write_row(format_args!(
            "{stamp},{:.5},{:.5},{:.6}",
            pose.x, pose.y, pose.theta
        ))?;
    }
    Ok(())
}
