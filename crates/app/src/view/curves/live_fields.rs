//! Fields of a live run: its cycles are converted to the messages that a log would hold.

use anyhow::Result;
use pipeline::Cycle;
use pipeline::log::LiveTopics;
use pipeline::log::columns::{Field, FieldValue};

/// The selected fields of a live run.
pub(super) struct LiveFields {
    topics: LiveTopics,
    fields: Vec<(String, Field)>,
    cycles: u64,
}

impl LiveFields {
    pub(super) fn new() -> Result<Self> {
        Ok(LiveFields {
            topics: LiveTopics::new()?,
            fields: Vec::new(),
            cycles: 0,
        })
    }

    /// Paths of all fields.
    pub(super) fn paths(&self) -> Vec<String> {
        let topics = self.topics.topics().iter();
        topics
            .flat_map(|(topic, about)| {
                let names = about.field_names(None).into_iter();
                names.map(move |name| format!("{topic}.{name}"))
            })
            .collect()
    }

    /// Selects a field.
    pub(super) fn select(&mut self, path: &str) -> Result<()> {
        let field = Field::find(self.topics.topics(), path)?;
        self.fields.push((path.to_owned(), field));
        Ok(())
    }

    /// Visits the values of the selected fields in a cycle: path, time (s) and value.
    pub(super) fn visit(
        &mut self,
        cycle: &Cycle,
        mut visit: impl FnMut(&str, f64, FieldValue),
    ) -> Result<()> {
        if self.fields.is_empty() {
            return Ok(());
        }
        self.cycles += 1;
        for message in self.topics.messages(self.cycles, cycle)? {
            for (path, field) in &self.fields {
                if field.topic() == message.topic {
                    let time = message.log_time as f64 * 1e-9;
                    visit(path, time, field.read(&message)?);
                }
            }
        }
        Ok(())
    }
}
