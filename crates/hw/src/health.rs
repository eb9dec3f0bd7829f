//! Does a device work? State and counts of each device, plain data for the status line, the log and doctor.

use localize::Stamp;
use serde::{Deserialize, Serialize};

/// What a device is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum HealthState {
    /// It cannot be opened, or was unplugged; its thread keeps trying to open it.
    Absent,
    /// It delivers.
    Running,
    /// It is open and silent.
    Stalled,
    /// Its bytes contain no message: another device, another baud rate, or a bad cable.
    Garbage,
    /// Its values repeat bit by bit, which the noise of a working sensor prevents.
    Stuck,
    /// Its values are saturated, as those of many broken sensors are.
    Range,
    /// It delivers, but its time stamps are implausible.
    Clock,
}

/// State and counts of one device since its thread started.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct HealthReport {
    /// Role of the device: camera, base, imu...
    pub device: String,
    /// What it is doing.
    pub state: HealthState,
    /// Why it is not running.
    pub reason: Option<String>,
    /// Messages or images per second, over the last full second that had any.
    pub rate_hz: f32,
    /// Arrival of the last complete message.
    pub last: Option<Stamp>,
    /// Complete messages.
    pub messages: u64,
    /// Bytes that belong to no message.
    pub garbage_bytes: u64,
    /// Messages rejected for a wrong checksum or length, and incomplete images.
    pub damaged: u64,
    /// How often it was opened after the first time.
    pub reopened: u64,
    /// How often it stalled, sent garbage or got stuck.
    pub faults: u64,
}

impl HealthReport {
    /// Seconds since the last complete message; `None` before the first.
    pub fn age(&self, now: Stamp) -> Option<f64> {
        self.last.map(|last| now - last)
    }
}
