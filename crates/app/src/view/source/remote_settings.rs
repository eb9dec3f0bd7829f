//! Changes the settings of a connected robot: requests of the view, answers of the robot.

use std::collections::BTreeMap;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use anyhow::Result;

use crate::run::tuning::seal;
use crate::stream::{HISTORY, MESSAGE, NONCE, StreamClient};

/// Requests that wait for the robot: one at a time, and its successor.
const REQUEST_CAPACITY: usize = 2;

/// A change of settings.
#[derive(Debug, Clone)]
struct SettingsRequest {
    /// TOML.
    overlay: String,
    /// The phrase of the robot; empty for none.
    key: String,
}

/// What is known of the robot's settings.
#[derive(Debug, Clone, Default)]
pub(crate) struct RemoteSettingsStatus {
    /// The robot accepts changes.
    pub(crate) available: bool,
    /// Changes need its key.
    pub(crate) needs_key: bool,
    /// Result of the last change.
    pub(crate) message: String,
    /// Changes of all operators with their times: a line each.
    pub(crate) history: String,
}

/// The view's side.
pub(crate) struct RemoteSettings {
    requests: SyncSender<SettingsRequest>,
    status: Arc<Mutex<RemoteSettingsStatus>>,
}

/// The side of the receiving thread.
pub(super) struct SettingsCourier {
    requests: Receiver<SettingsRequest>,
    pending: Option<SettingsRequest>,
    status: Arc<Mutex<RemoteSettingsStatus>>,
}

impl RemoteSettings {
    /// Both sides.
    pub(super) fn new() -> (Self, SettingsCourier) {
        let (requests, received) = sync_channel(REQUEST_CAPACITY);
        let status = Arc::<Mutex<RemoteSettingsStatus>>::default();
        let courier = SettingsCourier {
            requests: received,
            pending: None,
            status: status.clone(),
        };
        (RemoteSettings { requests, status }, courier)
    }

    /// What is known now.
    pub(crate) fn status(&self) -> RemoteSettingsStatus {
        lock(&self.status).clone()
    }

    /// Requests a change; the result comes later in the status.
    pub(crate) fn change(&self, overlay: String, key: &str) {
        let key = key.to_owned();
        let sent = self.requests.try_send(SettingsRequest { overlay, key });
        lock(&self.status).message = match sent {
            Ok(()) => "sent".to_owned(),
            Err(_) => "the robot is busy with another change".to_owned(),
        };
    }
}

impl SettingsCourier {
    /// Passes on a request. The robot is asked for its nonce first.
    pub(super) fn pass_on(&mut self, client: &mut StreamClient) -> Result<()> {
        if self.pending.is_none()
            && let Ok(request) = self.requests.try_recv()
        {
            self.pending = Some(request);
            client.request_settings()?;
        }
        Ok(())
    }

    /// Takes the robot's answer, and sends the change that waits for it.
    pub(super) fn receive(
        &mut self,
        client: &mut StreamClient,
        texts: &BTreeMap<String, String>,
    ) -> Result<()> {
        let nonce = texts.get(NONCE);
        let mut status = lock(&self.status);
        status.available = true;
        status.needs_key |= nonce.is_some();
        if let Some(history) = texts.get(HISTORY) {
            status.history.clone_from(history);
        }
        if let Some(message) = texts.get(MESSAGE).filter(|_| self.pending.is_none()) {
            status.message.clone_from(message);
        }
        let Some(SettingsRequest { overlay, key }) = self.pending.take() else {
            return Ok(());
        };
        let seal = match nonce.map(|nonce| seal(&key, nonce, &overlay)).transpose() {
            Ok(seal) => seal,
            Err(error) => {
                status.message = format!("{error:#}");
                return Ok(());
            }
        };
        drop(status);
        client.change_settings(&overlay, seal.as_deref())
    }
}

// Texts are valid even if a thread panicked with the lock.
fn lock(status: &Mutex<RemoteSettingsStatus>) -> MutexGuard<'_, RemoteSettingsStatus> {
    status.lock().unwrap_or_else(PoisonError::into_inner)
}
