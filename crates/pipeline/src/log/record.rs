//! How are cycles written without delaying the robot? By a writer thread with a bounded queue.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;

use anyhow::{Context, Result, anyhow};
use localize::{Field, Stamp};
use vision::output_file::PendingName;

use super::config::LogConfig;
use super::header::Header;
use super::held_messages::HeldMessages;
use super::note_queue::NoteQueue;
use super::schema::{CYCLE_TOPIC, IMAGE_TOPIC};
use super::writer::{LogStats, LogWriter};
use crate::cycle::Cycle;
use crate::feed::Pace;
use crate::feed::queue::CycleQueue;

/// Writes the cycles of one run into one log.
pub struct Recorder {
    queue: Arc<CycleQueue>,
    next_index: u64,
    writer: Option<JoinHandle<(LogStats, Result<()>)>>,
    write_error: Arc<OnceLock<String>>,
    held: HeldMessages,
    notes: NoteQueue,
    path: PathBuf,
    /// The name that a log in lockstep gets when it is complete. None for a live log, which has it from the start.
    name: Option<PendingName>,
}

impl Recorder {
    /// Starts a log at `path` and its writer thread.
    ///
    /// A live log has its name from the start, so that a robot that loses power leaves one: it replaces an existing file
    /// at once. A log in lockstep replaces it when it is complete (`vision::output_file`).
    ///
    /// The image compression in `header` is set from `config`.
    pub fn create(
        path: &Path,
        header: &Header,
        field: &Field,
        pace: Pace,
        config: &LogConfig,
    ) -> Result<Self> {
        Recorder::create_with(path, header, field, (pace, config), || ())
    }

    /// As [`Recorder::create`]; `prepare` runs first in the writer thread, to set its priority.
    pub fn create_with(
        path: &Path,
        header: &Header,
        field: &Field,
        (pace, config): (Pace, &LogConfig),
        prepare: impl FnOnce() + Send + 'static,
    ) -> Result<Self> {
        let notes = NoteQueue::default();
        let created = match pace {
            Pace::Live => File::create(path).map(|file| (None, file)),
            Pace::Lockstep => PendingName::create(path).map(|(name, file)| (Some(name), file)),
        };
        let (name, file) = created.with_context(|| format!("cannot write {}", path.display()))?;
        let log = (path, file);
        let mut writer = LogWriter::create(log, header, field, (pace, config), notes.clone())?;
        let queue = Arc::new(CycleQueue::new(
            pace,
            config.queue_images,
            config.queue_cycles,
        ));
        let write_error = Arc::new(OnceLock::new());
        let held = writer.held();
        let (end, failed) = (CloseOnDrop(queue.clone()), write_error.clone());
        let run = move || {
            prepare();
            let written = writer.run(&end.0);
            let (stats, closed) = writer.close(written);
            if let Err(error) = &closed {
                failed.get_or_init(|| format!("{error:#}"));
            }
            (stats, closed)
        };
        let thread = std::thread::Builder::new()
            .name("log".to_owned())
            .spawn(run)?;
        Ok(Recorder {
            queue,
            next_index: 0,
            writer: Some(thread),
            write_error,
            held,
            notes,
            path: path.to_owned(),
            name,
        })
    }

    /// Queues a cycle. Returns an error after a write has failed.
    pub fn record_cycle(&mut self, cycle: Arc<Cycle>) -> Result<()> {
        let index = self.next_index;
        self.next_index += 1;
        self.queue.push((index, cycle));
        self.check()
    }

    /// Queues a note, which is logged with the next cycle.
    pub fn note(&self, stamp: Stamp, text: &str) {
        self.notes.push(stamp, text);
    }

    /// Number of the next cycle.
    pub fn next_index(&self) -> u64 {
        self.next_index
    }

    /// Continues the numbers of an earlier log. A reader sees from the first number that earlier cycles are missing.
    pub fn set_next_index(&mut self, next_index: u64) {
        self.next_index = next_index;
    }

    /// Writes queued cycles, then index and summary.
    pub fn finish(self) -> Result<LogStats> {
        self.finish_by(PendingName::give)
    }

    /// As [`Recorder::finish`] for a run that was broken off: its log is complete up to there, but replaces no earlier one.
    pub fn finish_broken_off(self) -> Result<LogStats> {
        self.finish_by(PendingName::give_unless_taken)
    }

    /// As [`Recorder::finish`] for a live log, which stays after a failure. Returns what it holds in both cases.
    pub fn finish_live(mut self) -> (LogStats, Result<()>) {
        self.join()
    }

    fn finish_by(mut self, give: fn(PendingName) -> std::io::Result<()>) -> Result<LogStats> {
        let (stats, closed) = self.join();
        closed?;
        let given = self.name.take().map_or(Ok(()), give);
        given.with_context(|| format!("cannot write {}", self.path.display()))?;
        Ok(stats)
    }

    fn check(&self) -> Result<()> {
        self.write_error
            .get()
            .map_or(Ok(()), |error| Err(anyhow!("{error}")))
    }

    fn join(&mut self) -> (LogStats, Result<()>) {
        self.queue.close();
        let path = self.path.display();
        let held = || LogStats {
            cycles: self.held.count(CYCLE_TOPIC),
            images: self.held.count(IMAGE_TOPIC),
            ..LogStats::default()
        };
        let Some(writer) = self.writer.take() else {
            return (held(), Err(anyhow!("the log {path} is closed already")));
        };
        writer.join().unwrap_or_else(|_panicked| {
            (
                held(),
                Err(anyhow!("the writer of the log {path} broke off")),
            )
        })
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        // A live run that failed still leaves a complete log. Its own error is reported, so one of the log is ignored.
        if self.writer.is_some() {
            let _ = self.join();
        }
    }
}

/// Closes the queue when the writer thread ends or panics, so that the run does not block.
struct CloseOnDrop(Arc<CycleQueue>);

impl Drop for CloseOnDrop {
    fn drop(&mut self) {
        self.0.close();
    }
}
