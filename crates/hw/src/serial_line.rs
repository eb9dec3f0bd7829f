//! How old is a command when it reaches the device? A serial line that holds few bytes, by its baud rate and the driver's count.

use std::os::fd::{AsFd, BorrowedFd};

use localize::Stamp;

use crate::clock;
use crate::error::HwError;
use crate::serial::SerialPort;

/// Bits on the line for each byte: start bit, eight bits, stop bit.
const BITS_PER_BYTE: f64 = 10.0;
/// Share of the baud rate that commands may use. Adapters and boards pause between bytes.
const USABLE_SHARE: f64 = 0.8;

/// Seconds that a line of this baud rate needs for `bytes`.
pub(crate) fn transmission_time(bytes: usize, baud: u32) -> f64 {
    bytes as f64 * BITS_PER_BYTE / (f64::from(baud.max(1)) * USABLE_SHARE)
}

/// A serial port whose output is not queued: it tells when the line has carried what was written.
#[derive(Debug)]
pub(crate) struct SerialLine {
    port: SerialPort,
    baud: u32,
    /// By the baud rate, the line has carried everything at this time.
    carried_at: Stamp,
}

impl SerialLine {
    /// Opens a port as [`SerialPort::open`] does.
    pub(crate) fn open(path: &str, baud: u32) -> Result<Self, HwError> {
        Ok(SerialLine {
            port: SerialPort::open(path, baud)?,
            baud,
            carried_at: clock::now(),
        })
    }

    /// The port, for reading.
    pub(crate) fn port(&self) -> &SerialPort {
        &self.port
    }

    /// True if nothing that was written waits any more, by the baud rate and by the driver. A pseudo terminal counts no
    /// bytes that wait.
    pub(crate) fn is_idle(&self, now: Stamp) -> bool {
        now >= self.carried_at && self.port.unsent_bytes() == 0
    }

    /// By the baud rate, the line has carried everything at this time.
    pub(crate) fn carried_at(&self) -> Stamp {
        self.carried_at
    }

    /// When the last of so many bytes arrives that are written now.
    pub(crate) fn arrival(&self, bytes: usize, now: Stamp) -> Stamp {
        now.max(self.carried_at) + transmission_time(bytes, self.baud)
    }

    /// Writes all bytes by the deadline.
    pub(crate) fn write(&mut self, bytes: &[u8], deadline: Stamp) -> Result<(), HwError> {
        self.carried_at = self.arrival(bytes.len(), clock::now());
        self.port.write(bytes, deadline)
    }

    /// Discards what was written and still waits in this computer. The device may have received a part of a message.
    pub(crate) fn discard_output(&mut self) -> Result<(), HwError> {
        self.carried_at = clock::now();
        self.port.discard_output()
    }
}

impl AsFd for SerialLine {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.port.as_fd()
    }
}
