//! Which images are missing?

use super::moments::quantile;
use super::record::CycleRecord;
use super::{Finding, FindingKind};

/// A gap is longer than this many usual periods.
const GAP_PERIODS: f64 = 3.0;

/// Dropped cycles, gaps and unusable images.
pub(super) fn missing(run: &[CycleRecord]) -> Vec<Finding> {
    let mut periods: Vec<f64> = run.windows(2).map(|w| w[1].time - w[0].time).collect();
    periods.sort_by(f64::total_cmp);
    let usual = quantile(&periods, 0.5).unwrap_or(0.0);
    let mut found = Vec::new();
    for pair in run.windows(2) {
        let (start, stop) = (pair[0].time, pair[1].time);
        let dropped = pair[1].index > pair[0].index + 1;
        if dropped || stop - start > GAP_PERIODS * usual {
            found.push(Finding {
                kind: if dropped {
                    FindingKind::Dropped
                } else {
                    FindingKind::Gap
                },
                start,
                stop,
                worst: start,
                size: stop - start,
                causes: Vec::new(),
            });
        }
    }
    for record in run {
        if let Some(fault) = &record.fault {
            found.push(Finding {
                kind: FindingKind::Unusable,
                start: record.time,
                stop: record.time,
                worst: record.time,
                size: 0.0,
                causes: vec![fault.to_string()],
            });
        }
    }
    found
}
