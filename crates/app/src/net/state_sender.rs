//! Who is told what the robot knows? A datagram for each cycle to each address, by a thread that nothing waits for.

use std::net::{SocketAddr, ToSocketAddrs, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Context, Result};
use prost::Message;
use serde::{Deserialize, Serialize};

use pipeline::datagram::message::State;
use pipeline::feed::{Feed, RecvError, Subscription};

/// One who is told.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OutputConfig {
    /// Host and port.
    pub to: String,
    /// How it is written.
    pub format: StateFormat,
    /// Our number.
    pub robot: u32,
}

impl Default for OutputConfig {
    fn default() -> Self {
        OutputConfig {
            to: "127.0.0.1:7070".to_owned(),
            format: StateFormat::Protobuf,
            robot: 1,
        }
    }
}

/// How a state is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum StateFormat {
    /// The messages of docs/network.proto.
    #[default]
    Protobuf,
    /// The same names as JSON, one object a datagram.
    Json,
}

/// A thread that tells; dropping it ends it.
pub struct StateSender {
    stop_requested: Arc<AtomicBool>,
    sent: Arc<AtomicU64>,
    thread: Option<JoinHandle<()>>,
}

/// The thread looks this often whether it is to end.
const POLL_PERIOD: Duration = Duration::from_millis(100);

impl StateSender {
    /// Tells each cycle of a feed to every address.
    pub fn start(feed: &Feed, outputs: &[OutputConfig]) -> Result<Self> {
        let mut receivers = Vec::with_capacity(outputs.len());
        for output in outputs {
            let address =
                resolve(&output.to).with_context(|| format!("[[outputs]] to = {:?}", output.to))?;
            receivers.push((socket(address)?, address, output.clone()));
        }
        let (ending, sent) = (Arc::new(AtomicBool::new(false)), Arc::default());
        let (stop, count) = (ending.clone(), Arc::clone(&sent));
        // What is older than the newest is of no use to anybody.
        let cycles = feed.subscribe(1);
        let thread = std::thread::Builder::new()
            .name("outputs".to_owned())
            .spawn(move || send_states(&cycles, &receivers, &stop, &count))?;
        Ok(StateSender {
            stop_requested: ending,
            sent,
            thread: Some(thread),
        })
    }

    /// Datagrams handed to the system.
    pub fn sent(&self) -> u64 {
        self.sent.load(Ordering::Relaxed)
    }
}

impl Drop for StateSender {
    fn drop(&mut self) {
        self.stop_requested.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // Its panic was told when it happened.
            let _ = thread.join();
        }
    }
}

fn send_states(
    cycles: &Subscription,
    receivers: &[(UdpSocket, SocketAddr, OutputConfig)],
    ending: &AtomicBool,
    sent: &AtomicU64,
) {
    while !ending.load(Ordering::Relaxed) {
        let ((index, cycle), _) = match cycles.recv_indexed(POLL_PERIOD) {
            Ok(entry) => entry,
            Err(RecvError::Timeout) => continue,
            Err(RecvError::Closed) => return,
        };
        for (socket, address, output) in receivers {
            let state = State::from_cycle(output.robot, index, &cycle);
            let datagram = match output.format {
                StateFormat::Protobuf => state.encode_to_vec(),
                // Numbers and strings always have a form.
                StateFormat::Json => serde_json::to_vec(&state).unwrap_or_default(),
            };
            // Nobody there, or no network for a while: the next cycle is told anew.
            sent.fetch_add(
                u64::from(socket.send_to(&datagram, address).is_ok()),
                Ordering::Relaxed,
            );
        }
    }
}

/// The first address of a name.
pub(crate) fn resolve(name: &str) -> Result<SocketAddr> {
    name.to_socket_addrs()
        .context("must be host:port")?
        .next()
        .context("no such host")
}

/// A socket to send from.
fn socket(to: SocketAddr) -> Result<UdpSocket> {
    let any: &str = if to.is_ipv4() { "0.0.0.0:0" } else { "[::]:0" };
    let socket = UdpSocket::bind(any).context("no socket to send from")?;
    socket.set_nonblocking(true)?;
    Ok(socket)
}
