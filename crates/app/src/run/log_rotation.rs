//! How does the log outlive its disk? A log that cannot be written costs a word; another is begun as soon as there is room.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use hw::realtime::lower_priority;
use localize::{Field, Stamp};
use serde::Serialize;

use pipeline::Cycle;
use pipeline::feed::Pace;
use pipeline::log::{Header, LogConfig, Recorder};

/// Time between attempts to begin a log after one failed, seconds.
const RETRY_PERIOD: f64 = 0.5;

/// What became of the logs of a run.
#[derive(Debug, Clone, Default, Serialize)]
pub struct LogSummary {
    /// The files, in order; more than one after a disk was full.
    pub files: Vec<PathBuf>,
    /// Cycles written.
    pub cycles: u64,
    /// Images written.
    pub images: u64,
    /// Cycles that a slow or full disk cost.
    pub cycles_dropped: u64,
    /// Images that a slow disk cost.
    pub images_dropped: u64,
}

/// Keeps the log of a run.
pub struct LogRotation {
    path: PathBuf,
    header: Header,
    field: Field,
    config: LogConfig,
    recorder: Option<Recorder>,
    next_attempt: Stamp,
    summary: LogSummary,
}

impl LogRotation {
    /// Begins the log; that it cannot be begun is an error here, and none later.
    pub fn start(
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

    /// Takes a cycle; returns what there is to say: that the log failed, or that another was begun.
    pub fn write_cycle(&mut self, cycle: Arc<Cycle>) -> Option<String> {
        let now = hw::now();
        let mut said = None;
        if self.recorder.is_none() && now > self.next_attempt {
            self.next_attempt = now + RETRY_PERIOD;
            said = self.open_next_file();
        }
        let Some(recorder) = &mut self.recorder else {
            self.summary.cycles_dropped += 1;
            return said;
        };
        if let Err(error) = recorder.record_cycle(cycle) {
            self.summary.cycles_dropped += 1;
            self.close_file();
            self.next_attempt = now + RETRY_PERIOD;
            return Some(format!(
                "the log cannot be written, the robot plays on: {error:#}"
            ));
        }
        said
    }

    /// A line for people into the log.
    pub fn write_note(&self, stamp: Stamp, text: &str) {
        if let Some(recorder) = &self.recorder {
            recorder.note(stamp, text);
        }
    }

    /// Writes what waits and closes the log; an error that only shows now is said.
    pub fn finish(mut self) -> (LogSummary, Option<String>) {
        let said = self.close_file();
        (self.summary, said)
    }

    /// Ends the log that is written now, as far as it can be; one that holds nothing is taken away again.
    fn close_file(&mut self) -> Option<String> {
        let recorder = self.recorder.take()?;
        let safe = recorder.flushed_cycles();
        match recorder.finish() {
            Ok(written) => {
                self.summary.cycles += written.cycles;
                self.summary.images += written.images;
                self.summary.cycles_dropped += written.dropped.cycles;
                self.summary.images_dropped += written.dropped.images;
                None
            }
            Err(error) => {
                self.summary.cycles += safe;
                if safe == 0
                    && let Some(path) = self.summary.files.pop()
                {
                    let _gone = std::fs::remove_file(path);
                }
                Some(format!("the log was not closed: {error:#}"))
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
                Some(format!("the log goes on in {}", path.display()))
            }
            Err(_) => {
                // A header that did not fit is no log; that there is no room was said before.
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
