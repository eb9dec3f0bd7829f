//! Samples of one field over a run of any length, in bounded memory.

/// Capacity. When it is reached, each four samples become their least and their greatest one.
const SAMPLES_MAX: usize = 400_000;
/// Different texts of a field that are kept apart.
const TEXTS_MAX: usize = 1000;

/// Samples in time order. Peaks survive the thinning of a long run.
#[derive(Debug, Clone, Default)]
pub(crate) struct SampleSeries {
    times: Vec<f64>,
    values: Vec<f64>,
    /// Samples that are not stored yet, because two of `group` are kept.
    pending: Vec<[f64; 2]>,
    /// Samples of which the least and the greatest are kept; 0 or 1: all are kept.
    group: usize,
    /// Texts whose indices are the values; empty for numbers.
    texts: Vec<String>,
}

impl SampleSeries {
    /// Number of stored samples.
    pub(crate) fn len(&self) -> usize {
        self.times.len()
    }

    /// Time (s) and value of a stored sample.
    pub(crate) fn point(&self, index: usize) -> [f64; 2] {
        [self.times[index], self.values[index]]
    }

    /// Number of stored samples before a time.
    pub(crate) fn count_before(&self, time: f64) -> usize {
        self.times.partition_point(|at| *at < time)
    }

    /// Number of stored samples at or before a time.
    pub(crate) fn count_until(&self, time: f64) -> usize {
        self.times.partition_point(|at| *at <= time)
    }

    /// The text of a value; None for numbers.
    pub(crate) fn text(&self, value: f64) -> Option<&str> {
        let index = (value >= 0.0).then_some(value as usize)?;
        self.texts.get(index).map(String::as_str)
    }

    /// Samples of which two are kept: changes when the stored samples are thinned.
    pub(crate) fn thinning(&self) -> usize {
        self.group.max(1)
    }

    /// Adds a text.
    pub(crate) fn push_text(&mut self, time: f64, text: &str) {
        let known = self.texts.iter().position(|known| known == text);
        let index = known.unwrap_or_else(|| {
            if self.texts.len() < TEXTS_MAX {
                self.texts.push(text.to_owned());
            }
            self.texts.len() - 1
        });
        self.push(time, index as f64);
    }

    /// Adds a sample; NaN: no value. A time from the past restarts the series.
    pub(crate) fn push(&mut self, time: f64, value: f64) {
        let last = self.pending.last().map(|point| point[0]);
        if last
            .or(self.times.last().copied())
            .is_some_and(|last| time < last)
        {
            *self = SampleSeries::default();
        }
        if self.group <= 1 {
            self.store([time, value]);
        } else {
            self.pending.push([time, value]);
            if self.pending.len() >= self.group {
                for point in extremes(&std::mem::take(&mut self.pending)) {
                    self.store(point);
                }
            }
        }
        if self.times.len() >= SAMPLES_MAX {
            self.thin();
        }
    }

    fn store(&mut self, [time, value]: [f64; 2]) {
        self.times.push(time);
        self.values.push(value);
    }

    fn thin(&mut self) {
        let points: Vec<[f64; 2]> = (0..self.len()).map(|index| self.point(index)).collect();
        self.times.clear();
        self.values.clear();
        for four in points.chunks(4) {
            for point in extremes(four) {
                self.store(point);
            }
        }
        // Two samples were kept of `group`; now two are kept of twice as many.
        self.group = if self.group <= 1 { 4 } else { 2 * self.group };
    }
}

/// The least and the greatest of some samples in time order; all if there are at most two.
fn extremes(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    if points.len() <= 2 {
        return points.to_vec();
    }
    let finite = points.iter().filter(|point| point[1].is_finite());
    let least = finite.clone().min_by(|a, b| a[1].total_cmp(&b[1]));
    let greatest = finite.max_by(|a, b| a[1].total_cmp(&b[1]));
    let (Some(least), Some(greatest)) = (least, greatest) else {
        // A gap stays a gap.
        return points[..1].to_vec();
    };
    let mut pair = vec![*least, *greatest];
    pair.sort_by(|a, b| a[0].total_cmp(&b[0]));
    pair
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_single_peak_survives_the_thinning_of_a_long_run() {
        let mut series = SampleSeries::default();
        let count = 3 * SAMPLES_MAX;
        for index in 0..count {
            let value = if index == 123_457 {
                50.0
            } else {
                (index % 7) as f64
            };
            series.push(index as f64, value);
        }
        assert!(series.len() <= SAMPLES_MAX);
        let values = (0..series.len()).map(|index| series.point(index));
        let peak = values
            .max_by(|a, b| a[1].total_cmp(&b[1]))
            .expect("samples");
        assert_eq!(peak, [123_457.0, 50.0]);
        assert!((0..series.len() - 1).all(|i| series.point(i)[0] <= series.point(i + 1)[0]));
    }

    #[test]
    fn texts_are_values_with_names() {
        let mut series = SampleSeries::default();
        for (time, text) in ["lost", "tracking", "lost"].iter().enumerate() {
            series.push_text(time as f64, text);
        }
        assert_eq!(series.point(2), [2.0, 0.0]);
        assert_eq!(series.text(1.0), Some("tracking"));
        assert_eq!(series.text(f64::NAN), None);
    }
}
