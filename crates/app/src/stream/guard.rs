//! What may connections to the stream cost? A proxy in front of Foxglove's server limits their number, time and memory.
//!
//! Foxglove's server stops accepting at its first error, has no limit of connections, and keeps unfinished messages of up
//! to 64 MiB for each. It listens on a loopback port here, and the guard restarts it when it is gone.

use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::net::{IpAddr, Shutdown, SocketAddr, TcpListener, TcpStream, ToSocketAddrs};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use socket2::Type;

use super::frame_meter::{FrameMeter, MESSAGE_TIME_MAX};
use super::handshake_request::{RequestError, check_origin, is_timeout, read_head};
use crate::net::bind;

/// Longest wait of a thread before it checks whether it must end.
const POLL_PERIOD: Duration = Duration::from_millis(100);
/// Connections that wait to be accepted.
const CONNECTIONS_WAITING: i32 = 128;
/// Pause after a failed accept: the process may have no free file descriptor for a while.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);
/// Longest wait for the server on the loopback interface.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(1);
/// System buffers of a connection, bytes: two images. More would only show a slow viewer older cycles.
const SOCKET_BUFFER_BYTES: usize = 256 * 1024;
/// Bytes passed on at once.
const PASS_BYTES: usize = 64 * 1024;

/// Limits of all connections.
#[derive(Debug, Clone)]
pub(super) struct GuardLimits {
    /// Connections at the same time.
    pub(super) connections: usize,
    /// Connections at the same time from one address.
    pub(super) connections_per_address: usize,
    /// A viewer that takes no byte for this time is dropped.
    pub(super) stall: Duration,
    /// Web pages that may connect.
    pub(super) origins: Vec<String>,
}

/// The server behind the guard.
pub(super) trait GuardedServer: Send + 'static {
    /// Its address.
    fn address(&self) -> SocketAddr;

    /// Starts it again.
    fn restart(&mut self) -> Result<()>;
}

/// The listening guard. Dropping it closes all connections.
pub(super) struct Guard {
    shared: Arc<GuardState>,
    address: SocketAddr,
    thread: Option<JoinHandle<()>>,
}

struct GuardState {
    limits: GuardLimits,
    server: Mutex<Box<dyn GuardedServer>>,
    /// Number of connections by address.
    connections: Mutex<BTreeMap<IpAddr, usize>>,
    notices: Mutex<Notices>,
    stop_requested: AtomicBool,
}

/// Messages for the operator, each text once.
#[derive(Default)]
struct Notices {
    pending: Vec<String>,
    known: Vec<String>,
}

impl Guard {
    /// Listens on `address` in front of a server.
    pub(super) fn start(
        address: (&str, u16),
        limits: GuardLimits,
        server: impl GuardedServer,
    ) -> Result<Self> {
        let resolved = address.to_socket_addrs()?.next();
        let (socket, notice) = bind(resolved.context("unknown host")?, Type::STREAM)?;
        socket.listen(CONNECTIONS_WAITING)?;
        let listener = TcpListener::from(socket);
        listener.set_nonblocking(true)?;
        let address = listener.local_addr()?;
        let shared = Arc::new(GuardState {
            limits,
            server: Mutex::new(Box::new(server)),
            connections: Mutex::default(),
            notices: Mutex::new(Notices {
                pending: notice
                    .map(|text| format!("[stream] {text}"))
                    .into_iter()
                    .collect(),
                known: Vec::new(),
            }),
            stop_requested: AtomicBool::new(false),
        });
        let state = shared.clone();
        let thread = std::thread::Builder::new()
            .name("stream guard".to_owned())
            .spawn(move || state.accept_loop(&listener))?;
        Ok(Guard {
            shared,
            address,
            thread: Some(thread),
        })
    }

    /// The address on which it listens.
    #[cfg(test)]
    pub(super) fn address(&self) -> SocketAddr {
        self.address
    }

    /// Messages for the operator since the last call.
    pub(super) fn take_notices(&self) -> Vec<String> {
        std::mem::take(&mut lock(&self.shared.notices).pending)
    }
}

impl Drop for Guard {
    fn drop(&mut self) {
        self.shared.stop_requested.store(true, Ordering::Relaxed);
        // Wakes the accepting thread.
        let _woken = TcpStream::connect_timeout(&self.address, POLL_PERIOD);
        if let Some(thread) = self.thread.take() {
            // A panic was reported when it happened.
            let _ = thread.join();
        }
    }
}

impl GuardState {
    fn accept_loop(self: &Arc<Self>, listener: &TcpListener) {
        while !self.is_stopped() {
            match listener.accept() {
                Ok((client, peer)) => self.admit(client, peer.ip()),
                Err(error) if is_timeout(&error) => wait_readable(listener),
                Err(error) => {
                    self.notify(format!("the stream cannot accept a connection: {error}"));
                    std::thread::sleep(ACCEPT_PAUSE);
                }
            }
        }
    }

