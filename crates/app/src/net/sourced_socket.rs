//! Who sent a datagram? A socket whose datagrams carry the time of their arrival and the sender's address.

use std::mem::MaybeUninit;
use std::net::{SocketAddr, UdpSocket};
use std::time::Duration;

use hw::StampedSocket;
use localize::Stamp;
use socket2::Socket;

/// A socket that one thread reads.
pub(super) struct SourcedSocket {
    stamped: StampedSocket,
    /// The same socket, to look at the next datagram.
    peeked: Socket,
}

/// A received datagram.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Received {
    /// Bytes in the buffer; a longer datagram is cut.
    pub(super) length: usize,
    /// Time of arrival at this machine, CLOCK_MONOTONIC.
    pub(super) arrival: Stamp,
    /// Address of the sender. None if the datagram came in the moment between the look and the reading.
    pub(super) source: Option<SocketAddr>,
}

impl SourcedSocket {
    /// What has arrived before is discarded. `timeout`: longest wait for a datagram.
    pub(super) fn new(socket: UdpSocket, timeout: Duration) -> std::io::Result<Self> {
        let peeked = Socket::from(socket.try_clone()?);
        peeked.set_read_timeout(Some(timeout))?;
        Ok(SourcedSocket {
            stamped: StampedSocket::new(socket)?,
            peeked,
        })
    }

    /// The oldest datagram; waits for one. None after the timeout or an error of an earlier datagram.
    pub(super) fn receive(&mut self, buffer: &mut [u8]) -> Option<Received> {
        let source = self.peek(libc::MSG_DONTWAIT);
        // If there is none, the stamped socket takes note of the time at which it was empty.
        if let Some(datagram) = self.stamped.receive(buffer, Duration::ZERO) {
            return Some(Received {
                length: datagram.length,
                arrival: datagram.arrival,
                source,
            });
        }
        let source = self.peek(0)?;
        let datagram = self.stamped.receive(buffer, Duration::ZERO)?;
        Some(Received {
            length: datagram.length,
            arrival: datagram.arrival,
            source: Some(source),
        })
    }

    /// The sender of the oldest datagram, which stays in the socket.
    fn peek(&self, flags: i32) -> Option<SocketAddr> {
        let mut byte = [MaybeUninit::uninit(); 1];
        let peeked = self
            .peeked
            .recv_from_with_flags(&mut byte, flags | libc::MSG_PEEK);
        peeked.ok()?.1.as_socket()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn datagrams_carry_the_addresses_of_their_senders() {
        let receiver = UdpSocket::bind("127.0.0.1:0").expect("a socket");
        let address = receiver.local_addr().expect("an address");
        let timeout = Duration::from_millis(10);
        let mut receiver = SourcedSocket::new(receiver, timeout).expect("a socket");
        let senders = [(); 2].map(|()| UdpSocket::bind("127.0.0.1:0").expect("a socket"));
        let mut buffer = [0; 16];
        assert_eq!(receiver.receive(&mut buffer), None);
        for (sender, text) in senders.iter().zip(["first", "second"]) {
            sender.send_to(text.as_bytes(), address).expect("sent");
        }
        for (sender, text) in senders.iter().zip(["first", "second"]) {
            let received = receiver.receive(&mut buffer).expect("a datagram");
            assert_eq!(&buffer[..received.length], text.as_bytes());
            let source = sender.local_addr().expect("an address");
            assert_eq!(received.source, Some(source));
        }
        // One that comes while the socket waits.
        let sender = senders[0].try_clone().expect("a socket");
        let late = std::thread::spawn(move || sender.send_to(b"late", address));
        let mut attempts = std::iter::repeat_with(|| receiver.receive(&mut buffer)).take(6000);
        let received = attempts.find_map(|received| received).expect("a datagram");
        drop(attempts);
        assert_eq!(&buffer[..received.length], b"late");
        assert!(late.join().expect("ended").is_ok());
    }
}
