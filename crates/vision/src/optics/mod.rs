//! Which ground point does a pixel show? Mirror profiles, ray tracing, ground maps.

pub mod camera_from_map;
pub mod ground_map;
pub mod mirror;
pub mod ray_tracing;

pub use ray_tracing::trace_rays;
