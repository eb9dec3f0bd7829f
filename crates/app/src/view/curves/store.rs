//! Which fields and formulas are in use, and what is known of them so far?

use std::collections::BTreeMap;

use pipeline::Cycle;
use pipeline::log::columns::FieldValue;

use super::catalogue::PlottedQuantity;
use super::curve::{Curve, FORMULA_MARK};
use super::formula::FormulaSeries;
use super::live_fields::LiveFields;
use super::sample_series::SampleSeries;
use crate::view::source::field_reader::{FieldEvent, FieldReader};
use crate::view::time_series::TimeSeries;

/// Batches of samples taken per drawn frame.
const BATCHES_PER_FRAME: usize = 48;

/// What is known of a curve.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum CurveState {
    /// More samples follow.
    Reading,
    /// All samples are read, or arrive as the run goes on.
    Complete,
    /// Why there are none.
    Failed(String),
}

struct FieldEntry {
    series: SampleSeries,
    state: CurveState,
}

/// Fields and formulas in use.
#[derive(Default)]
pub(crate) struct CurveStore {
    paths: Vec<String>,
    reader: Option<FieldReader>,
    live: Option<LiveFields>,
    fields: BTreeMap<String, FieldEntry>,
    formulas: BTreeMap<String, Result<FormulaSeries, String>>,
}

impl CurveStore {
    /// Reads the fields of a log.
    pub(crate) fn of_log(reader: FieldReader) -> Self {
        CurveStore {
            reader: Some(reader),
            ..CurveStore::default()
        }
    }

    /// Computes the fields of a live run from its cycles.
    pub(crate) fn of_live_run() -> anyhow::Result<Self> {
        let live = LiveFields::new()?;
        Ok(CurveStore {
            paths: live.paths(),
            live: Some(live),
            ..CurveStore::default()
        })
    }

    /// Paths of all fields of the source, as far as they are known.
    pub(crate) fn paths(&self) -> &[String] {
        &self.paths
    }

    /// Takes what the thread has read; true if there is anything.
    pub(crate) fn poll(&mut self) -> bool {
        let Some(reader) = &self.reader else {
            return false;
        };
        let mut changed = false;
        for event in reader.poll().take(BATCHES_PER_FRAME) {
            changed = true;
            match event {
                FieldEvent::Paths(paths) => self.paths = paths,
                FieldEvent::Samples(path, samples) => {
                    if let Some(entry) = self.fields.get_mut(&path) {
                        for (time, value) in samples {
                            push(&mut entry.series, time, value);
                        }
                    }
                }
                FieldEvent::Complete(path) => {
                    set_state(&mut self.fields, &path, CurveState::Complete)
                }
                FieldEvent::Failed(path, reason) => {
                    set_state(&mut self.fields, &path, CurveState::Failed(reason));
                }
            }
        }
        changed
    }

    /// Takes the fields of a cycle of a live run.
    pub(crate) fn push_live(&mut self, cycle: &Cycle) {
        let fields = &mut self.fields;
        if let Some(live) = &mut self.live {
            let visited = live.visit(cycle, |path, time, value| {
                if let Some(entry) = fields.get_mut(path) {
                    push(&mut entry.series, time, value);
                }
            });
            if let Err(error) = visited {
                for entry in fields.values_mut() {
                    entry.state = CurveState::Failed(format!("{error:#}"));
                }
            }
        }
    }

    /// Starts to read a field or to compute a formula, if that has not begun yet.
    pub(crate) fn request(&mut self, name: &str) {
        if name.starts_with(FORMULA_MARK) {
            if !self.formulas.contains_key(name) {
                let parsed = FormulaSeries::parse(name).map_err(|error| format!("{error:#}"));
                self.formulas.insert(name.to_owned(), parsed);
            }
            let inputs = match self.formulas.get(name) {
                Some(Ok(formula)) => formula.inputs().map(str::to_owned).collect(),
                _ => Vec::new(),
            };
            inputs.iter().for_each(|input: &String| self.request(input));
        } else if PlottedQuantity::named(name).is_none() && !self.fields.contains_key(name) {
            let state = match (&mut self.live, &self.reader) {
                (Some(live), _) => match live.select(name) {
                    Ok(()) => CurveState::Complete,
                    Err(error) => CurveState::Failed(format!("{error:#}")),
                },
                (None, Some(reader)) if reader.request(name) => CurveState::Reading,
                // Asked again with the next frame.
                (None, Some(_)) => return,
                (None, None) => CurveState::Failed("no source".to_owned()),
            };
            let series = SampleSeries::default();
            let entry = FieldEntry { series, state };
            self.fields.insert(name.to_owned(), entry);
        }
    }

    /// Computes new values of the formulas. `read`: the quantities of the run are complete.
    pub(crate) fn update_formulas(&mut self, quantities: &TimeSeries, read: bool) {
        for formula in self.formulas.values_mut().flatten() {
            let mut curves = Vec::new();
            let mut complete = true;
            for input in formula.inputs() {
                if let Some(quantity) = PlottedQuantity::named(input) {
                    curves.push(Curve::Quantity(quantities, quantity));
                    complete &= read;
                } else if let Some(entry) = self.fields.get(input) {
                    curves.push(Curve::Samples(&entry.series));
                    complete &= entry.state != CurveState::Reading && self.live.is_none();
                }
            }
            formula.update(&curves, complete);
        }
    }

    /// The curve of a name that was requested; None if it is unknown or invalid.
    pub(crate) fn curve<'a>(&'a self, name: &str, quantities: &'a TimeSeries) -> Option<Curve<'a>> {
        if let Some(quantity) = PlottedQuantity::named(name) {
            return Some(Curve::Quantity(quantities, quantity));
        }
        if let Some(Ok(formula)) = self.formulas.get(name) {
            return Some(Curve::Samples(&formula.series));
        }
        let entry = self.fields.get(name)?;
        Some(Curve::Samples(&entry.series))
    }

    /// What is known of a curve.
    pub(crate) fn state(&self, name: &str) -> CurveState {
        match (self.formulas.get(name), self.fields.get(name)) {
            (Some(Err(reason)), _) => CurveState::Failed(reason.clone()),
            (Some(Ok(formula)), _) => {
                let states = formula.inputs().map(|input| self.state(input));
                let worst = states.filter(|state| *state != CurveState::Complete);
                worst.last().unwrap_or(CurveState::Complete)
            }
            (None, Some(entry)) => entry.state.clone(),
            (None, None) => CurveState::Complete,
        }
    }
}

fn set_state(fields: &mut BTreeMap<String, FieldEntry>, path: &str, state: CurveState) {
    if let Some(entry) = fields.get_mut(path) {
        entry.state = state;
    }
}

fn push(series: &mut SampleSeries, time: f64, value: FieldValue) {
    match value {
        FieldValue::Number(value) => series.push(time, value),
        FieldValue::Text(text) => series.push_text(time, &text),
        FieldValue::Absent => series.push(time, f64::NAN),
    }
}
