//! Links the shared libpython wherever the build's Python keeps it, and remembers that Python.

fn main() {
    #[cfg(feature = "python")]
    link_python();
}

#[cfg(feature = "python")]
fn link_python() {
    pyo3_build_config::add_libpython_rpath_link_args();
    let python = pyo3_build_config::get().executable().unwrap_or("python3");
    println!("cargo::rustc-env=MIRRORBALL_BUILD_PYTHON={python}");
}
