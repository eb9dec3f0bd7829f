//! Who sent a datagram? Authentication codes under a shared key, and protection against replays.

use std::net::SocketAddr;

use hmac::{Hmac, Mac};
use sha2::Sha256;

/// Length of the code after a datagram's content, bytes: the first half of HMAC-SHA256.
pub const MAC_BYTES: usize = 16;
/// Shortest key, characters; shorter ones can be guessed. Also in the documents of the keys of network.toml.
const MIN_KEY_LENGTH: usize = 8;

/// A key that all senders share.
#[derive(Clone)]
pub struct MacKey(Hmac<Sha256>);

impl std::fmt::Debug for MacKey {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Key")
    }
}

/// Why a datagram is rejected.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, thiserror::Error, serde::Serialize,
)]
#[serde(rename_all = "lowercase")]
pub enum RejectReason {
    /// Not a message of Mirrorball or of this team.
    #[error("no message of ours")]
    Foreign,
    /// Authentication code missing or wrong.
    #[error("not under our key")]
    Unsealed,
    /// Another version of the message.
    #[error("of another version")]
    Version,
    /// JSON without a version.
    #[error("without `version` (expected 1)")]
    Unversioned,
    /// Received before, or older than the latest message.
    #[error("received before, or older than the latest message")]
    Old,
    /// From a session that another one has replaced, or that is lower than the present one.
    #[error(
        "another sender took over with a higher session. Start again with a higher one, or without a key wait until that sender is silent"
    )]
    Superseded,
    /// From another address than the last message of the same session, which is not silent.
    #[error(
        "another sender uses the same session. Give each start of a program a session of its own (the time in nanoseconds), and send from one socket"
    )]
    Shared,
    /// A value is implausible on a field.
    #[error("no sensible numbers")]
    Senseless,
    /// Sent by this robot.
    #[error("our own")]
    Own,
    /// Sent by another robot with this robot's number.
    #[error("another robot sends under this robot's number. Give each robot its own `robot`")]
    Duplicate,
    /// Of another team.
    #[error("of another team")]
    Team,
    /// From a number without a place among the stored senders.
    #[error("no place: other senders are as many as are stored. List the number in `members`")]
    Full,
    /// Expired before it was read, or based on a state that is too old.
    #[error("too late: expired before it was read, or based on an old state")]
    Late,
    /// Based on a state from the future: a stamp of another clock would never be too old.
    #[error(
        "`state_ns` is in the future of this robot's clock: echo `stamp_ns` of its state output"
    )]
    Future,
    /// Under a key, but without the robot's number or the number of its start.
    #[error("without `boot` and `robot`: with a key, echo both from the robot's state output")]
    Unbound,
    /// Meant for an earlier start of the robot.
    #[error("for another start of this robot: echo `boot` from its present state output")]
    Boot,
    /// Meant for another robot.
    #[error("for another robot")]
    Robot,
}

impl MacKey {
    /// Derives a key from a phrase. Short phrases are rejected.
    pub fn new(phrase: &str) -> anyhow::Result<Self> {
        anyhow::ensure!(
            phrase.chars().count() >= MIN_KEY_LENGTH,
            "key: must have at least {MIN_KEY_LENGTH} characters"
        );
        Ok(MacKey(Hmac::new_from_slice(phrase.as_bytes())?))
    }

    fn mac(&self, content: &[u8]) -> [u8; MAC_BYTES] {
        let whole = self.0.clone().chain_update(content).finalize().into_bytes();
        let mut code = [0; MAC_BYTES];
        code.copy_from_slice(&whole[..MAC_BYTES]);
        code
    }
}

/// Appends the code to a datagram's content, if there is a key.
pub fn append_mac(mut content: Vec<u8>, key: Option<&MacKey>) -> Vec<u8> {
    if let Some(key) = key {
        let code = key.mac(&content);
        content.extend(code);
    }
    content
}

/// Content of a datagram with a correct code. Without a key, any datagram is accepted.
pub fn verify_mac<'a>(datagram: &'a [u8], key: Option<&MacKey>) -> Result<&'a [u8], RejectReason> {
    let Some(key) = key else {
        return Ok(datagram);
    };
    let (content, code) = datagram
        .split_last_chunk::<MAC_BYTES>()
        .ok_or(RejectReason::Unsealed)?;
    key.0
        .clone()
        .chain_update(content)
        .verify_truncated_left(code)
        .map(|()| content)
        .map_err(|_wrong| RejectReason::Unsealed)
}

