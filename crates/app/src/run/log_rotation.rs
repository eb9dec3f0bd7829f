//! What happens when the disk is full, or somebody removes the log? It ends with a message, and a new file starts as soon as there is space.
//!
//! A thread of its own closes the failed file and opens the next, because both can take long on a bad disk.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::Context;
use localize::{Field, Stamp};
use serde::Serialize;

use pipeline::Cycle;
use pipeline::feed::Pace;
use pipeline::log::{Header, LogConfig, LogStats, Recorder};

/// Shortest and longest time between attempts to start a new log. It doubles with each failure.
const RETRY_PERIODS: [Duration; 2] = [Duration::from_millis(500), Duration::from_secs(30)];
/// Time between looks at whether the file is still there.
const LOOK_PERIOD: Duration = Duration::from_secs(2);
/// Time after which a waiting thread notices the end of the run.
const CANCEL_PERIOD: Duration = Duration::from_millis(50);
/// Largest number behind a log's name.
const NUMBER_MAX: u32 = 9999;

/// Statistics of the logs of a run.
#[derive(Debug, Clone, Default, Serialize)]
pub(crate) struct LogSummary {
    /// The files, in order; more than one if the disk was full.
    pub files: Vec<PathBuf>,
    /// Cycles written.
    pub cycles: u64,
    /// Images written.
    pub images: u64,
    /// Cycles that are in none of the files: lost to a slow or full disk.
    pub cycles_dropped: u64,
    /// Images lost to a slow disk.
    pub images_dropped: u64,
    /// When the first cycle was lost to a full or failing disk, or to a removed file; seconds of the run.
    pub incomplete_since_s: Option<f64>,
}

impl LogSummary {
    /// What is missing in the log, in a sentence. None if it is complete.
    pub(crate) fn gap(&self) -> Option<String> {
        let (lost, all) = (self.cycles_dropped, self.cycles + self.cycles_dropped);
        let when = match self.incomplete_since_s {
            Some(since) => format!("the first at {since:.1} s of the run"),
            None => "because the disk was slow".to_owned(),
        };
        (lost > 0 && !self.files.is_empty())
            .then(|| format!("the log is incomplete: {lost} of {all} cycles are not in it, {when}"))
    }
}

/// The logs of a run after its end.
pub(crate) struct FinishedLog {
    /// Files and counts.
    pub summary: LogSummary,
    /// Why the last file could not be closed.
    pub error: Option<String>,
    /// The last file, if somebody moved or removed it, perhaps with its folder, before it was closed.
    removed: Option<PathBuf>,
}

impl FinishedLog {
    /// Why there is no log. None if there is one.
    pub(crate) fn loss(&self) -> Option<String> {
        if let Some(path) = &self.removed {
            return Some(format!(
                "{}: the log was moved or removed while it was written",
                path.display()
            ));
        }
        let error = self.error.as_deref();
        let is_lost = self.summary.files.is_empty();
        is_lost.then(|| {
            error
                .unwrap_or("the disk had no space for a log")
                .to_owned()
        })
    }
}

/// Writes the log of a run, in a new file after a failure.
pub(crate) struct LogRotation {
    plan: Arc<LogPlan>,
    state: State,
    retry_period: Duration,
    summary: LogSummary,
    started: Stamp,
    /// Number of cycles of the run.
    cycles: u64,
    /// When the present file was last seen.
    looked: Instant,
    /// The log continues another, and no cycle of it holds the state that replay needs.
    needs_state: bool,
}

/// Where and how a log is started.
struct LogPlan {
    path: PathBuf,
    header: Header,
    field: Field,
    config: LogConfig,
    /// Sets the priority of the threads that write.
    set_priority: fn(),
    /// True at the end of the run: no new file is started.
    cancelled: AtomicBool,
}

enum State {
    Writing(Recorder),
    /// A thread closes the failed file and starts the next one. The number is that of the next cycle.
    Reopening(JoinHandle<Reopened>, u64),
    Ended,
}

/// Result of closing a file and starting the next.
struct Reopened {
    closed: ClosedFile,
    /// None if the run ended first.
    next: Option<(Recorder, PathBuf)>,
    /// Time to wait before the next attempt, should this file fail too.
    retry_period: Duration,
}

/// Result of closing a file.
#[derive(Default)]
struct ClosedFile {
    stats: LogStats,
    error: Option<String>,
    /// True if the file held no cycle and was removed.
    removed: bool,
}

impl LogRotation {
    /// Images that may wait for the writer.
    pub(crate) fn queue_images(&self) -> usize {
        self.plan.config.queue_images
    }

