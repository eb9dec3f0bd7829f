//! Plays a log of any length with a few of its chunks in memory.

use std::collections::VecDeque;
use std::sync::Arc;

use anyhow::Result;
use localize::Stamp;

use super::decoded_cycle::DecodedCycle;
use super::image_prefetch::ImagePrefetch;
use pipeline::Cycle;
use pipeline::log::{LogIndex, LoggedCycle, UnpackedSetup};
use pipeline::setup::Setup;

/// Decoded chunks kept in memory: about 1 MB each.
const CACHED_CHUNKS: usize = 8;
/// Chunks searched for a cycle in each direction; some may hold images only.
const SEEK_CHUNKS: usize = 64;

/// A log, and the cycle it shows.
pub(crate) struct LogPlayer {
    index: Arc<LogIndex>,
    chunk_cache: VecDeque<(usize, Arc<Vec<LoggedCycle>>)>,
    /// Shown cycle: its chunk, and its index in the chunk.
    place: Option<(usize, usize)>,
    /// The cycle decoded last, and its position.
    last_decoded: Option<((usize, usize), DecodedCycle)>,
    /// The cycle returned last without its image.
    last_cycle: Option<Arc<Cycle>>,
    /// None if its thread cannot start: images are decoded when they are shown.
    prefetch: Option<ImagePrefetch>,
    /// Temporary folder with the files that the log carries.
    folder: Option<tempfile::TempDir>,
}

impl LogPlayer {
    /// Creates a player; only the index has been read.
    pub(crate) fn new(index: LogIndex) -> Self {
        LogPlayer {
            index: Arc::new(index),
            chunk_cache: VecDeque::new(),
            place: None,
            last_decoded: None,
            last_cycle: None,
            prefetch: ImagePrefetch::start().ok(),
            folder: None,
        }
    }

    /// Index of the log.
    pub(crate) fn index(&self) -> &Arc<LogIndex> {
        &self.index
    }

    /// Times of the first and last message, seconds.
    pub(crate) fn span(&self) -> (f64, f64) {
        let (start, stop) = self.index.span();
        (start.seconds(), stop.seconds())
    }

    /// Loads the robot's setup from the files in the log.
    ///
    /// Its paths point into a temporary folder that lives as long as the player.
    pub(crate) fn load_setup(&mut self) -> Result<Setup> {
        let UnpackedSetup { setup, folder } = UnpackedSetup::load(self.index.header())?;
        self.folder = Some(folder);
        Ok(setup)
    }

    /// The last cycle at or before a time, else the first one after it.
    pub(crate) fn seek(&mut self, time: f64) -> Result<Option<DecodedCycle>> {
        let stamp = Stamp::from_seconds(time);
        let first = self.index.chunk_at(stamp);
        for part in (first.saturating_sub(SEEK_CHUNKS)..=first).rev() {
            let cycles = self.chunk(part)?;
            let later = cycles.partition_point(|logged| logged.cycle.stamp <= stamp);
            if let Some(place) = later.checked_sub(1) {
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

    /// The first cycle that can be read, of a log whose start is damaged.
    pub(crate) fn first_readable(&mut self) -> Result<Option<DecodedCycle>> {
        for part in 0..self.index.chunks().len().min(SEEK_CHUNKS) {
            if self.chunk(part).is_ok_and(|cycles| !cycles.is_empty()) {
                self.place = Some((part, 0));
                return self.decode_current();
            }
        }
        Ok(None)
    }

    /// The last cycle at or before a time, without its image; None before the first one and after the end of the log.
    pub(crate) fn cycle_at(&mut self, time: f64) -> Result<Option<Arc<Cycle>>> {
        let (stamp, (_, end)) = (Stamp::from_seconds(time), self.index.span());
        if stamp > end {
            return Ok(None);
        }
        let first = self.index.chunk_at(stamp);
        for part in (first.saturating_sub(SEEK_CHUNKS)..=first).rev() {
            let cycles = self.chunk(part)?;
            let later = cycles.partition_point(|logged| logged.cycle.stamp <= stamp);
            let Some(place) = later.checked_sub(1) else {
                continue;
            };
            let found = &cycles[place].cycle;
            let known = self.last_cycle.as_ref();
            let known = known.filter(|known| known.stamp == found.stamp).cloned();
            let cycle = known.unwrap_or_else(|| Arc::new(found.clone()));
            self.last_cycle = Some(cycle.clone());
            return Ok(Some(cycle));
        }
        Ok(None)
    }

    /// The cycle `by` cycles later (negative: earlier); None beyond either end.
    pub(crate) fn step(&mut self, by: i64) -> Result<Option<DecodedCycle>> {
        let Some((mut part, place)) = self.place else {
            return self.seek(self.span().0);
        };
        let mut place = place as i64 + by;
        loop {
            let count = self.chunk(part)?.len() as i64;
            if place < 0 {
                let Some(previous) = part.checked_sub(1) else {
                    return Ok(None);
                };
                part = previous;
                place += self.chunk(part)?.len() as i64;
            } else if place >= count {
                if part + 1 >= self.index.chunks().len() {
                    return Ok(None);
                }
                place -= count;
                part += 1;
            } else {
                self.place = Some((part, place as usize));
                return self.decode_current();
            }
        }
    }

    /// Visits the cycles after `from`, up to and including `to`.
    pub(crate) fn visit_cycles(
        &mut self,
        from: Stamp,
        to: Stamp,
        mut visit: impl FnMut(&Cycle),
    ) -> Result<()> {
        for part in self.index.chunk_at(from)..=self.index.chunk_at(to) {
            for logged in &*self.chunk(part)? {
                if logged.cycle.stamp > from && logged.cycle.stamp <= to {
                    visit(&logged.cycle);
                }
            }
        }
        Ok(())
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
            let decoded = self.prefetch.as_mut();
            let decoded = decoded.and_then(|prefetch| prefetch.take(cycle.stamp));
            let decoded = decoded.unwrap_or_else(|| image.decode())?;
            cycle.inputs.image = Some(decoded.into());
        }
        // A view that skips cycles would decode images in vain.
        let follows = self.last_decoded.as_ref().map(|(at, _)| *at);
        let follows = place > 0 && follows == Some((part, place - 1));
        if let (true, Some(next), Some(prefetch)) =
            (follows, cycles.get(place + 1), &mut self.prefetch)
            && let Some(image) = &next.image
        {
            prefetch.request(next.cycle.stamp, image);
        }
        let shown = DecodedCycle {
            cycle: Arc::new(cycle),
            particles: Vec::new(),
        };
        self.last_decoded = Some(((part, place), shown.clone()));
        Ok(Some(shown))
    }

    fn chunk(&mut self, part: usize) -> Result<Arc<Vec<LoggedCycle>>> {
        if let Some((_, cycles)) = self.chunk_cache.iter().find(|(cached, _)| *cached == part) {
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
