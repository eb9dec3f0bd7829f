//! Checks of arguments that clap cannot make; a failure ends with exit code 2.

use std::path::Path;

use anyhow::Result;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use pipeline::log::ImageCompression;
use pipeline::recording::INPUT_FILES;

/// Invalid arguments.
#[derive(Debug)]
pub(crate) struct UsageError(pub String);

impl std::fmt::Display for UsageError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for UsageError {}

/// Maximum duration, seconds: a month.
const DURATION_MAX: f64 = 2_678_400.0;

/// Parses a duration in seconds.
pub(crate) fn parse_duration(text: &str) -> Result<f64, String> {
    let seconds: f64 = text
        .parse()
        .map_err(|error: std::num::ParseFloatError| error.to_string())?;
    if seconds > 0.0 && seconds <= DURATION_MAX {
        Ok(seconds)
    } else {
        Err(format!(
            "expected seconds above 0 and at most {DURATION_MAX}"
        ))
    }
}

/// Parser for the image format of a log.
pub(crate) fn image_mode() -> impl TypedValueParser<Value = ImageCompression> {
    PossibleValuesParser::new(ImageCompression::ALL.map(ImageCompression::name))
        .map(|name| ImageCompression::from_name(&name).unwrap_or_default())
}

/// Rejects equal output paths: the second output would overwrite the first.
pub(crate) fn ensure_distinct_outputs<'a>(
    outputs: impl IntoIterator<Item = Option<&'a Path>>,
) -> Result<()> {
    let mut distinct: Vec<&Path> = Vec::new();
    for path in outputs.into_iter().flatten() {
        if distinct.contains(&path) {
            return Err(
                UsageError(format!("same path for two outputs: {}", path.display())).into(),
            );
        }
        distinct.push(path);
    }
    Ok(())
}

/// Rejects outputs in a recording's folder that have the name of one of its inputs: they would replace what was measured.
pub(crate) fn ensure_inputs_kept<'a>(
    recording: &Path,
    outputs: impl IntoIterator<Item = Option<&'a Path>>,
) -> Result<()> {
    let folder_of = |path: &Path| {
        let folder = path.parent()?;
        let is_here = folder.as_os_str().is_empty();
        let folder = if is_here { Path::new(".") } else { folder };
        folder.canonicalize().ok()
    };
    let recording = recording.canonicalize().ok();
    for path in outputs.into_iter().flatten() {
        let name = path.file_name().unwrap_or_default();
        if recording.is_some()
            && folder_of(path) == recording
            && INPUT_FILES.iter().any(|input| name == *input)
        {
            let path = path.display();
            let text = format!("{path} is an input of the recording: choose another name");
            return Err(UsageError(text).into());
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outputs_that_would_replace_inputs_are_rejected() {
        let folder = tempfile::tempdir().expect("a folder");
        let (recording, other) = (folder.path().join("drive"), folder.path().join("other"));
        for folder in [&recording, &other] {
            std::fs::create_dir(folder).expect("created");
        }
        let check = |path: &Path| ensure_inputs_kept(&recording, [None, Some(path)]);
        let around = other.join("../drive/frames.csv");
        let message = check(&around).expect_err("an input").to_string();
        assert!(
            message.contains("frames.csv is an input of the recording"),
            "{message}"
        );
        check(&recording.join("poses.csv")).expect("a result");
        check(&other.join("frames.csv")).expect("elsewhere");
    }

    #[test]
    fn non_positive_and_non_finite_durations_are_rejected() {
        for text in ["nan", "inf", "0", "-1", "soon"] {
            assert!(parse_duration(text).is_err(), "{text}");
        }
        assert_eq!(parse_duration("2.5"), Ok(2.5));
    }

    #[test]
    fn duplicate_output_paths_are_rejected() {
        let (a, b) = (Path::new("a.csv"), Path::new("b.csv"));
        assert!(ensure_distinct_outputs([Some(a), None, Some(b)]).is_ok());
        assert!(ensure_distinct_outputs([Some(a), Some(b), Some(a)]).is_err());
    }
}
