//! Links the shared libpython of the build's Python, and stores that Python's path.
//!
//! With `MIRRORBALL_PORTABLE=1` no path of this machine is stored: for tarballs. The executable then finds libpython where the
//! system has it, and `python3` on the path.

fn main() {
    #[cfg(feature = "python")]
    link_python();
}

#[cfg(feature = "python")]
fn link_python() {
    println!("cargo::rerun-if-env-changed=MIRRORBALL_PORTABLE");
    let portable = std::env::var_os("MIRRORBALL_PORTABLE").is_some_and(|value| value == "1");
    let (mut python, mut venv) = ("python3", String::new());
    if !portable {
        pyo3_build_config::add_libpython_rpath_link_args();
        python = pyo3_build_config::get().executable().unwrap_or(python);
        // The virtual environment that `make` creates in the source folder.
        venv = concat!(env!("CARGO_MANIFEST_DIR"), "/../../.venv").to_owned();
    }
    println!("cargo::rustc-env=MIRRORBALL_BUILD_PYTHON={python}");
    println!("cargo::rustc-env=MIRRORBALL_BUILD_VENV={venv}");
}
