//! Which commands of other programs are accepted? Fresh ones of an authorised sender.

use std::collections::BTreeMap;
use std::net::{SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use hw::StampedSocket;
use localize::Stamp;
use prost::Message;
use serde::{Deserialize, Serialize};
use socket2::Type;

use super::address::{bind, resolve};
use super::command_senders::CommandSenders;
use super::lock::lock;
use super::polling::POLL_PERIOD;
use pipeline::datagram::authentication::{MacKey, RejectReason, ReplayGuard, verify_mac};
use pipeline::datagram::message::{Command, Drive, Kick, VERSION};

/// Commands by UDP.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CommandConfig {
    /// Address to listen on; other than loopback addresses need a key. The name of a host must be known at the start.
    pub bind: String,
    /// Phrase of at least 8 characters shared with the sender; datagrams then end with an authentication code.
    pub key: Option<String>,
    /// Maximum validity of a command, milliseconds; longer ones are shortened.
    pub valid_max_ms: f32,
    /// Maximum speed, over the ground in m/s and about the vertical in rad/s; faster commands are rejected.
    pub speed_max: f32,
    /// Maximum speed of a kick, m/s.
    pub kick_max: f32,
    /// After this time without an accepted command a sender may start again with a lower session, or go on with the same one from
    /// another address, seconds. Without a key one that
    /// another sender interrupted goes on then; under a key it needs a session that was not used yet.
    pub silence: f64,
    /// Maximum age of the state on which a command is based, if the command names it, milliseconds. A state as far in the
    /// future is rejected, too.
    pub state_age_max_ms: f32,
}

/// By what senders address this start of this robot; the state output publishes both.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RobotIdentity {
    /// Number of the robot.
    pub robot: u32,
    /// Random number of this start.
    pub boot: u64,
}

impl Default for CommandConfig {
    fn default() -> Self {
        CommandConfig {
            bind: "127.0.0.1:7071".to_owned(),
            key: None,
            valid_max_ms: (hw::config::COMMAND_VALIDITY_MAX * 1e3) as f32,
            speed_max: 15.0,
            kick_max: 15.0,
            silence: 1.0,
            state_age_max_ms: 500.0,
        }
    }
}

/// An accepted command.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RemoteCommand {
    /// Velocity. None keeps the current one.
    pub drive: Option<Drive>,
    /// A kick, once.
    pub kick: Option<Kick>,
    /// The command is valid only while there is a pose.
    pub needs_pose: bool,
    /// Validity after its arrival.
    pub valid_for: Duration,
    /// End of its validity, in the clock of its arrival.
    pub deadline: Stamp,
}

/// Accepts or rejects datagrams. Does no I/O and reads no clock.
#[derive(Debug)]
pub struct CommandFilter {
    config: CommandConfig,
    identity: RobotIdentity,
    key: Option<MacKey>,
    replay_guard: ReplayGuard,
}

impl CommandFilter {
    /// A filter by a configuration, for the commands to one start of a robot.
    pub fn new(config: &CommandConfig, identity: RobotIdentity) -> Result<Self> {
        for (name, value) in [
            ("valid_max_ms", config.valid_max_ms),
            ("speed_max", config.speed_max),
            ("kick_max", config.kick_max),
            ("silence", config.silence as f32),
            ("state_age_max_ms", config.state_age_max_ms),
        ] {
            ensure!(
                (0.0..=1e6).contains(&value),
                "[commands] invalid {name}: {value} (expected 0 to 1e6)"
            );
        }
        let key = config.key.as_deref().map(MacKey::new).transpose()?;
        Ok(CommandFilter {
            config: config.clone(),
            identity,
            replay_guard: ReplayGuard::new(key.is_some()),
            key,
        })
    }

