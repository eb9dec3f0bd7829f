//! Settings with a fixed number of values. TOML's deserializer ignores additional values; here they are an error.

use serde::{Deserialize, Deserializer};

/// For `#[serde(deserialize_with)]`: an array of exactly `N` values.
pub fn deserialize<'de, D, T, const N: usize>(deserializer: D) -> Result<[T; N], D::Error>
where
    D: Deserializer<'de>,
    T: Deserialize<'de>,
{
    let values = Vec::<T>::deserialize(deserializer)?;
    let count = values.len();
    let wrong = |_| serde::de::Error::custom(format!("{N} numbers are wanted, not {count}"));
    values.try_into().map_err(wrong)
}
