//! What does a robot elsewhere see? Its live stream, read by a thread of its own, which waits for it if it goes away.

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

/// A robot that listens answers within this.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(3);
/// Between two looks at the connection.
const POLL_INTERVAL: Duration = Duration::from_millis(100);
/// Between two attempts to reach a robot that went away.
const RETRY_INTERVAL: Duration = Duration::from_secs(1);

/// The thread's lease: when it is dropped, the thread ends.
pub(crate) struct StopGuard(Arc<AtomicBool>);

impl Drop for StopGuard {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// A robot that is being watched.
pub(crate) struct RemoteRobot {
    /// What its log would start with.
    pub(crate) header: Header,
    /// Its robot, field and map.
    pub(crate) setup: Setup,
    /// The files that the setup's paths lead to.
    pub(crate) folder: tempfile::TempDir,
    /// Ends the thread.
    pub(crate) guard: StopGuard,
}

/// Connects to `host:port`, waits for the robot's files, and then hands its cycles over.
pub(crate) fn connect(address: &str, inbox: CycleInbox) -> Result<RemoteRobot> {
    let mut client = StreamClient::connect(address, CONNECT_TIMEOUT)?;
    let until = Instant::now() + CONNECT_TIMEOUT;
    let header = loop {
        match client.next_event(POLL_INTERVAL)? {
            Some(StreamEvent::Header(header)) => break *header,
            _ if Instant::now() > until => bail!("{address} does not say which robot it is"),
            _ => {}
        }
    };
    let folder = tempfile::tempdir().context("no room for the robot's files")?;
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
                inbox.set_status(Some(format!("{error:#}; waiting for it to come back")));
                let Some(again) = reconnect(address, stop) else {
                    return;
                };
                client = again;
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
    // A broken image leaves a cycle that is still worth seeing.
    let image = logged.image.and_then(|image| image.decode().ok());
    cycle.inputs.image = image.map(Into::into);
    DecodedCycle {
        cycle: Arc::new(cycle),
        particles: Vec::new(),
    }
}

/// Hands on the cycles of a run beside, until it ends.
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