    /// Decodes and checks a datagram of `source` that arrived at `arrival`, in the clock of the published states.
    pub fn accept(
        &mut self,
        datagram: &[u8],
        source: Option<SocketAddr>,
        arrival: Stamp,
    ) -> Result<RemoteCommand, RejectReason> {
        let content = verify_mac(datagram, self.key.as_ref())?;
        let command = if content.first() == Some(&b'{') {
            let command: Command =
                serde_json::from_slice(content).map_err(|_foreign| RejectReason::Foreign)?;
            if command.version == 0 {
                return Err(RejectReason::Unversioned);
            }
            command
        } else {
            let command = Command::decode(content).map_err(|_foreign| RejectReason::Foreign)?;
            // Other bytes, none among them, may decode by chance. They lack a version then.
            if command.version == 0 {
                return Err(RejectReason::Foreign);
            }
            command
        };
        if command.version != VERSION {
            return Err(RejectReason::Version);
        }
        let config = &self.config;
        let within = |value: f32, limit: f32| value.abs() <= limit;
        let is_valid = command.drive.is_none_or(|drive| {
            [drive.x.hypot(drive.y), drive.theta]
                .iter()
                .all(|value| within(*value, config.speed_max))
        }) && command
            .kick
            .is_none_or(|kick| kick.speed >= 0.0 && within(kick.speed, config.kick_max));
        if !is_valid || !(command.valid_ms >= 0.0) {
            return Err(RejectReason::Senseless);
        }
        self.check_addressee(&command)?;
        if command.state_ns != 0 {
            let state_age = arrival - Stamp(command.state_ns);
            let state_age_max = f64::from(config.state_age_max_ms) * 1e-3;
            if state_age > state_age_max {
                return Err(RejectReason::Late);
            }
            if state_age < -state_age_max {
                return Err(RejectReason::Future);
            }
        }
        // Last, so that a rejected datagram does not use up its sequence number.
        self.replay_guard.accept(
            command.session,
            command.sequence,
            source,
            arrival.seconds(),
            config.silence,
        )?;
        let valid_ms = command.valid_ms.min(config.valid_max_ms);
        let valid_for = Duration::from_secs_f64(f64::from(valid_ms) / 1e3);
        Ok(RemoteCommand {
            drive: command.drive,
            kick: command.kick,
            needs_pose: command.needs_pose,
            valid_for,
            deadline: arrival + valid_for.as_secs_f64(),
        })
    }

    /// Under a key a command must name this robot and this start of it: another robot may have the same key, and a
    /// command recorded before a restart must have no effect after it.
    fn check_addressee(&self, command: &Command) -> Result<(), RejectReason> {
        if command.boot == 0 && self.key.is_some() {
            return Err(RejectReason::Unbound);
        }
        let names_robot = command.robot != 0 || self.key.is_some();
        if names_robot && command.robot != self.identity.robot {
            return Err(RejectReason::Robot);
        }
        if command.boot != 0 && command.boot != self.identity.boot {
            return Err(RejectReason::Boot);
        }
        Ok(())
    }
}

/// A thread that listens for commands. Dropping it ends the thread.
pub(crate) struct CommandListener {
    shared: Arc<ListenerState>,
    #[cfg(test)]
    address: SocketAddr,
    thread: Option<JoinHandle<()>>,
}

/// What the listening thread shares with the run and the state output.
#[derive(Default)]
pub(crate) struct ListenerState {
    counts: Mutex<CommandCounts>,
    /// Why the newest datagram was rejected. Empty if it was not.
    fault: Mutex<String>,
    /// Messages for the operator.
    notices: Mutex<Vec<String>>,
    stop_requested: AtomicBool,
}

/// Numbers of received datagrams by result.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub(crate) struct CommandCounts {
    /// Datagrams whose command was passed to the base.
    pub accepted: u64,
    /// Drive commands and kicks of other programs that were sent on the base's bus. A newer command replaces one that was
    /// not sent yet.
    pub sent: u64,
    /// Sent commands that the base confirmed: by a report of its wheels during their validity without a pressed emergency
    /// stop, or by a report of the kick.
    pub obeyed: u64,
    /// Valid commands that were not executed: a higher priority, no pose or no base.
    pub overruled: u64,
    /// Rejected datagrams by reason.
    pub refused: BTreeMap<RejectReason, u64>,
}

/// A command is far shorter; a longer datagram is cut and then rejected.
const MAX_DATAGRAM_BYTES: usize = 2048;

impl CommandConfig {
    /// Refuses what a base could not do.
    pub(super) fn check_validity(&self) -> Result<()> {
        let most = CommandConfig::default().valid_max_ms;
        ensure!(
            self.valid_max_ms <= most,
            "[commands] invalid valid_max_ms: {} (expected at most {most}: no command of a base is valid longer)",
            self.valid_max_ms
        );
        Ok(())
    }

