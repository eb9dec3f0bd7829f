//! When did a datagram arrive? The kernel's receive stamp tells, however late a thread reads the socket.

use std::io::Error;
use std::net::{SocketAddr, UdpSocket};
use std::os::fd::{AsFd, AsRawFd};
use std::time::Duration;

use localize::Stamp;
use rustix::event::PollFlags;
use rustix::time::{ClockId, clock_gettime};
use socket2::SockAddr;

use crate::clock;
use crate::serial::wait_ready;

/// Change of the offset between the two clocks that is taken as a step of CLOCK_REALTIME, nanoseconds.
const CLOCK_STEP_NS: i64 = 1_000_000;
/// Longest time between two readings of the monotonic clock around one of the real-time clock, nanoseconds.
const READING_TIME_MAX_NS: i64 = 50_000;
/// More datagrams than a socket's buffer holds.
const DISCARDED_MAX: usize = 10_000;
/// Attempts to read both clocks without an interruption.
const READING_ATTEMPTS: usize = 4;

/// A UDP socket whose datagrams carry the time of their arrival.
#[derive(Debug)]
pub struct StampedSocket {
    socket: UdpSocket,
    /// The socket was empty at this time: what is read later arrived later.
    last_empty: Stamp,
    /// CLOCK_REALTIME minus CLOCK_MONOTONIC at that time, nanoseconds.
    offset_ns: i64,
}

/// A received datagram.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ReceivedDatagram {
    /// Bytes in the buffer; a longer datagram is cut.
    pub length: usize,
    /// Time of arrival at this machine, CLOCK_MONOTONIC.
    pub arrival: Stamp,
    /// Address of the sender.
    pub source: Option<SocketAddr>,
}

/// What the kernel says of a datagram.
struct Datagram {
    length: usize,
    /// Its stamp, CLOCK_REALTIME, nanoseconds.
    stamp_ns: Option<i64>,
    source: Option<SocketAddr>,
}

impl StampedSocket {
    /// Lets the kernel stamp the datagrams of a socket from now on. What has arrived before is discarded. Datagrams of the first
    /// milliseconds may still be stamped when they are read.
    pub fn new(socket: UdpSocket) -> Result<Self, Error> {
        enable_receive_stamps(&socket)?;
        let mut stamped = StampedSocket {
            socket,
            last_empty: clock::now(),
            offset_ns: realtime_offset_ns(),
        };
        let mut datagram = [0; 1];
        for _ in 0..DISCARDED_MAX {
            if receive_with_stamp(&stamped.socket, &mut datagram).is_err() {
                break;
            }
        }
        stamped.last_empty = clock::now();
        Ok(stamped)
    }

    /// The oldest datagram; waits for one up to `timeout`. None after the timeout or an error of an earlier datagram.
    ///
    /// The kernel stamps by CLOCK_REALTIME. If that clock was set meanwhile, the arrival is taken as early as possible:
    /// the time at which the socket was last found empty.
    pub fn receive(&mut self, buffer: &mut [u8], timeout: Duration) -> Option<ReceivedDatagram> {
        let deadline = clock::now() + timeout.as_secs_f64();
        loop {
            let before = clock::now();
            match receive_with_stamp(&self.socket, buffer) {
                Ok(datagram) => {
                    let arrival =
                        self.arrival(datagram.stamp_ns, realtime_offset_ns(), clock::now());
                    return Some(ReceivedDatagram {
                        length: datagram.length,
                        arrival,
                        source: datagram.source,
                    });
                }
                Err(error) if error.kind() == std::io::ErrorKind::WouldBlock => {
                    self.last_empty = before;
                    self.offset_ns = realtime_offset_ns();
                    if before >= deadline
                        || !wait_ready(self.socket.as_fd(), PollFlags::IN, deadline)
                    {
                        return None;
                    }
                }
                // An ICMP error of an earlier datagram.
                Err(_) => return None,
            }
        }
    }

