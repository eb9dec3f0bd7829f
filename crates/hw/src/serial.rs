//! How are bytes sent and received on a serial port? A raw tty with a baud rate and deadlines.

use std::os::fd::{AsFd, BorrowedFd, OwnedFd};

use localize::Stamp;
use rustix::event::{PollFd, PollFlags, poll};
use rustix::fs::{FlockOperation, Mode, OFlags, flock, open};
use rustix::io::Errno;
use rustix::ioctl::{Getter, Opcode, ioctl};
use rustix::termios::{
    ControlModes, OptionalActions, QueueSelector, SpecialCodeIndex, tcflush, tcgetattr, tcsetattr,
};

use crate::clock;
use crate::error::HwError;

/// An open serial port.
#[derive(Debug)]
pub struct SerialPort {
    fd: OwnedFd,
    path: String,
}

impl SerialPort {
    /// Opens a tty exclusively: eight bits, no parity, one stop bit, no flow control.
    ///
    /// Sets no modem lines, so that pseudo terminals work too. Drops bytes that arrived earlier: their age is unknown.
    pub fn open(path: &str, baud: u32) -> Result<Self, HwError> {
        let failed = |action| move |source| HwError::from_errno(path, action, source);
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let fd = open(path, flags, Mode::empty()).map_err(failed("open"))?;
        flock(&fd, FlockOperation::NonBlockingLockExclusive).map_err(failed("lock"))?;
        let mut settings = tcgetattr(&fd).map_err(|source| match source {
            Errno::NOTTY => HwError::Unsupported {
                device: path.to_owned(),
                reason: "not a serial port".to_owned(),
            },
            source => HwError::from_errno(path, "read the settings of", source),
        })?;
        settings.make_raw();
        settings.control_modes |= ControlModes::CLOCAL | ControlModes::CREAD;
        // With HUPCL, closing drops DTR, which resets many boards each time the port is reopened.
        settings.control_modes &=
            !(ControlModes::CSTOPB | ControlModes::CRTSCTS | ControlModes::HUPCL);
        settings.special_codes[SpecialCodeIndex::VMIN] = 0;
        settings.special_codes[SpecialCodeIndex::VTIME] = 0;
        settings
            .set_speed(baud)
            .map_err(failed("set the baud rate of"))?;
        tcsetattr(&fd, OptionalActions::Now, &settings).map_err(failed("configure"))?;
        tcflush(&fd, QueueSelector::IOFlush).map_err(failed("flush"))?;
        Ok(SerialPort {
            fd,
            path: path.to_owned(),
        })
    }

    /// Reads the bytes that have arrived; waits for the first until the deadline and returns 0 if none came.
    pub fn read(&self, buffer: &mut [u8], deadline: Stamp) -> Result<usize, HwError> {
        if !wait_ready(self.fd.as_fd(), PollFlags::IN, deadline) {
            return Ok(0);
        }
        match rustix::io::read(&self.fd, buffer) {
            // Readable without a byte: the other end was closed.
            Ok(0) => Err(HwError::Disconnected {
                device: self.path.clone(),
            }),
            Ok(bytes) => Ok(bytes),
            Err(Errno::WOULDBLOCK | Errno::INTR) => Ok(0),
            Err(source) => Err(HwError::from_errno(&self.path, "read from", source)),
        }
    }

    /// Discards the bytes that have arrived.
    pub fn discard_input(&self) -> Result<(), HwError> {
        tcflush(&self.fd, QueueSelector::IFlush)
            .map_err(|source| HwError::from_errno(&self.path, "flush", source))
    }

    /// Discards the bytes that were written and wait in this computer.
    pub fn discard_output(&self) -> Result<(), HwError> {
        tcflush(&self.fd, QueueSelector::OFlush)
            .map_err(|source| HwError::from_errno(&self.path, "flush", source))
    }

    /// Bytes that were written and wait in this computer; 0 for a driver that does not count them.
    pub fn unsent_bytes(&self) -> usize {
        #[expect(unsafe_code, reason = "rustix has no function for TIOCOUTQ")]
        // SAFETY: TIOCOUTQ writes one int, and changes nothing else.
        let count = unsafe {
            let getter = Getter::<{ libc::TIOCOUTQ as Opcode }, libc::c_int>::new();
            ioctl(&self.fd, getter)
        };
        count.map_or(0, |count| usize::try_from(count).unwrap_or(0))
    }

    /// Writes all bytes by the deadline.
    pub fn write(&self, bytes: &[u8], deadline: Stamp) -> Result<(), HwError> {
        let mut rest = bytes;
        while !rest.is_empty() {
            match rustix::io::write(&self.fd, rest) {
                Ok(written) => rest = &rest[written..],
                Err(Errno::INTR) => {}
                Err(Errno::WOULDBLOCK) => {
                    if !wait_ready(self.fd.as_fd(), PollFlags::OUT, deadline) {
                        return Err(HwError::Stalled {
                            device: self.path.clone(),
                            reason: "its output buffer stays full".to_owned(),
                        });
                    }
                }
                Err(source) => return Err(HwError::from_errno(&self.path, "write to", source)),
            }
        }
        Ok(())
    }
}

impl AsFd for SerialPort {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.fd.as_fd()
    }
}

/// Waits until `fd` is readable or writable, or has failed; false if the deadline passed first.
pub(crate) fn wait_ready(fd: BorrowedFd<'_>, wanted: PollFlags, deadline: Stamp) -> bool {
    let mut fds = [PollFd::from_borrowed_fd(fd, wanted)];
    matches!(poll(&mut fds, Some(&clock::time_until(deadline))), Ok(1..))
}
