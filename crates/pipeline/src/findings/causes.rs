//! What differed in a moment from the rest of the run?

use std::cell::OnceCell;
use std::cmp::Ordering;

use super::moments::{Moment, moments, quantile};
use super::record::CycleRecord;
use super::{Finding, FindingKind};

/// A cause may precede its effect by this, seconds.
const LOOK_BACK: f64 = 0.5;
/// Fewer values do not say what is usual.
const VALUES_MIN: usize = 10;
/// Usual spreads from the median from which on a value is unusual.
const UNUSUAL: f64 = 3.0;
/// The spread of a normal distribution's standard deviation between its quantiles at 10 and 90 %.
const DECILE_SPREAD: f64 = 2.56;
/// The spread is at least this share of the median.
const LEAST_SPREAD: f64 = 0.05;
/// Ranks of causes that are no measurements, in spreads.
const FAULT_RANK: f64 = 20.0;
const COLLISION_RANK: f64 = 10.0;
const REASON_RANK: f64 = 5.0;
const HALF_RANK: f64 = 4.0;

/// Median and spread of a quantity over the run.
#[derive(Debug, Clone, Copy)]
struct Usual {
    median: f64,
    spread: f64,
}

/// A quantity that may be unusual, on one side.
struct Quantity {
    value: fn(&CycleRecord) -> Option<f64>,
    text: fn(value: f64, usual: f64) -> String,
    /// Are low values unusual, or high ones?
    below: bool,
    /// A smaller difference from the usual value causes nothing.
    least: f64,
}

const QUANTITIES: [Quantity; 7] = [
    Quantity {
        value: |record| Some(record.line_points),
        text: |value, usual| format!("few line points ({value:.0}, usually {usual:.0})"),
        below: true,
        least: 20.0,
    },
    Quantity {
        value: |record| Some(record.inlier_share),
        text: |value, usual| {
            let (value, usual) = (100.0 * value, 100.0 * usual);
            format!("points off the markings ({value:.0}% on them, usually {usual:.0}%)")
        },
        below: true,
        least: 0.1,
    },
    Quantity {
        value: |record| Some(record.residual),
        text: |value, usual| {
            let (value, usual) = (1e3 * value, 1e3 * usual);
            format!("poor fit ({value:.0} mm, usually {usual:.0})")
        },
        below: false,
        least: 0.01,
    },
    Quantity {
        value: |record| record.carpet_share,
        text: |_, _| "view is blocked".to_owned(),
        below: true,
        least: 0.1,
    },
    Quantity {
        value: |record| record.robots_seen,
        text: |value, _| format!("many robots close by ({value:.0})"),
        below: false,
        least: 0.5,
    },
    Quantity {
        value: |record| record.brightness,
        text: |value, usual| format!("bright light ({value:.0} of 255, usually {usual:.0})"),
        below: false,
        least: 25.0,
    },
    Quantity {
        value: |record| record.brightness,
        text: |value, usual| format!("darkness ({value:.0} of 255, usually {usual:.0})"),
        below: true,
        least: 25.0,
    },
];

/// Says of each moment of a run what was unusual.
pub(super) struct Causes<'a> {
    run: &'a [CycleRecord],
    times: Vec<f64>,
    /// By quantity. A clean run does not need them.
    usual: OnceCell<Vec<Option<Usual>>>,
}

impl<'a> Causes<'a> {
    /// For a run.
    pub(super) fn new(run: &'a [CycleRecord]) -> Self {
        Causes {
            run,
            times: run.iter().map(|record| record.time).collect(),
            usual: OnceCell::new(),
        }
    }

    /// The moments in which `size` has a value, each with its causes.
    pub(super) fn findings(
        &self,
        kind: FindingKind,
        size: impl Fn(usize) -> Option<f64>,
    ) -> Vec<Finding> {
        let found = moments(&self.times, &size).into_iter();
        found
            .map(|moment| {
                let worst = size(moment.worst).unwrap_or_default();
                moment.finding(kind, &self.times, worst, self.of(moment))
            })
            .collect()
    }

    /// The causes of a moment, the strongest first.
    fn of(&self, moment: Moment) -> Vec<String> {
        let from = self.times[moment.first] - LOOK_BACK;
        let start = self.times.partition_point(|time| *time < from);
        let around = &self.run[start..=moment.last];
        let usual = self.usual.get_or_init(|| {
            let usual = |quantity: &Quantity| Usual::of(self.run, quantity.value);
            QUANTITIES.iter().map(usual).collect()
        });
        let mut found: Vec<(f64, String)> = Vec::new();
        for (quantity, usual) in QUANTITIES.iter().zip(usual) {
            let values = around.iter().filter_map(quantity.value);
            let extreme = if quantity.below {
                values.min_by(f64::total_cmp)
            } else {
                values.max_by(f64::total_cmp)
            };
            let (Some(usual), Some(value)) = (usual, extreme) else {
                continue;
            };
            let apart = value - usual.median;
            let score = if quantity.below { -apart } else { apart } / usual.spread;
            if score.is_finite() && score > UNUSUAL && apart.abs() >= quantity.least {
                found.push((score, (quantity.text)(value, usual.median)));
            }
        }
        if around.iter().any(|record| record.collision) {
            found.push((COLLISION_RANK, "collision or slip".to_owned()));
        }
        let faults = around.iter().filter_map(|record| record.fault.as_deref());
        for fault in distinct(faults) {
            found.push((FAULT_RANK, format!("image fault ({fault})")));
        }
        let within = &self.run[moment.first..=moment.last];
        let reasons = within.iter().map(|record| record.reason);
        for reason in distinct(reasons.filter(|reason| !reason.is_empty())) {
            found.push((REASON_RANK, reason.to_owned()));
        }
        if around.iter().any(|record| !record.half_known) {
            found.push((HALF_RANK, "half of the field unknown".to_owned()));
        }
        found.sort_by(|a, b| b.0.partial_cmp(&a.0).unwrap_or(Ordering::Equal));
        found.into_iter().map(|(_, text)| text).collect()
    }
}

impl Usual {
    /// None with too few values.
    fn of(run: &[CycleRecord], value: fn(&CycleRecord) -> Option<f64>) -> Option<Self> {
        let mut values: Vec<f64> = run.iter().filter_map(value).collect();
        if values.len() < VALUES_MIN {
            return None;
        }
        values.sort_by(f64::total_cmp);
        let median = quantile(&values, 0.5)?;
        let spread = (quantile(&values, 0.9)? - quantile(&values, 0.1)?) / DECILE_SPREAD;
        Some(Usual {
            median,
            spread: spread.max(LEAST_SPREAD * median.abs()).max(1e-9),
        })
    }
}

/// Each text once, in alphabetical order.
fn distinct<'a>(texts: impl Iterator<Item = &'a str>) -> Vec<&'a str> {
    let mut texts: Vec<&str> = texts.collect();
    texts.sort_unstable();
    texts.dedup();
    texts
}