    fn arrival(&self, realtime_ns: Option<i64>, offset_ns: i64, now: Stamp) -> Stamp {
        let clock_stepped = (offset_ns - self.offset_ns).abs() > CLOCK_STEP_NS;
        match realtime_ns {
            Some(realtime_ns) if !clock_stepped => Stamp(
                (realtime_ns - offset_ns).clamp(self.last_empty.0, now.0.max(self.last_empty.0)),
            ),
            _ => self.last_empty,
        }
    }
}

/// CLOCK_REALTIME minus CLOCK_MONOTONIC, nanoseconds: the wall-clock time at the zero of all stamps.
pub fn realtime_offset_ns() -> i64 {
    let mut best = (i64::MAX, 0);
    for _ in 0..READING_ATTEMPTS {
        let before = clock::now().0;
        let realtime = clock_gettime(ClockId::Realtime);
        let after = clock::now().0;
        let realtime_ns = realtime.tv_sec * 1_000_000_000 + realtime.tv_nsec;
        best = best.min((
            after - before,
            realtime_ns - (before + (after - before) / 2),
        ));
        if best.0 <= READING_TIME_MAX_NS {
            break;
        }
    }
    best.1
}

#[expect(unsafe_code, reason = "neither std nor rustix sets SO_TIMESTAMPNS")]
fn enable_receive_stamps(socket: &UdpSocket) -> Result<(), Error> {
    let on: libc::c_int = 1;
    // SAFETY: the option takes an int of this size, which outlives the call; the descriptor is open.
    let result = unsafe {
        libc::setsockopt(
            socket.as_raw_fd(),
            libc::SOL_SOCKET,
            libc::SO_TIMESTAMPNS,
            std::ptr::from_ref(&on).cast(),
            size_of_val(&on) as libc::socklen_t,
        )
    };
    if result == 0 {
        Ok(())
    } else {
        Err(Error::last_os_error())
    }
}

