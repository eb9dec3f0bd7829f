//! `mirrorball recover`: a complete log from a truncated or damaged one.

use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use serde::Serialize;

use super::inputs::Inputs;
use pipeline::log;

/// Make a complete log, with index and summary, from a truncated or damaged one.
#[derive(clap::Args)]
#[command(after_help = "Example: mirrorball recover game.mcap --out game-whole.mcap")]
pub(crate) struct Args {
    /// The log.
    log: PathBuf,
    /// The recovered log.
    #[arg(long, value_name = "LOG2")]
    out: PathBuf,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Outcome {
    messages: u64,
    until_s: Option<f64>,
    lost: Vec<String>,
    was_whole: bool,
}

/// Runs the command.
pub(crate) fn run(args: &Args, json: bool) -> Result<()> {
    Inputs::of([&*args.log]).ensure_kept([Some(&*args.out)])?;
    let recovered = log::recover(&args.log, &args.out)?;
    if recovered.messages == 0 {
        std::fs::remove_file(&args.out)
            .with_context(|| format!("cannot remove {}", args.out.display()))?;
        let lost = match recovered.lost.is_empty() {
            true => String::new(),
            false => format!(" (lost {})", recovered.lost.join(", ")),
        };
        bail!("{}: no readable message{lost}", args.log.display());
    }
    let summary = Outcome {
        messages: recovered.messages,
        until_s: recovered.until.map(localize::Stamp::seconds),
        lost: recovered.lost,
        was_whole: recovered.was_whole,
    };
    if json {
        println!("{}", serde_json::to_string(&summary)?);
        return Ok(());
    }
    let until = summary
        .until_s
        .map_or_else(String::new, |until| format!(" until {until:.3} s"));
    println!(
        "{} messages{until}: {}",
        summary.messages,
        args.out.display()
    );
    for lost in &summary.lost {
        println!("lost {lost}");
    }
    if summary.was_whole {
        println!("{} was already complete", args.log.display());
    }
    Ok(())
}
