//! What goes on right now? The last seconds of a live source, so that one may pause and step back.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use super::Shown;
use super::remote::Lease;
use super::worker::SimWorker;

/// Cycles that may wait for the view to draw; beyond it the oldest goes.
const WAITING: usize = 32;
/// Cycles that are kept to step back in.
const KEPT: usize = 1800;
/// Of these the newest keep their images: about 140 MB at 480 × 480 pixels.
const KEPT_IMAGES: usize = 200;

/// Between the thread that drives and the view: the driving side never waits.
#[derive(Clone, Default)]
pub(crate) struct Inbox(Arc<Mutex<Waiting>>);

#[derive(Default)]
struct Waiting {
    cycles: VecDeque<Shown>,
    dropped: u64,
    word: Option<String>,
    wake: Option<Box<dyn Fn() + Send>>,
}

impl Inbox {
    /// Hands over a cycle; the oldest one goes if the view does not keep up.
    pub(crate) fn put(&self, shown: Shown) {
        let mut waiting = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if waiting.cycles.len() >= WAITING {
            waiting.cycles.pop_front();
            waiting.dropped += 1;
        }
        waiting.cycles.push_back(shown);
        if let Some(wake) = &waiting.wake {
            wake();
        }
    }

    /// Says what became of the source; none: it is well.
    pub(crate) fn say(&self, word: Option<String>) {
        let mut waiting = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        waiting.word = word;
        if let Some(wake) = &waiting.wake {
            wake();
        }
    }

    /// Calls `wake` whenever a cycle comes.
    pub(crate) fn on_cycle(&self, wake: impl Fn() + Send + 'static) {
        let mut waiting = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        waiting.wake = Some(Box::new(wake));
    }

    /// Everything that waits, how many were dropped since the last call, and what became of the source.
    fn take(&self) -> (VecDeque<Shown>, u64, Option<String>) {
        let mut waiting = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let dropped = std::mem::take(&mut waiting.dropped);
        let word = waiting.word.clone();
        (std::mem::take(&mut waiting.cycles), dropped, word)
    }
}

/// A live source and its last seconds.
pub(crate) struct Live {
    inbox: Inbox,
    worker: Option<SimWorker>,
    kept: VecDeque<Shown>,
    /// Which of the kept ones is shown.
    place: usize,
    /// What became of the source, if it is not well.
    pub(crate) word: Option<String>,
    _lease: Option<(Lease, Option<tempfile::TempDir>)>,
}

impl Live {
    /// `worker`: the simulation behind it, if it is the view's own.
    pub(crate) fn new(inbox: Inbox, worker: Option<SimWorker>) -> Self {
        Live {
            inbox,
            worker,
            kept: VecDeque::new(),
            place: 0,
            word: None,
            _lease: None,
        }
    }

    /// The same, with what must live as long: a thread's lease, and the files of a robot elsewhere.
    pub(crate) fn with_lease(self, lease: Lease, folder: Option<tempfile::TempDir>) -> Self {
        Live {
            _lease: Some((lease, folder)),
            ..self
        }
    }

    /// The simulation behind it.
    pub(crate) fn worker(&self) -> Option<&SimWorker> {
        self.worker.as_ref()
    }

    /// Where its cycles come in.
    pub(crate) fn inbox(&self) -> &Inbox {
        &self.inbox
    }

    /// Takes what came; returns it with the number of cycles that were dropped.
    pub(crate) fn poll(&mut self) -> (Vec<Shown>, u64) {
        let (came, dropped, word) = self.inbox.take();
        self.word = word;
        let came: Vec<Shown> = came.into();
        for shown in &came {
            // A clock that was set back belongs to another run.
            if (self.kept.back()).is_some_and(|last| last.cycle.stamp >= shown.cycle.stamp) {
                self.kept.clear();
                self.place = 0;
            }
            self.kept.push_back(shown.clone());
        }
        while self.kept.len() > KEPT {
            self.kept.pop_front();
            self.place = self.place.saturating_sub(1);
        }
        let old = self.kept.len().saturating_sub(KEPT_IMAGES);
        for shown in self.kept.iter_mut().take(old).rev() {
            if shown.cycle.inputs.image.is_none() {
                break;
            }
            Arc::make_mut(&mut shown.cycle).inputs.image = None;
        }
        (came, dropped)
    }

    /// The newest cycle.
    pub(crate) fn newest(&mut self) -> Option<Shown> {
        self.place = self.kept.len().saturating_sub(1);
        self.kept.back().cloned()
    }

    /// What is kept, seconds.
    pub(crate) fn span(&self) -> Option<(f64, f64)> {
        let (first, last) = (self.kept.front()?, self.kept.back()?);
        Some((first.cycle.stamp.seconds(), last.cycle.stamp.seconds()))
    }

    /// The last kept cycle at or before a time, else the first.
    pub(crate) fn seek(&mut self, time: f64) -> Option<Shown> {
        let behind = self
            .kept
            .partition_point(|shown| shown.cycle.stamp.seconds() <= time);
        self.place = behind.saturating_sub(1);
        self.kept.get(self.place).cloned()
    }

    /// So many kept cycles on or back.
    pub(crate) fn step(&mut self, by: i64) -> Option<Shown> {
        let place = self.place as i64 + by;
        let place = usize::try_from(place).ok()?;
        let shown = self.kept.get(place).cloned()?;
        self.place = place;
        Some(shown)
    }
}
