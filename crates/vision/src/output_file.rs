//! How does an output get its name only when it is complete? Written beside it, flushed, checked, then renamed.

use std::fs::File;
use std::io::{BufWriter, Error, ErrorKind, Result, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// Most unfinished files of one name that this process and killed ones of its number leave.
const PARTS_MAX: u32 = 10_000;

/// Buffer of a file that is written in place, bytes. What is written between two flushes fits in it, so that a killed process
/// leaves whole lines.
const IN_PLACE_BUFFER: usize = 1 << 18;

/// A name that a file gets when it is complete. Until then its content has a name of this process alone.
///
/// Several processes that write one output therefore never mix: the last one to complete it wins. Dropping it without
/// [`PendingName::give`] removes the content and leaves an earlier file as it was.
#[derive(Debug)]
pub struct PendingName {
    path: PathBuf,
    /// The unfinished file. None for a pipe or device, and when the file has its name.
    part: Option<PathBuf>,
}

impl PendingName {
    /// Creates an empty file beside `path`. Links are followed. Pipes and devices are opened themselves.
    pub fn create(path: &Path) -> Result<(Self, File)> {
        let path = path
            .canonicalize()
            .unwrap_or_else(|_: std::io::Error| path.to_owned());
        if path.exists() && !path.is_file() {
            let file = std::fs::OpenOptions::new().write(true).open(&path)?;
            return Ok((PendingName { path, part: None }, file));
        }
        let (part, file) = create_part(&path, |part| File::create_new(part))?;
        let part = Some(part);
        Ok((PendingName { path, part }, file))
    }

    /// Gives an unfinished content its name unless an earlier file has it, which stays.
    pub fn give_unless_taken(self) -> Result<()> {
        if self.part.is_some() && self.path.exists() {
            return Ok(());
        }
        self.give()
    }

    /// Passes the content to the disk and gives it its name.
    pub fn give(mut self) -> Result<()> {
        let Some(part) = &self.part else {
            return Ok(());
        };
        // Some file systems report a full disk only here.
        File::open(part)?.sync_all()?;
        std::fs::rename(part, &self.path)?;
        self.part = None;
        Ok(())
    }
}

impl Drop for PendingName {
    fn drop(&mut self) {
        // The first error is reported. Failure to remove the part is ignored: it has a visible name.
        if let Some(part) = &self.part {
            let _ = std::fs::remove_file(part);
        }
    }
}

/// A file that replaces an earlier one of its name when it is complete.
///
/// Until then its content is in `NAME.PROCESS.part` in the same folder. A failure removes that part and leaves an earlier
/// file as it was. Links are followed. Pipes and devices are written directly.
pub struct OutputFile {
    out: BufWriter<File>,
    name: PendingName,
}

impl OutputFile {
    /// Starts the file. Errors if the folder does not exist or cannot be written.
    pub fn create(path: &Path) -> Result<Self> {
        let (name, file) = PendingName::create(path)?;
        let out = BufWriter::new(file);
        Ok(OutputFile { out, name })
    }

    /// Starts a file that has its name from the start: what is flushed outlives a killed process. Errors if the name is taken.
    pub fn create_in_place(path: &Path) -> Result<Self> {
        let out = BufWriter::with_capacity(IN_PLACE_BUFFER, File::create_new(path)?);
        let name = PendingName {
            path: path.to_owned(),
            part: None,
        };
        Ok(OutputFile { out, name })
    }

    /// Completes the file: passes everything to the disk, then gives it its name.
    pub fn finish(mut self) -> Result<()> {
        self.out.flush()?;
        self.name.give()
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

/// An error if a file of that name cannot be written: no such folder, no permission, a folder itself.
pub fn ensure_can_create(path: &Path) -> Result<()> {
    if path.exists() && !path.is_file() && !path.is_dir() {
        // Opening a pipe waits for its reader.
        return Ok(());
    }
    PendingName::create(path).map(drop)
}

/// Writes a whole file. After a failure an earlier file of that name is unchanged.
pub fn write_file(path: &Path, content: impl AsRef<[u8]>) -> Result<()> {
    let mut file = OutputFile::create(path)?;
    file.write_all(content.as_ref())?;
    file.finish()
}

/// Creates a file or folder with an unused name of this process in the folder of `path`, so that renaming stays on one disk.
///
/// `create` fails on an existing name. A killed process of the same number may have left one.
pub fn create_part<T>(path: &Path, create: impl Fn(&Path) -> Result<T>) -> Result<(PathBuf, T)> {
    let name = path
        .file_name()
        .ok_or_else(|| Error::other(format!("{} names no file", path.display())))?;
    let process = std::process::id();
    for number in 0..PARTS_MAX {
        let mut part = name.to_owned();
        part.push(match number {
            0 => format!(".{process}.part"),
            _ => format!(".{process}-{number}.part"),
        });
        let part = path.with_file_name(part);
        match create(&part) {
            Ok(created) => return Ok((part, created)),
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
            Err(error) => return Err(error),
        }
    }
    let rest = format!("too many unfinished files {}.*.part", path.display());
    Err(Error::other(rest))
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
        let part = format!("map.npz.{}.part", std::process::id());
        assert_eq!(names(folder.path()), ["map.npz", &part]);
        assert_eq!(std::fs::read(&path).expect("readable"), b"first");
        drop(second);
        assert_eq!(names(folder.path()), ["map.npz"]);
        write_file(&path, "third").expect("written");
        assert_eq!(std::fs::read(&path).expect("readable"), b"third");
        assert_eq!(names(folder.path()), ["map.npz"]);
    }

    #[test]
    fn outputs_of_one_name_do_not_mix_and_the_last_one_wins() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("poses.csv");
        let mut first = OutputFile::create(&path).expect("started");
        let mut second = OutputFile::create(&path).expect("started");
        first.write_all(b"the first output").expect("written");
        second.write_all(b"the second").expect("written");
        first.finish().expect("complete");
        assert_eq!(std::fs::read(&path).expect("there"), b"the first output");
        second.finish().expect("complete");
        assert_eq!(std::fs::read(&path).expect("there"), b"the second");
        assert_eq!(names(folder.path()), ["poses.csv"]);
    }

    #[test]
    fn part_that_a_killed_process_left_is_not_touched() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("poses.csv");
        let left = folder
            .path()
            .join(format!("poses.csv.{}.part", std::process::id()));
        std::fs::write(&left, "of a killed process").expect("written");
        write_file(&path, "whole").expect("written");
        assert_eq!(std::fs::read(&left).expect("there"), b"of a killed process");
        assert_eq!(std::fs::read(&path).expect("there"), b"whole");
    }

    #[test]
    fn full_device_is_an_error() {
        let full = Path::new("/dev/full");
        if full.exists() {
            assert!(write_file(full, "text").is_err());
        }
    }
}
