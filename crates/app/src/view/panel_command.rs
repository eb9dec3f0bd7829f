//! What keys ask of the current panel.

/// A command to the current panel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum PanelCommand {
    /// Move the visible part: right and down, in steps.
    Pan([f32; 2]),
    /// Enlarge by a factor.
    Zoom(f32),
    /// Show all.
    ShowAll,
}