    /// Serves a client in its own thread, if there is place.
    fn admit(self: &Arc<Self>, client: TcpStream, peer: IpAddr) {
        let Some(place) = Place::take(self, peer) else {
            self.notify(format!(
                "the stream rejects connections: more than {} in all or {} from one address",
                self.limits.connections, self.limits.connections_per_address
            ));
            return;
        };
        let state = self.clone();
        let serve = move || {
            let _place = place;
            if let Err(error) = state.serve(client) {
                state.notify(format!("the stream closed a connection: {error:#}"));
            }
        };
        let started = std::thread::Builder::new()
            .name("stream client".to_owned())
            .spawn(serve);
        if let Err(error) = started {
            self.notify(format!("the stream cannot start a thread: {error}"));
        }
    }

    /// Passes bytes in both directions until one side ends. An error is a violation by the client.
    fn serve(self: &Arc<Self>, mut client: TcpStream) -> Result<()> {
        client.set_nonblocking(false)?;
        let (received, head_bytes) = match read_head(&mut client) {
            Ok(head) => head,
            // A port scan, or a viewer that was closed at once.
            Err(RequestError::Io(_)) => return Ok(()),
            Err(error) => return Err(error.into()),
        };
        if let Err(error) = check_origin(&received[..head_bytes], &self.limits.origins) {
            let _gone = client.write_all(b"HTTP/1.1 403 Forbidden\r\nContent-Length: 0\r\n\r\n");
            return Err(error.into());
        }
        let mut server = self.connect().context("no server behind the stream")?;
        for socket in [&client, &server] {
            socket.set_nodelay(true)?;
            socket.set_read_timeout(Some(POLL_PERIOD))?;
            socket.set_write_timeout(Some(self.limits.stall))?;
            // The system may allow less.
            let reference = socket2::SockRef::from(socket);
            let _less = reference.set_send_buffer_size(SOCKET_BUFFER_BYTES);
            let _less = reference.set_recv_buffer_size(SOCKET_BUFFER_BYTES);
        }
        server.write_all(&received[..head_bytes])?;
        let (from_server, to_client) = (server.try_clone()?, client.try_clone()?);
        let state = self.clone();
        let down = std::thread::Builder::new()
            .name("stream data".to_owned())
            .spawn(move || state.pass_down(from_server, to_client))?;
        let result = self.pass_up(&mut client, &mut server, &received[head_bytes..]);
        // Either may be closed already.
        let _gone = client.shutdown(Shutdown::Both);
        let _gone = server.shutdown(Shutdown::Both);
        // A panic was reported when it happened.
        let _ended = down.join();
        result
    }

    /// Connects to the server, which is started again if it is gone.
    fn connect(&self) -> Result<TcpStream> {
        let mut server = lock(&self.server);
        if let Ok(stream) = TcpStream::connect_timeout(&server.address(), CONNECT_TIMEOUT) {
            // The system may choose the free port of a server that is gone for the connection itself.
            if stream.local_addr()? != stream.peer_addr()? {
                return Ok(stream);
            }
        }
        server.restart()?;
        let address = server.address();
        drop(server);
        let text = "the stream's server was gone and has been started again. Viewers connect anew";
        lock(&self.notices).pending.push(text.to_owned());
        Ok(TcpStream::connect_timeout(&address, CONNECT_TIMEOUT)?)
    }

    /// Passes what the client sends, within the limits of its messages.
    fn pass_up(&self, client: &mut TcpStream, server: &mut TcpStream, first: &[u8]) -> Result<()> {
        let mut meter = FrameMeter::default();
        let mut message_start = Instant::now();
        let mut bytes = vec![0; PASS_BYTES];
        bytes[..first.len()].copy_from_slice(first);
        let mut length = first.len();
        loop {
            if length > 0 {
                meter.feed(&bytes[..length])?;
                if server.write_all(&bytes[..length]).is_err() {
                    return Ok(());
                }
            }
            if meter.is_between_messages() {
                message_start = Instant::now();
            } else if message_start.elapsed() > MESSAGE_TIME_MAX {
                anyhow::bail!(
                    "a message was not finished within {} s",
                    MESSAGE_TIME_MAX.as_secs()
                );
            }
            length = match client.read(&mut bytes) {
                Ok(0) => return Ok(()),
                Ok(length) => length,
                Err(error) if is_timeout(&error) && !self.is_stopped() => 0,
                Err(_) => return Ok(()),
            };
        }
    }

