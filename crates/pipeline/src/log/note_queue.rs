//! How do notes reach the log's writer? Through a bounded queue; the next cycle takes them along.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use localize::Stamp;

/// Notes that may wait for the next cycle; beyond it, the oldest are dropped.
const NOTES_MAX: usize = 256;

/// Notes that wait for the writer.
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
