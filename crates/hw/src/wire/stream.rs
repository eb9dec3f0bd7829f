//! Where does a message begin? Turns a stream of bytes, damaged or not, into the messages that are whole.

/// Why bytes were thrown away.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Fault {
    /// Bytes between messages.
    #[error("bytes that begin no message")]
    Noise,
    /// A message whose checksum does not match.
    #[error("wrong checksum")]
    Checksum,
    /// A message of a known kind and of another length than that kind has.
    #[error("wrong length")]
    Length,
    /// A whole message of another version of the protocol.
    #[error("protocol version {0} is not spoken here")]
    Version(u8),
    /// A whole message of a kind that is not known.
    #[error("unknown message type {0:#04x}")]
    Kind(u8),
}

/// What the front of the received bytes is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Step<M> {
    /// Perhaps the beginning of a message: more bytes will tell.
    More,
    /// So many bytes are no message; without a fault they are mere filling.
    Skip(usize, Option<Fault>),
    /// A message and the bytes it took.
    Take(usize, M),
}

/// Counts of what went through a stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Tally {
    /// Bytes received.
    pub bytes: u64,
    /// Whole messages.
    pub messages: u64,
    /// Bytes thrown away.
    pub garbage_bytes: u64,
    /// Messages with a wrong checksum or length.
    pub damaged: u64,
    /// Why bytes were last thrown away.
    pub last_fault: Option<Fault>,
}

/// A decoder of one protocol. Feed it with [`Stream::extend`], then iterate until `None`.
#[derive(Debug, Clone)]
pub struct Stream<M> {
    parse: fn(&[u8]) -> Step<M>,
    received: Vec<u8>,
    start: usize,
    tally: Tally,
}

impl<M> Stream<M> {
    /// A decoder by `parse`, which says what the front of its argument is.
    ///
    /// `parse` must answer `More` only for fewer bytes than its longest message has, and skip or take at least one byte
    /// and at most all.
    pub fn new(parse: fn(&[u8]) -> Step<M>) -> Self {
        Stream {
            parse,
            received: Vec::new(),
            start: 0,
            tally: Tally::default(),
        }
    }

    /// Appends received bytes.
    pub fn extend(&mut self, bytes: &[u8]) {
        self.received.drain(..self.start);
        self.start = 0;
        self.received.extend_from_slice(bytes);
        self.tally.bytes += bytes.len() as u64;
    }

    /// Forgets a message that was begun; for a port that was opened anew.
    pub fn clear(&mut self) {
        self.received.clear();
        self.start = 0;
    }

    /// What went through so far.
    pub fn tally(&self) -> Tally {
        self.tally
    }
}

impl<M> Iterator for Stream<M> {
    type Item = M;

    fn next(&mut self) -> Option<M> {
        while self.start < self.received.len() {
            match (self.parse)(&self.received[self.start..]) {
                Step::More => return None,
                Step::Take(bytes, message) => {
                    self.start += bytes;
                    self.tally.messages += 1;
                    return Some(message);
                }
                Step::Skip(bytes, fault) => {
                    self.start += bytes;
                    let Some(fault) = fault else { continue };
                    self.tally.garbage_bytes += bytes as u64;
                    self.tally.damaged += u64::from(fault != Fault::Noise);
                    self.tally.last_fault = Some(fault);
                }
            }
        }
        None
    }
}

/// Skips to the next byte that can begin a message, or over everything.
pub(crate) fn skip_to<M>(bytes: &[u8], begins: impl Fn(u8) -> bool, fault: Fault) -> Step<M> {
    let skipped = 1 + bytes[1..].iter().take_while(|byte| !begins(**byte)).count();
    Step::Skip(skipped, Some(fault))
}
