//! Why does a drive yield no field?

/// Why a drive yields no field.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum FieldMappingError {
    /// Too few images with line points.
    #[error("too few images with line points: {0} (expected at least {1}). Record a longer drive")]
    FewImages(usize, usize),
    /// The robot did not move.
    #[error("the wheels report no motion: a map needs a drive of several metres past the lines")]
    NoMotion,
    /// No line or arc.
    #[error(
        "no line or arc found in the line points of {0} images (expected straight pieces of at least half a metre)"
    )]
    NoMarkings(usize),
}
