//! Values of some fields in one cycle, at once: a curve of a long log has not been read to the shown moment yet.

use std::collections::BTreeMap;

use localize::Stamp;
use pipeline::Cycle;
use pipeline::log::columns::FieldValue;

use super::live_fields::LiveFields;

/// Fields of the shown cycle.
#[derive(Default)]
pub(crate) struct CycleValues {
    live: Option<LiveFields>,
    paths: Vec<String>,
    of: Option<Stamp>,
    values: BTreeMap<String, FieldValue>,
}

impl CycleValues {
    /// Reads the fields of a cycle, if they are not those of the last call.
    pub(crate) fn update(&mut self, cycle: &Cycle, paths: &[String]) -> anyhow::Result<()> {
        if self.paths != paths || self.live.is_none() {
            let mut live = LiveFields::new()?;
            for path in paths {
                live.select(path)?;
            }
            self.live = Some(live);
            self.paths = paths.to_vec();
            self.of = None;
        }
        if self.of.replace(cycle.stamp) == Some(cycle.stamp) {
            return Ok(());
        }
        self.values.clear();
        let values = &mut self.values;
        match &mut self.live {
            Some(live) => live.visit(cycle, |path, _, value| {
                values.insert(path.to_owned(), value);
            }),
            None => Ok(()),
        }
    }

    /// The value of a field; absent if the cycle does not hold it.
    pub(crate) fn get(&self, path: &str) -> &FieldValue {
        self.values.get(path).unwrap_or(&FieldValue::Absent)
    }
}