/// Reads a datagram without waiting.
#[expect(unsafe_code, reason = "neither std nor rustix reads SCM_TIMESTAMPNS")]
fn receive_with_stamp(socket: &UdpSocket, buffer: &mut [u8]) -> Result<Datagram, Error> {
    // Aligned as control messages must be; one message of 32 bytes is expected.
    let mut control = [0_u64; 16];
    let mut part = libc::iovec {
        iov_base: buffer.as_mut_ptr().cast(),
        iov_len: buffer.len(),
    };
    // SAFETY: all bytes zero is a valid msghdr without name, parts and control data.
    let mut message: libc::msghdr = unsafe { std::mem::zeroed() };
    message.msg_iov = &raw mut part;
    message.msg_iovlen = 1;
    message.msg_control = control.as_mut_ptr().cast();
    message.msg_controllen = size_of_val(&control);
    let flags = libc::MSG_DONTWAIT;
    // SAFETY: the message refers to a buffer, a control buffer and a name of the given lengths, which outlive the call. The kernel
    // fills the name up to the length that it returns.
    let (length, source) = unsafe {
        SockAddr::try_init(|name, name_length| {
            message.msg_name = name.cast();
            message.msg_namelen = *name_length;
            let length = libc::recvmsg(socket.as_raw_fd(), &raw mut message, flags);
            *name_length = message.msg_namelen;
            match length {
                ..0 => Err(Error::last_os_error()),
                length => Ok(length as usize),
            }
        })
    }?;
    let mut stamp_ns = None;
    // SAFETY: the kernel has filled the control buffer and its length; the macros stay within them. The payload of
    // SCM_TIMESTAMPNS is a timespec, read without assuming its alignment.
    unsafe {
        let mut header = libc::CMSG_FIRSTHDR(&raw const message);
        while !header.is_null() {
            if (*header).cmsg_level == libc::SOL_SOCKET
                && (*header).cmsg_type == libc::SCM_TIMESTAMPNS
            {
                let time: libc::timespec = libc::CMSG_DATA(header)
                    .cast::<libc::timespec>()
                    .read_unaligned();
                stamp_ns = Some(time.tv_sec * 1_000_000_000 + time.tv_nsec);
            }
            header = libc::CMSG_NXTHDR(&raw const message, header);
        }
    }
    Ok(Datagram {
        length,
        stamp_ns,
        source: source.as_socket(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pair() -> (StampedSocket, UdpSocket) {
        let receiver = UdpSocket::bind("127.0.0.1:0").expect("a socket");
        let sender = UdpSocket::bind("127.0.0.1:0").expect("a socket");
        sender
            .connect(receiver.local_addr().expect("an address"))
            .expect("connected");
        (StampedSocket::new(receiver).expect("stamps"), sender)
    }

    /// The kernel begins to stamp a moment after the first socket asked for it; until then it stamps at reading.
    fn wait_for_stamps(socket: &mut StampedSocket, sender: &UdpSocket) {
        for _ in 0..1000 {
            sender.send(b"stamped?").expect("sent");
            std::thread::sleep(Duration::from_millis(5));
            let read = clock::now();
            let datagram = socket.receive(&mut [0; 16], Duration::ZERO);
            if datagram.is_some_and(|datagram| datagram.arrival < read) {
                return;
            }
        }
        panic!("the kernel does not stamp");
    }

    #[test]
    fn arrival_is_the_time_of_sending_not_of_reading() {
        let (mut socket, sender) = pair();
        wait_for_stamps(&mut socket, &sender);
        let mut buffer = [0; 16];
        assert_eq!(socket.receive(&mut buffer, Duration::ZERO), None);
        let before = clock::now();
        sender.send(b"early").expect("sent");
        // Not a wait for a state: the claim is about a late reader.
        std::thread::sleep(Duration::from_millis(30));
        let between = clock::now();
        sender.send(b"later").expect("sent");
        std::thread::sleep(Duration::from_millis(30));
        let read = clock::now();
        let early = socket
            .receive(&mut buffer, Duration::ZERO)
            .expect("a datagram");
        assert_eq!(&buffer[..early.length], b"early");
        // The two clocks are read one after the other.
        let tolerance = READING_TIME_MAX_NS as f64 * 1e-9;
        assert!(
            early.arrival - before > -tolerance && early.arrival < between,
            "{early:?}"
        );
        let second = socket
            .receive(&mut buffer, Duration::ZERO)
            .expect("a datagram");
        assert!(second.arrival - between > -tolerance && second.arrival < read);
        assert_eq!(socket.receive(&mut buffer, Duration::ZERO), None);
    }

    #[test]
    fn datagrams_carry_the_addresses_of_their_senders() {
        let receiver = UdpSocket::bind("127.0.0.1:0").expect("a socket");
        let address = receiver.local_addr().expect("an address");
        let mut receiver = StampedSocket::new(receiver).expect("stamps");
        let senders = [(); 2].map(|()| UdpSocket::bind("127.0.0.1:0").expect("a socket"));
        for (sender, text) in senders.iter().zip(["first", "second"]) {
            sender.send_to(text.as_bytes(), address).expect("sent");
        }
        let mut buffer = [0; 16];
        for (sender, text) in senders.iter().zip(["first", "second"]) {
            let received = receiver.receive(&mut buffer, Duration::from_secs(60));
            let received = received.expect("a datagram");
            assert_eq!(&buffer[..received.length], text.as_bytes());
            let source = sender.local_addr().expect("an address");
            assert_eq!(received.source, Some(source));
        }
    }

    #[test]
    fn arrival_is_the_earliest_possible_if_the_clock_was_set() {
        let (mut socket, _) = pair();
        (socket.last_empty, socket.offset_ns) = (Stamp(1000), 7_000_000_000);
        let now = Stamp(10_000_000_000);
        let arrival = |realtime_ns, offset_ns| socket.arrival(realtime_ns, offset_ns, now);
        assert_eq!(
            arrival(Some(12_000_000_000), 7_000_000_000),
            Stamp(5_000_000_000)
        );
        assert_eq!(arrival(Some(12_000_000_000), 8_000_000_000), Stamp(1000));
        assert_eq!(arrival(None, 7_000_000_000), Stamp(1000));
        assert_eq!(arrival(Some(99_000_000_000), 7_000_000_000), now);
        assert_eq!(arrival(Some(0), 7_000_000_000), Stamp(1000));
    }
}
