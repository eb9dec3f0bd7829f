//! What does the file of a log hold, should the next write fail? The messages of its whole chunks, counted by topic.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

/// Numbers of messages that a reader of the file finds. Clones share the same numbers.
#[derive(Debug, Clone, Default)]
pub(crate) struct HeldMessages {
    counts: Arc<Mutex<BTreeMap<String, u64>>>,
}

impl HeldMessages {
    /// Sets the numbers of all topics after a chunk has reached the file.
    pub(super) fn set<'a>(&self, counts: impl Iterator<Item = (&'a String, &'a u64)>) {
        let mut held = self.counts.lock().unwrap_or_else(PoisonError::into_inner);
        for (topic, count) in counts {
            match held.get_mut(topic) {
                Some(known) => *known = *count,
                None => drop(held.insert(topic.clone(), *count)),
            }
        }
    }

    /// Number of messages of a topic.
    pub(crate) fn count(&self, topic: &str) -> u64 {
        let held = self.counts.lock().unwrap_or_else(PoisonError::into_inner);
        held.get(topic).copied().unwrap_or(0)
    }
}
