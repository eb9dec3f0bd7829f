//! Pictures that commands write: an annotated camera image and a field from above.

pub(crate) mod annotate;
pub(crate) mod field;
pub(crate) mod text;
