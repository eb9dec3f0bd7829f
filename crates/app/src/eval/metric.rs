//! How accurate is a result? Metrics with their intervals and the paper's values.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

/// A measured number.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct Metric {
    /// ScenarioVariant of the experiment; empty if there is only one.
    pub variant: String,
    /// Preset or stage.
    pub method: String,
    /// Its name with its unit.
    pub name: &'static str,
    /// The value. None if nothing could be measured.
    pub value: Option<f64>,
    /// Its interval.
    pub interval: Option<Interval>,
    /// The paper's value.
    pub paper: Option<PaperValue>,
}

/// Interval of a value.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(crate) struct Interval {
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
    /// Its content: the true value with 95 % confidence, 90 % of all values, or the value of each run.
    pub kind: &'static str,
}

/// A value of the paper, as an experiment file gives it.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct PaperReference {
    /// ScenarioVariant or method that it belongs to; all if left out.
    pub variant: Option<String>,
    /// The metric's name, as `results.json` has it.
    pub figure: String,
    /// The value.
    pub value: f64,
    /// Upper end, if the paper gives a range.
    pub until: Option<f64>,
    /// Section, table or figure of the paper.
    pub place: String,
}

/// A value of the paper next to a metric.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct PaperValue {
    /// The value.
    pub value: f64,
    /// Upper end of a range.
    pub until: Option<f64>,
    /// Section, table or figure of the paper.
    pub place: String,
}

/// Errors within which a pose counts as correct.
pub(super) struct PoseTolerance {
    /// Position, metres.
    pub(super) position: f32,
    /// Heading, radians.
    pub(super) heading: f32,
}

impl PoseTolerance {
    /// True if an error in x, y (metres) and heading (radians) is within the tolerance.
    pub(super) fn contains(&self, [x, y, heading]: [f32; 3]) -> bool {
        x.hypot(y) < self.position && heading.abs() < self.heading
    }
}

const CONFIDENCE_LABEL: &str = "95 % confidence";

/// Student's t, two-sided 95 %, for 1 to 20 degrees of freedom.
const STUDENT_T_95: [f64; 20] = [
    12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160,
    2.145, 2.131, 2.120, 2.110, 2.101, 2.093, 2.086,
];

/// Beyond 20 degrees of freedom the value lies between 1.96 and 2.08; 2.1 bounds it.
fn student_t_95(freedom: usize) -> f64 {
    STUDENT_T_95.get(freedom - 1).copied().unwrap_or(2.1)
}

/// Resamples of a bootstrap: the ends of its interval are accurate to some percent.
const BOOTSTRAP_RESAMPLES: usize = 1000;

fn sample_std(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let count = values.clone().count() as f64;
    let mean = values.clone().sum::<f64>() / count;
    (values.map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0)).sqrt()
}

impl Metric {
    /// A number without an interval.
    pub(crate) fn without_interval(
        variant: &str,
        method: &str,
        name: &'static str,
        value: Option<f64>,
    ) -> Self {
        Metric {
            variant: variant.to_owned(),
            method: method.to_owned(),
            name,
            value,
            interval: None,
            paper: None,
        }
    }

    /// The mean of independent values: one per run, because errors within a run are correlated.
    pub(crate) fn mean(variant: &str, method: &str, name: &'static str, values: &[f64]) -> Self {
        let count = values.len() as f64;
        let mean = (!values.is_empty()).then(|| values.iter().sum::<f64>() / count);
        let interval = mean.filter(|_| values.len() > 1).map(|mean| {
            let variance = values
                .iter()
                .map(|value| (value - mean).powi(2))
                .sum::<f64>()
                / (count - 1.0);
            let half = student_t_95(values.len() - 1) * (variance / count).sqrt();
            // What cannot be negative has no negative mean: durations, sizes of errors.
            let is_signed = values.iter().any(|value| *value < 0.0);
            let least = if is_signed { f64::NEG_INFINITY } else { 0.0 };
            Interval {
                low: (mean - half).max(least),
                high: mean + half,
                kind: CONFIDENCE_LABEL,
            }
        });
        Metric {
            interval,
            ..Metric::without_interval(variant, method, name, mean)
        }
    }

    /// A proportion in percent, with the Wilson score interval.
    pub(crate) fn proportion(
        variant: &str,
        method: &str,
        name: &'static str,
        hits: usize,
        count: usize,
    ) -> Self {
        let mut figure = Metric::without_interval(variant, method, name, None);
        if count > 0 {
            let (n, z) = (count as f64, 1.96_f64);
            let p = hits as f64 / n;
            let middle = (p + z * z / (2.0 * n)) / (1.0 + z * z / n);
            let half = z * (p * (1.0 - p) / n + z * z / (4.0 * n * n)).sqrt() / (1.0 + z * z / n);
            figure.value = Some(100.0 * p);
            figure.interval = Some(Interval {
                low: 100.0 * (middle - half).max(0.0),
                high: 100.0 * (middle + half).min(1.0),
                kind: CONFIDENCE_LABEL,
            });
        }
        figure
    }

