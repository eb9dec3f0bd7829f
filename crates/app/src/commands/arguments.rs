//! Which arguments make no sense? What the command line alone cannot check, answered with exit code 2.

use std::path::Path;

use anyhow::Result;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use pipeline::log::ImageMode;

/// Arguments that cannot be meant.
#[derive(Debug)]
pub struct WrongArguments(pub String);

impl std::fmt::Display for WrongArguments {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for WrongArguments {}

/// Longest simulation, seconds: a month.
const LONGEST: f64 = 2_678_400.0;

/// A duration on the command line, seconds.
pub fn duration(text: &str) -> Result<f64, String> {
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
pub fn image_mode() -> impl TypedValueParser<Value = ImageMode> {
    PossibleValuesParser::new(ImageMode::ALL.map(ImageMode::name))
        .map(|name| ImageMode::named(&name).unwrap_or_default())
}

/// Refuses two outputs of one name: the second would overwrite the first.
pub fn distinct<'a>(outputs: impl IntoIterator<Item = Option<&'a Path>>) -> Result<()> {
    let mut seen: Vec<&Path> = Vec::new();
    for path in outputs.into_iter().flatten() {
        if seen.contains(&path) {
            return Err(
                WrongArguments(format!("{} is named for two outputs", path.display())).into(),
            );
        }
        seen.push(path);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_that_never_end_or_never_begin_are_refused() {
        for text in ["nan", "inf", "0", "-1", "soon"] {
            assert!(duration(text).is_err(), "{text}");
        }
        assert_eq!(duration("2.5"), Ok(2.5));
    }

    #[test]
    fn one_name_for_two_outputs_is_refused() {
        let (a, b) = (Path::new("a.csv"), Path::new("b.csv"));
        assert!(distinct([Some(a), None, Some(b)]).is_ok());
        assert!(distinct([Some(a), Some(b), Some(a)]).is_err());
    }
}
