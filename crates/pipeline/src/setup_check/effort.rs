//! How thorough is a check of the set-up?

/// How much is tried.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Effort {
    /// Only what could be wrong by the fit of the configured set-up: for each run.
    Brief,
    /// Everything: for the doctor.
    Full,
}
