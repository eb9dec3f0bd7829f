//! Receives a robot's live stream over the network in a thread, and reconnects after a lost connection.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Result, bail};

use super::decoded_cycle::DecodedCycle;
use super::inbox::CycleInbox;
use super::remote_settings::{RemoteSettings, SettingsCourier};
use super::stop_guard::StopGuard;
use crate::stream::{StreamClient, StreamEvent};
use pipeline::log::{Header, LoggedCycle, UnpackedSetup};
use pipeline::setup::Setup;

/// Time limit for connecting to the robot and receiving its header.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(3);
/// Interval at which the thread checks its stop flag.
const POLL_INTERVAL: Duration = Duration::from_millis(100);
/// Interval between reconnection attempts.
const RETRY_INTERVAL: Duration = Duration::from_secs(1);

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
    /// Changes its settings.
    pub(crate) settings: RemoteSettings,
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
    let UnpackedSetup { setup, folder } = UnpackedSetup::load(&header)?;
    let (guard, stop) = StopGuard::new();
    let (settings, mut courier) = RemoteSettings::new();
    client.request_settings()?;
    let address = address.to_owned();
    std::thread::Builder::new()
        .name("watch".to_owned())
        .spawn(move || receive_cycles(client, &mut courier, &address, &inbox, &stop))?;
    Ok(RemoteRobot {
        header,
        setup,
        folder,
        guard,
        settings,
    })
}

fn receive_cycles(
    mut client: StreamClient,
    courier: &mut SettingsCourier,
    address: &str,
    inbox: &CycleInbox,
    stop: &AtomicBool,
) {
    while !stop.load(Ordering::Relaxed) {
        match receive_event(&mut client, courier, inbox) {
            Ok(()) => {}
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

/// Passes on a change of settings, and takes the next event.
fn receive_event(
    client: &mut StreamClient,
    courier: &mut SettingsCourier,
    inbox: &CycleInbox,
) -> Result<()> {
    courier.pass_on(client)?;
    match client.next_event(POLL_INTERVAL)? {
        Some(StreamEvent::Cycle(logged)) => inbox.push(decode(*logged)),
        Some(StreamEvent::Settings(texts)) => courier.receive(client, &texts)?,
        Some(StreamEvent::Header(_)) | None => {}
    }
    Ok(())
}

fn reconnect(address: &str, stop: &AtomicBool) -> Option<StreamClient> {
    while !stop.load(Ordering::Relaxed) {
        let connected = StreamClient::connect(address, CONNECT_TIMEOUT);
        if let Ok(client) = connected.and_then(|mut client| {
            client.request_settings()?;
            Ok(client)
        }) {
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
