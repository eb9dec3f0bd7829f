//! Links the shared libpython of the build's Python, and stores that Python's path.

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
