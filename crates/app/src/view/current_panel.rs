//! Which panel do the keys act on? The one that was clicked last, or that F6 has reached.

use egui_tiles::Tree;

use super::layout::{panels_in_order, show_panel};
use super::panels::PanelId;

/// The current panel.
#[derive(Default)]
pub(crate) struct CurrentPanel {
    pub(crate) id: Option<PanelId>,
    /// Outlined: keys are in use.
    pub(crate) outlined: bool,
}

impl CurrentPanel {
    /// The current panel, or the first one if it is closed.
    pub(crate) fn or_first(&mut self, tree: &Tree<PanelId>) -> Option<PanelId> {
        let open = panels_in_order(tree);
        let known = self.id.filter(|id| open.contains(id));
        self.id = known.or(open.first().copied());
        self.id
    }

    /// Goes to the next panel (`ahead`) or the previous one, and brings it to the front.
    pub(crate) fn go(&mut self, tree: &mut Tree<PanelId>, ahead: bool) {
        let open = panels_in_order(tree);
        let at = self
            .id
            .and_then(|id| open.iter().position(|other| *other == id));
        let next = match (at, ahead) {
            (Some(at), true) => at + 1,
            (Some(at), false) => at + open.len() - 1,
            (None, true) => 0,
            (None, false) => open.len().saturating_sub(1),
        };
        self.id = open.get(next % open.len().max(1)).copied();
        self.outlined = true;
        if let Some(id) = self.id {
            show_panel(tree, id);
        }
    }
}
