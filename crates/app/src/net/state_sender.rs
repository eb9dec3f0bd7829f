//! How do other programs get the robot's state? A thread sends a datagram per cycle to each address.

use std::net::{SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;

use anyhow::{Context, Result};
use prost::Message;
use serde::{Deserialize, Serialize};

use super::address::{Destination, resolve};
use super::commands::{ListenerState, RobotIdentity};
use super::lock::lock;
use super::polling::POLL_PERIOD;
use pipeline::datagram::message::State;
use pipeline::feed::{Feed, RecvError, Subscription};

/// A receiver of the state.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct OutputConfig {
    /// Host and port. A name that is not known yet is asked for until it is.
    pub to: String,
    /// Encoding.
    pub format: StateFormat,
    /// This robot's number.
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

/// Encoding of the state.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum StateFormat {
    /// The messages of docs/network.proto.
    #[default]
    Protobuf,
    /// The same names as JSON, one object per datagram.
    Json,
}

/// What senders of commands must know: how to address this start of the robot, and why their commands have no effect.
#[derive(Clone)]
pub(crate) struct CommandStatus {
    pub(crate) identity: RobotIdentity,
    pub(crate) listener: Arc<ListenerState>,
    pub(crate) obstacle: Obstacle,
}

/// Why the robot does not follow the accepted commands of programs now; `None` if it does.
pub(crate) type Obstacle = Arc<dyn Fn() -> Option<String> + Send + Sync>;

impl CommandStatus {
    /// Why the newest command was rejected, else why accepted ones have no effect; empty if they have.
    fn fault(&self) -> String {
        let rejection = self.listener.fault();
        if rejection.is_empty() {
            (self.obstacle)().unwrap_or_default()
        } else {
            rejection
        }
    }
}

/// A thread that sends the state. Dropping it ends the thread.
pub(crate) struct StateSender {
    notices: Arc<Mutex<Vec<String>>>,
    stop_requested: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

/// An address with its socket and encoding.
struct Receiver {
    destination: Destination,
    /// None until the address is known.
    socket: Option<UdpSocket>,
    output: OutputConfig,
}

impl StateSender {
    /// Sends each cycle of a feed to every address. `commands`: None if no commands are received.
    pub(crate) fn start(
        feed: &Feed,
        outputs: &[OutputConfig],
        commands: Option<CommandStatus>,
    ) -> Result<Self> {
        let mut receivers = Vec::with_capacity(outputs.len());
        let stop_requested = Arc::new(AtomicBool::new(false));
        let notices = Arc::default();
        for output in outputs {
            let destination = Destination::new(&output.to, resolve, &stop_requested, &notices);
            let destination = destination.context("[[outputs]] to")?;
            receivers.push(Receiver {
                socket: destination.address().map(socket).transpose()?,
                destination,
                output: output.clone(),
            });
        }
        let stop = stop_requested.clone();
        // Only the newest cycle is of use.
        let cycles = feed.subscribe(1);
        let thread = std::thread::Builder::new()
            .name("outputs".to_owned())
            .spawn(move || send_states(&cycles, receivers, commands.as_ref(), &stop))?;
        Ok(StateSender {
            notices,
            stop_requested,
            thread: Some(thread),
        })
    }

    /// Messages for the operator since the last call.
    pub(crate) fn take_notices(&self) -> Vec<String> {
        std::mem::take(&mut *lock(&self.notices))
    }
}

impl Drop for StateSender {
    fn drop(&mut self) {
        self.stop_requested.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A panic was reported when it happened.
            let _ = thread.join();
        }
    }
}

fn send_states(
    cycles: &Subscription,
    mut receivers: Vec<Receiver>,
    commands: Option<&CommandStatus>,
    stop: &AtomicBool,
) {
    while !stop.load(Ordering::Relaxed) {
        let ((index, cycle), _) = match cycles.recv_indexed(POLL_PERIOD) {
            Ok(entry) => entry,
            Err(RecvError::Timeout) => continue,
            Err(RecvError::Closed) => return,
        };
        for receiver in &mut receivers {
            let Some(address) = receiver.destination.address() else {
                continue;
            };
            if receiver.socket.is_none() {
                receiver.socket = socket(address).ok();
            }
            let (Some(socket), output) = (&receiver.socket, &receiver.output) else {
                continue;
            };
            let mut state = State::from_cycle(output.robot, index, &cycle);
            if let Some(commands) = commands {
                state.boot = commands.identity.boot;
                state.command_fault = commands.fault();
            }
            let datagram = match output.format {
                StateFormat::Protobuf => state.encode_to_vec(),
                // Numbers and strings can always be serialised.
                StateFormat::Json => serde_json::to_vec(&state).unwrap_or_default(),
            };
            // Without a receiver or a network the datagram is lost; the next cycle follows.
            let _sent = socket.send_to(&datagram, address);
        }
    }
}

/// A socket to send from.
fn socket(to: SocketAddr) -> Result<UdpSocket> {
    let any: &str = if to.is_ipv4() { "0.0.0.0:0" } else { "[::]:0" };
    let socket = UdpSocket::bind(any).context("cannot open a socket")?;
    socket.set_nonblocking(true)?;
    Ok(socket)
}
