//! What can be wrong with a device? Each case in words that say what to do about it.

use rustix::io::Errno;

/// Why a device cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum HwError {
    /// Nothing is there under that name.
    #[error("{device} is missing: is it plugged in and switched on?")]
    Missing {
        /// The device's path or interface.
        device: String,
    },
    /// Another program has it.
    #[error("{device} is busy: another program uses it")]
    Busy {
        /// The device's path or interface.
        device: String,
    },
    /// This user may not open it.
    #[error(
        "{device} may not be opened by this user: a udev rule or the group that owns it (dialout, video) helps"
    )]
    PermissionDenied {
        /// The device's path or interface.
        device: String,
    },
    /// It was there and is gone.
    #[error("{device} was unplugged")]
    Disconnected {
        /// The device's path or interface.
        device: String,
    },
    /// It takes no more bytes, or sends none.
    #[error("{device} is stalled: {reason}")]
    Stalled {
        /// The device's path or interface.
        device: String,
        /// For how long, and in which direction.
        reason: String,
    },
    /// It sends bytes in which there is no message.
    #[error(
        "{device} sends bytes without a message in them: look at baud rate and wiring, or it is another device"
    )]
    Garbage {
        /// The device's path or interface.
        device: String,
    },
    /// It is there and is not what is wanted, or cannot do what is wanted.
    #[error("{device}: {reason}")]
    Unsupported {
        /// The device's path or interface.
        device: String,
        /// What is wanted.
        reason: String,
    },
    /// The system refused something else.
    #[error("{device}: cannot {action}: {source}")]
    System {
        /// The device's path or interface.
        device: String,
        /// What was being done.
        action: &'static str,
        /// The system's word.
        source: Errno,
    },
    /// A value of the configuration that cannot work.
    #[error("hardware: {key}: {reason}")]
    Config {
        /// The key.
        key: &'static str,
        /// What is wrong with its value.
        reason: String,
    },
}

impl HwError {
    /// The word for what the system answered to `action` on `device`.
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
