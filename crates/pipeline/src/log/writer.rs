//! What does a log's thread do? It writes the cycles that wait, and flushes them so often that a kill costs little.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use localize::Field;

use super::LogConfig;
use super::header::Header;
use super::messages::Messages;
use super::record::{Notes, Written};
use super::schema::{ABOUT, Level, Sink};
use crate::feed::Pace;
use crate::feed::queue::Queue;

/// The thread's side of a recorder.
pub(super) struct Writer {
    sink: Sink,
    messages: Messages,
    period: Duration,
    /// Until it is drawn, at the first cycle's time.
    field_scene: Option<Field>,
    notes: Notes,
    written: Written,
    safe: Arc<AtomicU64>,
}

impl Writer {
    /// Starts a log with its header.
    pub(super) fn begin(
        path: &Path,
        header: &Header,
        field: &Field,
        (pace, config): (Pace, &LogConfig),
        notes: Notes,
    ) -> Result<Self> {
        if !(1..=100).contains(&config.jpeg_quality) {
            bail!(
                "[log] jpeg_quality = {}: must be 1 to 100",
                config.jpeg_quality
            );
        }
        let period = Duration::try_from_secs_f32(config.flush_period).with_context(|| {
            format!(
                "[log] flush_period = {}: must be seconds",
                config.flush_period
            )
        })?;
        let (sink, topics) = Sink::create(path, pace)?;
        let header = Header {
            images: config.images,
            ..header.clone()
        };
        sink.metadata(ABOUT, header.metadata())?;
        let mut files = header.files;
        if !files.contains_key("field.toml") {
            files.insert(
                "field.toml".to_owned(),
                toml::to_string(&field.config)?.into_bytes(),
            );
        }
        for (name, content) in &files {
            sink.attach(name, content)?;
        }
        sink.flush()?;
        Ok(Writer {
            sink,
            messages: Messages::new(topics, config.images, config.jpeg_quality),
            period,
            field_scene: Some(field.clone()),
            notes,
            written: Written::default(),
            safe: Arc::default(),
        })
    }

    /// Where the number of cycles stands that are safe from a kill.
    pub(super) fn safe(&self) -> Arc<AtomicU64> {
        self.safe.clone()
    }

    /// Writes what the queue holds until it is closed.
    pub(super) fn run(&mut self, queue: &Queue) -> Result<()> {
        let mut flushed = Instant::now();
        while let Some(((index, cycle), dropped)) = queue.pop() {
            if let Some(field) = self.field_scene.take() {
                self.messages.field(&field, cycle.stamp);
            }
            let has_image = self.messages.cycle(index, &cycle)?;
            self.messages.tell_dropped("the disk", dropped, cycle.stamp);
            while let Some((stamp, text)) = self.notes.take() {
                self.messages.topics.note(stamp, Level::Info, text);
            }
            let Written {
                cycles,
                images,
                dropped: lost,
            } = &mut self.written;
            *cycles += 1;
            *images += u64::from(has_image);
            lost.images += dropped.images;
            lost.cycles += dropped.cycles;
            if flushed.elapsed() >= self.period {
                self.sink.flush()?;
                self.safe.store(self.written.cycles, Ordering::Relaxed);
                flushed = Instant::now();
            }
        }
        Ok(())
    }

    /// Writes index and summary.
    pub(super) fn close(self) -> Result<Written> {
        self.sink.close()?;
        Ok(self.written)
    }
}
