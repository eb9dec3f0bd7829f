//! `mirrorball demo`: a simulated minute and a recorded drive, with pictures and a log.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context, Result};
use localize::frames::{At, FieldFrame};
use serde::Serialize;
use vision::image::Image;

use crate::commands::arguments;
use crate::commands::locate::EXTERNAL_POINT_STD;
use crate::interrupt;
use crate::pictures::annotate::draw_detections;
use crate::pictures::field::{FieldDrawing, ink, side_by_side};
use pipeline::doubted_poses::DoubtedPoses;
use pipeline::log::start_log;
use pipeline::log::{ImageCompression, LogConfig};
use pipeline::paths;
use pipeline::recording::Recording;
use pipeline::score;
use pipeline::score::summary::{RunStatistics, Summary};
use pipeline::setup::Setup;
use pipeline::setup_check::{self, Effort, KeyframeCollector};
use pipeline::simulation::Simulation;
use pipeline::{Cycle, Pipeline, PipelineConfig};

/// Locate the robot in a simulated minute with moving opponents, then on recorded images.
///
/// Writes a log (demo.mcap) and two pictures: the field with the true and the estimated path next to a camera image with
/// the detections.
#[derive(clap::Args)]
#[command(after_help = "Example: mirrorball demo --seed 3 --out out/demo")]
pub(crate) struct Args {
    /// Seed; overrides the scenario's.
    #[arg(long, value_name = "N", value_parser = arguments::parse_seed, allow_negative_numbers = true)]
    seed: Option<u64>,
    /// Seconds to simulate.
    #[arg(long, value_name = "SECONDS", value_parser = arguments::parse_duration, allow_negative_numbers = true)]
    duration: Option<f64>,
    /// Folder for log and pictures.
    #[arg(long, value_name = "DIR", default_value = "out/demo")]
    out: PathBuf,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Outcome {
    seed: u64,
    simulated_s: f64,
    times_real_time: f64,
    play: Summary,
    recording: Summary,
    /// Sentences about a doubtful set-up; empty when all is well.
    warnings: Vec<String>,
    log: PathBuf,
    pictures: [PathBuf; 2],
}

/// Runs the command.
pub(crate) fn run(args: &Args, json: bool) -> Result<()> {
    let scenario = paths::find_resource("config/scenarios/demo.toml")?;
    let sample = paths::find_resource("samples/sequence")?;
    std::fs::create_dir_all(&args.out)
        .with_context(|| format!("cannot make {}", args.out.display()))?;
    let log = args.out.join("demo.mcap");
    let pictures = ["play.png", "recording.png"].map(|name| args.out.join(name));

    interrupt::install_handler()?;
    let simulation = Simulation::load(&scenario, args.seed, args.duration)?;
    let (seed, duration) = (simulation.sim().scenario().seed, simulation.duration());
    let setup = simulation.setup()?;
    let config = PipelineConfig::default();
    let log_config = LogConfig {
        images: ImageCompression::Jpeg,
        ..LogConfig::default()
    };
    let mut recorder = start_log(&log, "demo", Some(seed), (&setup, &config), &log_config)?;
    let bar = crate::progress::bar((duration * 1e3) as u64, "ms simulated");
    let started = Instant::now();
    let mut play = RunTrace::new(&setup);
    let mut keyframes = KeyframeCollector::new(&setup, &config.localize.filter);
    let mut doubted = DoubtedPoses::default();
    let mut pipeline = Pipeline::new(&setup, &config)?;
    simulation.run(&mut pipeline, |cycle| {
        let cycle = Arc::new(cycle);
        bar.set_position((cycle.stamp.seconds() * 1e3) as u64);
        play.add(&cycle);
        keyframes.add_cycle(&cycle);
        doubted.add(&cycle);
        recorder.record_cycle(cycle)?;
        Ok(interrupt::flow())
    })?;
    bar.finish_and_clear();
    interrupt::check()?;
    let times_real_time = duration / started.elapsed().as_secs_f64();
    recorder.finish()?;
    let keyframes = keyframes.keyframes();
    let checked = setup_check::check(&setup, &config, &keyframes, Effort::Brief);
    play.picture(&setup)?.save(&pictures[0])?;

    let setup = Setup::load(&sample.join("robot.toml"), None)?;
    let recording = Recording::open(&sample, EXTERNAL_POINT_STD)?;
    let mut pipeline = Pipeline::new(&setup, &config)?;
    let mut replay = RunTrace::new(&setup);
    for cycle in recording.filter_map(|sample| pipeline.process_sample(sample)) {
        replay.add(&Arc::new(cycle));
        interrupt::check()?;
    }
    replay.picture(&setup)?.save(&pictures[1])?;

    let (play, recording) = (play.statistics.summary(), replay.statistics.summary());
    if json {
        let outcome = Outcome {
            seed,
            simulated_s: duration,
            times_real_time,
            play,
            recording,
            warnings: checked
                .warnings
                .into_iter()
                .chain(doubted.warning())
                .collect(),
            log,
            pictures,
        };
        println!("{}", serde_json::to_string(&outcome)?);
        return Ok(());
    }
    println!("{duration:.0} s simulated, seed {seed}, {times_real_time:.1} times real time");
    play.print();
    println!("\nrecorded images ({})", sample.display());
    recording.print();
    println!("\nlog:      {}", log.display());
    for picture in &pictures {
        println!("picture:  {}", picture.display());
    }
    Ok(())
}

/// What a picture of a run needs.
struct RunTrace {
    truth: Vec<At<FieldFrame>>,
    estimates: Vec<At<FieldFrame>>,
    statistics: RunStatistics,
    /// The cycle with the most detections, and its score.
    best_cycle: Option<(usize, Arc<Cycle>)>,
}

impl RunTrace {
    fn new(setup: &Setup) -> Self {
        RunTrace {
            truth: Vec::new(),
            estimates: Vec::new(),
            statistics: RunStatistics::new(setup),
            best_cycle: None,
        }
    }

