//! `mirrorball replay`: a log's run once more, to verify it or to hand it on as a recording folder.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail};
use serde::Serialize;

use pipeline::config::PIPELINE_FILE;
use pipeline::log::{self, Difference, LogEnd, LogReader, VerificationReport};
use pipeline::setup::Setup;
use pipeline::{Pipeline, PipelineConfig};

/// Run a log once more: verify that it gives the same bits, or export it as a recording folder.
#[derive(clap::Args)]
#[command(
    after_help = "Example: mirrorball replay game.mcap --verify\n         mirrorball replay game.mcap --export game/"
)]
pub struct Args {
    /// The log.
    log: PathBuf,
    /// Compute every estimate again and compare it bit for bit (the default).
    #[arg(long)]
    verify: bool,
    /// Write the log as a recording folder.
    #[arg(long, value_name = "DIR")]
    export: Option<PathBuf>,
    /// Show the log in a window, with the run computed again beside the recorded one.
    #[cfg(feature = "view")]
    #[arg(long, conflicts_with_all = ["verify", "export"])]
    view: bool,
}

/// What `--json` prints.
#[derive(Serialize, Default)]
struct Outcome {
    #[serde(skip_serializing_if = "Option::is_none")]
    verified: Option<VerifyOutcome>,
    #[serde(skip_serializing_if = "Option::is_none")]
    exported: Option<ExportOutcome>,
}

#[derive(Serialize)]
struct VerifyOutcome {
    identical: bool,
    cycles: u64,
    vision_cycles: u64,
    different: u64,
    unverified: u64,
    whole: bool,
}

#[derive(Serialize)]
struct ExportOutcome {
    frames: u64,
    odometry: u64,
    whole: bool,
}

/// Runs the command.
pub fn run(args: &Args, json: bool) -> Result<()> {
    #[cfg(feature = "view")]
    if args.view {
        return crate::view::show_recomputed(&args.log);
    }
    let mut summary = Outcome::default();
    if let Some(folder) = &args.export {
        let exported = log::export(LogReader::open(&args.log)?, folder)?;
        let whole = exported.end == LogEnd::Complete;
        if !json {
            let cut = if whole {
                ""
            } else {
                " (the log is cut: up to its last whole part)"
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
    let mut failure = None;
    if args.verify || args.export.is_none() {
        let log = LogReader::open(&args.log)?;
        if let Some(note) = log.header().version_mismatch() {
            eprintln!("{}: {note}", args.log.display());
        }
        let verdict =
            verify_log(log).with_context(|| format!("cannot verify {}", args.log.display()))?;
        if !json {
            print(&verdict);
        }
        summary.verified = Some(VerifyOutcome {
            identical: verdict.different == 0,
            cycles: verdict.cycles,
            vision_cycles: verdict.vision_cycles,
            different: verdict.different,
            unverified: verdict.unverified,
            whole: verdict.end == LogEnd::Complete,
        });
        failure = verdict.first_difference;
    }
    if json {
        println!("{}", serde_json::to_string(&summary)?);
    }
    match failure {
        None => Ok(()),
        Some(Difference {
            stamp,
            quantity: what,
            recorded,
            computed,
        }) => bail!(
            "{}: at {} s {what} differs: recorded {recorded}, computed {computed}",
            args.log.display(),
            stamp.seconds()
        ),
    }
}

/// Runs a fresh spine, built from the log's own files, over the log.
fn verify_log(log: LogReader) -> Result<VerificationReport> {
    let folder = tempfile::tempdir().context("no room for the log's files")?;
    log.header().write_files(folder.path())?;
    let mut spine = load_pipeline(folder.path()).map_err(|error| {
        // The files lie in the log; where they were unpacked tells nobody anything.
        let unpacked = format!("{}/", folder.path().display());
        anyhow!(format!("{error:#}").replace(&unpacked, "the log's "))
    })?;
    if let Some(notice) = spine.notice() {
        eprintln!("{notice}");
    }
    let bar = crate::progress::bar(0, "cycles");
    let verdict = log::verify(log, |sample| {
        let cycle = spine.process_sample(sample);
        bar.inc(u64::from(cycle.is_some()));
        cycle
    });
    bar.finish_and_clear();
    verdict
}

/// A spine from the files that a log keeps.
fn load_pipeline(folder: &Path) -> Result<Pipeline> {
    let setup = Setup::load(&folder.join("robot.toml"), None)?;
    let settings = folder.join(PIPELINE_FILE);
    let config = PipelineConfig::load("default", settings.exists().then_some(&*settings))?;
    Pipeline::new(&setup, &config)
}

fn print(verdict: &VerificationReport) {
    let VerificationReport {
        cycles,
        vision_cycles: seen,
        different,
        gap,
        unverified,
        end,
        ..
    } = verdict;
    if *different == 0 {
        println!("{cycles} estimates computed again: the same bits");
    } else {
        println!("{cycles} estimates computed again: {different} differ");
    }
    if seen < cycles {
        println!(
            "vision computed again in {seen} cycles; the others hold no exact image, so their line points were taken"
        );
    }
    if let Some(gap) = gap {
        println!(
            "not verified: {unverified} cycles behind one that was dropped at {} s",
            gap.seconds()
        );
    }
    if *end == LogEnd::Truncated {
        println!("the log is cut: verified up to its last whole part");
    }
}
