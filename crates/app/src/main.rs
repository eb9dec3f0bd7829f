//! Mirrorball: eyes and a sense of place for soccer robots with an omnidirectional mirror.

mod cli;
mod cycle;
mod field_picture;
mod locate;
mod log;
mod progress;
mod recording;
mod recover;
mod replay;
mod sample;
mod score;
mod setup;
mod table;

use std::process::ExitCode;

fn main() -> ExitCode {
    cli::run()
}