    /// Passes what the server sends. A client that takes nothing for the time of a stall is dropped.
    fn pass_down(&self, mut server: TcpStream, mut client: TcpStream) {
        let mut bytes = vec![0; PASS_BYTES];
        while !self.is_stopped() {
            let length = match server.read(&mut bytes) {
                Ok(0) => break,
                Ok(length) => length,
                Err(error) if is_timeout(&error) => continue,
                Err(_) => break,
            };
            if let Err(error) = client.write_all(&bytes[..length]) {
                if is_timeout(&error) {
                    let stall = self.limits.stall.as_secs_f64();
                    self.notify(format!(
                        "the stream dropped a viewer that took nothing for {stall} s"
                    ));
                }
                break;
            }
        }
        // Ends the other direction too. Either may be closed already.
        let _gone = client.shutdown(Shutdown::Both);
        let _gone = server.shutdown(Shutdown::Both);
    }

    fn is_stopped(&self) -> bool {
        self.stop_requested.load(Ordering::Relaxed)
    }

    /// Reports a text once.
    fn notify(&self, text: String) {
        let mut notices = lock(&self.notices);
        // Reasons are few; more would be a flood.
        if notices.known.len() < 32 && !notices.known.contains(&text) {
            notices.known.push(text.clone());
            notices.pending.push(text);
        }
    }
}

/// A counted connection; dropping it frees its place.
struct Place {
    state: Arc<GuardState>,
    peer: IpAddr,
}

impl Place {
    fn take(state: &Arc<GuardState>, peer: IpAddr) -> Option<Self> {
        let mut connections = lock(&state.connections);
        let total: usize = connections.values().sum();
        let own = connections.entry(peer).or_default();
        if total >= state.limits.connections || *own >= state.limits.connections_per_address {
            connections.retain(|_, count| *count > 0);
            return None;
        }
        *own += 1;
        Some(Place {
            state: state.clone(),
            peer,
        })
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut connections = lock(&self.state.connections);
        if let Some(count) = connections.get_mut(&self.peer) {
            *count -= 1;
        }
        connections.retain(|_, count| *count > 0);
    }
}

fn wait_readable(listener: &TcpListener) {
    use rustix::event::{PollFd, PollFlags, Timespec, poll};
    let period = Timespec {
        tv_sec: 0,
        tv_nsec: i64::from(POLL_PERIOD.subsec_nanos()),
    };
    // An interrupted wait is shorter, which does no harm.
    let _interrupted = poll(&mut [PollFd::new(listener, PollFlags::IN)], Some(&period));
}

// Counts and texts are valid even if a thread panicked with the lock.
fn lock<T: ?Sized>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Loopback address of this test alone: on the common one, another test may be given the port of a server that is
    /// gone.
    const SERVER_ADDRESS: &str = "127.77.0.1";

    /// A server that echoes one connection after the other, and ends after each.
    struct Echo {
        address: SocketAddr,
        restarts: Arc<Mutex<usize>>,
    }

    impl GuardedServer for Echo {
        fn address(&self) -> SocketAddr {
            self.address
        }

        fn restart(&mut self) -> Result<()> {
            let listener = TcpListener::bind((SERVER_ADDRESS, 0))?;
            self.address = listener.local_addr()?;
            *lock(&self.restarts) += 1;
            std::thread::spawn(move || {
                let (mut peer, _) = listener.accept().expect("a peer");
                drop(listener);
                let mut bytes = [0; 1024];
                while let Ok(length @ 1..) = peer.read(&mut bytes) {
                    peer.write_all(&bytes[..length]).expect("written");
                }
            });
            Ok(())
        }
    }

    #[test]
    fn server_that_is_gone_is_started_again() {
        let gone = TcpListener::bind((SERVER_ADDRESS, 0)).expect("bound");
        let restarts = Arc::new(Mutex::new(0));
        let echo = Echo {
            address: gone.local_addr().expect("an address"),
            restarts: restarts.clone(),
        };
        drop(gone);
        let limits = GuardLimits {
            connections: 2,
            connections_per_address: 2,
            stall: Duration::from_secs(5),
            origins: Vec::new(),
        };
        let guard = Guard::start(("127.0.0.1", 0), limits, echo).expect("a guard");
        for round in 1..4 {
            // A viewer tries again when its connection is reset: the guard may still count the connection before, and a
            // child process between fork and exec keeps the listener of a server that is gone open.
            let deadline = Instant::now() + Duration::from_secs(30);
            while let Err(error) = echo_once(guard.address()) {
                assert!(Instant::now() < deadline, "{error}");
                std::thread::sleep(POLL_PERIOD);
            }
            assert_eq!(*lock(&restarts), round);
            let notices = guard.take_notices();
            assert!(
                notices.iter().any(|text| text.contains("started again")),
                "{notices:?}"
            );
        }
    }

    /// A request that the echo answers with the request itself.
    fn echo_once(address: SocketAddr) -> std::io::Result<()> {
        let mut client = TcpStream::connect(address)?;
        let request = b"GET / HTTP/1.1\r\n\r\n";
        client.write_all(request)?;
        let mut answer = [0; 18];
        client.read_exact(&mut answer)?;
        assert_eq!(&answer, request);
        Ok(())
    }
}
