//! What happens when the disk is full? The log ends with a message, and a new file starts as soon as there is space.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use hw::realtime::lower_priority;
use localize::{Field, Stamp};
use serde::Serialize;

use pipeline::Cycle;
use pipeline::feed::Pace;
use pipeline::log::{Header, LogConfig, Recorder};

/// Time between attempts to start a new log, seconds.
const RETRY_PERIOD: f64 = 0.5;

/// Statistics of the logs of a run.
#[derive(Debug, Clone, Default, Serialize)]
pub(crate) struct LogSummary {
    /// The files, in order; more than one if the disk was full.
    pub files: Vec<PathBuf>,
    /// Cycles written.
    pub cycles: u64,
    /// Images written.
    pub images: u64,
    /// Cycles lost to a slow or full disk.
    pub cycles_dropped: u64,
    /// Images lost to a slow disk.
    pub images_dropped: u64,
}

/// The logs of a run after its end.
pub(crate) struct FinishedLog {
    /// Files and counts.
    pub summary: LogSummary,
    /// Why the last file could not be closed.
    pub error: Option<String>,
}

/// Writes the log of a run, in a new file after a failure.
pub(crate) struct LogRotation {
    path: PathBuf,
    header: Header,
    field: Field,
    config: LogConfig,
    recorder: Option<Recorder>,
    next_attempt: Stamp,
    summary: LogSummary,
}

impl LogRotation {
    /// Starts the log. Only here a failure is an error; later it is a message.
    pub(crate) fn start(
        path: &Path,
        header: Header,
        field: &Field,
        config: &LogConfig,
    ) -> anyhow::Result<Self> {
        let recorder =
            Recorder::create_with(path, &header, field, (Pace::Live, config), lower_priority)?;
        Ok(LogRotation {
            path: path.to_owned(),
            header,
            field: field.clone(),
            config: config.clone(),
            recorder: Some(recorder),
            next_attempt: Stamp(0),
            summary: LogSummary {
                files: vec![path.to_owned()],
                ..LogSummary::default()
            },
        })
    }

    /// Writes a cycle. Returns a message if the log failed or a new one started.
    pub(crate) fn write_cycle(&mut self, cycle: Arc<Cycle>) -> Option<String> {
        let now = hw::now();
        let mut message = None;
        if self.recorder.is_none() && now > self.next_attempt {
            self.next_attempt = now + RETRY_PERIOD;
            message = self.open_next_file();
        }
        let Some(recorder) = &mut self.recorder else {
            self.summary.cycles_dropped += 1;
            return message;
        };
        if let Err(error) = recorder.record_cycle(cycle) {
            self.summary.cycles_dropped += 1;
            self.close_file();
            self.next_attempt = now + RETRY_PERIOD;
            return Some(format!(
                "cannot write the log: {error:#}. The run continues without it"
            ));
        }
        message
    }

    /// Writes a text message into the log.
    pub(crate) fn write_note(&self, stamp: Stamp, text: &str) {
        if let Some(recorder) = &self.recorder {
            recorder.note(stamp, text);
        }
    }

    /// Writes the pending cycles and closes the log.
    pub(crate) fn finish(mut self) -> FinishedLog {
        let error = self.close_file();
        FinishedLog {
            summary: self.summary,
            error,
        }
    }

    /// Closes the current file and returns the error, if any. A file without cycles is removed.
    fn close_file(&mut self) -> Option<String> {
        let recorder = self.recorder.take()?;
        let flushed_cycles = recorder.flushed_cycles();
        match recorder.finish() {
            Ok(written) => {
                self.summary.cycles += written.cycles;
                self.summary.images += written.images;
                self.summary.cycles_dropped += written.dropped.cycles;
                self.summary.images_dropped += written.dropped.images;
                None
            }
            Err(error) => {
                self.summary.cycles += flushed_cycles;
                if flushed_cycles == 0
                    && let Some(path) = self.summary.files.pop()
                {
                    let _gone = std::fs::remove_file(path);
                }
                Some(format!("cannot close the log: {error:#}"))
            }
        }
    }

    fn open_next_file(&mut self) -> Option<String> {
        let path = match self.summary.files.len() {
            0 => self.path.clone(),
            files => numbered(&self.path, files + 1),
        };
        match Recorder::create_with(
            &path,
            &self.header,
            &self.field,
            (Pace::Live, &self.config),
            lower_priority,
        ) {
            Ok(recorder) => {
                self.recorder = Some(recorder);
                self.summary.files.push(path.clone());
                Some(format!("the log continues in {}", path.display()))
            }
            Err(_) => {
                // The file has no complete header. The failure has been reported before.
                let _gone = std::fs::remove_file(&path);
                None
            }
        }
    }
}

/// game.mcap, game.2.mcap, game.3.mcap...
fn numbered(path: &Path, number: usize) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let end = path
        .extension()
        .map_or_else(String::new, |end| format!(".{}", end.to_string_lossy()));
    path.with_file_name(format!("{stem}.{number}{end}"))
}
