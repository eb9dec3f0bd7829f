//! What can be plotted: quantities of the cycles, any field of any topic, and formulas of both.

pub(crate) mod catalogue;
mod curve;
mod cycle_values;
mod formula;
mod live_fields;
mod sample_series;
mod store;

pub(crate) use self::curve::{Curve, FORMULA_MARK, unit_of};
pub(crate) use self::cycle_values::CycleValues;
pub(crate) use self::store::{CurveState, CurveStore};
