//! Which colour class does a pixel have? The learned carpet model, colour tables, their adaptation to the light.

pub(crate) mod adaptation;
pub mod carpet_model;
pub mod colour_table;
pub mod lookup_table;
pub(crate) mod pixel_classifier;