    /// Starts the log, under the next free name if `path` exists. Only here a failure is an error; later it is a message.
    pub(crate) fn start(
        path: &Path,
        header: Header,
        field: &Field,
        (config, set_priority): (&LogConfig, fn()),
    ) -> anyhow::Result<Self> {
        let context = || format!("cannot write {}", path.display());
        let is_stream = path.exists() && !path.is_file();
        let first = if is_stream {
            path.to_owned()
        } else {
            create_free(path, 1).with_context(context)?
        };
        let how = (Pace::Live, config);
        let recorder = Recorder::create_with(&first, &header, field, how, set_priority)
            .inspect_err(|_reported| {
                if !is_stream {
                    let _gone = std::fs::remove_file(&first);
                }
            })?;
        Ok(LogRotation {
            plan: Arc::new(LogPlan {
                path: path.to_owned(),
                header,
                field: field.clone(),
                config: config.clone(),
                set_priority,
                cancelled: AtomicBool::new(false),
            }),
            state: State::Writing(recorder),
            retry_period: RETRY_PERIODS[0],
            summary: LogSummary {
                files: vec![first],
                ..LogSummary::default()
            },
            started: hw::now(),
            cycles: 0,
            looked: Instant::now(),
            needs_state: false,
        })
    }

    /// The file in which the log starts.
    pub(crate) fn first_file(&self) -> Option<&Path> {
        self.summary.files.first().map(PathBuf::as_path)
    }

    /// True if the log continues another one and holds no state yet from which its estimates can be computed again.
    pub(crate) fn needs_state(&self) -> bool {
        self.needs_state && matches!(self.state, State::Writing(_))
    }

    /// Writes a cycle. Returns a message if the log failed or a new one started.
    pub(crate) fn write_cycle(&mut self, cycle: Arc<Cycle>) -> Option<String> {
        let message = self.take_reopened().or_else(|| self.leave_lost_file());
        self.cycles += 1;
        let stamp = cycle.stamp;
        let holds_state = cycle.inputs.warm_start.is_some();
        match &mut self.state {
            State::Writing(recorder) => {
                let Err(error) = recorder.record_cycle(cycle) else {
                    self.needs_state &= !holds_state;
                    return message;
                };
                self.note_loss(stamp);
                self.reopen();
                Some(format!(
                    "cannot write the log: {error:#}. The run continues without it"
                ))
            }
            State::Reopening(_, next_index) => {
                *next_index += 1;
                self.note_loss(stamp);
                message
            }
            State::Ended => {
                self.note_loss(stamp);
                message
            }
        }
    }

    /// Notes the first cycle that is in no file.
    fn note_loss(&mut self, stamp: Stamp) {
        let since = stamp - self.started;
        let known = &mut self.summary.incomplete_since_s;
        *known = Some(known.map_or(since, |known| known.min(since)));
    }

    /// Writes a text message into the log.
    pub(crate) fn write_note(&self, stamp: Stamp, text: &str) {
        if let State::Writing(recorder) = &self.state {
            recorder.note(stamp, text);
        }
    }

    /// Writes the pending cycles and closes the log.
    pub(crate) fn finish(mut self) -> FinishedLog {
        self.plan.cancelled.store(true, Ordering::Relaxed);
        let mut error = None;
        match std::mem::replace(&mut self.state, State::Ended) {
            State::Writing(recorder) => {
                let path = self.summary.files.last().cloned().unwrap_or_default();
                let closed = close_file(recorder, &path);
                error = self.count_closed(closed);
            }
            State::Reopening(thread, _) => {
                if let Ok(reopened) = thread.join() {
                    error = self.count_closed(reopened.closed);
                    if let Some((recorder, path)) = reopened.next {
                        // Started, but without a cycle.
                        self.summary.files.push(path.clone());
                        let closed = close_file(recorder, &path);
                        error = error.or(self.count_closed(closed));
                    }
                }
            }
            State::Ended => {}
        }
        self.summary.cycles_dropped = self.cycles.saturating_sub(self.summary.cycles);
        let files = &mut self.summary.files;
        let removed = files.pop_if(|last| !last.exists());
        FinishedLog {
            summary: self.summary,
            error,
            removed,
        }
    }

    /// Goes on in a new file if somebody moved or removed the present one, perhaps with its folder. Returns a message then.
    fn leave_lost_file(&mut self) -> Option<String> {
        if self.looked.elapsed() < LOOK_PERIOD || !matches!(self.state, State::Writing(_)) {
            return None;
        }
        self.looked = Instant::now();
        let path = self.summary.files.last().filter(|path| !path.exists())?;
        let message = format!("{}: the log was moved or removed", path.display());
        self.reopen();
        Some(message)
    }

    /// Closes the failed file and starts the next one, in a thread of its own.
    fn reopen(&mut self) {
        let State::Writing(recorder) = std::mem::replace(&mut self.state, State::Ended) else {
            return;
        };
        let next_index = recorder.next_index();
        let plan = self.plan.clone();
        let path = self.summary.files.last().cloned().unwrap_or_default();
        let waited = self.retry_period;
        let thread = std::thread::Builder::new()
            .name("log-reopen".to_owned())
            .spawn(move || {
                (plan.set_priority)();
                let closed = close_file(recorder, &path);
                // A file that held cycles shows that there was space.
                let first = if closed.removed {
                    waited
                } else {
                    RETRY_PERIODS[0]
                };
                let (next, retry_period) = open_next_file(&plan, first, &path);
                Reopened {
                    closed,
                    next,
                    retry_period,
                }
            });
        if let Ok(thread) = thread {
            self.state = State::Reopening(thread, next_index);
        }
    }

