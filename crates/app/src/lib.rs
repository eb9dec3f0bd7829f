//! The executable `mirrorball`: its command line, and what each command runs around the pipeline.
//!
//! The crate exports only the command line and what fuzz targets feed with datagrams, with both sides of a live stream, and
//! with network.toml.

// eprintln! panics if the terminal is closed.
#![deny(clippy::print_stderr)]

#[macro_use]
mod stderr_line;

mod cli;
mod closed_terminal;

mod commands;

mod eval;
mod run;
#[cfg(feature = "view")]
mod view;
mod virtual_hardware;

mod net;
mod ros2;
mod stream;

mod interrupt;
mod machine;
mod memory;
mod pictures;
mod progress;
#[cfg(feature = "python")]
mod python;

pub use cli::run;
pub use net::check_network_file;
pub use net::commands::{CommandConfig, CommandFilter, RemoteCommand, RobotIdentity};
pub use stderr_line::print_stderr;
pub use stream::{StreamEvent, StreamMessages, TextAnswer, check_client_bytes};
