//! Which values does the command line override? `path.speed=2.0` as a table that is merged into a file's.

use std::path::Path;

use anyhow::{Context, Result};
use localize::toml_file::{self, TomlFileError};

use crate::commands::arguments::UsageError;
use pipeline::config::merge_tables;

/// The table of `KEY=VALUE` arguments: dotted keys, values in TOML (a bare word is a string).
pub(crate) fn parse_overrides(assignments: &[String]) -> Result<toml::Table> {
    let mut table = toml::Table::new();
    for assignment in assignments {
        let single = parse_assignment(assignment).with_context(|| {
            UsageError(format!(
                "invalid assignment: {assignment:?} (expected KEY=VALUE)"
            ))
        })?;
        merge_tables(&mut table, single);
    }
    Ok(table)
}

fn parse_assignment(assignment: &str) -> Result<toml::Table> {
    let (key, value) = assignment.split_once('=').context("no =")?;
    let (key, value) = (key.trim(), value.trim());
    let place = Path::new("the command line");
    match toml_file::parse(place, &format!("{key} = {value}")) {
        Ok(table) => Ok(table),
        Err(error @ TomlFileError::Number { .. }) => Err(error.into()),
        // A word that is no TOML value is a string, so that it needs no quotes.
        Err(_) => Ok(toml::from_str(&format!("{key} = {value:?}"))?),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dotted_keys_become_tables_and_bare_words_strings() {
        let assignment = [
            "path.speed=2.5",
            "path.repeat = false",
            "robot=a.toml",
            "start={x=1, y=2}",
        ];
        let table = parse_overrides(&assignment.map(str::to_owned)).expect("a table");
        let wanted: toml::Table = toml::from_str(
            "robot = 'a.toml'\nstart = { x = 1, y = 2 }\n[path]\nspeed = 2.5\nrepeat = false",
        )
        .expect("TOML");
        assert_eq!(table, wanted);
    }

    #[test]
    fn malformed_assignment_is_a_usage_error() {
        for assignment in ["speed", "=3", "a b=1", "path.speed=1e300"] {
            let error = parse_overrides(&[assignment.to_owned()]).expect_err(assignment);
            assert!(error.is::<UsageError>(), "{error:#}");
        }
    }
}
