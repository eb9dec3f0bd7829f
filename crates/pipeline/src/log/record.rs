//! How does a cycle get to the disk without holding up the robot? Through a bounded queue, by a thread of its own.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::thread::JoinHandle;

use anyhow::{Result, anyhow, bail};
use localize::{Field, Stamp};

use super::LogConfig;
use super::header::Header;
use super::writer::LogWriter;
use crate::cycle::Cycle;
use crate::feed::DropCounts;
use crate::feed::Pace;
use crate::feed::queue::CycleQueue;

/// What a recorder wrote.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct LogStats {
    /// Cycles.
    pub cycles: u64,
    /// Images.
    pub images: u64,
    /// What a slow disk cost.
    pub dropped: DropCounts,
}

/// Writes the cycles of one run into one log.
pub struct Recorder {
    queue: Arc<CycleQueue>,
    next_index: u64,
    writer: Option<JoinHandle<Result<LogStats>>>,
    write_error: Arc<OnceLock<String>>,
    flushed_cycles: Arc<AtomicU64>,
    notes: NoteQueue,
    path: PathBuf,
}

impl Recorder {
    /// Starts a log at `path`, replacing one that is there, and its writer thread.
    ///
    /// What `header` says of images is set from `config`.
    pub fn create(
        path: &Path,
        header: &Header,
        field: &Field,
        pace: Pace,
        config: &LogConfig,
    ) -> Result<Self> {
        Recorder::create_with(path, header, field, (pace, config), || ())
    }

    /// As [`Recorder::create`]; `prepare` runs first in the writer's thread, to set its priority.
    pub fn create_with(
        path: &Path,
        header: &Header,
        field: &Field,
        (pace, config): (Pace, &LogConfig),
        prepare: impl FnOnce() + Send + 'static,
    ) -> Result<Self> {
        let notes = NoteQueue::default();
        let mut writer = LogWriter::create(path, header, field, (pace, config), notes.clone())?;
        let queue = Arc::new(CycleQueue::new(
            pace,
            config.queue_images,
            config.queue_cycles,
        ));
        let fault = Arc::new(OnceLock::new());
        let safe = writer.flushed_cycles();
        let (end, failed) = (CloseOnDrop(queue.clone()), fault.clone());
        let run = move || {
            prepare();
            let done = writer.run(&end.0).and_then(|()| writer.close());
            if let Err(error) = &done {
                failed.get_or_init(|| format!("{error:#}"));
            }
            done
        };
        let thread = std::thread::Builder::new()
            .name("log".to_owned())
            .spawn(run)?;
        Ok(Recorder {
            queue,
            next_index: 0,
            writer: Some(thread),
            write_error: fault,
            flushed_cycles: safe,
            notes,
            path: path.to_owned(),
        })
    }

    /// Takes a cycle; fails once the log could not be written.
    pub fn record_cycle(&mut self, cycle: Arc<Cycle>) -> Result<()> {
        let index = self.next_index;
        self.next_index += 1;
        self.queue.push((index, cycle));
        self.check()
    }

    /// Takes a line for people, which goes into the log with the next cycle.
    pub fn note(&self, stamp: Stamp, text: &str) {
        self.notes.push(stamp, text);
    }

    /// Cycles that are safe from a kill.
    pub fn flushed_cycles(&self) -> u64 {
        self.flushed_cycles.load(Ordering::Relaxed)
    }

    /// Writes what waits, then index and summary.
    pub fn finish(mut self) -> Result<LogStats> {
        self.join()
    }

    fn check(&self) -> Result<()> {
        self.write_error
            .get()
            .map_or(Ok(()), |fault| Err(anyhow!("{fault}")))
    }

    fn join(&mut self) -> Result<LogStats> {
        self.queue.close();
        let Some(writer) = self.writer.take() else {
            bail!("the log {} is closed already", self.path.display());
        };
        let written = writer.join();
        written.unwrap_or_else(|_| {
            Err(anyhow!(
                "the writer of the log {} broke off",
                self.path.display()
            ))
        })
    }
}

/// Notes that may wait for the next cycle; beyond it the oldest are dropped.
const NOTES_MAX: usize = 256;

/// Lines for people that wait for the writer.
#[derive(Debug, Clone, Default)]
pub(super) struct NoteQueue {
    queue: Arc<Mutex<VecDeque<(Stamp, String)>>>,
}

impl NoteQueue {
    fn push(&self, stamp: Stamp, text: &str) {
        let mut waiting = self.queue.lock().unwrap_or_else(PoisonError::into_inner);
        if waiting.len() == NOTES_MAX {
            waiting.pop_front();
        }
        waiting.push_back((stamp, text.to_owned()));
    }

    /// The oldest, if there is one.
    pub(super) fn pop(&self) -> Option<(Stamp, String)> {
        let mut waiting = self.queue.lock().unwrap_or_else(PoisonError::into_inner);
        waiting.pop_front()
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        // A run that failed still leaves a whole log; the failure that ends it is the one to be told.
        if self.writer.is_some() {
            let _ = self.join();
        }
    }
}

/// Closes the queue when the writer ends, however it ends: nobody waits for a writer that is gone.
struct CloseOnDrop(Arc<CycleQueue>);

impl Drop for CloseOnDrop {
    fn drop(&mut self) {
        self.0.close();
    }
}
