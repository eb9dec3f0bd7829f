//! What does the writer thread of a log do? It writes queued cycles and flushes often, so that a kill loses little.

use std::fs::File;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use localize::Field;

use super::config::LogConfig;
use super::header::Header;
use super::note_queue::NoteQueue;
use super::publisher::CyclePublisher;
use super::schema::{Level, PROJECT_NAME, Sink};
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
    flushed_cycles: Arc<AtomicU64>,
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
            sink,
            messages: CyclePublisher::new(topics, config.images, config.jpeg_quality, &header),
            period,
            pending_field: Some(field.clone()),
            notes,
            stats: LogStats::default(),
            flushed_cycles: Arc::default(),
        })
    }

    /// Number of cycles flushed to disk, shared with the recorder.
    pub(super) fn flushed_cycles(&self) -> Arc<AtomicU64> {
        self.flushed_cycles.clone()
    }

    /// Writes cycles from the queue until it is closed.
    pub(super) fn run(&mut self, queue: &CycleQueue) -> Result<()> {
        let mut flushed = Instant::now();
        while let Some(((index, cycle), dropped)) = queue.pop() {
            if let Some(field) = self.pending_field.take() {
                self.messages.publish_scenery(&field, cycle.stamp, None);
            }
            let has_image = self.messages.publish_cycle(index, &cycle)?;
            self.messages.log_dropped("the disk", dropped, cycle.stamp);
            while let Some((stamp, text)) = self.notes.pop() {
                self.messages.log_message(stamp, Level::Info, text);
            }
            let LogStats {
                cycles,
                images,
                dropped: total,
            } = &mut self.stats;
            *cycles += 1;
            *images += u64::from(has_image);
            total.images += dropped.images;
            total.cycles += dropped.cycles;
            if flushed.elapsed() >= self.period {
                self.sink.flush()?;
                self.flushed_cycles
                    .store(self.stats.cycles, Ordering::Relaxed);
                flushed = Instant::now();
            }
        }
        Ok(())
    }

    /// Writes index and summary.
    pub(super) fn close(self) -> Result<LogStats> {
        self.sink.close()?;
        Ok(self.stats)
    }
}