    fn add(&mut self, cycle: &Arc<Cycle>) {
        self.statistics.add_cycle(cycle, score::cycle_error(cycle));
        self.truth
            .extend(cycle.inputs.truth.as_ref().map(|truth| truth.pose.origin()));
        self.estimates
            .extend(cycle.estimate.pose.map(|pose| pose.origin()));
        let Some(detections) = &cycle.detections else {
            return;
        };
        // Ball and robots weigh more in a picture than line points.
        let score = detections.line_points.len()
            + 40 * (detections.robots.len() + 2 * usize::from(detections.ball.is_some()));
        if self
            .best_cycle
            .as_ref()
            .is_none_or(|(best, _)| score > *best)
        {
            self.best_cycle = Some((score, cycle.clone()));
        }
    }

    fn picture(&self, setup: &Setup) -> Result<Image> {
        let mut field =
            FieldDrawing::new(&setup.field, 1200).context("the field is too large to draw")?;
        field.path(self.truth.iter().copied(), ink::truth(), 5.0);
        field.path(self.estimates.iter().copied(), ink::estimate(), 2.0);
        field.text(12, 10, "true path", ink::line());
        field.text(12, 30, "estimated path", ink::estimate());
        let Some((_, cycle)) = &self.best_cycle else {
            return Ok(field.finish());
        };
        let truth = cycle.inputs.truth.as_ref();
        if let Some(ball) = truth.and_then(|truth| truth.ball) {
            field.dot(ball, ink::ball(), 6.0);
        }
        for robot in truth.iter().flat_map(|truth| &truth.robots) {
            field.dot(*robot, ink::global(), 10.0);
        }
        if let Some(pose) = cycle.estimate.pose {
            field.dot(pose.origin(), ink::estimate(), 9.0);
        }
        let camera = draw_detections(cycle, setup);
        let field = field.finish();
        Ok(camera.map_or_else(|| field.clone(), |camera| side_by_side(&field, &camera)))
    }
}