    /// The address to listen on. Addresses that other machines reach need a key.
    pub fn address(&self) -> Result<SocketAddr> {
        let address =
            resolve(&self.bind).with_context(|| format!("[commands] bind = {:?}", self.bind))?;
        ensure!(
            address.ip().is_loopback() || self.key.is_some(),
            "[commands] bind = {:?} lets other machines drive the robot without authentication: set a key",
            self.bind
        );
        Ok(address)
    }
}

impl CommandListener {
    /// Listens for commands and passes each to `execute`, which returns whether it was executed.
    pub(crate) fn listen(
        config: &CommandConfig,
        identity: RobotIdentity,
        mut execute: impl FnMut(RemoteCommand) -> bool + Send + 'static,
    ) -> Result<Self> {
        let address = config.address()?;
        let mut filter = CommandFilter::new(config, identity)?;
        let (socket, notice) = bind(address, Type::DGRAM)
            .with_context(|| format!("[commands] cannot listen on {}", config.bind))?;
        let socket = UdpSocket::from(socket);
        #[cfg(test)]
        let address = socket.local_addr()?;
        let mut socket = StampedSocket::new(socket)?;
        let shared = Arc::new(ListenerState::default());
        lock(&shared.notices).extend(notice.map(|text| format!("[commands] {text}")));
        let state = shared.clone();
        let thread = std::thread::Builder::new()
            .name("commands".to_owned())
            .spawn(move || {
                let mut datagram = [0; MAX_DATAGRAM_BYTES];
                let mut senders = CommandSenders::new();
                while !state.stop_requested.load(Ordering::Relaxed) {
                    let Some(received) = socket.receive(&mut datagram, POLL_PERIOD) else {
                        continue;
                    };
                    let command = filter.accept(
                        &datagram[..received.length],
                        received.source,
                        received.arrival,
                    );
                    if command.is_ok() {
                        lock(&state.notices).extend(senders.accept(&received));
                    }
                    // The thread may have been stopped while the command waited in the socket.
                    let command = command.and_then(|command| {
                        let in_time = command.deadline > hw::now();
                        in_time.then_some(command).ok_or(RejectReason::Late)
                    });
                    let rejected = command.as_ref().err();
                    if let Some(reason) = rejected {
                        lock(&state.notices).extend(senders.reject(&received, *reason));
                    }
                    *lock(&state.fault) =
                        rejected.map_or_else(String::new, |reason| senders.fault(*reason));
                    state.count(command.map(&mut execute));
                }
            })?;
        Ok(CommandListener {
            shared,
            #[cfg(test)]
            address,
            thread: Some(thread),
        })
    }

    /// Local address of the socket.
    #[cfg(test)]
    pub(crate) fn address(&self) -> SocketAddr {
        self.address
    }

    /// Numbers of datagrams so far.
    pub(crate) fn counts(&self) -> CommandCounts {
        self.shared.lock().clone()
    }

    /// The shared state, for the state output.
    pub(crate) fn shared(&self) -> Arc<ListenerState> {
        self.shared.clone()
    }

    /// Messages for the operator since the last call.
    pub(crate) fn take_notices(&self) -> Vec<String> {
        std::mem::take(&mut *lock(&self.shared.notices))
    }
}

impl CommandListener {
    /// Ends the thread after the datagram that it processes.
    fn stop(&mut self) {
        self.shared.stop_requested.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A panic was reported when it happened.
            let _ = thread.join();
        }
    }

    /// Ends the thread; returns the final counts.
    #[cfg(test)]
    pub(crate) fn finish(mut self) -> CommandCounts {
        self.stop();
        self.counts()
    }
}

impl Drop for CommandListener {
    fn drop(&mut self) {
        self.stop();
    }
}

impl ListenerState {
    fn count(&self, executed: Result<bool, RejectReason>) {
        let mut counts = self.lock();
        match executed {
            Ok(true) => counts.accepted += 1,
            Ok(false) => counts.overruled += 1,
            Err(reason) => *counts.refused.entry(reason).or_default() += 1,
        }
    }

    /// Why the newest datagram was rejected; empty if it was not.
    pub(crate) fn fault(&self) -> String {
        lock(&self.fault).clone()
    }

    fn lock(&self) -> MutexGuard<'_, CommandCounts> {
        lock(&self.counts)
    }
}
