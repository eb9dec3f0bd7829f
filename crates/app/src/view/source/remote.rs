//! Receives a robot's live stream over the network in a thread, and reconnects after a lost connection.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};

use super::DecodedCycle;
use super::live::CycleInbox;
use crate::stream::{StreamClient, StreamEvent};
use pipeline::feed::{RecvError, Subscription};
use pipeline::log::{Header, LoggedCycle};
use pipeline::setup::Setup;

/// Time limit for connecting to the robot and receiving its header.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(3);
/// Interval at which the thread checks its stop flag.
const POLL_INTERVAL: Duration = Duration::from_millis(100);
/// Interval between reconnection attempts.
const RETRY_INTERVAL: Duration = Duration::from_secs(1);

/// Stops its thread when dropped.
pub(crate) struct StopGuard(Arc<AtomicBool>);

impl Drop for StopGuard {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// A connected robot.
pub(crate) struct RemoteRobot {
    /// Header of its log.
    pub(crate) header: Header,
    /// Its robot, field and ground map.
    pub(crate) setup: Setup,
    /// Temporary folder with the files that `setup` refers to.
    pub(crate) folder: tempfile::TempDir,
    /// Stops the receiving thread.
    pub(crate) guard: StopGuard,
}

/// Connects to `host:port`, waits for the robot's files, and starts the thread that forwards its cycles.
pub(crate) fn connect(address: &str, inbox: CycleInbox) -> Result<RemoteRobot> {
    let mut client = StreamClient::connect(address, CONNECT_TIMEOUT)?;
    let deadline = Instant::now() + CONNECT_TIMEOUT;
    let header = loop {
        match client.next_event(POLL_INTERVAL)? {
            Some(StreamEvent::Header(header)) => break *header,
            _ if Instant::now() > deadline => bail!(
                "{address}: no header received within {} s",
                CONNECT_TIMEOUT.as_secs()
            ),
            _ => {}
        }
    };
    let folder =
        tempfile::tempdir().context("cannot create a temporary folder for the robot's files")?;
    header.write_files(folder.path())?;
    let setup = Setup::load(&folder.path().join("robot.toml"), None)?;
    let stop = Arc::new(AtomicBool::new(false));
    let (stopped, address) = (stop.clone(), address.to_owned());
    std::thread::Builder::new()
        .name("watch".to_owned())
        .spawn(move || receive_cycles(client, &address, &inbox, &stopped))?;
    Ok(RemoteRobot {
        header,
        setup,
        folder,
        guard: StopGuard(stop),
    })
}

fn receive_cycles(mut client: StreamClient, address: &str, inbox: &CycleInbox, stop: &AtomicBool) {
    while !stop.load(Ordering::Relaxed) {
        match client.next_event(POLL_INTERVAL) {
            Ok(Some(StreamEvent::Cycle(logged))) => inbox.push(decode(*logged)),
            Ok(_) => {}
            Err(error) => {
                inbox.set_status(Some(format!("{error:#}; reconnecting")));
                let Some(reconnected) = reconnect(address, stop) else {
                    return;
                };
                client = reconnected;
                inbox.set_status(None);
            }
        }
    }
}

fn reconnect(address: &str, stop: &AtomicBool) -> Option<StreamClient> {
    while !stop.load(Ordering::Relaxed) {
        if let Ok(client) = StreamClient::connect(address, CONNECT_TIMEOUT) {
            return Some(client);
        }
        std::thread::sleep(RETRY_INTERVAL);
    }
    None
}

fn decode(logged: LoggedCycle) -> DecodedCycle {
    let mut cycle = logged.cycle;
    // A cycle with a corrupt image is still shown, without its image.
    let image = logged.image.and_then(|image| image.decode().ok());
    cycle.inputs.image = image.map(Into::into);
    DecodedCycle {
        cycle: Arc::new(cycle),
        particles: Vec::new(),
    }
}

/// Forwards the cycles of a run in this process to the inbox until the run ends.
pub(crate) fn forward_feed(
    subscription: Subscription,
    inbox: CycleInbox,
) -> std::io::Result<StopGuard> {
    let stop = Arc::new(AtomicBool::new(false));
    let stopped = stop.clone();
    std::thread::Builder::new()
        .name("watch".to_owned())
        .spawn(move || {
            while !stopped.load(Ordering::Relaxed) {
                match subscription.recv_timeout(POLL_INTERVAL) {
                    Ok(cycle) => inbox.push(DecodedCycle::new(cycle, Vec::new())),
                    Err(RecvError::Timeout) => {}
                    Err(RecvError::Closed) => {
                        inbox.set_status(Some("the run has ended".to_owned()));
                        return;
                    }
                }
            }
        })?;
    Ok(StopGuard(stop))
}
