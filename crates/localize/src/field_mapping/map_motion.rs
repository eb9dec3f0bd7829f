//! Motions of a map in its own frame.

use crate::frames::{FieldFrame, Tf};

/// A rigid motion of the map.
pub(super) type MapMotion = Tf<FieldFrame, FieldFrame>;
