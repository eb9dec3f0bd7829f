//! The command line: exit code 0 when done, 1 when the command failed, 2 when the arguments were wrong, and that of a script.

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use pipeline::message_text::{error_message, printable};

use crate::commands::arguments::UsageError;
use crate::commands::{
    bench, calibrate, demo, doctor, field, locate, record, recover, replay, sim,
};
#[cfg(feature = "python")]
use crate::commands::{import, mirror, report, script};
use crate::eval;
#[cfg(feature = "view")]
use crate::view;

/// Vision and localization for RoboCup MSL robots with an omnidirectional (catadioptric) camera.
#[derive(Parser)]
#[command(
    name = "mirrorball",
    version,
    max_term_width = 100,
    subcommand_required = true,
    arg_required_else_help = true
)]
struct Cli {
    /// Print the result as one JSON object to standard output.
    #[arg(long, global = true)]
    json: bool,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Demo(demo::Args),
    Doctor(doctor::Args),
    Field(field::Args),
    Locate(locate::Args),
    Sim(sim::Args),
    Replay(replay::Args),
    Run(crate::run::Args),
    Record(record::Args),
    #[cfg(feature = "view")]
    View(view::Args),
    Recover(recover::Args),
    #[cfg(feature = "python")]
    Import(import::Args),
    Calibrate(calibrate::Args),
    Bench(bench::Args),
    Eval(eval::Args),
    #[cfg(feature = "python")]
    Report(report::Args),
    #[cfg(feature = "python")]
    Mirror(mirror::Args),
    #[cfg(feature = "python")]
    Script(script::Args),
}

/// Parses the arguments of this process and runs the command.
pub fn run() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => {
            let code = if error.use_stderr() { 2 } else { 0 };
            // If the message cannot be printed, there is no other way to report it.
            let _ = error.print();
            return ExitCode::from(code);
        }
    };
    let result = match cli.command {
        Command::Demo(args) => demo::run(&args, cli.json),
        Command::Doctor(args) => doctor::run(&args, cli.json),
        Command::Field(args) => field::run(&args, cli.json),
        Command::Locate(args) => locate::run(&args, cli.json),
        Command::Sim(args) => sim::run(&args, cli.json),
        Command::Replay(args) => replay::run(&args, cli.json),
        Command::Run(args) => crate::run::run(&args, cli.json),
        Command::Record(args) => record::run(&args, cli.json),
        #[cfg(feature = "view")]
        Command::View(args) => view::run(&args, cli.json),
        Command::Calibrate(args) => calibrate::run(&args, cli.json),
        Command::Bench(args) => bench::run(&args, cli.json),
        Command::Eval(args) => eval::run(&args, cli.json),
        Command::Recover(args) => recover::run(&args, cli.json),
        #[cfg(feature = "python")]
        Command::Import(args) => import::run(&args, cli.json),
        #[cfg(feature = "python")]
        Command::Report(args) => report::run(&args, cli.json),
        #[cfg(feature = "python")]
        Command::Mirror(args) => mirror::run(&args, cli.json),
        #[cfg(feature = "python")]
        Command::Script(args) => script::run(&args),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            stderr_line!("mirrorball: {}", printable(&error_message(&error)));
            ExitCode::from(exit_code(&error))
        }
    }
}

fn exit_code(error: &anyhow::Error) -> u8 {
    #[cfg(feature = "python")]
    if let Some(exit) = error.downcast_ref::<script::ScriptExit>() {
        return exit.code();
    }
    if error.is::<UsageError>() { 2 } else { 1 }
}
