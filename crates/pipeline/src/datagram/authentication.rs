//! Who says so? Datagrams with an authentication code under a shared key, and none older than the last.

use hmac::{Hmac, Mac};
use sha2::Sha256;

/// Bytes of the code behind a datagram's content: HMAC-SHA256, its first half.
pub const MAC_BYTES: usize = 16;
/// Shorter keys are guessed.
const MIN_KEY_LENGTH: usize = 8;

/// A key that the speakers share.
#[derive(Clone)]
pub struct MacKey(Hmac<Sha256>);

impl std::fmt::Debug for MacKey {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Key")
    }
}

/// Why a datagram is refused.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, thiserror::Error, serde::Serialize,
)]
#[serde(rename_all = "lowercase")]
pub enum RejectReason {
    /// Something else speaks here.
    #[error("no message of ours")]
    Foreign,
    /// Its code is missing or wrong.
    #[error("not under our key")]
    Unsealed,
    /// Of another version.
    #[error("of another version")]
    Version,
    /// Heard before, or overtaken by a newer one.
    #[error("heard before or overtaken")]
    Old,
    /// A number that nothing on a field has.
    #[error("no sensible numbers")]
    Senseless,
    /// Our own word, come back.
    #[error("our own")]
    Own,
}

impl MacKey {
    /// A key from a phrase; a short one is refused.
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

/// Puts the code behind a datagram's content, if there is a key.
pub fn append_mac(mut content: Vec<u8>, key: Option<&MacKey>) -> Vec<u8> {
    if let Some(key) = key {
        let code = key.mac(&content);
        content.extend(code);
    }
    content
}

/// A datagram's content, if its code is right or none is wanted.
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

/// Lets each message of a speaker pass once, and none that was overtaken.
#[derive(Debug, Clone, Copy, Default)]
pub struct ReplayGuard {
    last: Option<(u64, u64, f64)>,
}

impl ReplayGuard {
    /// Takes the message `sequence` of a speaker's `session` (larger for each start of the speaker) at `now`, seconds.
    ///
    /// A speaker that was silent for `silence` seconds may come back with any session: its clock may have been set.
    pub fn accept(
        &mut self,
        session: u64,
        sequence: u64,
        now: f64,
        silence: f64,
    ) -> Result<(), RejectReason> {
        if let Some((last_session, last_sequence, heard)) = self.last
            && (session, sequence) <= (last_session, last_sequence)
            && (session == last_session || now - heard < silence)
        {
            return Err(RejectReason::Old);
        }
        self.last = Some((session, sequence, now));
        Ok(())
    }
}
