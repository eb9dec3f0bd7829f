//! What goes on right now? The last seconds of a live source, so that one may pause and step back.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use super::DecodedCycle;
use super::remote::StopGuard;
use super::sim_worker::SimWorker;

/// Cycles that may wait for the view to draw; beyond it the oldest goes.
const INBOX_CAPACITY: usize = 32;
/// Cycles that are kept to step back in.
const HISTORY_CAPACITY: usize = 1800;
/// Of these the newest keep their images: about 140 MB at 480 × 480 pixels.
const HISTORY_IMAGES: usize = 200;

/// Between the thread that drives and the view: the driving side never waits.
#[derive(Clone, Default)]
pub(crate) struct CycleInbox(Arc<Mutex<InboxState>>);

#[derive(Default)]
struct InboxState {
    cycles: VecDeque<DecodedCycle>,
    dropped: u64,
    status: Option<String>,
    on_cycle: Option<Box<dyn Fn() + Send>>,
}

impl CycleInbox {
    /// Hands over a cycle; the oldest one goes if the view does not keep up.
    pub(crate) fn push(&self, shown: DecodedCycle) {
        let mut waiting = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if waiting.cycles.len() >= INBOX_CAPACITY {
            waiting.cycles.pop_front();
            waiting.dropped += 1;
        }
        waiting.cycles.push_back(shown);
        if let Some(wake) = &waiting.on_cycle {
            wake();
        }
    }

    /// Says what became of the source; none: it is well.
    pub(crate) fn set_status(&self, word: Option<String>) {
        let mut waiting = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        waiting.status = word;
        if let Some(wake) = &waiting.on_cycle {
            wake();
        }
    }

    /// Calls `wake` whenever a cycle comes.
    pub(crate) fn set_on_cycle(&self, wake: impl Fn() + Send + 'static) {
        let mut waiting = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        waiting.on_cycle = Some(Box::new(wake));
    }

    /// Everything that waits, how many were dropped since the last call, and what became of the source.
    fn drain(&self) -> (VecDeque<DecodedCycle>, u64, Option<String>) {
        let mut waiting = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let dropped = std::mem::take(&mut waiting.dropped);
        let word = waiting.status.clone();
        (std::mem::take(&mut waiting.cycles), dropped, word)
    }
}

/// A live source and its last seconds.
pub(crate) struct LiveSource {
    inbox: CycleInbox,
    worker: Option<SimWorker>,
    history: VecDeque<DecodedCycle>,
    /// Which of the kept ones is shown.
    place: usize,
    /// What became of the source, if it is not well.
    pub(crate) status: Option<String>,
    _guard: Option<(StopGuard, Option<tempfile::TempDir>)>,
}

impl LiveSource {
    /// `worker`: the simulation behind it, if it is the view's own.
    pub(crate) fn new(inbox: CycleInbox, worker: Option<SimWorker>) -> Self {
        LiveSource {
            inbox,
            worker,
            history: VecDeque::new(),
            place: 0,
            status: None,
            _guard: None,
        }
    }

    /// The same, with what must live as long: a thread's lease, and the files of a robot elsewhere.
    pub(crate) fn with_guard(self, lease: StopGuard, folder: Option<tempfile::TempDir>) -> Self {
        LiveSource {
            _guard: Some((lease, folder)),
            ..self
        }
    }

    /// The simulation behind it.
    pub(crate) fn worker(&self) -> Option<&SimWorker> {
        self.worker.as_ref()
    }

    /// Where its cycles come in.
    pub(crate) fn inbox(&self) -> &CycleInbox {
        &self.inbox
    }

    /// Takes what came; returns it with the number of cycles that were dropped.
    pub(crate) fn poll(&mut self) -> (Vec<DecodedCycle>, u64) {
        let (came, dropped, word) = self.inbox.drain();
        self.status = word;
        let came: Vec<DecodedCycle> = came.into();
        for shown in &came {
            // A clock that was set back belongs to another run.
            if (self.history.back()).is_some_and(|last| last.cycle.stamp >= shown.cycle.stamp) {
                self.history.clear();
                self.place = 0;
            }
            self.history.push_back(shown.clone());
        }
        while self.history.len() > HISTORY_CAPACITY {
            self.history.pop_front();
            self.place = self.place.saturating_sub(1);
        }
        let old = self.history.len().saturating_sub(HISTORY_IMAGES);
        for shown in self.history.iter_mut().take(old).rev() {
            if shown.cycle.inputs.image.is_none() {
                break;
            }
            Arc::make_mut(&mut shown.cycle).inputs.image = None;
        }
        (came, dropped)
    }

    /// The newest cycle.
    pub(crate) fn newest(&mut self) -> Option<DecodedCycle> {
        self.place = self.history.len().saturating_sub(1);
        self.history.back().cloned()
    }

    /// What is kept, seconds.
    pub(crate) fn span(&self) -> Option<(f64, f64)> {
        let (first, last) = (self.history.front()?, self.history.back()?);
        Some((first.cycle.stamp.seconds(), last.cycle.stamp.seconds()))
    }

    /// The last kept cycle at or before a time, else the first.
    pub(crate) fn seek(&mut self, time: f64) -> Option<DecodedCycle> {
        let behind = self
            .history
            .partition_point(|shown| shown.cycle.stamp.seconds() <= time);
        self.place = behind.saturating_sub(1);
        self.history.get(self.place).cloned()
    }

    /// So many kept cycles on or back.
    pub(crate) fn step(&mut self, by: i64) -> Option<DecodedCycle> {
        let place = self.place as i64 + by;
        let place = usize::try_from(place).ok()?;
        let shown = self.history.get(place).cloned()?;
        self.place = place;
        Some(shown)
    }
}
