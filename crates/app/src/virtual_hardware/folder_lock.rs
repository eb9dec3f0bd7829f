//! Who serves a folder of virtual devices? One process, until it ends in whatever way: the kernel frees its lock.

use std::fs::{File, TryLockError};
use std::io::{Read, Seek, Write};
use std::path::Path;

use anyhow::{Context, Result, bail};

/// File name of the lock. It stays in the folder; the lock does not.
const NAME: &str = "lock";

/// The right to serve a folder.
#[derive(Debug)]
pub(super) struct FolderLock {
    _locked: File,
}

impl FolderLock {
    /// Makes the folder if needed. Errors if another process serves it.
    pub(super) fn take(folder: &Path) -> Result<Self> {
        std::fs::create_dir_all(folder)
            .with_context(|| format!("cannot make {}", folder.display()))?;
        let path = folder.join(NAME);
        let context = || format!("cannot write {}", path.display());
        let mut options = File::options();
        options.read(true).write(true).create(true).truncate(false);
        let mut file = options.open(&path).with_context(context)?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                let mut process = String::new();
                // The number is a hint. Without one the message is still right.
                let _unreadable = file.read_to_string(&mut process);
                let process = match process.trim() {
                    "" => String::new(),
                    number => format!(" (process {number})"),
                };
                bail!(
                    "{} is served by another `sim --hardware`{process}. End it, or name another folder",
                    folder.display()
                );
            }
            Err(TryLockError::Error(error)) => return Err(error).with_context(context),
        }
        file.set_len(0)
            .and_then(|()| file.rewind())
            .and_then(|()| writeln!(file, "{}", std::process::id()))
            .with_context(context)?;
        Ok(FolderLock { _locked: file })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folder_is_served_once_and_free_after_that() {
        let place = tempfile::tempdir().expect("a folder");
        let folder = place.path().join("robot");
        let first = FolderLock::take(&folder).expect("free");
        let message = FolderLock::take(&folder).expect_err("taken").to_string();
        let process = format!("(process {})", std::process::id());
        assert!(message.contains("robot is served by another"), "{message}");
        assert!(message.contains(&process), "{message}");
        drop(first);
        FolderLock::take(&folder).expect("free again");
    }
}
