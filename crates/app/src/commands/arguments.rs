//! Checks of arguments that clap cannot make; a failure ends with exit code 2.

use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use pipeline::log::ImageCompression;

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

/// Parses the seed of random numbers.
pub(crate) fn parse_seed(text: &str) -> Result<u64, String> {
    let expected = |_| format!("expected a whole number from 0 to {}", u64::MAX);
    text.parse().map_err(expected)
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
    let mut distinct: Vec<PathBuf> = Vec::new();
    for path in outputs.into_iter().flatten() {
        let place = place_of(path);
        if distinct.contains(&place) {
            return Err(
                UsageError(format!("same path for two outputs: {}", path.display())).into(),
            );
        }
        distinct.push(place);
    }
    Ok(())
}

/// The name that an output takes, without links and detours to its folder. A link of that name would be replaced, not followed.
fn place_of(path: &Path) -> PathBuf {
    let whole = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let folder = whole.parent().and_then(|folder| folder.canonicalize().ok());
    match folder.zip(whole.file_name()) {
        Some((folder, name)) => folder.join(name),
        None => whole,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
        for spelling in ["./a.csv", "src/../a.csv"] {
            let same = Path::new(spelling);
            assert!(ensure_distinct_outputs([Some(a), Some(same)]).is_err());
        }
    }
}
