//! What do other programs want of the wheels? Fresh commands of one who may give them; none else.

use std::collections::BTreeMap;
use std::net::{SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use prost::Message;
use serde::{Deserialize, Serialize};

use super::state_sender::resolve;
use pipeline::datagram::authentication::{MacKey, RejectReason, ReplayGuard, verify_mac};
use pipeline::datagram::message::{Command, Drive, Kick, VERSION};

/// Commands by UDP.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CommandConfig {
    /// Address to listen on; beyond this machine a key is asked for.
    pub bind: String,
    /// A phrase that the sender shares; datagrams then end with their authentication code.
    pub key: Option<String>,
    /// No command holds for longer, milliseconds, whatever it asks for.
    pub valid_max_ms: f32,
    /// Fastest drive that is taken, m/s and rad/s; more is refused.
    pub speed_max: f32,
    /// Fastest kick that is taken, m/s.
    pub kick_max: f32,
    /// A sender that was silent for so many seconds may begin anew with a lower session.
    pub silence: f64,
}

impl Default for CommandConfig {
    fn default() -> Self {
        CommandConfig {
            bind: "127.0.0.1:7071".to_owned(),
            key: None,
            // The watchdog of the base.
            valid_max_ms: 100.0,
            speed_max: 15.0,
            kick_max: 15.0,
            silence: 1.0,
        }
    }
}

/// A command that was taken.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RemoteCommand {
    /// How to drive; none leaves it as it is.
    pub drive: Option<Drive>,
    /// A kick, once.
    pub kick: Option<Kick>,
    /// Drive only while there is a pose.
    pub needs_pose: bool,
    /// How long it holds after its arrival.
    pub valid_for: Duration,
}

/// Decides which datagrams are commands to us; a function of what it is given.
#[derive(Debug)]
pub struct CommandFilter {
    config: CommandConfig,
    key: Option<MacKey>,
    replay_guard: ReplayGuard,
}

impl CommandFilter {
    /// A gate for commands under a configuration.
    pub fn new(config: &CommandConfig) -> Result<Self> {
        for (name, value) in [
            ("valid_max_ms", config.valid_max_ms),
            ("speed_max", config.speed_max),
            ("kick_max", config.kick_max),
            ("silence", config.silence as f32),
        ] {
            ensure!(
                (0.0..=1e6).contains(&value),
                "[commands] {name} = {value}: must be 0 to 1e6"
            );
        }
        Ok(CommandFilter {
            config: config.clone(),
            key: config.key.as_deref().map(MacKey::new).transpose()?,
            replay_guard: ReplayGuard::default(),
        })
    }

    /// Takes a datagram at `now`, seconds.
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
        let within = |value: f32, most: f32| value.abs() <= most;
        let sensible = command.drive.is_none_or(|drive| {
            [drive.x, drive.y, drive.theta]
                .iter()
                .all(|value| within(*value, config.speed_max))
        }) && command
            .kick
            .is_none_or(|kick| kick.speed >= 0.0 && within(kick.speed, config.kick_max));
        if !sensible || !(command.valid_ms >= 0.0) {
            return Err(RejectReason::Senseless);
        }
        // Last, so that what is refused takes nobody's turn.
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

/// A thread that listens; dropping it ends it.
pub struct CommandListener {
    shared: Arc<ListenerState>,
    address: SocketAddr,
    thread: Option<JoinHandle<()>>,
}

#[derive(Default)]
struct ListenerState {
    counts: Mutex<CommandCounts>,
    stop_requested: AtomicBool,
}

/// What became of the datagrams.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct CommandCounts {
    /// Commands that were carried out.
    pub obeyed: u64,
    /// Good commands that were not carried out: another drives, there is no pose or no base.
    pub overruled: u64,
    /// Datagrams that were no command to us, for each reason.
    pub refused: BTreeMap<RejectReason, u64>,
}

/// The thread looks this often whether it is to end.
const POLL_PERIOD: Duration = Duration::from_millis(100);
/// A command is far shorter; a longer datagram is cut and so refused.
const MAX_DATAGRAM_BYTES: usize = 2048;

impl CommandConfig {
    /// Where to listen; refused where strangers could drive the robot.
    pub fn address(&self) -> Result<SocketAddr> {
        let address =
            resolve(&self.bind).with_context(|| format!("[commands] bind = {:?}", self.bind))?;
        ensure!(
            address.ip().is_loopback() || self.key.is_some(),
            "[commands] bind = {:?} lets others than this machine drive the robot: set a key",
            self.bind
        );
        Ok(address)
    }
}

impl CommandListener {
    /// Listens for commands, and hands each one on as it comes; `obey` says whether it is carried out.
    pub fn listen(
        config: &CommandConfig,
        mut obey: impl FnMut(RemoteCommand) -> bool + Send + 'static,
    ) -> Result<Self> {
        let address = config.address()?;
        let mut gate = CommandFilter::new(config)?;
        let socket = UdpSocket::bind(address)
            .with_context(|| format!("[commands] cannot listen on {}", config.bind))?;
        socket.set_read_timeout(Some(POLL_PERIOD))?;
        let address = socket.local_addr()?;
        let shared = Arc::new(ListenerState::default());
        let own = shared.clone();
        let started = Instant::now();
        let thread = std::thread::Builder::new()
            .name("commands".to_owned())
            .spawn(move || {
                let mut datagram = [0; MAX_DATAGRAM_BYTES];
                while !own.stop_requested.load(Ordering::Relaxed) {
                    // A timeout, or an error of an earlier datagram's way back: neither ends listening.
                    let Ok(length) = socket.recv(&mut datagram) else {
                        continue;
                    };
                    let order = gate.accept(&datagram[..length], started.elapsed().as_secs_f64());
                    own.count(order.map(&mut obey));
                }
            })?;
        Ok(CommandListener {
            shared,
            address,
            thread: Some(thread),
        })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// What became of the datagrams so far.
    pub fn counts(&self) -> CommandCounts {
        self.shared.lock().clone()
    }
}

impl Drop for CommandListener {
    fn drop(&mut self) {
        self.shared.stop_requested.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // Its panic was told when it happened.
            let _ = thread.join();
        }
    }
}

impl ListenerState {
    fn count(&self, obeyed: Result<bool, RejectReason>) {
        let mut counts = self.lock();
        match obeyed {
            Ok(true) => counts.obeyed += 1,
            Ok(false) => counts.overruled += 1,
            Err(why) => *counts.refused.entry(why).or_default() += 1,
        }
    }

    // A panic of the other side leaves counts that are still true.
    fn lock(&self) -> MutexGuard<'_, CommandCounts> {
        self.counts.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
