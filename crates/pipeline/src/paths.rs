//! Where are config/ and samples/? Beside the working folder, beside the executable, or where $MIRRORBALL_HOME says.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};

/// Where tables that take long to build are kept from run to run: `$MIRRORBALL_CACHE`, else the user's cache folder;
/// none where there is no user.
pub fn cache_folder() -> Option<PathBuf> {
    let named = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty());
    if let Some(given) = named("MIRRORBALL_CACHE") {
        return Some(given.into());
    }
    let folder = named("XDG_CACHE_HOME").map(PathBuf::from);
    let folder = folder.or_else(|| Some(PathBuf::from(named("HOME")?).join(".cache")))?;
    Some(folder.join("mirrorball"))
}

/// Finds a file or folder that comes with Mirrorball, as `config/scenarios/demo.toml`.
pub fn find_resource(relative: &str) -> Result<PathBuf> {
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
