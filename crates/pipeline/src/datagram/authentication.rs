//! Who sent a datagram? Authentication codes under a shared key, and protection against replays.

use hmac::{Hmac, Mac};
use sha2::Sha256;

/// Length of the code after a datagram's content, bytes: the first half of HMAC-SHA256.
pub const MAC_BYTES: usize = 16;
/// Shortest key, characters; shorter ones can be guessed.
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
    /// Received before, or older than the latest message.
    #[error("heard before or overtaken")]
    Old,
    /// A value is implausible on a field.
    #[error("no sensible numbers")]
    Senseless,
    /// Sent by this robot.
    #[error("our own")]
    Own,
}

impl MacKey {
    /// Derives a key from a phrase. Short phrases are rejected.
    pub fn new(phrase: &str) -> anyhow::Result<Self> {
        anyhow::ensure!(
            phrase.len() >= MIN_KEY_LENGTH,
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

/// Accepts each message of a sender once, and none older than the latest.
#[derive(Debug, Clone, Copy, Default)]
pub struct ReplayGuard {
    last: Option<(u64, u64, f64)>,
}

impl ReplayGuard {
    /// Checks the message `sequence` of a sender's `session` (larger for each start of the sender) at `now`, seconds.
    ///
    /// After `silence` seconds without a message, any session is accepted: the sender's clock may have been set.
    pub fn accept(
        &mut self,
        session: u64,
        sequence: u64,
        now: f64,
        silence: f64,
    ) -> Result<(), RejectReason> {
        if let Some((last_session, last_sequence, last_received)) = self.last
            && (session, sequence) <= (last_session, last_sequence)
            && (session == last_session || now - last_received < silence)
        {
            return Err(RejectReason::Old);
        }
        self.last = Some((session, sequence, now));
        Ok(())
    }
}
