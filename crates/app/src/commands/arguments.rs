//! Which arguments make no sense? What the command line alone cannot check, answered with exit code 2.

use std::path::Path;

use anyhow::Result;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use pipeline::log::ImageCompression;

/// Arguments that cannot be meant.
#[derive(Debug)]
pub struct UsageError(pub String);

impl std::fmt::Display for UsageError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for UsageError {}

/// Longest simulation, seconds: a month.
const LONGEST: f64 = 2_678_400.0;

/// A duration on the command line, seconds.
pub fn parse_duration(text: &str) -> Result<f64, String> {
    let seconds: f64 = text
        .parse()
        .map_err(|error: std::num::ParseFloatError| error.to_string())?;
    if seconds > 0.0 && seconds <= LONGEST {
        Ok(seconds)
    } else {
        Err(format!("must be seconds above 0 and at most {LONGEST}"))
    }
}

/// How a log keeps images, by name.
pub fn image_mode() -> impl TypedValueParser<Value = ImageCompression> {
    PossibleValuesParser::new(ImageCompression::ALL.map(ImageCompression::name))
        .map(|name| ImageCompression::from_name(&name).unwrap_or_default())
}

/// Refuses two outputs of one name: the second would overwrite the first.
pub fn ensure_distinct_outputs<'a>(
    outputs: impl IntoIterator<Item = Option<&'a Path>>,
) -> Result<()> {
    let mut seen: Vec<&Path> = Vec::new();
    for path in outputs.into_iter().flatten() {
        if seen.contains(&path) {
            return Err(UsageError(format!("{} is named for two outputs", path.display())).into());
        }
        seen.push(path);
    }
    Ok(())
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
    }
}
