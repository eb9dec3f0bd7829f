//! Reading a TOML file.

use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;

use crate::input_file;

/// Why a file cannot be read as a value.
#[derive(Debug, thiserror::Error)]
pub enum TomlFileError {
    /// The file cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// The content is not such a value.
    #[error("{}: {source}", path.display())]
    Parse {
        /// The file.
        path: PathBuf,
        /// Line and reason.
        source: Box<toml::de::Error>,
    },
}

impl TomlFileError {
    /// The error of a file's content.
    pub fn parse(path: &Path, source: toml::de::Error) -> Self {
        TomlFileError::Parse {
            path: path.to_owned(),
            source: Box::new(source),
        }
    }

    /// True if there is no such file.
    pub fn is_not_found(&self) -> bool {
        matches!(self, TomlFileError::Read { source, .. } if source.kind() == std::io::ErrorKind::NotFound)
    }
}

/// Reads a file as a value; also returns its text, for the lines of later errors.
pub fn read<T: DeserializeOwned>(path: &Path) -> Result<(T, String), TomlFileError> {
    let text = input_file::read_text(path).map_err(|source| TomlFileError::Read {
        path: path.to_owned(),
        source,
    })?;
    let value = toml::from_str(&text).map_err(|source| TomlFileError::parse(path, source))?;
    Ok((value, text))
}
