//! Where does a message begin? Extracts the complete messages from a possibly damaged byte stream.

/// Why bytes were discarded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// Bytes between messages.
    #[error("bytes between messages")]
    Noise,
    /// A message whose checksum does not match.
    #[error("wrong checksum")]
    Checksum,
    /// A message whose length does not match its type.
    #[error("wrong length")]
    Length,
    /// A complete message of another protocol version.
    #[error("unsupported protocol version: {0}")]
    UnsupportedVersion(u8),
    /// A complete message of an unknown type.
    #[error("unknown message type: {0:#04x}")]
    UnknownType(u8),
}

/// Classification of the front of the received bytes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ParseStep<M> {
    /// Possibly the beginning of a message: more bytes are needed.
    Incomplete,
    /// This many bytes are no message; padding if there is no error.
    Skip(usize, Option<DecodeError>),
    /// The length of a message in bytes, and the message.
    Message(usize, M),
}

/// Counts of a decoder.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct DecoderStats {
    /// Bytes received.
    pub bytes: u64,
    /// Complete messages.
    pub messages: u64,
    /// Bytes discarded.
    pub garbage_bytes: u64,
    /// Messages that were rejected.
    pub damaged: u64,
    /// Why bytes were last discarded.
    pub last_error: Option<DecodeError>,
}

/// A decoder of one protocol. Add bytes with [`StreamDecoder::extend`], then iterate until `None`.
#[derive(Debug, Clone)]
pub struct StreamDecoder<M> {
    parse: fn(&[u8]) -> ParseStep<M>,
    buffer: Vec<u8>,
    start: usize,
    stats: DecoderStats,
}

impl<M> StreamDecoder<M> {
    /// A decoder by `parse`, which classifies the front of its argument.
    ///
    /// `parse` may return `Incomplete` only for fewer bytes than its longest message has. It must skip or consume at
    /// least one byte and at most all.
    pub fn new(parse: fn(&[u8]) -> ParseStep<M>) -> Self {
        StreamDecoder {
            parse,
            buffer: Vec::new(),
            start: 0,
            stats: DecoderStats::default(),
        }
    }

    /// Adds received bytes.
    pub fn extend(&mut self, bytes: &[u8]) {
        self.buffer.drain(..self.start);
        self.start = 0;
        self.buffer.extend_from_slice(bytes);
        self.stats.bytes += bytes.len() as u64;
    }

    /// Discards an incomplete message, for a port that was reopened.
    pub fn reset(&mut self) {
        self.buffer.clear();
        self.start = 0;
    }

    /// Counts so far.
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
                ParseStep::Skip(bytes, error) => {
                    self.start += bytes;
                    let Some(error) = error else { continue };
                    self.stats.garbage_bytes += bytes as u64;
                    self.stats.damaged += u64::from(error != DecodeError::Noise);
                    self.stats.last_error = Some(error);
                }
            }
        }
        None
    }
}

/// Skips the first byte and all up to the next one that can begin a message.
pub(crate) fn skip_to<M>(
    bytes: &[u8],
    begins: impl Fn(u8) -> bool,
    error: DecodeError,
) -> ParseStep<M> {
    let skipped = 1 + bytes[1..].iter().take_while(|byte| !begins(**byte)).count();
    ParseStep::Skip(skipped, Some(error))
}
