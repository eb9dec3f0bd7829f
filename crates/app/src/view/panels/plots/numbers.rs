//! Numbers behind the plots: thinned curves, limits that outliers do not stretch, histograms, spectra.

use std::f64::consts::TAU;

use crate::view::curves::Curve;

/// Points of a curve: time and value.
pub(super) type Points = Vec<[f64; 2]>;

/// Bins of a histogram.
const BINS: usize = 40;
/// Most samples of a spectrum: the latest ones in sight.
const SPECTRUM_SAMPLES: usize = 1024;
/// Share of the values at either end that limits ignore if they lie far outside.
const TAIL: f64 = 0.01;

/// The curve's points, at most about `points_max`: minimum and maximum of equal chunks of samples.
pub(super) fn thinned_curve(
    curve: Curve<'_>,
    (from, to): (f64, f64),
    scaled: impl Fn(f64) -> f64,
    points_max: usize,
) -> Points {
    let range = curve.between(from, to);
    let point = |index: usize| {
        let [time, value] = curve.point(index);
        [time, scaled(value)]
    };
    if range.len() <= points_max {
        let points = range.map(point);
        return points.filter(|[_, value]| value.is_finite()).collect();
    }
    let share = range.len().div_ceil(points_max / 2);
    let mut points = Vec::with_capacity(points_max);
    for start in range.clone().step_by(share) {
        let chunk = (start..(start + share).min(range.end)).map(point);
        let mut pair: Option<[[f64; 2]; 2]> = None;
        for at in chunk.filter(|[_, value]| value.is_finite()) {
            let [least, most] = pair.get_or_insert([at, at]);
            if at[1] < least[1] {
                *least = at;
            }
            if at[1] > most[1] {
                *most = at;
            }
        }
        if let Some(mut pair) = pair {
            pair.sort_by(|a, b| a[0].total_cmp(&b[0]));
            points.extend(pair);
        }
    }
    points
}

/// Limits of an axis, and whether values lie outside.
///
/// All values, unless the outermost hundredth of them would stretch the axis to more than twice what the others take.
pub(super) fn robust_limits(mut values: Vec<f64>) -> Option<([f64; 2], bool)> {
    values.sort_by(f64::total_cmp);
    let (first, last) = (*values.first()?, *values.last()?);
    let tail = (values.len() as f64 * TAIL).ceil() as usize;
    let inner = values.get(tail..values.len() - tail).unwrap_or(&[]);
    let (low, high) = match (inner.first(), inner.last()) {
        (Some(low), Some(high)) if last - first > 2.0 * (high - low) && high > low => (*low, *high),
        _ => (first, last),
    };
    let margin = (0.08 * (high - low)).max(1e-6 * high.abs().max(low.abs()).max(1.0));
    let clipped = first < low - margin || last > high + margin;
    Some(([low - margin, high + margin], clipped))
}

/// Counts of equal bins over the limits of the values: centre and width of each bin, and its count.
pub(super) fn histogram(values: &[f64]) -> (f64, Points) {
    let Some(([low, high], _)) = robust_limits(values.to_vec()) else {
        return (1.0, Vec::new());
    };
    let width = (high - low) / BINS as f64;
    let mut bins: Points = (0..BINS)
        .map(|bin| [low + (bin as f64 + 0.5) * width, 0.0])
        .collect();
    for value in values {
        let bin = ((value - low) / width).floor();
        if (0.0..BINS as f64).contains(&bin) {
            bins[bin as usize][1] += 1.0;
        }
    }
    (width, bins)
}

/// Amplitude over frequency (Hz) of the latest samples, by a discrete Fourier transform under a Hann window.
pub(super) fn spectrum(points: &[[f64; 2]]) -> Points {
    let points = &points[points.len().saturating_sub(SPECTRUM_SAMPLES)..];
    let (Some(first), Some(last)) = (points.first(), points.last()) else {
        return Vec::new();
    };
    let count = points.len() as f64;
    let interval = (last[0] - first[0]) / (count - 1.0);
    if !(interval > 0.0) {
        return Vec::new();
    }
    let mean = points.iter().map(|point| point[1]).sum::<f64>() / count;
    let windowed: Vec<f64> = points
        .iter()
        .enumerate()
        .map(|(index, point)| (point[1] - mean) * (1.0 - (TAU * index as f64 / count).cos()))
        .collect();
    (1..points.len() / 2)
        .map(|bin| {
            // Goertzel's recurrence: one multiplication a sample.
            let angle = TAU * bin as f64 / count;
            let factor = 2.0 * angle.cos();
            let (mut before, mut last) = (0.0, 0.0);
            for value in &windowed {
                (before, last) = (last, value + factor * last - before);
            }
            let power = last * last + before * before - factor * last * before;
            [
                bin as f64 / (count * interval),
                2.0 * power.max(0.0).sqrt() / count,
            ]
        })
        .collect()
}

/// A number with about four digits; `-` for NaN.
pub(super) fn short(value: f64) -> String {
    match value.abs() {
        size if size.is_nan() => "-".to_owned(),
        size if size >= 1000.0 => format!("{value:.0}"),
        size if size >= 10.0 => format!("{value:.1}"),
        size if size >= 0.1 || size == 0.0 => format!("{value:.2}"),
        _ => format!("{value:.4}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_outlier_does_not_flatten_the_curve_but_a_step_is_shown() {
        let mut values: Vec<f64> = (0..500).map(|index| f64::from(index % 10)).collect();
        values.push(1e6);
        let ([low, high], clipped) = robust_limits(values).expect("limits");
        assert!((-1.0..0.0).contains(&low) && (9.0..10.0).contains(&high) && clipped);
        let step: Vec<f64> = (0..100)
            .map(|index| if index < 50 { 0.0 } else { 5.0 })
            .collect();
        let ([_, high], clipped) = robust_limits(step).expect("limits");
        assert!(high > 5.0 && !clipped);
        assert_eq!(robust_limits(Vec::new()), None);
    }

    #[test]
    fn spectrum_has_its_peak_at_the_frequency_and_the_amplitude_of_a_sine() {
        let points: Points = (0..600)
            .map(|index| {
                let time = f64::from(index) / 30.0;
                [time, 4.0 + 1.5 * (TAU * 2.5 * time).sin()]
            })
            .collect();
        let spectrum = spectrum(&points);
        let peak = spectrum
            .iter()
            .max_by(|a, b| a[1].total_cmp(&b[1]))
            .expect("a peak");
        assert!((peak[0] - 2.5).abs() < 0.06, "{peak:?}");
        assert!((peak[1] - 1.5).abs() < 0.1, "{peak:?}");
    }

    #[test]
    fn histogram_counts_every_value_within_its_limits() {
        let values: Vec<f64> = (0..1000).map(|index| f64::from(index % 100)).collect();
        let (_, bins) = histogram(&values);
        assert_eq!(bins.iter().map(|bin| bin[1]).sum::<f64>(), 1000.0);
    }
}
