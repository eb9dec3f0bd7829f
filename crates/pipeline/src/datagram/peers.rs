//! Which senders of team messages are stored, and who gives his place to whom?

use std::collections::{BTreeMap, VecDeque};

use localize::Stamp;

use super::authentication::{RejectReason, ReplayGuard};
use super::peer_clock::PeerClock;

/// Number of stored senders: more than a team has. Bounds the memory if a foreign program invents robot numbers.
const MAX_PEERS: usize = 16;
/// A sender that is silent for this time loses its place when another one needs it, seconds.
const PEER_AGE_MAX: f64 = 5.0;
/// Number of senders without a place whose last message is remembered.
const MAX_DISPLACED: usize = 64;

/// Reception of a teammate's messages.
#[derive(Debug, Clone)]
pub(super) struct Peer {
    pub(super) replay_guard: ReplayGuard,
    pub(super) clock: PeerClock,
    pub(super) sent_ns: i64,
    pub(super) received_ns: i64,
}

/// The stored senders by number.
#[derive(Debug)]
pub(super) struct Peers {
    members: Vec<u32>,
    has_key: bool,
    peers: BTreeMap<u32, Peer>,
    /// Senders that lost their place, the longest ago first: their recorded messages stay replays.
    displaced: VecDeque<(u32, ReplayGuard)>,
}

impl Peers {
    /// No senders. `members`: numbers of the team. `has_key`: messages are authenticated.
    pub(super) fn new(members: Vec<u32>, has_key: bool) -> Self {
        Peers {
            members,
            has_key,
            peers: BTreeMap::new(),
            displaced: VecDeque::new(),
        }
    }

    /// True if the team lists this number.
    pub(super) fn is_member(&self, robot: u32) -> bool {
        self.members.contains(&robot)
    }

    /// The stored senders in the order of their numbers.
    pub(super) fn iter(&self) -> impl Iterator<Item = (&u32, &Peer)> {
        self.peers.iter()
    }

    /// Accepts a message of a sender at `now`, if it is no replay and the sender has or gets a place.
    pub(super) fn accept(
        &mut self,
        robot: u32,
        (session, sequence): (u64, u64),
        now: Stamp,
        silence: f64,
    ) -> Result<&mut Peer, RejectReason> {
        let seconds = now.seconds();
        if !self.peers.contains_key(&robot) {
            let replaced = self.replaceable_for(robot, now)?;
            let mut displaced = self.displaced.iter();
            let known = displaced.position(|(number, _)| *number == robot);
            let mut replay_guard = known.map_or_else(
                || ReplayGuard::new(self.has_key),
                |index| self.displaced[index].1.clone(),
            );
            // Before anything changes: a replay takes no place.
            replay_guard.accept(session, sequence, None, seconds, silence)?;
            known.and_then(|index| self.displaced.remove(index));
            if let Some(replaced) = replaced {
                self.displace(replaced);
            }
            let clock = PeerClock::default();
            return Ok(self.peers.entry(robot).or_insert(Peer {
                replay_guard,
                clock,
                sent_ns: 0,
                received_ns: now.0,
            }));
        }
        let peer = self.peers.get_mut(&robot).ok_or(RejectReason::Full)?;
        peer.replay_guard
            .accept(session, sequence, None, seconds, silence)?;
        Ok(peer)
    }

    /// The sender that gives its place to a new one; None if a place is free. Numbers of the team come first: they take the
    /// place of any other number, and of a silent one of the team.
    fn replaceable_for(&self, robot: u32, now: Stamp) -> Result<Option<u32>, RejectReason> {
        if self.peers.len() < MAX_PEERS {
            return Ok(None);
        }
        let age = |peer: &Peer| now - Stamp(peer.received_ns);
        let replaceable = self.peers.iter().filter(|(number, peer)| {
            age(peer) > PEER_AGE_MAX || (self.is_member(robot) && !self.is_member(**number))
        });
        // Others before those of the team, then the longest silent one.
        let replaced = replaceable.max_by(|(a, peer_a), (b, peer_b)| {
            let others = self.is_member(**b).cmp(&self.is_member(**a));
            others.then(age(peer_a).total_cmp(&age(peer_b)))
        });
        let replaced = replaced.map(|(number, _)| Some(*number));
        replaced.ok_or(RejectReason::Full)
    }

    /// Takes a sender's place, and remembers its last message. Of too many, numbers of the team are forgotten last.
    fn displace(&mut self, robot: u32) {
        let Some(peer) = self.peers.remove(&robot) else {
            return;
        };
        if self.displaced.len() == MAX_DISPLACED {
            let mut displaced = self.displaced.iter();
            let stranger = displaced.position(|(number, _)| !self.is_member(*number));
            self.displaced.remove(stranger.unwrap_or(0));
        }
        self.displaced.push_back((robot, peer.replay_guard));
    }

    #[cfg(test)]
    pub(super) fn contains(&self, robot: u32) -> bool {
        self.peers.contains_key(&robot)
    }

    #[cfg(test)]
    pub(super) fn len(&self) -> usize {
        self.peers.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn remembered_senders_are_bounded_and_those_of_the_team_stay() {
        let mut peers = Peers::new(vec![2], true);
        let mut accept = |robot: u32, sequence: u64, seconds: f64| {
            let now = Stamp::from_seconds(seconds);
            peers.accept(robot, (5, sequence), now, 1.0).map(|_| ())
        };
        assert_eq!(accept(2, 1, 0.0), Ok(()));
        let rounds = 100..300;
        for number in rounds {
            let seconds = f64::from(number) * 10.0;
            assert_eq!(accept(number, 1, seconds), Ok(()), "{number}");
        }
        let end = 4000.0;
        assert_eq!(accept(2, 1, end), Err(RejectReason::Old));
        // Forgotten, as every other number may be.
        assert_eq!(accept(100, 1, end), Ok(()));
        assert_eq!(accept(2, 2, end), Ok(()));
        assert!(peers.displaced.len() <= MAX_DISPLACED && peers.len() == MAX_PEERS);
    }
}
