//! `mirrorball doctor`: what keeps this robot from playing, and what is to be done about each?

mod machine;
mod robot;

use std::path::PathBuf;

use anyhow::{Result, bail};
use serde::Serialize;

/// Check a robot and its machine: configuration, devices, permissions, disk, clock, Python. Exits 1 if something must be done.
#[derive(clap::Args)]
#[command(after_help = "Example: mirrorball doctor --robot config/robots/virtual")]
pub struct Args {
    /// The robot: a folder with robot.toml and hardware.toml; without, the machine alone is looked at.
    #[arg(long, value_name = "DIR")]
    robot: Option<PathBuf>,
    /// Where logs are written.
    #[arg(long, value_name = "DIR", default_value = ".")]
    logs: PathBuf,
    /// Seconds for which each device is listened to.
    #[arg(long, value_name = "SECONDS", value_parser = crate::commands::arguments::parse_duration, default_value = "2")]
    listen: f64,
}

/// How something is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
enum Severity {
    /// As it should be.
    Fine,
    /// The robot plays, but not as well as it could.
    Note,
    /// The robot does not play like this.
    Bad,
}

/// What was found of one thing.
#[derive(Debug, Clone, Serialize)]
struct Finding {
    /// What was looked at.
    what: String,
    /// How it is.
    verdict: Severity,
    /// What was found.
    found: String,
    /// What to do about it; empty if nothing.
    remedy: String,
}

impl Finding {
    fn fine(what: &str, found: impl Into<String>) -> Self {
        Finding {
            what: what.to_owned(),
            verdict: Severity::Fine,
            found: found.into(),
            remedy: String::new(),
        }
    }

    fn note(what: &str, found: impl Into<String>, remedy: impl Into<String>) -> Self {
        Finding {
            what: what.to_owned(),
            verdict: Severity::Note,
            found: found.into(),
            remedy: remedy.into(),
        }
    }

    fn bad(what: &str, found: impl Into<String>, remedy: impl Into<String>) -> Self {
        Finding {
            verdict: Severity::Bad,
            ..Finding::note(what, found, remedy)
        }
    }
}

/// Runs the command.
pub fn run(args: &Args, json: bool) -> Result<()> {
    let mut findings = machine::check_machine(&args.logs);
    if let Some(robot) = &args.robot {
        findings.extend(robot::check_robot(robot, args.listen));
    }
    let bad = findings
        .iter()
        .filter(|finding| finding.verdict == Severity::Bad)
        .count();
    if json {
        println!(
            "{}",
            serde_json::json!({ "findings": findings, "bad": bad })
        );
    } else {
        for finding in &findings {
            let mark = match finding.verdict {
                Severity::Fine => "ok  ",
                Severity::Note => "note",
                Severity::Bad => "BAD ",
            };
            println!("{mark} {}: {}", finding.what, finding.found);
            if !finding.remedy.is_empty() {
                println!("       -> {}", finding.remedy);
            }
        }
    }
    match bad {
        0 => Ok(()),
        1 => bail!("one thing keeps the robot from playing"),
        count => bail!("{count} things keep the robot from playing"),
    }
}
