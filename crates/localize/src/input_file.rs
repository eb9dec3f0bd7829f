//! Reading a file that a user or a configuration names. A pipe without a writer and a device without an end are refused.

use std::fs::File;
use std::io::{Error, ErrorKind, Read, Result};
use std::path::Path;

/// Largest text, bytes: settings, profiles, lists of labels.
pub const TEXT_BYTES_MAX: u64 = 16 << 20;

/// Opens a regular file, or a stream that the caller of the program gave it.
///
/// # Errors
/// Those of the system, and "not a regular file" for other pipes, devices and sockets.
pub fn open(path: &Path) -> Result<File> {
    let kind = std::fs::metadata(path)?.file_type();
    // The system's own error names a folder. Opening a pipe without a writer would block for ever.
    if !kind.is_file() && !kind.is_dir() && !is_given_stream(path) {
        return Err(Error::new(ErrorKind::InvalidInput, "not a regular file"));
    }
    File::open(path)
}

/// Standard input, a descriptor of this process (a shell's `<(…)`), or the empty file.
fn is_given_stream(path: &Path) -> bool {
    let folders = ["/dev/fd", "/proc/self/fd"].map(Path::new);
    path.parent()
        .is_some_and(|parent| folders.contains(&parent))
        || [Path::new("/dev/stdin"), Path::new("/dev/null")].contains(&path)
}

/// Reads a file of at most `bytes_max` bytes.
///
/// # Errors
/// Those of [`open`], and "larger than … bytes".
pub fn read(path: &Path, bytes_max: u64) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let file = open(path)?;
    // Nothing is read of a file that says that it is too large.
    if file.metadata()?.len() <= bytes_max {
        file.take(bytes_max.saturating_add(1))
            .read_to_end(&mut bytes)?;
        if bytes.len() as u64 <= bytes_max {
            return Ok(bytes);
        }
    }
    let reason = format!("larger than {bytes_max} bytes");
    Err(Error::new(ErrorKind::InvalidData, reason))
}

/// Reads a text of at most [`TEXT_BYTES_MAX`] bytes.
///
/// # Errors
/// Those of [`read`], and "not UTF-8 text".
pub fn read_text(path: &Path) -> Result<String> {
    String::from_utf8(read(path, TEXT_BYTES_MAX)?).map_err(|error| {
        let line = error.as_bytes()[..error.utf8_error().valid_up_to()]
            .split(|&byte| byte == b'\n')
            .count();
        Error::new(
            ErrorKind::InvalidData,
            format!("line {line} is not UTF-8 text"),
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn endless_device_is_refused_also_behind_a_link() {
        let folder = tempfile::tempdir().expect("a folder");
        let link = folder.path().join("robot.toml");
        std::os::unix::fs::symlink("/dev/zero", &link).expect("linked");
        for path in [Path::new("/dev/zero"), &link] {
            let error = read_text(path).expect_err("endless");
            assert_eq!(error.to_string(), "not a regular file");
        }
    }

    #[test]
    fn socket_is_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("socket");
        let _socket = std::os::unix::net::UnixListener::bind(&path).expect("bound");
        let error = open(&path).expect_err("a socket");
        assert_eq!(error.to_string(), "not a regular file");
    }

    #[test]
    fn file_is_read_up_to_the_limit_and_refused_above() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("file");
        std::fs::write(&path, [7; 100]).expect("written");
        assert_eq!(read(&path, 100).expect("at the limit"), [7; 100]);
        let error = read(&path, 99).expect_err("too large");
        assert_eq!(error.to_string(), "larger than 99 bytes");
        // A file with a hole takes no space on the disk.
        let hole = File::create(&path).expect("created");
        hole.set_len(1 << 40).expect("a hole");
        read_text(&path).expect_err("too large");
    }

    #[test]
    fn missing_file_and_folder_keep_the_systems_errors() {
        let folder = tempfile::tempdir().expect("a folder");
        let missing = read_text(&folder.path().join("none")).expect_err("missing");
        assert_eq!(missing.kind(), ErrorKind::NotFound);
        let directory = read_text(folder.path()).expect_err("a folder");
        assert_eq!(directory.kind(), ErrorKind::IsADirectory);
    }

    #[test]
    fn pipe_of_the_caller_is_read() {
        let (reader, mut writer) = std::io::pipe().expect("a pipe");
        std::io::Write::write_all(&mut writer, b"a = 1").expect("written");
        drop(writer);
        let number = std::os::fd::AsRawFd::as_raw_fd(&reader);
        let path = format!("/dev/fd/{number}");
        assert_eq!(read_text(Path::new(&path)).expect("read"), "a = 1");
    }

    #[test]
    fn text_of_other_bytes_names_its_line() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("file");
        std::fs::write(&path, b"a = 1\nb = \xff").expect("written");
        let error = read_text(&path).expect_err("not UTF-8");
        assert_eq!(error.to_string(), "line 2 is not UTF-8 text");
    }
}