/// Number of ended sessions that are remembered. After more, only higher sessions are accepted under a key; without one the
/// oldest is forgotten.
const MAX_ENDED_SESSIONS: usize = 64;

/// Accepts each message of a sender once, and none older than the latest.
#[derive(Debug, Clone)]
pub struct ReplayGuard {
    sessions_return: bool,
    last: Option<LastMessage>,
    /// Sessions that another one has replaced, the oldest first.
    ended: Vec<EndedSession>,
}

/// The latest accepted message.
#[derive(Debug, Clone, Copy)]
struct LastMessage {
    session: u64,
    sequence: u64,
    /// Address of the sender, where it tells senders apart.
    source: Option<SocketAddr>,
    /// Time of arrival, seconds.
    received: f64,
}

/// The last accepted message of a session that another one has replaced.
#[derive(Debug, Clone, Copy)]
struct EndedSession {
    session: u64,
    sequence: u64,
}

impl ReplayGuard {
    /// A guard of authenticated messages (`has_key`): a session that another one has replaced never comes back, because a
    /// recording of it would be as valid. Without a key anyone can send what he likes, and a sender that another one
    /// interrupted goes on after the silence.
    pub fn new(has_key: bool) -> Self {
        ReplayGuard {
            sessions_return: !has_key,
            last: None,
            ended: Vec::new(),
        }
    }

    /// Checks the message `sequence` of a sender's `session` (larger for each start of the sender) from `source` at `now`, seconds.
    ///
    /// A session belongs to the address of its last message until the silence: two senders with the same one would take turns.
    ///
    /// After `silence` seconds without an accepted message, a lower session is accepted too, because the sender's clock may
    /// have been set. Under a key never one that was accepted before; without one only messages after its last one.
    pub fn accept(
        &mut self,
        session: u64,
        sequence: u64,
        source: Option<SocketAddr>,
        now: f64,
        silence: f64,
    ) -> Result<(), RejectReason> {
        if let Some(last) = self.last {
            let is_silent = now - last.received >= silence;
            if session == last.session {
                if sequence <= last.sequence {
                    return Err(RejectReason::Old);
                }
                if source != last.source && !is_silent {
                    return Err(RejectReason::Shared);
                }
            } else {
                self.check_takeover(last, session, sequence, is_silent)?;
                self.end_session(last, session);
            }
        }
        self.last = Some(LastMessage {
            session,
            sequence,
            source,
            received: now,
        });
        Ok(())
    }

    /// May a session replace that of the last message?
    fn check_takeover(
        &self,
        last: LastMessage,
        session: u64,
        sequence: u64,
        is_silent: bool,
    ) -> Result<(), RejectReason> {
        let ended = self.ended.iter().find(|ended| ended.session == session);
        match ended {
            Some(ended) if self.sessions_return && is_silent => {
                let is_fresh = sequence > ended.sequence;
                is_fresh.then_some(()).ok_or(RejectReason::Old)
            }
            Some(_) => Err(RejectReason::Superseded),
            None if session > last.session => Ok(()),
            None => {
                let is_remembered = self.sessions_return || self.ended.len() < MAX_ENDED_SESSIONS;
                let may_begin = is_silent && is_remembered;
                may_begin.then_some(()).ok_or(RejectReason::Superseded)
            }
        }
    }

