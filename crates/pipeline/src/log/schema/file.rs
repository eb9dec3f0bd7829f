//! Did a write fail? A buffered file stores the first error, which the SDK's channels discard.

use std::fs::File;
use std::io::{BufWriter, Result, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

/// Buffered file of a log.
pub(crate) struct LogFile {
    path: PathBuf,
    file: BufWriter<File>,
    write_error: Arc<OnceLock<String>>,
}

impl LogFile {
    /// Writes to an empty file, which `path` names in messages. `fault` receives the first write error.
    pub(crate) fn new(path: &Path, file: File, fault: Arc<OnceLock<String>>) -> Self {
        LogFile {
            path: path.to_owned(),
            file: BufWriter::new(file),
            write_error: fault,
        }
    }

    fn record_error<T>(&self, result: Result<T>) -> Result<T> {
        if let Err(error) = &result {
            self.write_error
                .get_or_init(|| format!("cannot write {}: {error}", self.path.display()));
        }
        result
    }
}

impl Write for LogFile {
    fn write(&mut self, bytes: &[u8]) -> Result<usize> {
        let result = self.file.write(bytes);
        self.record_error(result)
    }

    fn flush(&mut self) -> Result<()> {
        let result = self.file.flush();
        self.record_error(result)
    }
}
