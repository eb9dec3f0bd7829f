//! What can be wrong with a device? Each message says what to do about it.

use rustix::io::Errno;

/// Why a device cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum HwError {
    /// No device has that name.
    #[error("{device} is missing. Check that it is plugged in and switched on")]
    Missing {
        /// The device's path or interface.
        device: String,
    },
    /// Another program uses it.
    #[error("{device} is busy: another program uses it")]
    Busy {
        /// The device's path or interface.
        device: String,
    },
    /// This user lacks the permission to open it.
    #[error(
        "no permission to open {device}. Add a udev rule, or join the group that owns it (dialout, video)"
    )]
    PermissionDenied {
        /// The device's path or interface.
        device: String,
    },
    /// It disappeared while it was open.
    #[error("{device} was unplugged")]
    Disconnected {
        /// The device's path or interface.
        device: String,
    },
    /// It accepts no more bytes, or sends none.
    #[error("{device} is stalled: {reason}")]
    Stalled {
        /// The device's path or interface.
        device: String,
        /// How long, and in which direction.
        reason: String,
    },
    /// Its bytes contain no message.
    #[error(
        "{device} sends bytes that contain no message. Check {}",
        garbage_cause(device)
    )]
    Garbage {
        /// The device's path or interface.
        device: String,
    },
    /// It is present but of another kind, or cannot do what was requested.
    #[error("{device}: {reason}")]
    Unsupported {
        /// The device's path or interface.
        device: String,
        /// What it cannot do.
        reason: String,
    },
    /// Another system error.
    #[error("{device}: cannot {action}: {source}")]
    System {
        /// The device's path or interface.
        device: String,
        /// What was being done.
        action: &'static str,
        /// The system's error.
        source: Errno,
    },
    /// An invalid value of the configuration.
    #[error("hardware: {key}: {reason}")]
    Config {
        /// The key.
        key: &'static str,
        /// What is wrong with its value.
        reason: String,
    },
}

/// What to check if the bytes of a device contain no message. A socket has no baud rate.
fn garbage_cause(device: &str) -> &'static str {
    if device.starts_with("unix:") {
        "that the program behind it sends images as in docs/wire.md"
    } else {
        "baud rate, wiring, and that it is the configured device"
    }
}

impl HwError {
    /// The error for a system call that failed during `action` on `device`.
    pub(crate) fn from_errno(device: &str, action: &'static str, source: Errno) -> Self {
        let device = device.to_owned();
        match source {
            Errno::NOENT | Errno::NXIO => HwError::Missing { device },
            Errno::NODEV | Errno::IO | Errno::NETDOWN if action != "open" => {
                HwError::Disconnected { device }
            }
            Errno::NODEV => HwError::Missing { device },
            Errno::BUSY | Errno::WOULDBLOCK => HwError::Busy { device },
            Errno::ACCESS | Errno::PERM => HwError::PermissionDenied { device },
            source => HwError::System {
                device,
                action,
                source,
            },
        }
    }
}
