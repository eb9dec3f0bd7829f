//! The compiled half of the Python package: the crates' own optics, eyes and calibrations, with numpy arrays. Conversions only.

mod calibrate;
mod camera;
pub mod embedded;
mod errors;
mod profile;
mod rays;
mod scene;
mod see;

use pyo3::prelude::*;

/// `mirrorball._core`.
#[pymodule]
pub fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_class::<profile::Profile>()?;
    module.add_class::<camera::Camera>()?;
    module.add_class::<camera::Mount>()?;
    module.add_class::<rays::GroundMap>()?;
    module.add_class::<scene::Field>()?;
    module.add_function(wrap_pyfunction!(rays::trace_rays, module)?)?;
    module.add_function(wrap_pyfunction!(rays::trace_points, module)?)?;
    module.add_function(wrap_pyfunction!(rays::ground_map, module)?)?;
    module.add_function(wrap_pyfunction!(scene::render, module)?)?;
    module.add_class::<see::Eyes>()?;
    module.add_class::<see::ColourTable>()?;
    module.add_function(wrap_pyfunction!(calibrate::calibrate_strip, module)?)?;
    module.add_function(wrap_pyfunction!(calibrate::calibrate_lines, module)?)?;
    module.add_function(wrap_pyfunction!(calibrate::calibrate_mask, module)?)?;
    module.add_function(wrap_pyfunction!(calibrate::calibrate_sizes, module)?)?;
    module.add_function(wrap_pyfunction!(calibrate::learn_colours, module)?)?;
    module.add_function(wrap_pyfunction!(calibrate::colours_from_labels, module)?)?;
    Ok(())
}
