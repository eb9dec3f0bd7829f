//! After which outages must the node join the domain anew?
//!
//! RustDDS 0.15.1 forgets a participant 10 s after its last announcement. Cyclone DDS repeats its announcement unchanged,
//! which RustDDS takes for one that it has already: the participant stays forgotten. A new participant of ours is
//! connected with all of them.

use std::collections::BTreeSet;
use std::io::ErrorKind;
use std::net::{Ipv4Addr, SocketAddrV4, UdpSocket};

use anyhow::{Context as _, Result};
use socket2::{Domain, Protocol, Socket, Type};

/// Identity of a participant: the prefix of its entities' identities.
pub(super) type ParticipantId = [u8; 12];

/// Multicast group of announcements (DDSI-RTPS 2.5, 9.6.2.4.1).
const GROUP: Ipv4Addr = Ipv4Addr::new(239, 255, 0, 1);

/// Listens to the announcements of a domain beside DDS.
pub(super) struct Announcements(UdpSocket);

impl Announcements {
    pub(super) fn listen(domain: u16, interface: Ipv4Addr) -> Result<Self> {
        // The well-known port of announcements (DDSI-RTPS 2.5, 9.6.2.3).
        let port = 7400 + 250 * domain;
        let open = || -> std::io::Result<UdpSocket> {
            let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
            socket.set_reuse_address(true)?;
            socket.bind(&SocketAddrV4::new(Ipv4Addr::UNSPECIFIED, port).into())?;
            socket.join_multicast_v4(&GROUP, &interface)?;
            socket.set_nonblocking(true)?;
            Ok(socket.into())
        };
        open()
            .map(Announcements)
            .with_context(|| format!("[ros2] cannot listen to announcements on port {port}"))
    }

    /// Who has sent one since the last call.
    pub(super) fn senders(&self) -> BTreeSet<ParticipantId> {
        let mut senders = BTreeSet::new();
        // The header is enough: magic, versions, then the sender's identity.
        let mut header = [0; 20];
        loop {
            match self.0.recv(&mut header) {
                Ok(length) => {
                    let is_whole = length == header.len() && header.starts_with(b"RTPS");
                    if let Some((_, id)) = header.split_last_chunk().filter(|_| is_whole) {
                        senders.insert(*id);
                    }
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => return senders,
            }
        }
    }
}

/// Remembers whom DDS has forgotten.
#[derive(Debug, Default)]
pub(super) struct OutageDetector {
    present: BTreeSet<ParticipantId>,
    forgotten: BTreeSet<ParticipantId>,
}

impl OutageDetector {
    /// Does somebody announce itself whom DDS has forgotten? One who leaves announces that and nothing afterwards.
    ///
    /// `present`: those whom DDS knows. `announced`: those who have announced themselves since the last call.
    pub(super) fn observe(
        &mut self,
        present: BTreeSet<ParticipantId>,
        announced: &BTreeSet<ParticipantId>,
    ) -> bool {
        let is_back = announced
            .iter()
            .any(|id| self.forgotten.contains(id) && !present.contains(id));
        let before = std::mem::replace(&mut self.present, present);
        self.forgotten.extend(before);
        self.forgotten.retain(|id| !self.present.contains(id));
        is_back
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ids(ids: &[u8]) -> BTreeSet<ParticipantId> {
        ids.iter().map(|id| [*id; 12]).collect()
    }

    /// Observes in turn (present, announced). Returns each answer.
    fn observe(sequence: &[(&[u8], &[u8])]) -> Vec<bool> {
        let mut detector = OutageDetector::default();
        sequence
            .iter()
            .map(|(present, announced)| detector.observe(ids(present), &ids(announced)))
            .collect()
    }

    #[test]
    fn a_forgotten_participant_that_announces_itself_is_an_outage() {
        let sequence: [(&[u8], &[u8]); 4] =
            [(&[1, 2], &[1, 2]), (&[2], &[]), (&[2], &[2]), (&[2], &[1])];
        assert_eq!(observe(&sequence), [false, false, false, true]);
    }

    #[test]
    fn those_who_leave_and_those_who_are_new_are_none() {
        let left: [(&[u8], &[u8]); 4] = [(&[1], &[]), (&[], &[1]), (&[2], &[2]), (&[], &[3])];
        assert_eq!(observe(&left), [false; 4]);
        // DDS has connected it again by itself.
        let back: [(&[u8], &[u8]); 4] = [(&[1], &[]), (&[], &[]), (&[1], &[1]), (&[1], &[1])];
        assert_eq!(observe(&back), [false; 4]);
    }
}
