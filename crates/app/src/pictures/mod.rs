//! Pictures that commands write: an annotated camera image and a field from above.

pub mod annotate;
pub mod field;
