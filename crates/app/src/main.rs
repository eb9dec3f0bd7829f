//! Mirrorball: eyes and a sense of place for soccer robots with an omnidirectional mirror.

mod annotate;
mod bench;
mod calibrate;
mod cli;
mod cycle;
mod demo;
mod field_picture;
mod home;
mod locate;
mod log;
mod mirror;
mod outputs;
mod progress;
mod python;
mod recording;
mod recover;
mod replay;
mod sample;
mod score;
mod script;
mod setup;
mod simulate;
mod simulation;
mod start_log;
mod summary;
mod table;

use std::process::ExitCode;

fn main() -> ExitCode {
    cli::run()
}
