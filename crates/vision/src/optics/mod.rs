//! Projection between image and ground: mirror profiles, ray tracing, ground maps.

pub mod camera_from_map;
pub mod ground_map;
pub(crate) mod image_polar;
pub mod map_basis;
pub mod mirror;
pub mod ray_tracing;

pub use ray_tracing::trace_rays;
