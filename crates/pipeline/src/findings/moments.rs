//! From marked images to moments.

use super::{Finding, FindingKind};

/// Moments of one kind that are closer together than this are one, seconds.
const MERGE: f64 = 1.0;

/// Images that follow one another, as indices of the first and the last, and the worst of them.
#[derive(Debug, Clone, Copy)]
pub(super) struct Moment {
    pub(super) first: usize,
    pub(super) last: usize,
    pub(super) worst: usize,
}

/// The moments in which `size` has a value.
pub(super) fn moments(times: &[f64], size: impl Fn(usize) -> Option<f64>) -> Vec<Moment> {
    let mut found: Vec<Moment> = Vec::new();
    let mut largest = 0.0;
    for (at, time) in times.iter().enumerate() {
        let Some(size) = size(at) else {
            continue;
        };
        match found.last_mut() {
            Some(moment) if moment.last + 1 == at || time - times[moment.last] < MERGE => {
                moment.last = at;
                if size > largest {
                    (moment.worst, largest) = (at, size);
                }
            }
            _ => {
                found.push(Moment {
                    first: at,
                    last: at,
                    worst: at,
                });
                largest = size;
            }
        }
    }
    found
}

impl Moment {
    /// A finding that lasts until the next image.
    pub(super) fn finding(
        self,
        kind: FindingKind,
        times: &[f64],
        size: f64,
        causes: Vec<String>,
    ) -> Finding {
        Finding {
            kind,
            start: times[self.first],
            stop: times[(self.last + 1).min(times.len() - 1)],
            worst: times[self.worst],
            size,
            causes,
        }
    }
}

/// Findings of a kind without causes.
pub(super) fn plain_findings(
    kind: FindingKind,
    times: &[f64],
    size: impl Fn(usize) -> Option<f64>,
) -> Vec<Finding> {
    let found = moments(times, &size).into_iter();
    found
        .map(|moment| {
            let worst = size(moment.worst).unwrap_or_default();
            moment.finding(kind, times, worst, Vec::new())
        })
        .collect()
}

/// Quantile of ascending values, linear between them.
pub(super) fn quantile(sorted: &[f64], share: f64) -> Option<f64> {
    let place = share * sorted.len().checked_sub(1)? as f64;
    let (low, high) = (place.floor() as usize, place.ceil() as usize);
    Some(sorted[low] + (place - place.floor()) * (sorted[high] - sorted[low]))
}
