//! How does a folder appear only when it is complete? It is written under another name, and renamed at the end.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use vision::output_file::create_part;

/// A folder that gets its name when it is complete, and is removed if it never is.
#[derive(Debug)]
pub struct PartialFolder {
    path: PathBuf,
    target: PathBuf,
}

impl PartialFolder {
    /// Creates a folder beside `target`, with a name of this process alone.
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
        let parent = target.parent().unwrap_or(Path::new(""));
        let created = std::fs::create_dir_all(parent)
            .and_then(|()| create_part(target, |part| std::fs::create_dir(part)));
        let (path, ()) = created.with_context(|| format!("cannot write {}", target.display()))?;
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

        let other = place.path().join("other");
        let [first, second] = [(), ()].map(|()| PartialFolder::create(&other).expect("created"));
        for (folder, text) in [(&first, "first"), (&second, "second")] {
            std::fs::write(folder.path().join("a.csv"), text).expect("written");
        }
        first.finish().expect("renamed");
        second.finish().expect_err("taken meanwhile");
        let table = std::fs::read(other.join("a.csv")).expect("there");
        assert_eq!(table, b"first");
    }
}