    /// Remembers that `session` has replaced that of the last message.
    fn end_session(&mut self, last: LastMessage, session: u64) {
        self.ended.retain(|ended| ended.session != session);
        if self.ended.len() == MAX_ENDED_SESSIONS {
            if !self.sessions_return {
                return;
            }
            self.ended.remove(0);
        }
        self.ended.push(EndedSession {
            session: last.session,
            sequence: last.sequence,
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_have_at_least_eight_characters() {
        assert!(MacKey::new("1234567").is_err() && MacKey::new("12345678").is_ok());
        assert!(MacKey::new("äöüß").is_err());
    }

    #[test]
    fn interrupted_sender_without_a_key_goes_on_after_the_silence() {
        let mut guard = ReplayGuard::new(false);
        let mut accept = |session, sequence, now| guard.accept(session, sequence, None, now, 1.0);
        assert_eq!(accept(10, 1, 0.0), Ok(()));
        assert_eq!(accept(10, 2, 0.1), Ok(()));
        // A single message of another program.
        assert_eq!(accept(20, 1, 0.2), Ok(()));
        assert_eq!(accept(10, 3, 0.3), Err(RejectReason::Superseded));
        assert_eq!(accept(10, 30, 1.1), Err(RejectReason::Superseded));
        assert_eq!(accept(10, 2, 1.2), Err(RejectReason::Old));
        assert_eq!(accept(10, 33, 1.3), Ok(()));
        // The other program waits for the silence, too, although its session is higher.
        assert_eq!(accept(20, 2, 1.4), Err(RejectReason::Superseded));
        assert_eq!(accept(10, 34, 2.2), Ok(()));
        assert_eq!(accept(20, 3, 2.5), Err(RejectReason::Superseded));
        assert_eq!(accept(20, 4, 3.3), Ok(()));
        assert_eq!(accept(21, 1, 3.4), Ok(()));
        // More sessions than are remembered do not end it.
        for session in (0..1000).rev() {
            let now = 1e4 - session as f64 * 2.0;
            assert_eq!(accept(1000 + session, 1, now), Ok(()), "{session}");
        }
    }

    #[test]
    fn session_belongs_to_one_address_until_it_is_silent() {
        let [first, second] = [10, 20].map(|port| Some(SocketAddr::from(([127, 0, 0, 1], port))));
        for has_key in [false, true] {
            let mut guard = ReplayGuard::new(has_key);
            let mut accept = |sequence, source, now| guard.accept(1, sequence, source, now, 1.0);
            assert_eq!(accept(1, first, 0.0), Ok(()));
            for turn in 1..100 {
                let now = turn as f64 * 0.03;
                assert_eq!(
                    accept(10 * turn, second, now),
                    Err(RejectReason::Shared),
                    "{turn}"
                );
                assert_eq!(accept(10 * turn + 1, first, now), Ok(()), "{turn}");
            }
            // A copy is one, from wherever it comes, and uses up nothing.
            assert_eq!(accept(5, second, 3.0), Err(RejectReason::Old));
            // The program was started again, on another port.
            assert_eq!(accept(2000, second, 3.5), Err(RejectReason::Shared));
            assert_eq!(accept(2001, second, 4.0), Ok(()));
            assert_eq!(accept(2002, first, 4.1), Err(RejectReason::Shared));
        }
    }

    #[test]
    fn interrupted_sender_under_a_key_needs_a_new_session() {
        let mut guard = ReplayGuard::new(true);
        let mut accept = |session, sequence, now| guard.accept(session, sequence, None, now, 1.0);
        assert_eq!(accept(10, 1, 0.0), Ok(()));
        assert_eq!(accept(20, 1, 0.2), Ok(()));
        assert_eq!(accept(10, 99, 9.9), Err(RejectReason::Superseded));
        assert_eq!(accept(21, 1, 10.0), Ok(()));
    }

    #[test]
    fn captured_sessions_cannot_be_replayed_in_turn_during_silence() {
        let mut guard = ReplayGuard::new(true);
        let mut accept =
            |session, sequence, now| guard.accept(session, sequence, None, now, 1.0).is_ok();
        assert!(accept(10, 1, 0.0) && accept(10, 2, 0.1));
        assert!(accept(20, 1, 0.2) && accept(20, 2, 0.3));
        for turn in 1..20 {
            let now = 0.3 + f64::from(turn) * 2.0;
            assert!(!accept(10, 1, now) && !accept(10, 3, now), "turn {turn}");
            assert!(!accept(20, 1, now) && !accept(20, 2, now), "turn {turn}");
        }
        // The sender's clock was set back: a new lower session after the silence, and then the sender goes on.
        assert!(!accept(5, 1, 1.0));
        assert!(accept(5, 1, 50.0) && accept(5, 2, 50.1) && !accept(5, 2, 50.2));
        assert!(!accept(20, 9, 99.0));
        assert!(accept(21, 1, 99.0));
    }

    #[test]
    fn endless_lower_sessions_are_bounded() {
        let mut guard = ReplayGuard::new(true);
        let accepted = (0..1000_u64).rev();
        let accepted = accepted.filter(|session| {
            let now = (1000 - session) as f64 * 2.0;
            guard.accept(*session, 1, None, now, 1.0).is_ok()
        });
        assert_eq!(accepted.count(), MAX_ENDED_SESSIONS + 1);
        assert!(guard.accept(1001, 1, None, 0.0, 1.0).is_ok());
    }
}
