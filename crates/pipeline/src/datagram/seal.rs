//! Who says so? Datagrams with an authentication code under a shared key, and none older than the last.

use hmac::{Hmac, Mac};
use sha2::Sha256;

/// Bytes of the code behind a datagram's content: HMAC-SHA256, its first half.
pub const CODE_BYTES: usize = 16;
/// Shorter keys are guessed.
const KEY_SHORTEST: usize = 8;

/// A key that the speakers share.
#[derive(Clone)]
pub struct Key(Hmac<Sha256>);

impl std::fmt::Debug for Key {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Key")
    }
}

/// Why a datagram is refused.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, thiserror::Error, serde::Serialize,
)]
#[serde(rename_all = "lowercase")]
pub enum Refused {
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

impl Key {
    /// A key from a phrase; a short one is refused.
    pub fn new(phrase: &str) -> anyhow::Result<Self> {
        anyhow::ensure!(
            phrase.len() >= KEY_SHORTEST,
            "key: must have at least {KEY_SHORTEST} characters"
        );
        Ok(Key(Hmac::new_from_slice(phrase.as_bytes())?))
    }

    fn code(&self, content: &[u8]) -> [u8; CODE_BYTES] {
        let whole = self.0.clone().chain_update(content).finalize().into_bytes();
        let mut code = [0; CODE_BYTES];
        code.copy_from_slice(&whole[..CODE_BYTES]);
        code
    }
}

/// Puts the code behind a datagram's content, if there is a key.
pub fn seal(mut content: Vec<u8>, key: Option<&Key>) -> Vec<u8> {
    if let Some(key) = key {
        let code = key.code(&content);
        content.extend(code);
    }
    content
}

/// A datagram's content, if its code is right or none is wanted.
pub fn open<'a>(datagram: &'a [u8], key: Option<&Key>) -> Result<&'a [u8], Refused> {
    let Some(key) = key else {
        return Ok(datagram);
    };
    let (content, code) = datagram
        .split_last_chunk::<CODE_BYTES>()
        .ok_or(Refused::Unsealed)?;
    key.0
        .clone()
        .chain_update(content)
        .verify_truncated_left(code)
        .map(|()| content)
        .map_err(|_wrong| Refused::Unsealed)
}

/// Lets each message of a speaker pass once, and none that was overtaken.
#[derive(Debug, Clone, Copy, Default)]
pub struct Turnstile {
    last: Option<(u64, u64, f64)>,
}

impl Turnstile {
    /// Takes the message `sequence` of a speaker's `session` (larger for each start of the speaker) at `now`, seconds.
    ///
    /// A speaker that was silent for `silence` seconds may come back with any session: its clock may have been set.
    pub fn pass(
        &mut self,
        session: u64,
        sequence: u64,
        now: f64,
        silence: f64,
    ) -> Result<(), Refused> {
        if let Some((last_session, last_sequence, heard)) = self.last
            && (session, sequence) <= (last_session, last_sequence)
            && (session == last_session || now - heard < silence)
        {
            return Err(Refused::Old);
        }
        self.last = Some((session, sequence, now));
        Ok(())
    }
}
