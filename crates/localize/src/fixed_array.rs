//! Settings with a fixed number of values. TOML's deserializer ignores additional values; here they are an error.

use serde::{Deserialize, Deserializer};

/// For `#[serde(deserialize_with)]`: an array of exactly `N` values.
pub fn deserialize<'de, D, T, const N: usize>(deserializer: D) -> Result<[T; N], D::Error>
where
    D: Deserializer<'de>,
    T: Deserialize<'de>,
{
    exactly(Vec::deserialize(deserializer)?)
}

/// As [`deserialize`], for a list of such arrays.
pub fn deserialize_rows<'de, D, T, const N: usize>(deserializer: D) -> Result<Vec<[T; N]>, D::Error>
where
    D: Deserializer<'de>,
    T: Deserialize<'de>,
{
    let rows = Vec::<Vec<T>>::deserialize(deserializer)?;
    rows.into_iter().map(exactly).collect()
}

/// As [`deserialize`], for a key that may be absent.
pub fn deserialize_optional<'de, D, T, const N: usize>(
    deserializer: D,
) -> Result<Option<[T; N]>, D::Error>
where
    D: Deserializer<'de>,
    T: Deserialize<'de>,
{
    let values = Option::<Vec<T>>::deserialize(deserializer)?;
    values.map(exactly).transpose()
}

fn exactly<T, E: serde::de::Error, const N: usize>(values: Vec<T>) -> Result<[T; N], E> {
    let count = values.len();
    let wrong = |_| E::custom(format!("{N} numbers are wanted, not {count}"));
    values.try_into().map_err(wrong)
}
