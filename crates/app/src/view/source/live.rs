//! A live source with a bounded history of its last cycles, for pausing and stepping back.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::decoded_cycle::DecodedCycle;
use super::inbox::CycleInbox;
use super::remote_settings::RemoteSettings;
use super::sim_worker::SimWorker;
use super::stop_guard::StopGuard;
use pipeline::Cycle;

/// Cycles kept for stepping back.
const HISTORY_CAPACITY: usize = 1800;
/// The newest of these keep their images: about 140 MB at 480 × 480 pixels.
const HISTORY_IMAGES: usize = 200;
/// Time without a cycle after which what is shown is called old: a robot publishes ten a second at least.
const SILENCE_MAX: Duration = Duration::from_secs(1);

/// A live source and its history.
pub(crate) struct LiveSource {
    inbox: CycleInbox,
    worker: Option<SimWorker>,
    history: VecDeque<DecodedCycle>,
    /// Index of the shown cycle in the history.
    position: usize,
    /// The source's problem; None if it works.
    status: Option<String>,
    /// When the last cycle came.
    last_received: Option<Instant>,
    /// Changes the settings of a remote robot.
    pub(crate) remote_settings: Option<RemoteSettings>,
    _guard: Option<(StopGuard, Option<tempfile::TempDir>)>,
}

impl LiveSource {
    /// `worker`: the simulation behind it, if the view owns it.
    pub(crate) fn new(inbox: CycleInbox, worker: Option<SimWorker>) -> Self {
        LiveSource {
            inbox,
            worker,
            history: VecDeque::new(),
            position: 0,
            status: None,
            last_received: None,
            remote_settings: None,
            _guard: None,
        }
    }

    /// Attaches what must live as long as the source: its thread's stop guard, and a remote robot's files.
    pub(crate) fn with_guard(self, guard: StopGuard, folder: Option<tempfile::TempDir>) -> Self {
        LiveSource {
            _guard: Some((guard, folder)),
            ..self
        }
    }

    /// The simulation behind it, if the view owns it.
    pub(crate) fn worker(&self) -> Option<&SimWorker> {
        self.worker.as_ref()
    }

    /// The queue of its incoming cycles.
    pub(crate) fn inbox(&self) -> &CycleInbox {
        &self.inbox
    }

    /// Takes the queued cycles into the history; returns them with the number of dropped ones.
    pub(crate) fn poll(&mut self) -> (Vec<DecodedCycle>, u64) {
        let (received, dropped, status) = self.inbox.drain();
        self.status = status;
        let received: Vec<DecodedCycle> = received.into();
        if !received.is_empty() {
            self.last_received = Some(Instant::now());
        }
        for shown in &received {
            // A clock that jumps back belongs to another run.
            if (self.history.back()).is_some_and(|last| last.cycle.stamp >= shown.cycle.stamp) {
                self.history.clear();
                self.position = 0;
            }
            self.history.push_back(shown.clone());
        }
        while self.history.len() > HISTORY_CAPACITY {
            self.history.pop_front();
            self.position = self.position.saturating_sub(1);
        }
        let old = self.history.len().saturating_sub(HISTORY_IMAGES);
        for shown in self.history.iter_mut().take(old).rev() {
            if shown.cycle.inputs.image.is_none() {
                break;
            }
            Arc::make_mut(&mut shown.cycle).inputs.image = None;
        }
        (received, dropped)
    }

    /// Why the newest cycle is old: the source's problem, or its silence. The view's own simulation may pause.
    pub(crate) fn problem(&self) -> Option<String> {
        if self.status.is_some() || self.worker.is_some() {
            return self.status.clone();
        }
        let silence = self.last_received?.elapsed();
        (silence > SILENCE_MAX).then(|| {
            format!(
                "nothing received for {} s: what is shown is old",
                silence.as_secs()
            )
        })
    }

    /// The newest cycle.
    pub(crate) fn newest(&mut self) -> Option<DecodedCycle> {
        self.position = self.history.len().saturating_sub(1);
        self.history.back().cloned()
    }

    /// First and last time of the history, seconds.
    pub(crate) fn span(&self) -> Option<(f64, f64)> {
        let (first, last) = (self.history.front()?, self.history.back()?);
        Some((first.cycle.stamp.seconds(), last.cycle.stamp.seconds()))
    }

    /// The last cycle of the history at or before a time, else the first.
    pub(crate) fn seek(&mut self, time: f64) -> Option<DecodedCycle> {
        let later = self
            .history
            .partition_point(|shown| shown.cycle.stamp.seconds() <= time);
        self.position = later.saturating_sub(1);
        self.history.get(self.position).cloned()
    }

    /// The last cycle of the history at or before a time.
    pub(crate) fn cycle_at(&self, time: f64) -> Option<Arc<Cycle>> {
        let later = self
            .history
            .partition_point(|shown| shown.cycle.stamp.seconds() <= time);
        let shown = self.history.get(later.checked_sub(1)?)?;
        Some(shown.cycle.clone())
    }

    /// The cycle `by` cycles later (negative: earlier) in the history.
    pub(crate) fn step(&mut self, by: i64) -> Option<DecodedCycle> {
        let position = self.position as i64 + by;
        let position = usize::try_from(position).ok()?;
        let shown = self.history.get(position).cloned()?;
        self.position = position;
        Some(shown)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn silence_and_problems_are_told_until_the_next_cycle() {
        let inbox = CycleInbox::default();
        let mut live = LiveSource::new(inbox.clone(), None);
        let deliver = |seconds: f64| {
            let mut cycle = pipeline::testing::random_cycle(0);
            cycle.stamp = localize::Stamp::from_seconds(seconds);
            inbox.push(DecodedCycle::new(Arc::new(cycle), Vec::new()));
        };
        // It may still begin.
        assert_eq!(live.problem(), None);
        deliver(1.0);
        live.poll();
        assert_eq!(live.problem(), None);
        live.last_received = Instant::now().checked_sub(Duration::from_secs(11));
        live.poll();
        let problem = live.problem().expect("silent");
        assert!(problem.contains("for 11 s"), "{problem}");
        inbox.set_status(Some("reset; reconnecting".to_owned()));
        live.poll();
        assert_eq!(live.problem().as_deref(), Some("reset; reconnecting"));
        inbox.set_status(None);
        deliver(2.0);
        live.poll();
        assert_eq!(live.problem(), None);
    }
}
