//! Which single values are changed on the command line? `path.speed=2.0` as a table that goes over a file's.

use anyhow::{Context, Result};

use crate::commands::arguments::UsageError;
use pipeline::config::merge_tables;

/// Tables of `KEY=VALUE` arguments: dotted keys, values as TOML writes them (a bare word is a text).
pub fn parse_overrides(assignments: &[String]) -> Result<toml::Table> {
    let mut whole = toml::Table::new();
    for assignment in assignments {
        let one = parse_assignment(assignment)
            .with_context(|| UsageError(format!("{assignment:?} is no KEY=VALUE")))?;
        merge_tables(&mut whole, one);
    }
    Ok(whole)
}

fn parse_assignment(assignment: &str) -> Result<toml::Table> {
    let (key, value) = assignment.split_once('=').context("it has no =")?;
    let (key, value) = (key.trim(), value.trim());
    match toml::from_str(&format!("{key} = {value}")) {
        Ok(table) => Ok(table),
        // A word that is no value of another kind is a text: no shell needs to keep its quotes.
        Err(_) => Ok(toml::from_str(&format!("{key} = {value:?}"))?),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dotted_keys_become_tables_and_bare_words_strings() {
        let given = [
            "path.speed=2.5",
            "path.repeat = false",
            "robot=a.toml",
            "start={x=1, y=2}",
        ];
        let table = parse_overrides(&given.map(str::to_owned)).expect("a table");
        let wanted: toml::Table = toml::from_str(
            "robot = 'a.toml'\nstart = { x = 1, y = 2 }\n[path]\nspeed = 2.5\nrepeat = false",
        )
        .expect("TOML");
        assert_eq!(table, wanted);
    }

    #[test]
    fn malformed_assignment_is_a_usage_error() {
        for given in ["speed", "=3", "a b=1"] {
            let error = parse_overrides(&[given.to_owned()]).expect_err(given);
            assert!(error.is::<UsageError>(), "{error:#}");
        }
    }
}
