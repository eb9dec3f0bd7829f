//! Undo and redo of edits: settings, marks, plots, and which panels are open.

use std::sync::Arc;

use egui_tiles::Tree;
use pipeline::PipelineConfig;

use super::layout::{PanelLayout, open_panels};
use super::panels::PanelId;
use super::panels::plots::PlotConfig;
use super::session::Mark;

/// Edits that can be undone.
const EDITS_MAX: usize = 200;

/// What an edit changes.
#[derive(Clone)]
pub(crate) struct Edited {
    /// The settings, and their text, by which they are compared.
    pub(crate) config: Arc<(PipelineConfig, String)>,
    pub(crate) marks: Vec<Mark>,
    pub(crate) plots: Vec<PlotConfig>,
    pub(crate) layout: PanelLayout,
    pub(crate) tree: Tree<PanelId>,
}

impl Edited {
    /// True if nothing was edited between both. A dragged or resized tile is no edit.
    fn is_same(&self, other: &Edited) -> bool {
        self.marks == other.marks
            && self.plots == other.plots
            && self.layout == other.layout
            && open_panels(&self.tree) == open_panels(&other.tree)
            && (Arc::ptr_eq(&self.config, &other.config) || self.config.1 == other.config.1)
    }
}

/// The edits of a session.
#[derive(Default)]
pub(crate) struct UndoHistory {
    /// States before each edit, the oldest first, then the current one.
    past: Vec<Edited>,
    /// States that were undone, the next one last.
    future: Vec<Edited>,
}

impl UndoHistory {
    /// Records the current state if it differs from the last one.
    pub(crate) fn record(&mut self, now: Edited) {
        if let Some(last) = self.past.last_mut() {
            if last.is_same(&now) {
                // Where tiles were dragged to stays as it is when an edit is undone.
                last.tree = now.tree;
                return;
            }
            self.future.clear();
        }
        self.past.push(now);
        if self.past.len() > EDITS_MAX {
            self.past.remove(0);
        }
    }

    /// The state before the last edit.
    pub(crate) fn undo(&mut self) -> Option<Edited> {
        if self.past.len() < 2 {
            return None;
        }
        self.future.extend(self.past.pop());
        self.past.last().cloned()
    }

    /// The state after the edit that was undone last.
    pub(crate) fn redo(&mut self) -> Option<Edited> {
        let next = self.future.pop()?;
        self.past.push(next.clone());
        Some(next)
    }
}
