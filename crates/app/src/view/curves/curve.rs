//! Samples of anything that can be plotted.

use super::catalogue::PlottedQuantity;
use super::sample_series::SampleSeries;
use crate::view::time_series::TimeSeries;

/// What marks a formula among the names of curves.
pub(crate) const FORMULA_MARK: char = '=';

/// Samples of a curve in time order.
#[derive(Clone, Copy)]
pub(crate) enum Curve<'a> {
    /// A quantity of the cycles.
    Quantity(&'a TimeSeries, &'static PlottedQuantity),
    /// A field or a formula.
    Samples(&'a SampleSeries),
}

impl<'a> Curve<'a> {
    /// Number of samples.
    pub(crate) fn len(&self) -> usize {
        match self {
            Curve::Quantity(series, _) => series.samples().len(),
            Curve::Samples(series) => series.len(),
        }
    }

    /// Time (s) and value of a sample; NaN if it has no value.
    pub(crate) fn point(&self, index: usize) -> [f64; 2] {
        match self {
            Curve::Quantity(series, quantity) => {
                let sample = &series.samples()[index];
                [sample.time, quantity.of(sample)]
            }
            Curve::Samples(series) => series.point(index),
        }
    }

    /// Number of samples at or before a time.
    pub(crate) fn count_until(&self, time: f64) -> usize {
        match self {
            Curve::Quantity(series, _) => series.samples().partition_point(|s| s.time <= time),
            Curve::Samples(series) => series.count_until(time),
        }
    }

    fn count_before(&self, time: f64) -> usize {
        match self {
            Curve::Quantity(series, _) => series.samples().partition_point(|s| s.time < time),
            Curve::Samples(series) => series.count_before(time),
        }
    }

    /// Indices of the samples of an interval, with one more on each side if there is one.
    pub(crate) fn between(&self, from: f64, to: f64) -> std::ops::Range<usize> {
        let start = self.count_before(from).saturating_sub(1);
        let end = (self.count_until(to) + 1).min(self.len());
        start..end.max(start)
    }

    /// Finite samples of an interval.
    pub(crate) fn finite(&self, from: f64, to: f64) -> impl Iterator<Item = [f64; 2]> + '_ {
        let points = self.between(from, to).map(|index| self.point(index));
        points.filter(|[_, value]| value.is_finite())
    }

    /// The last value at or before a time; NaN if there is none.
    pub(crate) fn at(&self, time: f64) -> f64 {
        let index = self.count_until(time).checked_sub(1);
        index.map_or(f64::NAN, |index| self.point(index)[1])
    }

    /// Time of the last sample, seconds; minus infinity if there is none.
    pub(super) fn end(&self) -> f64 {
        let last = self.len().checked_sub(1);
        last.map_or(f64::NEG_INFINITY, |index| self.point(index)[0])
    }

    /// Changes when stored samples are thinned.
    pub(crate) fn thinning(&self) -> usize {
        match self {
            Curve::Quantity(series, _) => series.stride(),
            Curve::Samples(series) => series.thinning(),
        }
    }

    /// The text of a value; None for numbers.
    pub(crate) fn text(&self, value: f64) -> Option<&'a str> {
        match *self {
            Curve::Quantity(..) => None,
            Curve::Samples(series) => series.text(value),
        }
    }
}

/// Unit of a curve by its name: that of the quantity, or what the name of the field ends in.
pub(crate) fn unit_of(name: &str) -> &'static str {
    if let Some(quantity) = PlottedQuantity::named(name) {
        return quantity.unit;
    }
    if name.starts_with(FORMULA_MARK) {
        return "";
    }
    for (end, unit) in [("_ms", "ms"), ("_px", "px"), ("_ns", "ns"), ("_deg", "°")] {
        if name.ends_with(end) {
            return unit;
        }
    }
    ""
}