    /// Goes on in the next file if it has been started. Returns a message then.
    fn take_reopened(&mut self) -> Option<String> {
        if !matches!(&self.state, State::Reopening(thread, _) if thread.is_finished()) {
            return None;
        }
        let State::Reopening(thread, next_index) = std::mem::replace(&mut self.state, State::Ended)
        else {
            return None;
        };
        let reopened = thread.join().ok()?;
        let removed = reopened.closed.removed;
        let error = self.count_closed(reopened.closed).filter(|_| removed);
        self.retry_period = reopened.retry_period;
        let (mut recorder, path) = reopened.next?;
        recorder.set_next_index(next_index);
        self.needs_state = true;
        self.state = State::Writing(recorder);
        let removed = error.map_or_else(String::new, |error| format!("{error}; "));
        let message = format!("{removed}the log continues in {}", path.display());
        self.summary.files.push(path);
        Some(message)
    }

    /// Adds the counts of a closed file. Returns its error, if any.
    fn count_closed(&mut self, closed: ClosedFile) -> Option<String> {
        if closed.removed {
            self.summary.files.pop();
        }
        self.summary.cycles += closed.stats.cycles;
        self.summary.images += closed.stats.images;
        self.summary.images_dropped += closed.stats.dropped.images;
        if let Some(stamp) = closed.stats.lost_from {
            self.note_loss(stamp);
        }
        closed.error
    }
}

/// Closes a file of this run. Removes it if a reader would find no cycle in it.
fn close_file(recorder: Recorder, path: &Path) -> ClosedFile {
    let (stats, closed) = recorder.finish_live();
    let Err(error) = closed else {
        return ClosedFile {
            stats,
            ..ClosedFile::default()
        };
    };
    let removed = stats.cycles == 0;
    if removed {
        let _gone = std::fs::remove_file(path);
    }
    ClosedFile {
        stats,
        error: Some(if removed {
            format!(
                "{} was removed, because the disk was full before it held a cycle: {error:#}",
                path.display()
            )
        } else {
            format!("cannot close the log: {error:#}")
        }),
        removed,
    }
}

/// Starts the next file as soon as the disk has space. Returns it with the period for the next attempt.
///
/// The file has a name that was free, so that files of earlier runs are never touched.
fn open_next_file(
    plan: &LogPlan,
    mut period: Duration,
    previous: &Path,
) -> (Option<(Recorder, PathBuf)>, Duration) {
    let previous = previous.file_name().unwrap_or_default().to_string_lossy();
    let header = plan.header.clone().continuing(&previous);
    loop {
        let mut waited = Duration::ZERO;
        while waited < period && !plan.cancelled.load(Ordering::Relaxed) {
            std::thread::sleep(CANCEL_PERIOD);
            waited += CANCEL_PERIOD;
        }
        if plan.cancelled.load(Ordering::Relaxed) {
            return (None, period);
        }
        period = (2 * period).min(RETRY_PERIODS[1]);
        let Ok(path) = create_free(&plan.path, 2) else {
            continue;
        };
        let how = (Pace::Live, &plan.config);
        match Recorder::create_with(&path, &header, &plan.field, how, || ()) {
            Ok(recorder) => return (Some((recorder, path)), period),
            Err(_) => {
                // It is this run's own, without a complete header. The failure has been reported before.
                let _gone = std::fs::remove_file(&path);
            }
        }
    }
}

/// Creates game.mcap, game.2.mcap, game.3.mcap, …: the first name from the number `first` on that is free.
fn create_free(path: &Path, first: u32) -> std::io::Result<PathBuf> {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let end = path
        .extension()
        .map_or_else(String::new, |end| format!(".{}", end.to_string_lossy()));
    for number in first..=NUMBER_MAX {
        let path = match number {
            1 => path.to_owned(),
            _ => path.with_file_name(format!("{stem}.{number}{end}")),
        };
        match std::fs::File::create_new(&path) {
            Ok(_) => return Ok(path),
            Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => {}
            Err(error) => return Err(error),
        }
    }
    Err(std::io::Error::other("too many logs of this name"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn log_takes_a_free_name_and_leaves_other_files_alone() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("game.mcap");
        assert_eq!(create_free(&path, 1).expect("a file"), path);
        std::fs::write(&path, "of an earlier run").expect("written");
        let second = folder.path().join("game.2.mcap");
        std::fs::write(&second, "of another one").expect("written");
        let next = create_free(&path, 1).expect("a file");
        assert_eq!(next, folder.path().join("game.3.mcap"));
        assert_eq!(std::fs::read(&path).expect("there"), b"of an earlier run");
        assert_eq!(std::fs::read(&second).expect("there"), b"of another one");
        create_free(&folder.path().join("none/game.mcap"), 1).expect_err("no folder");
    }
}
