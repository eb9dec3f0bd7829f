//! The subcommands of the command line, a file or folder each: arguments, progress, result.

pub(crate) mod arguments;
pub(crate) mod bench;
pub(crate) mod calibrate;
pub(crate) mod demo;
pub(crate) mod doctor;
pub(crate) mod field;
#[cfg(feature = "python")]
pub(crate) mod import;
pub(crate) mod inputs;
pub(crate) mod locate;
#[cfg(feature = "python")]
pub(crate) mod mirror;
pub(crate) mod overrides;
pub(crate) mod record;
pub(crate) mod recover;
pub(crate) mod replay;
#[cfg(feature = "python")]
pub(crate) mod report;
#[cfg(feature = "python")]
pub(crate) mod script;
pub(crate) mod sim;
