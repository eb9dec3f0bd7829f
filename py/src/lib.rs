//! The compiled half of the Python package: optics, vision, calibration, simulation and logs with numpy arrays. Conversions
//! only.

mod arguments;
mod calibrate;
mod camera;
mod cycle;
mod detections;
pub mod embedded;
mod errors;
mod findings;
mod ground_map;
mod log;
mod profile;
mod rays;
mod robot_pipeline;
mod scene;
mod settings;
mod simulation;
mod simulation_object;
mod threads;

use pyo3::prelude::*;

/// `mirrorball._core`.
#[pymodule]
pub fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    threads::remember_process();
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_class::<profile::Profile>()?;
    module.add_class::<camera::Camera>()?;
    module.add_class::<camera::Mount>()?;
    module.add_class::<ground_map::GroundMap>()?;
    module.add_class::<scene::Field>()?;
    module.add_function(wrap_pyfunction!(rays::trace_rays, module)?)?;
    module.add_function(wrap_pyfunction!(rays::trace_points, module)?)?;
    module.add_function(wrap_pyfunction!(rays::ground_map, module)?)?;
    module.add_function(wrap_pyfunction!(scene::render, module)?)?;
    module.add_class::<detections::Vision>()?;
    module.add_class::<detections::ColourTable>()?;
    module.add_function(wrap_pyfunction!(calibrate::calibrate_strip, module)?)?;
    module.add_function(wrap_pyfunction!(calibrate::calibrate_lines, module)?)?;
    module.add_function(wrap_pyfunction!(calibrate::calibrate_mask, module)?)?;
    module.add_function(wrap_pyfunction!(calibrate::calibrate_sizes, module)?)?;
    module.add_function(wrap_pyfunction!(calibrate::learn_colours, module)?)?;
    module.add_function(wrap_pyfunction!(calibrate::colours_from_labels, module)?)?;
    module.add_function(wrap_pyfunction!(simulation::simulate, module)?)?;
    module.add_function(wrap_pyfunction!(simulation::scenario_files, module)?)?;
    module.add_class::<simulation_object::Simulation>()?;
    module.add_class::<robot_pipeline::Pipeline>()?;
    module.add_class::<cycle::Cycle>()?;
    module.add_class::<log::LogReader>()?;
    module.add_function(wrap_pyfunction!(findings::findings, module)?)?;
    module.add("LogError", module.py().get_type::<log::LogError>())?;
    Ok(())
}
