//! How does an output get its name only when it is complete? Written beside it, flushed, checked, then renamed.

use std::fs::File;
use std::io::{BufWriter, Result, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// A file that replaces an earlier one of its name when it is complete.
///
/// Until then its content is in `NAME.part` in the same folder. A failure removes that part and leaves an earlier file as
/// it was. Links are followed. Pipes and devices are written directly.
pub struct OutputFile {
    path: PathBuf,
    /// The unfinished file. None for a pipe or device.
    part: Option<PathBuf>,
    out: BufWriter<File>,
}

impl OutputFile {
    /// Starts the file. Errors if the folder does not exist or cannot be written.
    pub fn create(path: &Path) -> Result<Self> {
        let path = path
            .canonicalize()
            .unwrap_or_else(|_: std::io::Error| path.to_owned());
        let is_stream = path.exists() && !path.is_file();
        let (part, file) = if is_stream {
            (None, std::fs::OpenOptions::new().write(true).open(&path)?)
        } else {
            let part = part_of(&path)?;
            let file = File::create(&part)?;
            (Some(part), file)
        };
        Ok(OutputFile {
            path,
            part,
            out: BufWriter::new(file),
        })
    }

    /// Completes the file: passes everything to the disk, then gives it its name.
    pub fn finish(mut self) -> Result<()> {
        self.out.flush()?;
        let Some(part) = &self.part else {
            return Ok(());
        };
        // Some file systems report a full disk only here.
        self.out.get_ref().sync_all()?;
        std::fs::rename(part, &self.path)?;
        self.part = None;
        Ok(())
    }
}

impl Write for OutputFile {
    fn write(&mut self, bytes: &[u8]) -> Result<usize> {
        self.out.write(bytes)
    }

    fn flush(&mut self) -> Result<()> {
        self.out.flush()
    }
}

impl Seek for OutputFile {
    fn seek(&mut self, to: SeekFrom) -> Result<u64> {
        self.out.seek(to)
    }
}

impl Drop for OutputFile {
    fn drop(&mut self) {
        // The first error is reported. Failure to remove the part is ignored: it has a visible name.
        if let Some(part) = &self.part {
            let _ = std::fs::remove_file(part);
        }
    }
}

/// Writes a whole file. After a failure an earlier file of that name is unchanged.
pub fn write_file(path: &Path, content: impl AsRef<[u8]>) -> Result<()> {
    let mut file = OutputFile::create(path)?;
    file.write_all(content.as_ref())?;
    file.finish()
}

/// NAME.part in the same folder, so that renaming stays on one disk.
fn part_of(path: &Path) -> Result<PathBuf> {
    let mut name = path
        .file_name()
        .ok_or_else(|| std::io::Error::other(format!("{} names no file", path.display())))?
        .to_owned();
    name.push(".part");
    Ok(path.with_file_name(name))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> = std::fs::read_dir(folder)
            .expect("a folder")
            .map(|entry| {
                entry
                    .expect("an entry")
                    .file_name()
                    .to_string_lossy()
                    .into_owned()
            })
            .collect();
        names.sort();
        names
    }

    #[test]
    fn unfinished_output_leaves_the_earlier_file_and_no_part() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("map.npz");
        write_file(&path, "first").expect("written");
        let mut second = OutputFile::create(&path).expect("started");
        second.write_all(b"sec").expect("written");
        assert_eq!(names(folder.path()), ["map.npz", "map.npz.part"]);
        assert_eq!(std::fs::read(&path).expect("readable"), b"first");
        drop(second);
        assert_eq!(names(folder.path()), ["map.npz"]);
        write_file(&path, "third").expect("written");
        assert_eq!(std::fs::read(&path).expect("readable"), b"third");
        assert_eq!(names(folder.path()), ["map.npz"]);
    }

    #[test]
    fn full_device_is_an_error() {
        let full = Path::new("/dev/full");
        if full.exists() {
            assert!(write_file(full, "text").is_err());
        }
    }
}
