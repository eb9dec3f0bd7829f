//! How does a device's thread record its health? A shared report, and an event for each change of state.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use localize::Stamp;

use crate::event_queue::{DeviceEvent, EventQueue};
use crate::health::{HealthReport, HealthState};
use crate::wire::DecoderStats;

/// Age of the last message at which the reported rate falls to 0, seconds.
const RATE_AGE_MAX: f64 = 1.5;

/// The health of one device; clones share it. A change of state is pushed into the event queue too.
#[derive(Debug, Clone)]
pub(crate) struct Monitor {
    shared: Arc<Mutex<MonitorState>>,
    queue: EventQueue,
}

#[derive(Debug)]
struct MonitorState {
    health: HealthReport,
    rate_window_start: Option<Stamp>,
    rate_window_messages: u32,
    was_opened: bool,
    /// Sums over the decoders of earlier openings.
    previous: DamageCounts,
    /// Counts of the current decoder.
    current: DamageCounts,
}

/// What a decoder rejected.
#[derive(Debug, Clone, Copy, Default)]
struct DamageCounts {
    garbage_bytes: u64,
    damaged: u64,
}

impl Monitor {
    pub(crate) fn new(device: &str, queue: &EventQueue) -> Self {
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
        let state = MonitorState {
            health,
            rate_window_start: None,
            rate_window_messages: 0,
            was_opened: false,
            previous: DamageCounts::default(),
            current: DamageCounts::default(),
        };
        Monitor {
            shared: Arc::new(Mutex::new(state)),
            queue: queue.clone(),
        }
    }

    fn lock(&self) -> MutexGuard<'_, MonitorState> {
        // The counts stay valid if a thread panicked while it held the lock.
        self.shared.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Health as of `now`.
    pub(crate) fn health(&self, now: Stamp) -> HealthReport {
        let mut health = self.lock().health.clone();
        if health.age(now).is_none_or(|age| age > RATE_AGE_MAX) {
            health.rate_hz = 0.0;
        }
        health
    }

    /// Records that the device was opened; counts of its new decoder are added to those before.
    pub(crate) fn on_opened(&self) {
        let mut state = self.lock();
        state.health.reopened += u64::from(state.was_opened);
        state.was_opened = true;
        state.previous.garbage_bytes += state.current.garbage_bytes;
        state.previous.damaged += state.current.damaged;
        state.current = DamageCounts::default();
    }

    /// Counts a complete message.
    pub(crate) fn count_message(&self, stamp: Stamp) {
        let mut state = self.lock();
        state.health.messages += 1;
        state.health.last = Some(stamp);
        state.rate_window_messages += 1;
        let start = *state.rate_window_start.get_or_insert(stamp);
        let elapsed = stamp - start;
        if elapsed >= 1.0 {
            // The first message of a window is also the last of the window before.
            state.health.rate_hz = (f64::from(state.rate_window_messages - 1) / elapsed) as f32;
            state.rate_window_start = Some(stamp);
            state.rate_window_messages = 1;
        }
    }

    /// Sets what the decoder has counted since the device was opened.
    pub(crate) fn set_decoder_stats(&self, stats: DecoderStats) {
        let mut state = self.lock();
        state.current = DamageCounts {
            garbage_bytes: stats.garbage_bytes,
            damaged: stats.damaged,
        };
        state.health.garbage_bytes = state.previous.garbage_bytes + stats.garbage_bytes;
        state.health.damaged = state.previous.damaged + stats.damaged;
    }

    /// Counts an incomplete or undecodable image.
    pub(crate) fn count_damaged(&self) {
        let mut state = self.lock();
        state.current.damaged += 1;
        state.health.damaged += 1;
    }

    /// Reports a fault that is already over; the state does not change.
    pub(crate) fn report_event(&self, reason: String) {
        let mut state = self.lock();
        state.health.faults += 1;
        let report = HealthReport {
            reason: Some(reason),
            ..state.health.clone()
        };
        self.queue.push(DeviceEvent::Health(report));
    }

    /// Sets the state; a state or reason that differs from the last is pushed into the event queue.
    pub(crate) fn set_state(&self, state: HealthState, reason: Option<String>) {
        let mut shared = self.lock();
        if shared.health.state == state && shared.health.reason == reason {
            return;
        }
        let fault = !matches!(state, HealthState::Running | HealthState::Absent);
        shared.health.faults += u64::from(fault && shared.health.state != state);
        shared.health.state = state;
        shared.health.reason = reason;
        self.queue.push(DeviceEvent::Health(shared.health.clone()));
    }
}
