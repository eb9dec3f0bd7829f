//! Where do the messages of a log's channels go? Into its file.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

use anyhow::{Context as _, Result, anyhow};
use foxglove::{ChannelId, Context, FoxgloveError, Metadata, RawChannel, SinkId};

use super::file::LogFile;
use super::{PROJECT_NAME, Topics};
use crate::feed::Pace;
use crate::log::held_messages::HeldMessages;
use crate::log::mcap_writer::McapWriter;

/// Size at which a chunk is closed, bytes. With the last image, chunks of usual cameras stay below 1 MiB.
const CHUNK_BYTES: usize = 384 * 1024;
/// Size at which a chunk is closed on a robot, bytes: a sixth of a second at 30 Hz with images of 80 kB.
///
/// The data lost by a kill do not depend on this size: they are those since the last flush.
const LIVE_CHUNK_BYTES: usize = 512 * 1024;
/// Program that wrote the file, for its header.
const LIBRARY: &str = concat!("mirrorball/", env!("CARGO_PKG_VERSION"));

/// File of a log.
pub(crate) struct Sink {
    context: Arc<Context>,
    file: Arc<FileSink>,
    held: HeldMessages,
}

impl Sink {
    /// Starts a log in an empty file, which `path` names in messages, and opens its channels.
    pub(crate) fn create(path: &Path, file: File, pace: Pace) -> Result<(Self, Topics)> {
        let chunk_bytes = match pace {
            Pace::Live => LIVE_CHUNK_BYTES,
            Pace::Lockstep => CHUNK_BYTES,
        };
        let write_error = Arc::new(OnceLock::new());
        let file = LogFile::new(path, file, write_error.clone());
        let identity = (PROJECT_NAME, LIBRARY);
        let writer = McapWriter::create(path, file, identity, chunk_bytes)
            .with_context(|| format!("cannot write {}", path.display()))?;
        let held = writer.held();
        let file = Arc::new(FileSink {
            id: SinkId::next(),
            path: path.to_owned(),
            write_error,
            state: Mutex::new(Some(OpenFile {
                writer,
                channels: HashMap::new(),
            })),
        });
        let context = Context::new();
        context.add_sink(file.clone());
        let topics = Topics::new(&context)?;
        let sink = Sink {
            context,
            file,
            held,
        };
        Ok((sink, topics))
    }

    /// The messages that the file holds, also after a failure.
    pub(crate) fn held(&self) -> HeldMessages {
        self.held.clone()
    }

    /// Writes a metadata record.
    pub(crate) fn metadata(&self, name: &str, values: &BTreeMap<String, String>) -> Result<()> {
        self.write(|writer| writer.write_metadata(name, values))
    }

    /// Writes an attachment.
    pub(crate) fn attach(&self, name: &str, data: &[u8]) -> Result<()> {
        self.write(|writer| writer.write_attachment(name, media_type(name), data))
    }

    /// Ends the chunk and passes all data to the operating system. A later kill does not lose them.
    pub(crate) fn flush(&self) -> Result<()> {
        self.write(McapWriter::flush)
    }

    /// Writes index and summary. Nothing can be written after it.
    pub(crate) fn finish(&self) -> Result<()> {
        self.context.remove_sink(self.file.id);
        if let Some(open) = self.file.lock().take()
            && let Err(error) = open.writer.finish()
        {
            self.file.store_error(&error);
        }
        self.check()
    }

    fn write(&self, write: impl FnOnce(&mut McapWriter) -> std::io::Result<()>) -> Result<()> {
        // The first error is the one that is reported.
        let _stored = self.file.write(|open| write(&mut open.writer));
        self.check()
    }

    fn check(&self) -> Result<()> {
        match self.file.write_error.get() {
            Some(error) => Err(anyhow!("{error}")),
            None => Ok(()),
        }
    }
}

impl Drop for Sink {
    fn drop(&mut self) {
        // After an error that is reported elsewhere, what was logged stays readable with an index.
        let _ = self.finish();
    }
}

/// Receives the messages of all channels of its context.
struct FileSink {
    id: SinkId,
    path: PathBuf,
    /// The first error of a write, the index included.
    write_error: Arc<OnceLock<String>>,
    /// None after the file was closed or a write failed: what follows a half-written record could not be read.
    state: Mutex<Option<OpenFile>>,
}

struct OpenFile {
    writer: McapWriter,
    /// The file's numbers of the channels.
    channels: HashMap<ChannelId, u16>,
}

impl FileSink {
    fn write(
        &self,
        write: impl FnOnce(&mut OpenFile) -> std::io::Result<()>,
    ) -> Result<(), FoxgloveError> {
        let mut state = self.lock();
        let open = state.as_mut().ok_or(FoxgloveError::SinkClosed)?;
        let written = write(open);
        if let Err(error) = &written {
            self.store_error(error);
            *state = None;
        }
        Ok(written?)
    }

    fn store_error(&self, error: &std::io::Error) {
        self.write_error
            .get_or_init(|| format!("cannot write {}: {error}", self.path.display()));
    }

    // The writer is in order after a panic of another thread.
    fn lock(&self) -> MutexGuard<'_, Option<OpenFile>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl foxglove::Sink for FileSink {
    fn id(&self) -> SinkId {
        self.id
    }

    fn log(
        &self,
        channel: &RawChannel,
        message: &[u8],
        metadata: &Metadata,
    ) -> Result<(), FoxgloveError> {
        self.write(|OpenFile { writer, channels }| {
            let id = *channels.entry(channel.id()).or_insert_with(|| {
                let schema = channel.schema();
                let schema =
                    schema.map(|it| (it.name.as_str(), it.encoding.as_str(), &it.data[..]));
                let names = (channel.topic(), channel.message_encoding());
                writer.add_channel(schema, names, channel.metadata())
            });
            writer.write_message(id, metadata.log_time, message)
        })
    }
}

fn media_type(name: &str) -> &'static str {
    match name.rsplit('.').next() {
        Some("toml") => "application/toml",
        Some("csv") => "text/csv",
        Some("json") => "application/json",
        _ => "application/octet-stream",
    }
}
