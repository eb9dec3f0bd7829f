//! Which address does a configured name mean, and how does a socket wait for it? A robot's network may come after its program.

use std::io::ErrorKind;
use std::net::{SocketAddr, ToSocketAddrs};

use anyhow::{Context, Result};
use socket2::{Domain, Socket, Type};

/// The first address of `host:port`.
pub(crate) fn resolve(name: &str) -> Result<SocketAddr> {
    name.to_socket_addrs()
        .context("invalid address (expected host:port)")?
        .next()
        .context("unknown host")
}

/// A socket on an address of this machine. One that it does not have yet is bound all the same, and receives once it is there. Second: a
/// message for the operator then.
pub(crate) fn bind(address: SocketAddr, kind: Type) -> std::io::Result<(Socket, Option<String>)> {
    let open = |waits: bool| -> std::io::Result<Socket> {
        let socket = Socket::new(Domain::for_address(address), kind, None)?;
        // A listener that ended a moment ago leaves its address in use.
        if kind == Type::STREAM {
            socket.set_reuse_address(true)?;
        }
        if waits && address.is_ipv4() {
            socket.set_freebind_v4(true)?;
        } else if waits {
            socket.set_freebind_v6(true)?;
        }
        socket.bind(&address.into())?;
        Ok(socket)
    };
    match open(false) {
        Err(error) if error.kind() == ErrorKind::AddrNotAvailable => {
            let text = format!(
                "{} is no address of this machine yet: waits for it",
                address.ip()
            );
            Ok((open(true)?, Some(text)))
        }
        socket => Ok((socket?, None)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn address_that_comes_later_is_waited_for_and_one_in_use_is_refused() {
        let later: SocketAddr = "203.0.113.7:0".parse().expect("an address");
        for kind in [Type::DGRAM, Type::STREAM] {
            let (_socket, notice) = bind(later, kind).expect("bound");
            assert!(notice.is_some_and(|text| text.contains("203.0.113.7")));
        }
        let (first, notice) =
            bind("127.0.0.1:0".parse().expect("valid"), Type::DGRAM).expect("bound");
        assert_eq!(notice, None);
        let taken = first
            .local_addr()
            .expect("bound")
            .as_socket()
            .expect("of the internet");
        let error = bind(taken, Type::DGRAM).expect_err("in use");
        assert_eq!(error.kind(), ErrorKind::AddrInUse);
    }
}