    /// A proportion or rate in percent over clusters, (hits, count) each, with the interval of a ratio of sums.
    ///
    /// The clusters are the sample, not their frames, which are correlated. If the clusters have no hits or only hits,
    /// the interval is Wilson's over the clusters.
    pub(crate) fn clustered_proportion(
        variant: &str,
        method: &str,
        name: &'static str,
        clusters: &[(usize, usize)],
    ) -> Self {
        let clusters: Vec<(f64, f64)> = clusters
            .iter()
            .filter(|(_, count)| *count > 0)
            .map(|&(hits, count)| (hits as f64, count as f64))
            .collect();
        let mut figure = Metric::without_interval(variant, method, name, None);
        let (hits, count) = clusters.iter().fold((0.0, 0.0), |(hits, count), cluster| {
            (hits + cluster.0, count + cluster.1)
        });
        if clusters.is_empty() {
            return figure;
        }
        let (p, k) = (hits / count, clusters.len() as f64);
        figure.value = Some(100.0 * p);
        if hits == 0.0 || hits == count {
            let all = if hits == 0.0 { 0 } else { clusters.len() };
            figure.interval = Metric::proportion("", "", name, all, clusters.len()).interval;
        } else if clusters.len() > 1 {
            let squares: f64 = clusters.iter().map(|(h, n)| (h - p * n).powi(2)).sum();
            let half = student_t_95(clusters.len() - 1) * (k / (k - 1.0) * squares).sqrt() / count;
            // A proportion is at most 1; a rate (several in a frame) is not bounded.
            let is_proportion = clusters.iter().all(|(hits, count)| hits <= count);
            let upper_bound = if is_proportion { 1.0 } else { f64::INFINITY };
            figure.interval = Some(Interval {
                low: 100.0 * (p - half).max(0.0),
                high: 100.0 * (p + half).min(upper_bound),
                kind: CONFIDENCE_LABEL,
            });
        }
        figure
    }

    /// The maximum over the runs, with the range of the runs' maxima.
    pub(crate) fn maximum(variant: &str, method: &str, name: &'static str, runs: &[f64]) -> Self {
        let high = runs.iter().copied().reduce(f64::max);
        let low = runs.iter().copied().reduce(f64::min);
        let interval = low.zip(high).filter(|_| runs.len() > 1);
        Metric {
            interval: interval.map(|(low, high)| Interval {
                low,
                high,
                kind: "of each run",
            }),
            ..Metric::without_interval(variant, method, name, high)
        }
    }

    /// Standard deviation of independent values, with a bootstrap interval: errors have heavy tails, for which the χ²
    /// interval of Gaussian values is too narrow.
    pub(crate) fn std_dev(variant: &str, method: &str, name: &'static str, values: &[f64]) -> Self {
        let mut figure = Metric::without_interval(variant, method, name, None);
        if values.len() < 2 {
            return figure;
        }
        figure.value = Some(sample_std(values.iter().copied()));
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut resampled: Vec<f64> = (0..BOOTSTRAP_RESAMPLES)
            .map(|_| {
                let resample: Vec<f64> = values
                    .iter()
                    .map(|_| values[rng.random_range(0..values.len())])
                    .collect();
                sample_std(resample.into_iter())
            })
            .collect();
        resampled.sort_by(f64::total_cmp);
        figure.interval = Some(Interval {
            low: resampled[BOOTSTRAP_RESAMPLES / 40],
            high: resampled[BOOTSTRAP_RESAMPLES - 1 - BOOTSTRAP_RESAMPLES / 40],
            kind: CONFIDENCE_LABEL,
        });
        figure
    }

    /// The median, with the range of the middle 90 % of the values.
    pub(crate) fn median(
        variant: &str,
        method: &str,
        name: &'static str,
        mut values: Vec<f64>,
    ) -> Self {
        values.sort_by(f64::total_cmp);
        let mut figure = Metric::without_interval(variant, method, name, None);
        if let Some(last) = values.len().checked_sub(1) {
            let quantile = |share: f64| values[(share * last as f64).round() as usize];
            figure.value = Some(quantile(0.5));
            figure.interval = Some(Interval {
                low: quantile(0.05),
                high: quantile(0.95),
                kind: "5 to 95 %",
            });
        }
        figure
    }

    /// Attaches the paper's value, if the paper has one.
    pub(crate) fn attach_paper_value(&mut self, references: &[PaperReference]) {
        let matches = |reference: &&PaperReference| {
            reference.figure == self.name
                && reference
                    .variant
                    .as_ref()
                    .is_none_or(|name| *name == self.variant || *name == self.method)
        };
        self.paper = references.iter().find(matches).map(|reference| PaperValue {
            value: reference.value,
            until: reference.until,
            place: reference.place.clone(),
        });
    }

