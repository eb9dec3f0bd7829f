//! Mirrorball: eyes and a sense of place for soccer robots with an omnidirectional mirror.

use std::process::ExitCode;

fn main() -> ExitCode {
    app::cli::run()
}
