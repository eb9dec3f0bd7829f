//! Reading a TOML file.

use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;
use toml::de::{DeTable, DeValue};

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
    #[error("{}: {reason}", path.display())]
    Parse {
        /// The file.
        path: PathBuf,
        /// With the line.
        reason: String,
    },
    /// The file says nothing, and something is needed.
    #[error("{}: an empty file: {reason}", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
        /// What is missing.
        reason: String,
    },
    /// A number that would become infinite.
    #[error("{}: line {line}: {number} is too large a number", path.display())]
    Number {
        /// The file.
        path: PathBuf,
        /// Counted from 1.
        line: usize,
        /// As the file has it.
        number: String,
    },
}

impl TomlFileError {
    /// The error of a file's content.
    pub fn parse(path: &Path, source: toml::de::Error) -> Self {
        TomlFileError::Parse {
            path: path.to_owned(),
            reason: in_plain_words(&source),
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
    let value = parse(path, &text)?;
    Ok((value, text))
}

/// The value in `text`, the content of the file `path`.
pub fn parse<T: DeserializeOwned>(path: &Path, text: &str) -> Result<T, TomlFileError> {
    // Invalid TOML is refused below, with a better message.
    let numbers = DeTable::parse(text).ok();
    let too_large = numbers.and_then(|document| {
        document
            .get_ref()
            .values()
            .find_map(|value| too_large_number(value.get_ref(), value.span().start))
    });
    if let Some((start, number)) = too_large {
        return Err(TomlFileError::Number {
            path: path.to_owned(),
            line: 1 + text[..start].matches('\n').count(),
            number,
        });
    }
    toml::from_str(text).map_err(|source| match text.parse::<toml::Table>() {
        Ok(table) if table.is_empty() => TomlFileError::Empty {
            path: path.to_owned(),
            reason: source.message().to_owned(),
        },
        _ => TomlFileError::parse(path, source),
    })
}

/// What a parser of TOML says, without the names that a type has in the program.
pub fn in_plain_words(error: &toml::de::Error) -> String {
    const WORDS: [(&[&str], &str); 3] = [
        (
            &["u8", "u16", "u32", "u64", "usize"],
            "a whole number from 0 on",
        ),
        (&["i8", "i16", "i32", "i64", "isize"], "a whole number"),
        (&["f32", "f64"], "a number"),
    ];
    let text = error.to_string();
    let lines = text.lines().map(|line| {
        let (reason, expected) = line.rsplit_once(", expected ")?;
        let (_, words) = WORDS.iter().find(|(types, _)| types.contains(&expected))?;
        Some(format!("{reason} (expected {words})"))
    });
    let lines = text.lines().zip(lines);
    let lines = lines.map(|(line, plain)| plain.unwrap_or_else(|| line.to_owned()));
    lines.collect::<Vec<String>>().join("\n")
}

/// A number in a value that starts at `start` which has no place in 32 bits, with its own start. It would become infinite.
fn too_large_number(value: &DeValue<'_>, start: usize) -> Option<(usize, String)> {
    match value {
        DeValue::Float(float) => {
            let text = float.as_str();
            let number: f64 = text.parse().ok()?;
            let is_finite = !text.contains("inf") && !number.is_nan();
            (is_finite && number.abs() > f64::from(f32::MAX)).then(|| (start, text.to_owned()))
        }
        DeValue::Array(values) => values
            .iter()
            .find_map(|value| too_large_number(value.get_ref(), value.span().start)),
        DeValue::Table(table) => table
            .values()
            .find_map(|value| too_large_number(value.get_ref(), value.span().start)),
        DeValue::String(_) | DeValue::Integer(_) | DeValue::Boolean(_) | DeValue::Datetime(_) => {
            None
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn value_of_another_type_is_refused_without_names_of_the_program() {
        #[derive(Debug, serde::Deserialize)]
        struct Sizes {
            #[serde(rename = "width")]
            _width: usize,
            #[serde(rename = "height")]
            _height: Option<f32>,
        }
        for (text, wanted) in [
            (
                "width = -3",
                "integer `-3` (expected a whole number from 0 on)",
            ),
            ("width = 3.5", "`3.5` (expected a whole number from 0 on)"),
            (
                "width = 1\nheight = \"x\"",
                "string \"x\" (expected a number)",
            ),
        ] {
            let message = parse::<Sizes>(Path::new("a.toml"), text).expect_err("another type");
            assert!(message.to_string().contains(wanted), "{message}");
        }
    }

    #[test]
    fn empty_file_is_named_as_one_where_something_is_needed() {
        #[derive(Debug, serde::Deserialize)]
        struct Needs {
            #[serde(rename = "robot")]
            _robot: String,
        }
        for text in ["", "# nothing\n\n"] {
            let message = parse::<Needs>(Path::new("a.toml"), text).expect_err("nothing in it");
            let wanted = "a.toml: an empty file: missing field `robot`";
            assert_eq!(message.to_string(), wanted);
            parse::<toml::Table>(Path::new("a.toml"), text).expect("nothing is needed");
        }
        let message = parse::<Needs>(Path::new("a.toml"), "a = 1").expect_err("no robot");
        assert!(!message.to_string().contains("empty"), "{message}");
    }

    #[test]
    fn number_that_would_become_infinite_is_refused_as_it_is_written() {
        for (text, line) in [
            ("a = 1\nb = 1e300\n", 2),
            ("[c]\n\nd = [1.0, { e = -1e39 }]\n", 3),
            ("a = 1e400\n", 1),
        ] {
            let parsed = parse::<toml::Table>(Path::new("robot.toml"), text);
            let message = parsed.expect_err("refused").to_string();
            assert!(
                message.starts_with(&format!("robot.toml: line {line}: "))
                    && message.ends_with("is too large a number"),
                "{message}"
            );
        }
        for text in ["a = 3e38", "a = inf", "a = nan", "a = 9223372036854775807"] {
            parse::<toml::Table>(Path::new("robot.toml"), text).expect(text);
        }
    }
}