    /// One line of the table on the terminal.
    pub(crate) fn table_line(&self) -> String {
        let value = self.value.map_or_else(|| "–".to_owned(), format_value);
        let interval = self.interval.map_or_else(String::new, |interval| {
            format!(
                "[{}, {}]",
                format_value(interval.low),
                format_value(interval.high)
            )
        });
        let paper = self
            .paper
            .as_ref()
            .map_or_else(String::new, |paper| match paper.until {
                Some(until) => format!("{} to {}", format_value(paper.value), format_value(until)),
                None => format_value(paper.value),
            });
        format!(
            "{:<26} {:<14} {:<35} {value:>10} {interval:<22} {paper}",
            self.variant, self.method, self.name
        )
        .trim_end()
        .to_owned()
    }
}

/// Three or four significant digits.
fn format_value(value: f64) -> String {
    let digits = match value.abs() {
        size if size >= 100.0 => 1,
        size if size >= 1.0 => 2,
        size if size >= 0.01 || size == 0.0 => 3,
        _ => 5,
    };
    format!("{value:.digits$}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mean_has_a_student_t_interval() {
        // Five values with mean 3 and deviation 1.5811: half width 2.776 · 1.5811 / √5.
        let figure = Metric::mean("", "", "cm", &[1.0, 2.0, 3.0, 4.0, 5.0]);
        let interval = figure.interval.expect("five values");
        assert!((interval.high - 4.9629).abs() < 1e-3 && (interval.low - 1.0371).abs() < 1e-3);
        let low = |values: &[f64]| Metric::mean("", "", "s", values).interval.map(|it| it.low);
        assert_eq!(low(&[1.4, 1.9]), Some(0.0));
        assert!(low(&[-1.4, 1.9]).is_some_and(|low| low < -10.0));
        assert_eq!(Metric::mean("", "", "cm", &[2.0]).interval, None);
        assert_eq!(Metric::mean("", "", "cm", &[]).value, None);
    }

    #[test]
    fn proportion_of_all_hits_has_a_wilson_lower_bound_below_100() {
        let figure = Metric::proportion("", "", "%", 90, 90);
        let interval = figure.interval.expect("counted");
        assert_eq!(figure.value, Some(100.0));
        assert!((interval.high - 100.0).abs() < 1e-9, "{interval:?}");
        assert!((interval.low - 95.9).abs() < 0.1, "{interval:?}");
    }

    #[test]
    fn correlated_frames_of_a_segment_count_as_one_sample() {
        // Ten clusters of 100 frames, two of them lost: a sample of 10, not of 1000.
        let clusters: Vec<(usize, usize)> =
            (0..10).map(|k| (100 * usize::from(k < 2), 100)).collect();
        let figure = Metric::clustered_proportion("", "", "%", &clusters);
        let interval = figure.interval.expect("ten clusters");
        // 2.262 · sqrt(10/9 · (2·80² + 8·20²)) / 1000 = 30.2 %.
        assert!((figure.value.expect("counted") - 20.0).abs() < 1e-9);
        assert!((interval.high - 50.16).abs() < 0.05, "{interval:?}");
        assert_eq!(interval.low, 0.0);
        let no_hits = Metric::clustered_proportion("", "", "%", &[(0, 30); 4]).interval;
        assert!((no_hits.expect("four clusters").high - 49.0).abs() < 0.1);
        assert_eq!(
            Metric::clustered_proportion("", "", "%", &[(0, 0)]).value,
            None
        );
    }

    #[test]
    fn std_dev_interval_contains_the_value_and_shrinks_with_sample_size() {
        let width = |count: u32| {
            let values: Vec<f64> = (0..count).map(|k| f64::from((k * 37) % 101)).collect();
            let figure = Metric::std_dev("", "", "cm", &values);
            let (value, interval) = figure.value.zip(figure.interval).expect("many values");
            assert!(interval.low < value && value < interval.high);
            interval.high - interval.low
        };
        let (few, many) = (width(25), width(400));
        assert!((2.0..8.0).contains(&(few / many)), "{few} {many}");
    }

    #[test]
    fn paper_value_is_attached_to_its_own_variant_only() {
        let references = [PaperReference {
            variant: Some("half".to_owned()),
            figure: "cm".to_owned(),
            value: 7.0,
            until: None,
            place: "table 1".to_owned(),
        }];
        let paper = |variant| {
            let mut figure = Metric::without_interval(variant, "default", "cm", Some(1.0));
            figure.attach_paper_value(&references);
            figure.paper.map(|paper| paper.value)
        };
        assert_eq!((paper("half"), paper("none")), (Some(7.0), None));
    }
}
