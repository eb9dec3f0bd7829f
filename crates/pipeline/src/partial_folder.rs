//! How does a folder appear only when it is complete? It is written under another name, and renamed at the end.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};

/// A folder that gets its name when it is complete, and is removed if it never is.
#[derive(Debug)]
pub struct PartialFolder {
    path: PathBuf,
    target: PathBuf,
}

impl PartialFolder {
    /// Creates `target` with `.part` behind its name; the rest of an earlier attempt is replaced.
    ///
    /// An existing target must be an empty folder.
    pub fn create(target: &Path) -> Result<Self> {
        let taken = target.exists()
            && target
                .read_dir()
                .map_or(true, |mut entries| entries.next().is_some());
        ensure!(
            !taken,
            "{} exists and is not an empty folder: name another",
            target.display()
        );
        let mut name = target
            .file_name()
            .context("the folder has no name")?
            .to_owned();
        name.push(".part");
        let path = target.with_file_name(name);
        let context = || format!("cannot write {}", path.display());
        if path.exists() {
            std::fs::remove_dir_all(&path).with_context(context)?;
        }
        std::fs::create_dir_all(&path).with_context(context)?;
        Ok(PartialFolder {
            path,
            target: target.to_owned(),
        })
    }

    /// Where the files are written.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Gives the folder its name.
    pub fn finish(self) -> Result<()> {
        std::fs::rename(&self.path, &self.target)
            .with_context(|| format!("cannot write {}", self.target.display()))
    }
}

impl Drop for PartialFolder {
    fn drop(&mut self) {
        // After `finish` there is nothing to remove. Before it, the first error has been reported.
        let _ = std::fs::remove_dir_all(&self.path);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folder_appears_when_complete_and_leaves_nothing_otherwise() {
        let place = tempfile::tempdir().expect("a folder");
        let target = place.path().join("drive");
        let names = || {
            place
                .path()
                .read_dir()
                .expect("readable")
                .map(|entry| entry.expect("an entry").file_name())
                .collect::<Vec<_>>()
        };
        let given_up = PartialFolder::create(&target).expect("created");
        std::fs::write(given_up.path().join("a.csv"), "1").expect("written");
        drop(given_up);
        assert!(names().is_empty());

        let complete = PartialFolder::create(&target).expect("created");
        std::fs::write(complete.path().join("a.csv"), "1").expect("written");
        complete.finish().expect("renamed");
        assert_eq!(names(), ["drive"]);
        PartialFolder::create(&target).expect_err("taken");
    }
}
