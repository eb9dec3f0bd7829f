//! The subcommands of the command line, a file or folder each: arguments, progress, result.

pub mod arguments;
pub mod bench;
pub mod calibrate;
pub mod demo;
pub mod doctor;
pub mod locate;
#[cfg(feature = "python")]
pub mod mirror;
pub mod overrides;
pub mod recover;
pub mod replay;
#[cfg(feature = "python")]
pub mod script;
pub mod sim;
