//! Reads any fields of a log's topics in a thread, chunk by chunk.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};

use pipeline::log::columns::{Field, FieldValue, TopicReader};

/// Events queued for the view; a batch holds the samples of one chunk.
const EVENT_CAPACITY: usize = 64;
/// Requested fields queued for the thread.
const REQUEST_CAPACITY: usize = 256;

/// What the thread has read.
pub(crate) enum FieldEvent {
    /// Every field of the log.
    Paths(Vec<String>),
    /// Samples of a field: time (s) and value.
    Samples(String, Vec<(f64, FieldValue)>),
    /// All samples of the field are read.
    Complete(String),
    /// The field cannot be read.
    Failed(String, String),
}

/// The running reader; dropping it stops the thread.
pub(crate) struct FieldReader {
    requests: SyncSender<String>,
    events: Receiver<FieldEvent>,
}

impl FieldReader {
    /// Starts the thread. `clock_offset_ns`: from the stamps of cycles to the times of messages.
    pub(crate) fn start(path: &Path, clock_offset_ns: i64) -> std::io::Result<Self> {
        let (requests, requested) = sync_channel(REQUEST_CAPACITY);
        let (sender, events) = sync_channel(EVENT_CAPACITY);
        let path = path.to_owned();
        std::thread::Builder::new()
            .name("fields".to_owned())
            .spawn(move || read_fields(path, clock_offset_ns, &requested, &sender))?;
        Ok(FieldReader { requests, events })
    }

    /// Requests a field; false if too many are waiting.
    pub(crate) fn request(&self, path: &str) -> bool {
        self.requests.try_send(path.to_owned()).is_ok()
    }

    /// What was read since the last call.
    pub(crate) fn poll(&self) -> impl Iterator<Item = FieldEvent> + '_ {
        self.events.try_iter()
    }
}

/// A field that is being read.
struct ActiveField {
    path: String,
    field: Field,
    /// Chunk to read next.
    next: usize,
}

/// Serves requests until the view drops the reader: an error of `send` or `recv`.
fn read_fields(
    path: PathBuf,
    clock_offset_ns: i64,
    requests: &Receiver<String>,
    events: &SyncSender<FieldEvent>,
) -> Option<()> {
    let reader = match TopicReader::open_any(&path) {
        Ok(reader) => reader,
        Err(error) => {
            while let Ok(path) = requests.recv() {
                events
                    .send(FieldEvent::Failed(path, format!("{error:#}")))
                    .ok()?;
            }
            return None;
        }
    };
    events.send(FieldEvent::Paths(reader.field_paths())).ok()?;
    let mut active: Vec<ActiveField> = Vec::new();
    loop {
        loop {
            let request = if active.is_empty() {
                requests.recv().ok()?
            } else {
                match requests.try_recv() {
                    Ok(request) => request,
                    Err(TryRecvError::Empty) => break,
                    Err(TryRecvError::Disconnected) => return None,
                }
            };
            match Field::find(reader.topics(), &request) {
                Ok(field) => active.push(ActiveField {
                    path: request,
                    field,
                    next: 0,
                }),
                Err(error) => {
                    let failed = FieldEvent::Failed(request, format!("{error:#}"));
                    events.send(failed).ok()?;
                }
            }
        }
        read_chunk(&reader, &mut active, clock_offset_ns, events)?;
        while let Some(done) = active
            .iter()
            .position(|field| field.next >= reader.chunk_count())
        {
            let path = active.swap_remove(done).path;
            events.send(FieldEvent::Complete(path)).ok()?;
        }
    }
}

/// Reads the first chunk that a field lacks, for all fields that lack it. A later request catches up with the others.
fn read_chunk(
    reader: &TopicReader,
    active: &mut [ActiveField],
    clock_offset_ns: i64,
    events: &SyncSender<FieldEvent>,
) -> Option<()> {
    let Some(chunk) = active.iter().map(|field| field.next).min() else {
        return Some(());
    };
    let mut group: Vec<&mut ActiveField> = active
        .iter_mut()
        .filter(|field| field.next == chunk)
        .collect();
    let mut topics: Vec<String> = group
        .iter()
        .map(|field| field.field.topic().to_owned())
        .collect();
    topics.sort();
    topics.dedup();
    // The player reports an unreadable chunk when it is shown. The curves have a gap there.
    let messages = reader.chunk_messages(chunk, &topics, &(0..u64::MAX));
    let messages = messages.unwrap_or_default();
    for active in &mut group {
        active.next += 1;
        let of_topic = messages
            .iter()
            .filter(|message| message.topic == active.field.topic());
        let samples: Vec<(f64, FieldValue)> = of_topic
            .map(|message| {
                let stamp_ns = i128::from(message.log_time) - i128::from(clock_offset_ns);
                let value = active.field.read(message).unwrap_or(FieldValue::Absent);
                (stamp_ns as f64 * 1e-9, value)
            })
            .collect();
        if !samples.is_empty() {
            let batch = FieldEvent::Samples(active.path.clone(), samples);
            events.send(batch).ok()?;
        }
    }
    Some(())
}
