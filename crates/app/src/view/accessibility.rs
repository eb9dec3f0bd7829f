//! Names for what carries no text of its own: a screen reader says them, and a test asks for them.

use eframe::egui::Response;

/// Gives a widget its name.
pub(crate) trait AccessibleLabel {
    /// The widget, known as `name` to whoever does not see it.
    fn with_accessible_label(self, name: &str) -> Self;
}

impl AccessibleLabel for Response {
    fn with_accessible_label(self, name: &str) -> Self {
        self.ctx
            .accesskit_node_builder(self.id, |node| node.set_label(name));
        self
    }
}
