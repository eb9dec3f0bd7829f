//! What does the doctor report? Findings with a severity and a remedy.

use serde::Serialize;

/// Severity of a finding.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Severity {
    /// No problem.
    Fine,
    /// The robot runs, with limitations.
    Note,
    /// The robot does not run.
    Bad,
}

/// Result of one check.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Finding {
    /// Subject of the check.
    pub(super) what: String,
    /// Severity.
    pub(super) verdict: Severity,
    /// Description.
    pub(super) found: String,
    /// Remedy; empty if none is needed.
    pub(super) remedy: String,
}

impl Finding {
    pub(super) fn fine(what: &str, found: impl Into<String>) -> Self {
        Finding {
            what: what.to_owned(),
            verdict: Severity::Fine,
            found: found.into(),
            remedy: String::new(),
        }
    }

    pub(super) fn note(what: &str, found: impl Into<String>, remedy: impl Into<String>) -> Self {
        Finding {
            what: what.to_owned(),
            verdict: Severity::Note,
            found: found.into(),
            remedy: remedy.into(),
        }
    }

    pub(super) fn bad(what: &str, found: impl Into<String>, remedy: impl Into<String>) -> Self {
        Finding {
            verdict: Severity::Bad,
            ..Finding::note(what, found, remedy)
        }
    }
}
