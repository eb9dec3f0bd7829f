//! Accessible labels for widgets without text, for screen readers and for tests.

use eframe::egui::Response;

/// Sets a widget's accessible label.
pub(crate) trait AccessibleLabel {
    /// Labels the widget `name` for screen readers.
    fn with_accessible_label(self, name: &str) -> Self;
}

impl AccessibleLabel for Response {
    fn with_accessible_label(self, name: &str) -> Self {
        self.ctx
            .accesskit_node_builder(self.id, |node| node.set_label(name));
        self
    }
}
