//! How is a running robot observed? The topics of its log, live, over a WebSocket.
//!
//! Foxglove and Lichtblick open `ws://127.0.0.1:8765`; `mirrorball view` reads the same stream by [`StreamClient`].

mod client;
mod config;
mod frame_meter;
mod guard;
mod handshake_request;
mod parameters;
mod server;
#[cfg(test)]
mod tests;

pub(crate) use client::StreamClient;
pub use client::{StreamEvent, StreamMessages, TextAnswer};
pub(crate) use config::StreamConfig;
pub(crate) use parameters::{MESSAGE, NONCE};
pub(crate) use server::{StreamPreamble, StreamServer};
