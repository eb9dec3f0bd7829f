//! `mirrorball replay`: verify a log by computing it again, or export it as a recording folder.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use serde::Serialize;

use pipeline::csv_table::format_seconds;
use pipeline::doubted_poses::DoubtedPoses;
use pipeline::log::{
    self, Difference, LogCompleteness, LogReader, UnpackedSetup, VerificationReport,
};
use pipeline::sample::Sample;
use pipeline::setup_check::{self, KeyframeCollector};
use pipeline::{Pipeline, PipelineConfig};

use super::arguments::UsageError;
use super::inputs::Inputs;
use crate::ros2::bag::{self, BagSummary};

/// Compute a log again: verify that the estimates are bit-identical, or export it as a recording folder.
#[derive(clap::Args)]
#[command(
    after_help = "Example: mirrorball replay game.mcap --verify\n         mirrorball replay game.mcap --export game/\n         mirrorball replay game.mcap --export game_ros.mcap --format ros2"
)]
pub(crate) struct Args {
    /// The log.
    log: PathBuf,
    /// Compute every estimate again and compare it bit by bit (the default).
    #[arg(long)]
    verify: bool,
    /// Write the log as a recording folder, or as a ROS 2 bag.
    #[arg(long, value_name = "DIR|BAG.mcap")]
    export: Option<PathBuf>,
    /// What to export: a recording folder, or a ROS 2 bag (an MCAP file).
    #[arg(long, value_enum, default_value_t = ExportFormat::Recording, requires = "export")]
    format: ExportFormat,
    /// Show the log in a window, with the recomputed run next to the recorded one.
    #[cfg(feature = "view")]
    #[arg(long, conflicts_with_all = ["verify", "export"])]
    view: bool,
}

/// What `--export` writes.
#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum ExportFormat {
    /// Images and CSV files.
    Recording,
    /// A bag of ROS 2.
    Ros2,
}

/// What `--json` prints.
#[derive(Serialize, Default)]
struct Outcome {
    #[serde(skip_serializing_if = "Option::is_none")]
    verified: Option<VerifyOutcome>,
    #[serde(skip_serializing_if = "Option::is_none")]
    exported: Option<ExportOutcome>,
    /// The bag that was written.
    #[serde(skip_serializing_if = "Option::is_none")]
    bag: Option<BagSummary>,
    /// Sentences about a doubtful set-up; empty when all is well.
    warnings: Vec<String>,
}

#[derive(Serialize)]
struct VerifyOutcome {
    identical: bool,
    cycles: u64,
    vision_cycles: u64,
    different: u64,
    unverified: u64,
    /// Seconds: stamps of the cycles after gaps from which the estimates are verified.
    verified_from_s: Vec<f64>,
    whole: bool,
}

#[derive(Serialize)]
struct ExportOutcome {
    frames: u64,
    odometry: u64,
    whole: bool,
}

/// Runs the command.
pub(crate) fn run(args: &Args, json: bool) -> Result<()> {
    #[cfg(feature = "view")]
    if args.view {
        return crate::view::show_recomputed(&args.log);
    }
    let mut summary = Outcome::default();
    if let (Some(path), ExportFormat::Ros2) = (&args.export, args.format) {
        summary.bag = Some(export_bag(&args.log, path, json)?);
    } else if let Some(folder) = &args.export {
        let exported = log::export(LogReader::open(&args.log)?, folder)?;
        let whole = exported.end == LogCompleteness::Complete;
        if !json {
            let cut = if whole {
                ""
            } else {
                " (the log is truncated: up to its last complete chunk)"
            };
            println!(
                "{} frames, {} odometry samples{cut}: {}",
                exported.frames,
                exported.odometry,
                folder.display()
            );
        }
        summary.exported = Some(ExportOutcome {
            frames: exported.frames,
            odometry: exported.odometry,
            whole,
        });
    }
    let (mut failure, mut nothing_verified) = (None, None);
    if args.verify || args.export.is_none() {
        let log = LogReader::open(&args.log)?;
        if let Some(note) = log.header().version_mismatch() {
            stderr_line!("{}: {note}", args.log.display());
        }
        if log.header().holds_inputs_only() {
            bail!(
                "{}: nothing is verified: the log holds what devices measured, and no estimates. \
                 Convert it to a recording folder with --export",
                args.log.display()
            );
        }
        let continued = log.header().continues.clone();
        let (report, warnings) =
            verify_log(log).with_context(|| format!("cannot verify {}", args.log.display()))?;
        if !json {
            print(&report);
        }
        for warning in &warnings {
            stderr_line!("warning: {warning}");
        }
        summary.warnings = warnings;
        summary.verified = Some(VerifyOutcome {
            identical: report.different == 0 && report.cycles > 0,
            cycles: report.cycles,
            vision_cycles: report.vision_cycles,
            different: report.different,
            unverified: report.unverified,
            verified_from_s: report.resumed.iter().map(|stamp| stamp.seconds()).collect(),
            whole: report.end == LogCompleteness::Complete,
        });
        failure = report.first_difference;
        nothing_verified = (report.cycles == 0).then_some(match continued {
            Some(earlier) => format!(
                "it continues {earlier} after a full disk, and ended before a cycle that holds the state of the pipeline. \
                 Verify the first log of the run"
            ),
            None => "no cycle could be computed again (expected at least one)".to_owned(),
        });
    }
    if json {
        println!("{}", serde_json::to_string(&summary)?);
    }
    match failure {
        None => match nothing_verified {
            Some(reason) => bail!("{}: nothing is verified: {reason}", args.log.display()),
            None => Ok(()),
        },
        Some(Difference {
            stamp,
            quantity,
            recorded,
            computed,
        }) => bail!(
            "{}: at {} s {quantity} differs: recorded {recorded}, computed {computed}",
            args.log.display(),
            format_seconds(stamp)
        ),
    }
}

