//! What was asked for? The command line: exit 0 when done, 1 when it failed, 2 when the arguments were wrong.

use std::process::ExitCode;

use clap::{Parser, Subcommand};

use crate::commands::arguments::UsageError;
use crate::commands::{bench, calibrate, demo, doctor, locate, recover, replay, sim};
#[cfg(feature = "python")]
use crate::commands::{mirror, script};
use crate::eval;
#[cfg(feature = "view")]
use crate::view;

/// Eyes and a sense of place for soccer robots with an omnidirectional mirror.
#[derive(Parser)]
#[command(
    name = "mirrorball",
    version,
    max_term_width = 100,
    subcommand_required = true,
    arg_required_else_help = true
)]
struct Cli {
    /// Print the one result as a JSON object to standard output.
    #[arg(long, global = true)]
    json: bool,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Demo(demo::Args),
    Doctor(doctor::Args),
    Locate(locate::Args),
    Sim(sim::Args),
    Replay(replay::Args),
    Run(crate::run::Args),
    #[cfg(feature = "view")]
    View(view::Args),
    Recover(recover::Args),
    Calibrate(calibrate::Args),
    Bench(bench::Args),
    Eval(eval::Args),
    #[cfg(feature = "python")]
    Mirror(mirror::Args),
    #[cfg(feature = "python")]
    Script(script::Args),
}

/// What went wrong and why, each reason once: many errors already name the one that they stem from.
fn message(error: &anyhow::Error) -> String {
    let mut message = String::new();
    for cause in error.chain().map(ToString::to_string) {
        if message.is_empty() {
            message = cause;
        } else if !message.contains(&cause) {
            message = format!("{message}: {cause}");
        }
    }
    message
}

/// Runs the command line of this process.
pub fn run() -> ExitCode {
    // A closed pipe (`mirrorball … | head`) ends the program quietly, as it does others.
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => {
            let code = if error.use_stderr() { 2 } else { 0 };
            // Nothing is left to tell anyone if even this cannot be printed.
            let _ = error.print();
            return ExitCode::from(code);
        }
    };
    let result = match cli.command {
        Command::Demo(args) => demo::run(&args, cli.json),
        Command::Doctor(args) => doctor::run(&args, cli.json),
        Command::Locate(args) => locate::run(&args, cli.json),
        Command::Sim(args) => sim::run(&args, cli.json),
        Command::Replay(args) => replay::run(&args, cli.json),
        Command::Run(args) => crate::run::run(&args, cli.json),
        #[cfg(feature = "view")]
        Command::View(args) => view::run(&args, cli.json),
        Command::Calibrate(args) => calibrate::run(&args, cli.json),
        Command::Bench(args) => bench::run(&args, cli.json),
        Command::Eval(args) => eval::run(&args, cli.json),
        Command::Recover(args) => recover::run(&args, cli.json),
        #[cfg(feature = "python")]
        Command::Mirror(args) => mirror::run(&args, cli.json),
        #[cfg(feature = "python")]
        Command::Script(args) => script::run(&args),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("mirrorball: {}", message(&error));
            ExitCode::from(if error.is::<UsageError>() { 2 } else { 1 })
        }
    }
}
