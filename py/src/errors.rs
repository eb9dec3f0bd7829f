//! Errors as Python exceptions: a missing file is an OSError, everything else a ValueError.

use pipeline::message_text::error_message;
use pyo3::exceptions::{PyFileNotFoundError, PyOSError, PyValueError};
use pyo3::prelude::*;
use vision::VisionError;
use vision::calibrate::CalibrationError;
use vision::optics::ground_map::GroundMapError;
use vision::optics::mirror::ProfileError;
use vision::optics::ray_tracing::OpticsError;

fn from_io(source: &std::io::Error, message: String) -> PyErr {
    match source.kind() {
        std::io::ErrorKind::NotFound => PyFileNotFoundError::new_err(message),
        std::io::ErrorKind::InvalidData | std::io::ErrorKind::UnexpectedEof => {
            PyValueError::new_err(message)
        }
        _ => PyOSError::new_err(message),
    }
}

pub(crate) fn profile(error: &ProfileError) -> PyErr {
    let message = error.to_string();
    match error {
        ProfileError::Read { source, .. } => from_io(source, message),
        _ => PyValueError::new_err(message),
    }
}

pub(crate) fn map(error: &GroundMapError) -> PyErr {
    match error {
        GroundMapError::File { source, .. } => from_io(source, error.to_string()),
        GroundMapError::Content { .. } => PyValueError::new_err(error.to_string()),
    }
}

pub(crate) fn optics(error: &OpticsError) -> PyErr {
    PyValueError::new_err(error.to_string())
}

pub(crate) fn calibration(error: &CalibrationError) -> PyErr {
    PyValueError::new_err(error.to_string())
}

pub(crate) fn vision(error: &VisionError) -> PyErr {
    let message = error.to_string();
    match error {
        VisionError::ReadImage { path, .. } | VisionError::File { path, .. } if !path.exists() => {
            PyFileNotFoundError::new_err(message)
        }
        _ => PyValueError::new_err(message),
    }
}

/// An error of the pipeline: its cause decides between OSError and ValueError.
pub(crate) fn from_anyhow(error: &anyhow::Error) -> PyErr {
    let message = error_message(error);
    match io_cause(error) {
        Some(io) => from_io(io, message),
        None => PyValueError::new_err(message),
    }
}

/// True if the system refused a file.
pub(crate) fn is_io(error: &anyhow::Error) -> bool {
    io_cause(error).is_some_and(|io| {
        !matches!(
            io.kind(),
            std::io::ErrorKind::UnexpectedEof | std::io::ErrorKind::InvalidData
        )
    })
}

fn io_cause(error: &anyhow::Error) -> Option<&std::io::Error> {
    error.chain().find_map(|cause| cause.downcast_ref())
}
