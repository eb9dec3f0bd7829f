//! Which address does a configured name mean?

use std::net::{SocketAddr, ToSocketAddrs};

use anyhow::{Context, Result};

/// The first address of `host:port`.
pub(crate) fn resolve(name: &str) -> Result<SocketAddr> {
    name.to_socket_addrs()
        .context("invalid address (expected host:port)")?
        .next()
        .context("unknown host")
}
