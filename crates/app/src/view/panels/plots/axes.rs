//! Marks and numbers of a plot's axes.

use egui_plot::{AxisHints, GridInput, GridMark};

/// Least distance of the marks below a plot, in those of the value axis: a number is wider than high.
const MARK_STRIDE: f64 = 3.0;
/// Distance at which labels below a plot appear, and at which they are opaque, points.
const LABEL_SPACING: std::ops::RangeInclusive<f32> = 20.0..=30.0;
/// Most marks of an axis.
const MARKS_MAX: f64 = 1000.0;

/// Marks of a value axis at multiples of 1, 2 or 5 times a power of ten.
pub(super) fn value_marks(input: GridInput) -> Vec<GridMark> {
    let decade = 10f64.powf(input.base_step_size.log10().floor());
    let steps = [1.0, 2.0, 5.0, 10.0].map(|factor| factor * decade);
    let step = steps
        .into_iter()
        .find(|step| *step >= input.base_step_size)
        .unwrap_or(10.0 * decade);
    let (first, last) = (input.bounds.0 / step, input.bounds.1 / step);
    if !(step > 0.0 && last - first < MARKS_MAX) {
        return Vec::new();
    }
    (first.ceil() as i64..=last.floor() as i64)
        .map(|number| GridMark {
            value: number as f64 * step,
            step_size: step,
        })
        .collect()
}

/// The axis below a plot.
pub(super) fn below<'a>(title: &str) -> AxisHints<'a> {
    let axis = AxisHints::new_x().label_spacing(LABEL_SPACING);
    let axis = axis.formatter(|mark, _| axis_value(mark.value, false));
    if title.is_empty() {
        axis
    } else {
        axis.label(title)
    }
}

/// Marks of the axis below a plot: as those of the value axis, but farther apart.
pub(super) fn marks_below(input: GridInput) -> Vec<GridMark> {
    value_marks(GridInput {
        base_step_size: MARK_STRIDE * input.base_step_size,
        ..input
    })
}

/// Text of a value.
pub(super) fn axis_value(value: f64, logarithmic: bool) -> String {
    let value = if logarithmic {
        10f64.powf(value)
    } else {
        value
    };
    match value.abs() {
        0.0 => "0".to_owned(),
        size if size < 0.001 => format!("{value:.0e}"),
        _ => {
            let text = format!("{value:.3}");
            text.trim_end_matches('0').trim_end_matches('.').to_owned()
        }
    }
}
