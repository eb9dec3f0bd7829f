//! How are cycles stored? Without loss, in an MCAP file that other tools can open.

pub mod columns;
mod config;
mod encoded_image;
mod export;
mod fallback;
mod header;
mod header_records;
mod held_messages;
mod index;
mod limits;
mod live_topics;
mod mcap_encoding;
mod mcap_files;
mod mcap_records;
mod mcap_writer;
mod note_queue;
pub mod publisher;
pub mod read;
mod record;
mod record_scan;
mod recover;
pub mod schema;
mod start;
mod summary;
#[cfg(test)]
mod tests;
mod unpack;
mod verify;
mod writer;

pub use config::LogConfig;
pub use encoded_image::{EncodedImage, ImageCompression};
pub use export::export;
pub use header::Header;
pub use index::LogIndex;
pub use live_topics::LiveTopics;
pub use mcap_records::LogCompleteness;
pub use read::{LogReader, LoggedCycle};
pub use record::Recorder;
pub use record_scan::ChunkInfo;
pub use recover::recover;
pub use schema::convert::{mode_and_advice, mode_and_reason, reason_text};
pub use start::start_log;
pub use unpack::UnpackedSetup;
pub use verify::{Difference, VerificationReport, verify};
pub use writer::LogStats;
