//! How do notes reach the log writer? Through a bounded queue. They are written with the next cycle.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use localize::Stamp;

/// Capacity of the queue. Beyond it, the oldest notes are dropped.
const NOTES_MAX: usize = 256;

/// Notes queued for the writer.
#[derive(Debug, Clone, Default)]
pub(super) struct NoteQueue {
    queue: Arc<Mutex<VecDeque<(Stamp, String)>>>,
}

impl NoteQueue {
    pub(super) fn push(&self, stamp: Stamp, text: &str) {
        let mut waiting = self.queue.lock().unwrap_or_else(PoisonError::into_inner);
        if waiting.len() == NOTES_MAX {
            waiting.pop_front();
        }
        waiting.push_back((stamp, text.to_owned()));
    }

    /// Removes the oldest note.
    pub(super) fn pop(&self) -> Option<(Stamp, String)> {
        let mut waiting = self.queue.lock().unwrap_or_else(PoisonError::into_inner);
        waiting.pop_front()
    }
}
