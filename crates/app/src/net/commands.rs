//! Which commands of other programs are accepted? Fresh ones of an authorised sender.

use std::collections::BTreeMap;
use std::net::{SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use prost::Message;
use serde::{Deserialize, Serialize};

use super::polling::POLL_PERIOD;
use super::state_sender::resolve;
use pipeline::datagram::authentication::{MacKey, RejectReason, ReplayGuard, verify_mac};
use pipeline::datagram::message::{Command, Drive, Kick, VERSION};

/// Commands by UDP.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CommandConfig {
    /// Address to listen on; other than loopback addresses need a key.
    pub bind: String,
    /// Phrase shared with the sender; datagrams then end with an authentication code.
    pub key: Option<String>,
    /// Maximum validity of a command, milliseconds; longer ones are shortened.
    pub valid_max_ms: f32,
    /// Maximum speed, m/s and rad/s; faster commands are rejected.
    pub speed_max: f32,
    /// Maximum speed of a kick, m/s.
    pub kick_max: f32,
    /// After this silence a sender may start again with a lower session, seconds.
    pub silence: f64,
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
}

/// Accepts or rejects datagrams. Does no I/O and reads no clock.
#[derive(Debug)]
pub struct CommandFilter {
    config: CommandConfig,
    key: Option<MacKey>,
    replay_guard: ReplayGuard,
}

impl CommandFilter {
    /// A filter by a configuration.
    pub fn new(config: &CommandConfig) -> Result<Self> {
        for (name, value) in [
            ("valid_max_ms", config.valid_max_ms),
            ("speed_max", config.speed_max),
            ("kick_max", config.kick_max),
            ("silence", config.silence as f32),
        ] {
            ensure!(
                (0.0..=1e6).contains(&value),
                "[commands] invalid {name}: {value} (expected 0 to 1e6)"
            );
        }
        Ok(CommandFilter {
            config: config.clone(),
            key: config.key.as_deref().map(MacKey::new).transpose()?,
            replay_guard: ReplayGuard::default(),
        })
    }

    /// Decodes and checks a datagram received at `now` (seconds of any clock).
    pub fn accept(&mut self, datagram: &[u8], now: f64) -> Result<RemoteCommand, RejectReason> {
        let content = verify_mac(datagram, self.key.as_ref())?;
        let command = if content.first() == Some(&b'{') {
            serde_json::from_slice(content).map_err(|_foreign| RejectReason::Foreign)?
        } else {
            Command::decode(content).map_err(|_foreign| RejectReason::Foreign)?
        };
        if command.version != VERSION {
            return Err(RejectReason::Version);
        }
        let config = &self.config;
        let within = |value: f32, limit: f32| value.abs() <= limit;
        let is_valid = command.drive.is_none_or(|drive| {
            [drive.x, drive.y, drive.theta]
                .iter()
                .all(|value| within(*value, config.speed_max))
        }) && command
            .kick
            .is_none_or(|kick| kick.speed >= 0.0 && within(kick.speed, config.kick_max));
        if !is_valid || !(command.valid_ms >= 0.0) {
            return Err(RejectReason::Senseless);
        }
        // Last, so that a rejected datagram does not use up its sequence number.
        self.replay_guard
            .accept(command.session, command.sequence, now, config.silence)?;
        let valid_ms = command.valid_ms.min(config.valid_max_ms);
        Ok(RemoteCommand {
            drive: command.drive,
            kick: command.kick,
            needs_pose: command.needs_pose,
            valid_for: Duration::from_secs_f64(f64::from(valid_ms) / 1e3),
        })
    }
}

/// A thread that listens for commands. Dropping it ends the thread.
pub(crate) struct CommandListener {
    shared: Arc<ListenerState>,
    #[cfg(test)]
    address: SocketAddr,
    thread: Option<JoinHandle<()>>,
}

#[derive(Default)]
struct ListenerState {
    counts: Mutex<CommandCounts>,
    stop_requested: AtomicBool,
}

/// Numbers of received datagrams by result.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub(crate) struct CommandCounts {
    /// Executed commands.
    pub obeyed: u64,
    /// Valid commands that were not executed: a higher priority, no pose or no base.
    pub overruled: u64,
    /// Rejected datagrams by reason.
    pub refused: BTreeMap<RejectReason, u64>,
}

/// A command is far shorter; a longer datagram is cut and then rejected.
const MAX_DATAGRAM_BYTES: usize = 2048;

impl CommandConfig {
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
        mut execute: impl FnMut(RemoteCommand) -> bool + Send + 'static,
    ) -> Result<Self> {
        let address = config.address()?;
        let mut filter = CommandFilter::new(config)?;
        let socket = UdpSocket::bind(address)
            .with_context(|| format!("[commands] cannot listen on {}", config.bind))?;
        socket.set_read_timeout(Some(POLL_PERIOD))?;
        #[cfg(test)]
        let address = socket.local_addr()?;
        let shared = Arc::new(ListenerState::default());
        let state = shared.clone();
        let started = Instant::now();
        let thread = std::thread::Builder::new()
            .name("commands".to_owned())
            .spawn(move || {
                let mut datagram = [0; MAX_DATAGRAM_BYTES];
                while !state.stop_requested.load(Ordering::Relaxed) {
                    // A timeout, or an ICMP error of an earlier datagram: neither ends the thread.
                    let Ok(length) = socket.recv(&mut datagram) else {
                        continue;
                    };
                    let command =
                        filter.accept(&datagram[..length], started.elapsed().as_secs_f64());
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
            Ok(true) => counts.obeyed += 1,
            Ok(false) => counts.overruled += 1,
            Err(reason) => *counts.refused.entry(reason).or_default() += 1,
        }
    }

    // The counts are valid even if a thread panicked with the lock.
    fn lock(&self) -> MutexGuard<'_, CommandCounts> {
        self.counts.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
