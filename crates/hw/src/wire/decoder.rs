//! Where does a message begin? Turns a stream of bytes, damaged or not, into the messages that are whole.

/// Why bytes were thrown away.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
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
    UnsupportedVersion(u8),
    /// A whole message of a kind that is not known.
    #[error("unknown message type {0:#04x}")]
    UnknownType(u8),
}

/// What the front of the received bytes is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ParseStep<M> {
    /// Perhaps the beginning of a message: more bytes will tell.
    Incomplete,
    /// So many bytes are no message; without a fault they are mere filling.
    Skip(usize, Option<DecodeError>),
    /// A message and the bytes it took.
    Message(usize, M),
}

/// Counts of what went through a stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct DecoderStats {
    /// Bytes received.
    pub bytes: u64,
    /// Whole messages.
    pub messages: u64,
    /// Bytes thrown away.
    pub garbage_bytes: u64,
    /// Messages with a wrong checksum or length.
    pub damaged: u64,
    /// Why bytes were last thrown away.
    pub last_error: Option<DecodeError>,
}

/// A decoder of one protocol. Feed it with [`Stream::extend`], then iterate until `None`.
#[derive(Debug, Clone)]
pub struct StreamDecoder<M> {
    parse: fn(&[u8]) -> ParseStep<M>,
    buffer: Vec<u8>,
    start: usize,
    stats: DecoderStats,
}

impl<M> StreamDecoder<M> {
    /// A decoder by `parse`, which says what the front of its argument is.
    ///
    /// `parse` must answer `More` only for fewer bytes than its longest message has, and skip or take at least one byte
    /// and at most all.
    pub fn new(parse: fn(&[u8]) -> ParseStep<M>) -> Self {
        StreamDecoder {
            parse,
            buffer: Vec::new(),
            start: 0,
            stats: DecoderStats::default(),
        }
    }

    /// Appends received bytes.
    pub fn extend(&mut self, bytes: &[u8]) {
        self.buffer.drain(..self.start);
        self.start = 0;
        self.buffer.extend_from_slice(bytes);
        self.stats.bytes += bytes.len() as u64;
    }

    /// Forgets a message that was begun; for a port that was opened anew.
    pub fn reset(&mut self) {
        self.buffer.clear();
        self.start = 0;
    }

    /// What went through so far.
    pub fn stats(&self) -> DecoderStats {
        self.stats
    }
}

impl<M> Iterator for StreamDecoder<M> {
    type Item = M;

    fn next(&mut self) -> Option<M> {
        while self.start < self.buffer.len() {
            match (self.parse)(&self.buffer[self.start..]) {
                ParseStep::Incomplete => return None,
                ParseStep::Message(bytes, message) => {
                    self.start += bytes;
                    self.stats.messages += 1;
                    return Some(message);
                }
                ParseStep::Skip(bytes, fault) => {
                    self.start += bytes;
                    let Some(fault) = fault else { continue };
                    self.stats.garbage_bytes += bytes as u64;
                    self.stats.damaged += u64::from(fault != DecodeError::Noise);
                    self.stats.last_error = Some(fault);
                }
            }
        }
        None
    }
}

/// Skips to the next byte that can begin a message, or over everything.
pub(crate) fn skip_to<M>(
    bytes: &[u8],
    begins: impl Fn(u8) -> bool,
    fault: DecodeError,
) -> ParseStep<M> {
    let skipped = 1 + bytes[1..].iter().take_while(|byte| !begins(**byte)).count();
    ParseStep::Skip(skipped, Some(fault))
}
