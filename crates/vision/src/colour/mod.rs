//! Colour classes: the learned carpet model, labelled colour tables, and adaptation to the light.

pub(crate) mod adaptation;
pub mod carpet_model;
pub(crate) mod class_bits;
pub mod colour_table;
pub mod lookup_table;
pub(crate) mod pixel_classifier;
