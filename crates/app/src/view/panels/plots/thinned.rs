//! The curves of a plot over time as they are drawn: computed again only when something has changed.

use egui_plot::PlotPoint;

use super::config::PlotConfig;
use super::numbers::{robust_limits, thinned_curve};
use super::plotted_curve::{PlottedCurve, scale};
use crate::view::curves::Curve;

/// What the drawn points depend on.
#[derive(Debug, Clone, PartialEq, Default)]
struct Key {
    range: (f64, f64),
    /// Number of parts without data, and the end of the last one.
    gaps: (usize, f64),
    points_max: usize,
    logarithmic: bool,
    thresholds: Vec<f64>,
    /// Of each curve: name, number of samples, thinning, first and last time.
    curves: Vec<(String, usize, usize, f64, f64)>,
}

/// The drawn points of a plot.
#[derive(Debug, Clone, Default)]
pub(super) struct ThinnedPlot {
    key: Option<Key>,
    /// Of each curve: its points, and those of other runs.
    pub(super) curves: Vec<(Vec<PlotPoint>, Vec<Vec<PlotPoint>>)>,
    /// Thresholds as the axis places them.
    pub(super) thresholds: Vec<f64>,
    /// Limits of the value axis.
    pub(super) limits: [f64; 2],
    /// Values lie outside the limits.
    pub(super) is_clipped: bool,
}

impl ThinnedPlot {
    /// Computes the points if they are not those of the last call.
    pub(super) fn update(
        &mut self,
        config: &PlotConfig,
        curves: &[PlottedCurve<'_>],
        (range, gaps): ((f64, f64), &[(f64, f64)]),
        points_max: usize,
    ) {
        let samples = curves.iter().flat_map(|one| {
            let others = one.others.iter().map(|(run, curve)| (*run, *curve));
            std::iter::once((one.name, one.curve)).chain(others)
        });
        let key = Key {
            range,
            gaps: (gaps.len(), gaps.last().map_or(0.0, |gap| gap.1)),
            points_max,
            logarithmic: config.logarithmic,
            thresholds: config.thresholds.clone(),
            curves: samples.map(|(name, curve)| state(name, curve)).collect(),
        };
        if self.key.as_ref() == Some(&key) {
            return;
        }
        let scaled = |value| scale(value, config.logarithmic);
        let thinned = |curve: Curve<'_>| -> Vec<PlotPoint> {
            let points = thinned_curve(curve, range, scaled, points_max);
            points.into_iter().map(PlotPoint::from).collect()
        };
        self.curves = curves
            .iter()
            .map(|one| {
                let others = one.others.iter().map(|(_, curve)| thinned(*curve));
                let mut own = thinned(one.curve);
                break_at_gaps(&mut own, gaps);
                (own, others.collect())
            })
            .collect();
        self.thresholds = config
            .thresholds
            .iter()
            .map(|value| scaled(*value))
            .collect();
        let drawn = self
            .curves
            .iter()
            .flat_map(|(own, others)| std::iter::once(own).chain(others))
            .flatten()
            .map(|point| point.y)
            .filter(|value| value.is_finite());
        let values = drawn.chain(self.thresholds.iter().copied()).collect();
        (self.limits, self.is_clipped) = robust_limits(values).unwrap_or(([0.0, 1.0], false));
        self.key = Some(key);
    }
}

/// Breaks a curve where there are no data: a point without a value ends a line.
fn break_at_gaps(points: &mut Vec<PlotPoint>, gaps: &[(f64, f64)]) {
    for (from, to) in gaps {
        let middle = (from + to) / 2.0;
        let behind = points.partition_point(|point| point.x <= middle);
        if (1..points.len()).contains(&behind) {
            points.insert(behind, PlotPoint::new(middle, f64::NAN));
        }
    }
}

#[test]
fn curve_is_broken_only_between_points_around_a_gap() {
    let mut points: Vec<PlotPoint> = [0.0, 1.0, 2.0].map(|x| PlotPoint::new(x, 5.0)).into();
    break_at_gaps(&mut points, &[(-2.0, -1.0), (1.2, 1.6), (3.0, 4.0)]);
    let values = points.iter().map(|point| point.y.is_finite());
    assert_eq!(values.collect::<Vec<_>>(), [true, true, false, true]);
}

fn state(name: &str, curve: Curve<'_>) -> (String, usize, usize, f64, f64) {
    let count = curve.len();
    let time = |index: usize| {
        if count == 0 {
            0.0
        } else {
            curve.point(index)[0]
        }
    };
    (
        name.to_owned(),
        count,
        curve.thinning(),
        time(0),
        time(count.saturating_sub(1)),
    )
}
