//! The executable's rooms, in the order in which a sample meets them: a source, the spine, what watches it, and the
//! commands that join them.

pub mod arguments;
pub mod home;
pub mod interrupt;
pub mod overrides;
pub mod sample;
pub mod setup;
pub mod table;

pub mod recording;
pub mod simulation;
pub mod squad;

pub mod cycle;
pub mod world;

pub mod feed;

pub mod log;
pub mod net;
pub mod start_log;
pub mod stream;

pub mod annotate;
pub mod field_picture;
pub mod outputs;
pub mod progress;
pub mod score;
pub mod sight_score;
pub mod summary;

#[cfg(feature = "python")]
pub mod python;

pub mod baseline;
pub mod bench;
pub mod calibrate;
pub mod demo;
pub mod doctor;
pub mod eval;
pub mod locate;
#[cfg(feature = "python")]
pub mod mirror;
pub mod recover;
pub mod replay;
pub mod run;
#[cfg(feature = "python")]
pub mod script;
pub mod simulate;
#[cfg(feature = "view")]
pub mod view;
pub mod virtual_hardware;
pub mod visible;

pub mod cli;
