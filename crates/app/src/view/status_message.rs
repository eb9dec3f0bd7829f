//! Outcome of a user's action, as one line of text.

use std::fmt::Display;

/// Outcome of the last action of a panel.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct StatusMessage {
    /// True if the action succeeded.
    pub(crate) ok: bool,
    /// What was done, or the error with its reason.
    pub(crate) text: String,
}

impl StatusMessage {
    /// The error with all its causes, or the text of a success.
    pub(crate) fn from_result<E: Display>(result: Result<String, E>) -> Self {
        match result {
            Ok(text) => StatusMessage { ok: true, text },
            Err(error) => StatusMessage {
                ok: false,
                text: format!("{error:#}"),
            },
        }
    }
}
