//! Where are config/ and samples/? In $MIRRORBALL_HOME, or in a parent of the working folder or of the executable.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};

/// Folder for tables that are slow to build: `$MIRRORBALL_CACHE`, else the user's cache folder. None if both are unset.
pub fn cache_folder() -> Option<PathBuf> {
    let named = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty());
    if let Some(folder) = named("MIRRORBALL_CACHE") {
        return Some(folder.into());
    }
    let folder = named("XDG_CACHE_HOME").map(PathBuf::from);
    let folder = folder.or_else(|| Some(PathBuf::from(named("HOME")?).join(".cache")))?;
    Some(folder.join("mirrorball"))
}

/// Finds a file or folder that ships with Mirrorball, such as `config/scenarios/demo.toml`.
pub fn find_resource(relative: &str) -> Result<PathBuf> {
    let home = std::env::var_os("MIRRORBALL_HOME").map(PathBuf::from);
    let working = std::env::current_dir().ok();
    let executable = std::env::current_exe().ok();
    // target/release/mirrorball is two levels below the folder that contains config/.
    let above = |path: Option<PathBuf>| {
        path.map(|path| path.ancestors().map(Path::to_owned).collect::<Vec<_>>())
            .unwrap_or_default()
    };
    let places = home
        .into_iter()
        .chain(above(working))
        .chain(above(executable));
    for place in places {
        let path = place.join(relative);
        if path.exists() {
            return Ok(path);
        }
    }
    bail!(
        "cannot find {relative}: start mirrorball in its own folder, or set MIRRORBALL_HOME to the folder that has config/"
    )
}
