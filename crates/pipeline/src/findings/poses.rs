//! Where is the pose wrong, too sure, too uncertain, unknown, or at odds with the wheels?

use localize::math;

use super::causes::Causes;
use super::record::CycleRecord;
use super::wheel_path::WheelPath;
use super::{Finding, FindingKind};

/// Position error that a player would notice, metres.
const LARGE_ERROR: f64 = 0.15;
/// Squared normalised error of a pose that one consistent pose in a thousand exceeds (χ², 3 degrees of freedom).
const NEES_MAX: f64 = 16.27;
/// Smallest error that is worth a look, however small its stated deviation, metres.
pub(super) const WRONG_BY: f64 = 0.03;
/// A leap is larger than this many standard deviations of both poses …
const LEAP_SIGMA: f64 = 4.0;
/// … and than this, metres.
const LEAP: f64 = 0.1;

/// Errors against the truth, stated uncertainty, and lost robots.
pub(super) fn pose_findings(run: &[CycleRecord], causes: &Causes<'_>) -> Vec<Finding> {
    let large = |record: &CycleRecord| record.error.filter(|error| *error > LARGE_ERROR);
    let known = |at: usize| Some(&run[at]).filter(|record| !record.lost);
    let mut found = causes.findings(FindingKind::Error, |at| large(known(at)?));
    found.extend(causes.findings(FindingKind::Overconfident, |at| {
        let record = known(at)?;
        let confident = record.nees? > NEES_MAX && large(record).is_none();
        record.error.filter(|error| confident && *error > WRONG_BY)
    }));
    found.extend(causes.findings(FindingKind::Uncertain, |at| {
        let record = known(at)?;
        (record.std > LARGE_ERROR && large(record).is_none()).then_some(record.std)
    }));
    found.extend(causes.findings(FindingKind::Lost, |at| run[at].lost.then_some(0.0)));
    found
}

/// Poses that moved otherwise than the wheels between two images, by more than both uncertainties allow.
pub(super) fn leaps(run: &[CycleRecord], wheels: &WheelPath, causes: &Causes<'_>) -> Vec<Finding> {
    if wheels.is_empty() {
        return Vec::new();
    }
    causes.findings(FindingKind::Leap, |at| {
        let (before, now) = (&run[at.checked_sub(1)?], &run[at]);
        let ([x, y, theta], [now_x, now_y, _]) = (before.pose?, now.pose?);
        let [ahead, aside] = wheels.motion(before.time, now.time);
        let (sin, cos) = math::sin_cos(theta);
        let off = math::hypot(
            now_x - (x + cos * ahead - sin * aside),
            now_y - (y + sin * ahead + cos * aside),
        );
        let allowed = LEAP_SIGMA * math::hypot(before.std, now.std);
        (off > LEAP.max(allowed)).then_some(off)
    })
}