/// Writes the log as a ROS 2 bag.
fn export_bag(log: &Path, path: &Path, json: bool) -> Result<BagSummary> {
    if path.extension().is_none_or(|ending| ending != "mcap") {
        return Err(UsageError(format!(
            "--export {}: not the name of a bag (expected a file that ends with .mcap)",
            path.display()
        ))
        .into());
    }
    Inputs::of([log]).ensure_kept([Some(path)])?;
    let written = bag::export(LogReader::open(log)?, path)?;
    if !json {
        let cut = if written.whole {
            ""
        } else {
            " (the log is truncated: up to its last complete chunk)"
        };
        let counts = written.messages.iter();
        let counts: Vec<String> = counts
            .map(|(topic, count)| format!("{topic} {count}"))
            .collect();
        println!("{}{cut}: {}", counts.join(", "), path.display());
    }
    Ok(written)
}

/// Runs a new pipeline, built from the log's own files, over the log. Returns warnings about its set-up, too.
fn verify_log(log: LogReader) -> Result<(VerificationReport, Vec<String>)> {
    let unpacked = UnpackedSetup::load(log.header())?;
    let (setup, config) = (&unpacked.setup, unpacked.config()?);
    let mut pipeline = Pipeline::new(setup, &config)?;
    if let Some(notice) = pipeline.notice() {
        stderr_line!("{notice}");
    }
    let bar = crate::progress::bar(0, "cycles");
    let mut keyframes = KeyframeCollector::new(setup, &config.localize.filter);
    let mut doubted = DoubtedPoses::default();
    let mut invalid_settings = None;
    let report = log::verify(log, |sample| {
        if let Sample::Settings(change) = sample {
            let next = PipelineConfig::parse(&change.config_toml)
                .map_err(anyhow::Error::from)
                .and_then(|config| {
                    config.check()?;
                    Pipeline::new(setup, &config)
                });
            match next {
                Ok(next) => pipeline.replace_by(next, change),
                Err(error) => invalid_settings = Some(error),
            }
            return None;
        }
        let cycle = pipeline.process_sample(sample);
        if let Some(cycle) = &cycle {
            keyframes.add_cycle(cycle);
            doubted.add(cycle);
        }
        bar.inc(u64::from(cycle.is_some()));
        cycle
    });
    bar.finish_and_clear();
    let rim = pipeline.visible_rim();
    let found = setup_check::check_drive(setup, &config, &keyframes.keyframes(), rim);
    if let Some(error) = invalid_settings {
        return Err(error.context("the settings that were changed during the run"));
    }
    let warnings = found.warnings.into_iter().chain(doubted.warning());
    Ok((report?, warnings.collect()))
}

fn print(report: &VerificationReport) {
    let VerificationReport {
        cycles,
        vision_cycles,
        different,
        gap,
        resumed,
        unverified,
        end,
        ..
    } = report;
    if *cycles == 0 {
        println!("no estimate could be computed again");
    } else if *different == 0 {
        println!("{cycles} estimates computed again: bit-identical");
    } else {
        println!("{cycles} estimates computed again: {different} differ");
    }
    if vision_cycles < cycles {
        println!(
            "vision computed again in {vision_cycles} cycles; the others have no lossless image, so their recorded line points were used"
        );
    }
    if let Some(gap) = gap {
        println!(
            "not verified: {unverified} cycles after one that was dropped at {} s",
            format_seconds(*gap)
        );
    }
    for stamp in resumed {
        println!(
            "verified again from {} s on, where the log holds the state of the pipeline",
            format_seconds(*stamp)
        );
    }
    if *end == LogCompleteness::Truncated {
        println!("the log is truncated: verified up to its last complete chunk");
    }
}
