//! What does the log show at this moment? A few of its chunks in memory, whatever its length.

use std::collections::VecDeque;
use std::sync::Arc;

use anyhow::{Context, Result};
use localize::Stamp;

use super::DecodedCycle;
use pipeline::log::{LogIndex, LoggedCycle};
use pipeline::setup::Setup;

/// Chunks kept unpacked: about a megabyte each.
const CACHED_CHUNKS: usize = 8;
/// A moment's cycle is sought in so many chunks before and behind; images alone may fill some.
const SEEK_CHUNKS: usize = 64;

/// Plays a log.
pub(crate) struct LogPlayer {
    index: Arc<LogIndex>,
    chunk_cache: VecDeque<(usize, Arc<Vec<LoggedCycle>>)>,
    /// Chunk, and cycle in it.
    place: Option<(usize, usize)>,
    /// What was shown last, and its place.
    last_decoded: Option<((usize, usize), DecodedCycle)>,
    /// The log's files.
    folder: Option<tempfile::TempDir>,
}

impl LogPlayer {
    /// Nothing is read yet but the index.
    pub(crate) fn new(index: LogIndex) -> Self {
        LogPlayer {
            index: Arc::new(index),
            chunk_cache: VecDeque::new(),
            place: None,
            last_decoded: None,
            folder: None,
        }
    }

    /// The log.
    pub(crate) fn index(&self) -> &Arc<LogIndex> {
        &self.index
    }

    /// From the first to the last message, seconds.
    pub(crate) fn span(&self) -> (f64, f64) {
        let (start, stop) = self.index.span();
        (start.seconds(), stop.seconds())
    }

    /// The robot that the log was made with, from the files it carries.
    ///
    /// Its paths lead to a folder that lives as long as the player.
    pub(crate) fn load_setup(&mut self) -> Result<Setup> {
        let folder = tempfile::tempdir().context("no room for the log's files")?;
        self.index.header().write_files(folder.path())?;
        let setup = Setup::load(&folder.path().join("robot.toml"), None);
        self.folder = Some(folder);
        setup
    }

    /// The last cycle at or before a time, else the first one.
    pub(crate) fn seek(&mut self, time: f64) -> Result<Option<DecodedCycle>> {
        let wanted = Stamp::from_seconds(time);
        let first = self.index.chunk_at(wanted);
        for part in (first.saturating_sub(SEEK_CHUNKS)..=first).rev() {
            let cycles = self.chunk(part)?;
            let behind = cycles.partition_point(|logged| logged.cycle.stamp <= wanted);
            if let Some(place) = behind.checked_sub(1) {
                self.place = Some((part, place));
                return self.decode_current();
            }
        }
        for part in first..self.index.chunks().len().min(first + SEEK_CHUNKS) {
            if !self.chunk(part)?.is_empty() {
                self.place = Some((part, 0));
                return self.decode_current();
            }
        }
        Ok(None)
    }

    /// So many cycles on or back; at an end the place stays.
    pub(crate) fn step(&mut self, by: i64) -> Result<Option<DecodedCycle>> {
        let Some((mut part, place)) = self.place else {
            return self.seek(self.span().0);
        };
        let mut place = place as i64 + by;
        loop {
            let held = self.chunk(part)?.len() as i64;
            if place < 0 {
                let Some(before) = part.checked_sub(1) else {
                    return Ok(None);
                };
                part = before;
                place += self.chunk(part)?.len() as i64;
            } else if place >= held {
                if part + 1 >= self.index.chunks().len() {
                    return Ok(None);
                }
                place -= held;
                part += 1;
            } else {
                self.place = Some((part, place as usize));
                return self.decode_current();
            }
        }
    }

    fn decode_current(&mut self) -> Result<Option<DecodedCycle>> {
        let Some((part, place)) = self.place else {
            return Ok(None);
        };
        if let Some((_, shown)) = self
            .last_decoded
            .as_ref()
            .filter(|(at, _)| *at == (part, place))
        {
            return Ok(Some(shown.clone()));
        }
        let cycles = self.chunk(part)?;
        let Some(logged) = cycles.get(place) else {
            return Ok(None);
        };
        let mut cycle = logged.cycle.clone();
        if let Some(image) = &logged.image {
            cycle.inputs.image = Some(image.decode()?.into());
        }
        let shown = DecodedCycle {
            cycle: Arc::new(cycle),
            particles: Vec::new(),
        };
        self.last_decoded = Some(((part, place), shown.clone()));
        Ok(Some(shown))
    }

    fn chunk(&mut self, part: usize) -> Result<Arc<Vec<LoggedCycle>>> {
        if let Some((_, cycles)) = self.chunk_cache.iter().find(|(kept, _)| *kept == part) {
            return Ok(cycles.clone());
        }
        let cycles = Arc::new(self.index.load(part)?);
        if self.chunk_cache.len() >= CACHED_CHUNKS {
            self.chunk_cache.pop_front();
        }
        self.chunk_cache.push_back((part, cycles.clone()));
        Ok(cycles)
    }
}
