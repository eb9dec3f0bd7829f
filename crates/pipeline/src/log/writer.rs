//! What does the writer thread of a log do? It writes queued cycles and flushes often, so that a kill loses little.

use std::collections::VecDeque;
use std::fs::File;
use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use localize::{Field, Stamp};

use super::config::LogConfig;
use super::header::Header;
use super::held_messages::HeldMessages;
use super::note_queue::NoteQueue;
use super::publisher::CyclePublisher;
use super::schema::{CYCLE_TOPIC, IMAGE_TOPIC, Level, PROJECT_NAME, Sink};
use crate::feed::queue::CycleQueue;
use crate::feed::{DropCounts, Pace};

/// Counts of what a recorder wrote.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct LogStats {
    /// Written cycles.
    pub cycles: u64,
    /// Written images.
    pub images: u64,
    /// Drops caused by a slow disk.
    pub dropped: DropCounts,
    /// Stamp of the first cycle that a failed write kept out of the file.
    pub lost_from: Option<Stamp>,
}

/// The writer thread's side of a recorder.
pub(super) struct LogWriter {
    sink: Sink,
    messages: CyclePublisher,
    period: Duration,
    /// Published with the stamp of the first cycle. None after that.
    pending_field: Option<Field>,
    notes: NoteQueue,
    stats: LogStats,
    /// The messages that the file holds.
    held: HeldMessages,
    /// Number of cycles taken from the queue.
    taken: u64,
    /// Stamps of those that are not in the file yet.
    pending: VecDeque<Stamp>,
}

impl LogWriter {
    /// Starts a log with its header in an empty file, which `path` names in messages.
    pub(super) fn create(
        (path, file): (&Path, File),
        header: &Header,
        field: &Field,
        (pace, config): (Pace, &LogConfig),
        notes: NoteQueue,
    ) -> Result<Self> {
        if !(1..=100).contains(&config.jpeg_quality) {
            bail!(
                "invalid [log] jpeg_quality: {} (expected 1 to 100)",
                config.jpeg_quality
            );
        }
        let period = Duration::try_from_secs_f32(config.flush_period).with_context(|| {
            format!(
                "invalid [log] flush_period: {} (expected seconds >= 0)",
                config.flush_period
            )
        })?;
        let (sink, topics) = Sink::create(path, file, pace)?;
        let mut header = Header {
            images: config.images,
            ..header.clone()
        };
        sink.metadata(PROJECT_NAME, &header.metadata())?;
        if !header.files.contains_key("field.toml") {
            let field = toml::to_string(&field.config)?;
            header = header.with_file("field.toml", field);
        }
        for (name, content) in &header.files {
            sink.attach(name, content)?;
        }
        sink.flush()?;
        Ok(LogWriter {
            held: sink.held(),
            sink,
            messages: CyclePublisher::new(topics, config.images, config.jpeg_quality, &header),
            period,
            pending_field: Some(field.clone()),
            notes,
            stats: LogStats::default(),
            taken: 0,
            pending: VecDeque::new(),
        })
    }

    /// The messages that the file holds, also after a failure.
    pub(super) fn held(&self) -> HeldMessages {
        self.held.clone()
    }

    /// Writes cycles from the queue until it is closed.
    pub(super) fn run(&mut self, queue: &CycleQueue) -> Result<()> {
        let mut flushed = Instant::now();
        while let Some(((index, cycle), dropped)) = queue.pop() {
            if let Some(field) = self.pending_field.take() {
                self.messages.publish_scenery(&field, cycle.stamp, None);
            }
            self.taken += 1;
            self.pending.push_back(cycle.stamp);
            let has_image = self.messages.publish_cycle(index, &cycle)?;
            self.messages.log_dropped("the disk", dropped, cycle.stamp);
            while let Some((stamp, text)) = self.notes.pop() {
                self.messages.log_message(stamp, Level::Info, text);
            }
            let LogStats {
                cycles,
                images,
                dropped: total,
                ..
            } = &mut self.stats;
            *cycles += 1;
            *images += u64::from(has_image);
            total.images += dropped.images;
            total.cycles += dropped.cycles;
            self.first_pending();
            if flushed.elapsed() >= self.period {
                self.sink.flush()?;
                flushed = Instant::now();
            }
        }
        Ok(())
    }

    /// Stamp of the first cycle that is not in the file. Forgets those of the cycles before it.
    fn first_pending(&mut self) -> Option<Stamp> {
        let waiting = self.taken.saturating_sub(self.held.count(CYCLE_TOPIC));
        let held = self.pending.len().saturating_sub(waiting as usize);
        self.pending.drain(..held);
        self.pending.front().copied()
    }

    /// Writes index and summary, unless a write has failed. Returns what the file holds in both cases.
    pub(super) fn close(mut self, written: Result<()>) -> (LogStats, Result<()>) {
        let closed = written.and(self.sink.finish());
        if closed.is_ok() {
            return (self.stats, closed);
        }
        let stats = LogStats {
            cycles: self.held.count(CYCLE_TOPIC),
            images: self.held.count(IMAGE_TOPIC),
            lost_from: self.first_pending(),
            ..self.stats
        };
        (stats, closed)
    }
}
