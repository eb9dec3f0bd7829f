//! Where are config/ and samples/? Beside the working folder, beside the executable, or where $MIRRORBALL_HOME says.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};

/// Finds a file or folder that comes with Mirrorball, as `config/scenarios/demo.toml`.
pub fn find(relative: &str) -> Result<PathBuf> {
    let given = std::env::var_os("MIRRORBALL_HOME").map(PathBuf::from);
    let working = std::env::current_dir().ok();
    let executable = std::env::current_exe().ok();
    // target/release/mirrorball lies two folders below the one that has config/.
    let above = |path: Option<PathBuf>| {
        path.map(|path| path.ancestors().map(Path::to_owned).collect::<Vec<_>>())
            .unwrap_or_default()
    };
    let places = given
        .into_iter()
        .chain(above(working))
        .chain(above(executable));
    for place in places {
        let found = place.join(relative);
        if found.exists() {
            return Ok(found);
        }
    }
    bail!(
        "cannot find {relative}: start mirrorball in its own folder, or set MIRRORBALL_HOME to the folder that has config/"
    )
}
