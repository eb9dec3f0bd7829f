//! The executable: the command line and what it runs around the pipeline.

pub mod cli;

pub mod commands;

pub mod eval;
pub mod run;
#[cfg(feature = "view")]
pub mod view;
pub mod virtual_hardware;

pub mod net;
pub mod stream;

pub mod interrupt;
pub mod pictures;
pub mod progress;
#[cfg(feature = "python")]
pub mod python;
