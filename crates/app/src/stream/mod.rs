//! How is a running robot observed? The topics of its log, live, over a WebSocket.
//!
//! Foxglove and Lichtblick open `ws://127.0.0.1:8765`; `mirrorball view` reads the same stream by `StreamClient`.

#[cfg(any(test, feature = "view"))]
mod client;
mod config;
mod frame_meter;
mod guard;
mod guard_check;
mod handshake_request;
mod messages;
mod parameters;
mod server;
#[cfg(test)]
mod tests;

#[cfg(any(test, feature = "view"))]
pub(crate) use client::StreamClient;
pub(crate) use config::StreamConfig;
pub use guard_check::check_client_bytes;
pub use messages::{StreamEvent, StreamMessages, TextAnswer};
#[cfg(any(test, feature = "view"))]
pub(crate) use parameters::{HISTORY, MESSAGE, NONCE};
pub(crate) use server::{StreamPreamble, StreamServer};
