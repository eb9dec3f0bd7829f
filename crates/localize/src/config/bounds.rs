//! Is every numeric setting in its valid range? One traversal of the settings as TOML, one error type.

use serde::Serialize;
use toml::Value;

/// The range of one numeric setting, both ends included.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bound {
    /// Dotted path below the section. `*` stands for any one name; elements of an array share the array's path.
    pub key: &'static str,
    /// Smallest valid value.
    pub min: f64,
    /// Largest valid value.
    pub max: f64,
    /// Reason for the range.
    pub why: &'static str,
}

/// A setting with an invalid value.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{key} = {}: must be between {min} and {max} ({why})", shortest(*value))]
pub struct SettingError {
    /// Full dotted path, as in `localize.branch_and_bound.cell`; elements of arrays as `bumpers[2].width_px`.
    pub key: String,
    /// The value.
    pub value: f64,
    /// Smallest valid value.
    pub min: f64,
    /// Largest valid value.
    pub max: f64,
    /// Reason for the range.
    pub why: &'static str,
}

/// Constructs a bound in a table.
pub const fn bound(key: &'static str, min: f64, max: f64, why: &'static str) -> Bound {
    Bound { key, min, max, why }
}

impl Bound {
    /// Returns an error for a value outside the bound, including NaN. `key`: full path, for the error.
    pub fn check(&self, key: &str, value: f64) -> Result<(), SettingError> {
        // Settings are f32. Comparison in f32 makes the bound 0.1 include the setting 0.1.
        let [single, min, max] = [value, self.min, self.max].map(|number| number as f32);
        if single >= min && single <= max {
            return Ok(());
        }
        Err(SettingError {
            key: key.to_owned(),
            value,
            min: self.min,
            max: self.max,
            why: self.why,
        })
    }

    /// True if the bound applies to the setting at `path` below the section.
    fn covers(&self, path: &[&str]) -> bool {
        let mut names = self.key.split('.');
        path.iter().all(|step| {
            names
                .next()
                .is_some_and(|name| name == "*" || name == *step)
        }) && names.next().is_none()
    }
}

/// Checks every number of `settings` that a bound covers. `section`: the path of the settings, as in `localize`.
pub fn check_bounds(
    section: &str,
    settings: &impl Serialize,
    bounds: &[Bound],
) -> Result<(), SettingError> {
    let table = Value::try_from(settings).map_err(|_error| SettingError {
        key: section.to_owned(),
        value: f64::INFINITY,
        min: i64::MIN as f64,
        max: i64::MAX as f64,
        why: "a whole number must fit 64 bits with sign",
    })?;
    let mut checked = Ok(());
    visit_numbers(&table, &mut |path, key, value| {
        if checked.is_ok()
            && let Some(bound) = bounds.iter().find(|bound| bound.covers(path))
        {
            checked = bound.check(&format!("{section}.{key}"), value);
        }
    });
    checked
}

/// Paths of all numbers of `settings` that no bound covers.
pub fn unbounded_settings(settings: &impl Serialize, bounds: &[Bound]) -> Vec<String> {
    let mut missing = Vec::new();
    let table = Value::try_from(settings).unwrap_or(Value::Boolean(false));
    visit_numbers(&table, &mut |path, key, _| {
        if !bounds.iter().any(|bound| bound.covers(path)) {
            missing.push(key.to_owned());
        }
    });
    missing
}

/// Calls `visit` for each number with its path, its key (with the indices of arrays) and its value.
fn visit_numbers<'a>(root: &'a Value, visit: &mut impl FnMut(&[&'a str], &str, f64)) {
    visit_value(root, &mut Vec::new(), String::new(), visit);
}

fn visit_value<'a>(
    value: &'a Value,
    path: &mut Vec<&'a str>,
    key: String,
    visit: &mut impl FnMut(&[&'a str], &str, f64),
) {
    match value {
        Value::Integer(number) => visit(path, &key, *number as f64),
        Value::Float(number) => visit(path, &key, *number),
        Value::Table(table) => {
            for (name, value) in table {
                path.push(name);
                let dot = if key.is_empty() { "" } else { "." };
                visit_value(value, path, format!("{key}{dot}{name}"), visit);
                path.pop();
            }
        }
        Value::Array(values) => {
            for (index, value) in values.iter().enumerate() {
                visit_value(value, path, format!("{key}[{index}]"), visit);
            }
        }
        Value::String(_) | Value::Boolean(_) | Value::Datetime(_) => {}
    }
}

/// Formats an f32 setting without the additional digits of its conversion to f64.
fn shortest(value: f64) -> String {
    let single = value as f32;
    if f64::from(single) == value {
        single.to_string()
    } else {
        value.to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Serialize)]
    struct Settings {
        cell: f32,
        lists: Vec<[f32; 2]>,
        nested: Nested,
    }

    #[derive(Serialize)]
    struct Nested {
        count: usize,
    }

    const BOUNDS: [Bound; 3] = [
        bound("cell", 0.1, 1.0, "cells fill the memory"),
        bound("lists", 0.0, 5.0, "inside"),
        bound("*.count", 1.0, 9.0, "one at least"),
    ];

    fn check(cell: f32, last: f32, count: usize) -> Result<(), SettingError> {
        let settings = Settings {
            cell,
            lists: vec![[1.0, 2.0], [3.0, last]],
            nested: Nested { count },
        };
        assert_eq!(
            unbounded_settings(&settings, &BOUNDS[..1]),
            [
                "lists[0][0]",
                "lists[0][1]",
                "lists[1][0]",
                "lists[1][1]",
                "nested.count"
            ]
        );
        assert!(unbounded_settings(&settings, &BOUNDS).is_empty());
        check_bounds("section", &settings, &BOUNDS)
    }

    #[test]
    fn both_ends_of_a_bound_are_included_and_values_outside_are_named() {
        assert_eq!(check(0.1, 5.0, 9), Ok(()));
        for (cell, last, count, message) in [
            (
                0.05,
                5.0,
                9,
                "section.cell = 0.05: must be between 0.1 and 1 (cells fill the memory)",
            ),
            (
                f32::NAN,
                5.0,
                9,
                "section.cell = NaN: must be between 0.1 and 1 (cells fill the memory)",
            ),
            (
                0.1,
                6.0,
                9,
                "section.lists[1][1] = 6: must be between 0 and 5 (inside)",
            ),
            (
                0.1,
                5.0,
                0,
                "section.nested.count = 0: must be between 1 and 9 (one at least)",
            ),
        ] {
            let error = check(cell, last, count).expect_err(message);
            assert_eq!(error.to_string(), message);
        }
    }
}
