//! Which address does a configured name mean, and how does a socket wait for it? A robot's network may come after its program.

use std::io::ErrorKind;
use std::net::{SocketAddr, ToSocketAddrs};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, OnceLock};

use anyhow::{Context, Result, ensure};
use socket2::{Domain, Socket, Type};

use super::lock::lock;
use super::polling::POLL_PERIOD;

/// Time between attempts to resolve a name, in periods of [`POLL_PERIOD`].
const POLLS_PER_ATTEMPT: u32 = 40;

/// The first address of `host:port`.
pub(crate) fn resolve(name: &str) -> Result<SocketAddr> {
    check_form(name)?;
    name.to_socket_addrs()?.next().context("unknown host")
}

/// Checks the form of `host:port`, without asking who the host is.
pub(crate) fn check_form(name: &str) -> Result<()> {
    let is_valid = name.parse::<SocketAddr>().is_ok()
        || name.rsplit_once(':').is_some_and(|(host, port)| {
            !host.is_empty() && !host.contains([':', ' ']) && port.parse::<u16>().is_ok()
        });
    ensure!(is_valid, "invalid address: {name:?} (expected host:port)");
    Ok(())
}

/// Where datagrams go: an address, or a name that is resolved in the background, since the network may come later.
#[derive(Debug, Clone, Default)]
pub(super) struct Destination(Arc<OnceLock<SocketAddr>>);

impl Destination {
    /// The destination of `host:port`. `resolve` finds the address of a name; it is asked until it knows one or `stop` is set.
    /// `notices`: a message for the operator when it fails and when it succeeds then.
    pub(super) fn new(
        name: &str,
        resolve: impl Fn(&str) -> Result<SocketAddr> + Send + 'static,
        stop: &Arc<AtomicBool>,
        notices: &Arc<Mutex<Vec<String>>>,
    ) -> Result<Self> {
        let destination = Destination::default();
        if let Ok(address) = name.parse() {
            destination.0.get_or_init(|| address);
            return Ok(destination);
        }
        check_form(name)?;
        let (name, found) = (name.to_owned(), destination.clone());
        let (stop, notices) = (stop.clone(), notices.clone());
        // Nobody waits for its end: the system may take many seconds to say that it knows no address.
        std::thread::Builder::new()
            .name("resolve".to_owned())
            .spawn(move || {
                let mut has_failed = false;
                while !stop.load(Ordering::Relaxed) {
                    match resolve(&name) {
                        Ok(address) => {
                            found.0.get_or_init(|| address);
                            if has_failed {
                                let text = format!("[[outputs]] {name} is {address}");
                                lock(&notices).push(text);
                            }
                            return;
                        }
                        Err(error) if !has_failed => {
                            has_failed = true;
                            lock(&notices).push(format!(
                                "[[outputs]] cannot resolve {name}: {error:#}. Nothing is sent to it until its name is known"
                            ));
                        }
                        Err(_) => {}
                    }
                    for _ in 0..POLLS_PER_ATTEMPT {
                        if !stop.load(Ordering::Relaxed) {
                            std::thread::sleep(POLL_PERIOD);
                        }
                    }
                }
            })?;
        Ok(destination)
    }

    /// The address, once it is known.
    pub(super) fn address(&self) -> Option<SocketAddr> {
        self.0.get().copied()
    }
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

    #[test]
    fn name_that_is_unknown_at_the_start_is_resolved_later() {
        let address: SocketAddr = "127.0.0.1:7070".parse().expect("an address");
        let (stop, notices) = (Arc::new(AtomicBool::new(false)), Arc::default());
        let attempts = Mutex::new(0);
        let resolve = move |name: &str| {
            assert_eq!(name, "coach.local:7070");
            let mut attempts = lock(&attempts);
            *attempts += 1;
            ensure!(*attempts > 1, "no answer");
            Ok(address)
        };
        let coach = Destination::new("coach.local:7070", resolve, &stop, &notices);
        let coach = coach.expect("a destination");
        let wait = |count: usize| {
            let is_there = || lock(&notices).len() >= count;
            let mut polls = std::iter::repeat_with(is_there).take(12_000);
            assert!(polls.any(|is_there| {
                std::thread::sleep(std::time::Duration::from_millis(5));
                is_there
            }));
        };
        wait(1);
        assert_eq!(coach.address(), None);
        wait(2);
        assert_eq!(coach.address(), Some(address));
        let notices = lock(&notices).clone();
        assert!(notices[0].contains("cannot resolve coach.local:7070: no answer"));
        assert_eq!(notices[1], "[[outputs]] coach.local:7070 is 127.0.0.1:7070");
    }

    #[test]
    fn address_is_known_at_once_and_a_malformed_one_is_refused() {
        let (stop, notices) = (Arc::new(AtomicBool::new(false)), Arc::default());
        let destination =
            |name: &str| Destination::new(name, |_| panic!("no name"), &stop, &notices);
        for address in ["127.0.0.1:7070", "[::1]:7070"] {
            let known = destination(address).expect("a destination").address();
            assert_eq!(
                known.map(|known| known.to_string()).as_deref(),
                Some(address)
            );
        }
        for name in [
            "coach.local",
            "coach.local:",
            ":7070",
            "coach:70700",
            "::1:7070",
            "",
        ] {
            let error = destination(name).expect_err("refused").to_string();
            assert!(error.contains("expected host:port"), "{error}");
        }
    }
}
