//! How is a device? Counts and a state per device, plain data for status line, log and doctor.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use localize::Stamp;
use serde::{Deserialize, Serialize};

use crate::event_queue::{DeviceEvent, EventQueue};
use crate::wire::DecoderStats;

/// What a device is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum HealthState {
    /// It cannot be opened, or was unplugged, and is tried again and again.
    Absent,
    /// It delivers.
    Running,
    /// It is open and silent.
    Stalled,
    /// It sends bytes that make no message: another device, another baud rate, or a bad cable.
    Garbage,
    /// It repeats itself to the last bit, which no sensor does.
    Stuck,
    /// Its readings stand at the end of their range, which is where broken sensors put them.
    Range,
    /// It delivers, and its clock cannot be right.
    Clock,
}

/// State and counts of one device since its thread began.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct HealthReport {
    /// What it is for: camera, base, imu...
    pub device: String,
    /// What it is doing.
    pub state: HealthState,
    /// Why it is not running.
    pub reason: Option<String>,
    /// Messages or frames per second, over the last whole second in which some came.
    pub rate_hz: f32,
    /// When the last whole message came.
    pub last: Option<Stamp>,
    /// Whole messages.
    pub messages: u64,
    /// Bytes that were no message.
    pub garbage_bytes: u64,
    /// Messages refused for a wrong checksum or length, frames that came torn.
    pub damaged: u64,
    /// Times it was opened after the first.
    pub reopened: u64,
    /// Times it fell silent, sent garbage or got stuck.
    pub faults: u64,
}

impl HealthReport {
    /// Seconds since the last whole message; `None` before the first.
    pub fn age(&self, now: Stamp) -> Option<f64> {
        self.last.map(|last| now - last)
    }
}

/// A device's thread keeps its health here; a change of state is put into the inbox too.
#[derive(Debug, Clone)]
pub(crate) struct Monitor {
    shared: Arc<Mutex<MonitorState>>,
    inbox: EventQueue,
}

#[derive(Debug)]
struct MonitorState {
    health: HealthReport,
    rate_window_start: Option<Stamp>,
    rate_window_messages: u32,
    was_opened: bool,
    /// What an earlier opening's decoder had counted.
    previous_counters: (u64, u64),
    decoder_counters: (u64, u64),
}

impl Monitor {
    pub(crate) fn new(device: &str, inbox: &EventQueue) -> Self {
        let health = HealthReport {
            device: device.to_owned(),
            state: HealthState::Absent,
            reason: Some("not opened yet".to_owned()),
            rate_hz: 0.0,
            last: None,
            messages: 0,
            garbage_bytes: 0,
            damaged: 0,
            reopened: 0,
            faults: 0,
        };
        let shared = MonitorState {
            health,
            rate_window_start: None,
            rate_window_messages: 0,
            was_opened: false,
            previous_counters: (0, 0),
            decoder_counters: (0, 0),
        };
        Monitor {
            shared: Arc::new(Mutex::new(shared)),
            inbox: inbox.clone(),
        }
    }

    fn lock(&self) -> MutexGuard<'_, MonitorState> {
        // Counts stay usable whatever a thread that held them died of.
        self.shared.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Health as of `now`.
    pub(crate) fn health(&self, now: Stamp) -> HealthReport {
        let mut health = self.lock().health.clone();
        if health.age(now).is_none_or(|age| age > 1.5) {
            health.rate_hz = 0.0;
        }
        health
    }

    /// The device was opened: what its new decoder counts comes on top.
    pub(crate) fn on_opened(&self) {
        let mut shared = self.lock();
        shared.health.reopened += u64::from(shared.was_opened);
        shared.was_opened = true;
        shared.previous_counters.0 += shared.decoder_counters.0;
        shared.previous_counters.1 += shared.decoder_counters.1;
        shared.decoder_counters = (0, 0);
    }

    /// A whole message came.
    pub(crate) fn count_message(&self, stamp: Stamp) {
        let mut shared = self.lock();
        shared.health.messages += 1;
        shared.health.last = Some(stamp);
        shared.rate_window_messages += 1;
        let began = *shared.rate_window_start.get_or_insert(stamp);
        let elapsed = stamp - began;
        if elapsed >= 1.0 {
            // The first message of a second is the last of the one before.
            shared.health.rate_hz = (f64::from(shared.rate_window_messages - 1) / elapsed) as f32;
            shared.rate_window_start = Some(stamp);
            shared.rate_window_messages = 1;
        }
    }

    /// What the decoder has counted since the device was opened.
    pub(crate) fn set_decoder_stats(&self, tally: DecoderStats) {
        let mut shared = self.lock();
        shared.decoder_counters = (tally.garbage_bytes, tally.damaged);
        shared.health.garbage_bytes = shared.previous_counters.0 + tally.garbage_bytes;
        shared.health.damaged = shared.previous_counters.1 + tally.damaged;
    }

    /// A torn frame.
    pub(crate) fn count_damaged(&self) {
        let mut shared = self.lock();
        shared.decoder_counters.1 += 1;
        shared.health.damaged += 1;
    }

    /// Something that is over already, told once; the state stays as it is.
    pub(crate) fn report_event(&self, reason: String) {
        let mut shared = self.lock();
        shared.health.faults += 1;
        let told = HealthReport {
            reason: Some(reason),
            ..shared.health.clone()
        };
        self.inbox.push(DeviceEvent::Health(told));
    }

    /// The state is this; if it was another, that is news for the inbox.
    pub(crate) fn set_state(&self, state: HealthState, reason: Option<String>) {
        let mut shared = self.lock();
        if shared.health.state == state && shared.health.reason == reason {
            return;
        }
        let fault = !matches!(state, HealthState::Running | HealthState::Absent);
        shared.health.faults += u64::from(fault && shared.health.state != state);
        shared.health.state = state;
        shared.health.reason = reason;
        self.inbox.push(DeviceEvent::Health(shared.health.clone()));
    }
}
