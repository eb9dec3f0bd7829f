//! How are frames sent and received on a CAN interface of Linux? A raw SocketCAN socket with deadlines.

use std::os::fd::{AsFd, BorrowedFd, OwnedFd};

use localize::Stamp;
use rustix::event::PollFlags;
use rustix::io::Errno;
use rustix::net::addr::{SocketAddrArg, SocketAddrLen, SocketAddrOpaque};
use rustix::net::{AddressFamily, Protocol, SocketFlags, SocketType, bind, netdevice, socket_with};

use crate::error::HwError;
use crate::serial::wait_ready;
use crate::wire::CanFrame;

/// A socket on one CAN interface.
#[derive(Debug)]
pub struct CanSocket {
    fd: OwnedFd,
    interface: String,
}

/// Linux' `struct sockaddr_can` (linux/can.h) for a raw socket.
#[repr(C)]
struct CanAddress {
    family: u16,
    interface: i32,
    unused: [u64; 2],
}

/// CAN_RAW of linux/can.h.
const CAN_RAW: std::num::NonZeroU32 = std::num::NonZeroU32::MIN;

#[expect(unsafe_code, reason = "rustix has no address type of the CAN family")]
// SAFETY: the pointer refers to a complete, initialised sockaddr_can of this length, which outlives the call.
unsafe impl SocketAddrArg for CanAddress {
    unsafe fn with_sockaddr<R>(
        &self,
        call: impl FnOnce(*const SocketAddrOpaque, SocketAddrLen) -> R,
    ) -> R {
        let length = size_of::<CanAddress>() as SocketAddrLen;
        call(std::ptr::from_ref(self).cast(), length)
    }
}

impl CanSocket {
    /// Opens a socket on an interface (`can0`), which must be up and have its bit rate set.
    pub fn open(interface: &str) -> Result<Self, HwError> {
        let failed = |action| move |source| HwError::from_errno(interface, action, source);
        let flags = SocketFlags::NONBLOCK | SocketFlags::CLOEXEC;
        let protocol = Some(Protocol::from_raw(CAN_RAW));
        let fd = socket_with(AddressFamily::CAN, SocketType::RAW, flags, protocol).map_err(
            |source| match source {
                Errno::AFNOSUPPORT | Errno::PROTONOSUPPORT => HwError::Unsupported {
                    device: interface.to_owned(),
                    reason: "the kernel does not support CAN. Load the modules can and can_raw"
                        .to_owned(),
                },
                source => HwError::from_errno(interface, "open", source),
            },
        )?;
        let index = netdevice::name_to_index(&fd, interface).map_err(failed("open"))?;
        let address = CanAddress {
            family: AddressFamily::CAN.as_raw(),
            interface: index as i32,
            unused: [0; 2],
        };
        bind(&fd, &address).map_err(failed("bind to"))?;
        Ok(CanSocket {
            fd,
            interface: interface.to_owned(),
        })
    }

    /// Reads one frame, waiting until the deadline; `None` if none came or it was an error frame.
    pub fn read(&self, deadline: Stamp) -> Result<Option<CanFrame>, HwError> {
        if !wait_ready(self.fd.as_fd(), PollFlags::IN, deadline) {
            return Ok(None);
        }
        let mut bytes = [0; 16];
        match rustix::io::read(&self.fd, &mut bytes[..]) {
            Ok(16) => Ok(CanFrame::from_socketcan(&bytes)),
            Ok(_) | Err(Errno::WOULDBLOCK | Errno::INTR) => Ok(None),
            Err(source) => Err(HwError::from_errno(&self.interface, "read from", source)),
        }
    }

    /// Sends one frame; a full queue (no other node acknowledges) is a stall.
    pub fn write(&self, frame: &CanFrame) -> Result<(), HwError> {
        match rustix::io::write(&self.fd, &frame.to_socketcan()) {
            Ok(_) => Ok(()),
            Err(Errno::WOULDBLOCK | Errno::NOBUFS) => Err(HwError::Stalled {
                device: self.interface.clone(),
                reason: "its send queue is full. Check that another node on the bus acknowledges"
                    .to_owned(),
            }),
            Err(source) => Err(HwError::from_errno(&self.interface, "write to", source)),
        }
    }
}

impl AsFd for CanSocket {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.fd.as_fd()
    }
}
