//! A camera whose mount nobody measured: the localizer expects such errors of the map and learns them. So does the check,
//! before it takes them for another mistake.

use localize::Field;
use localize::config::LocalizeConfig;
use localize::map_correction::DriveFit;
use localize::setup_check::{Explanation, FieldTables, compare, explain};

use super::assess::FIRM_MIN;
use super::measurements::MeasuredKeyframe;
use super::variant::SetupVariant;
use crate::setup::Setup;

/// Log likelihood ratio by which the map as given must explain the images until a knock better: e⁵ decides among some dozen moments.
const KNOCK_GAIN_MIN: f32 = 5.0;

/// Fits and searches in turn: poses that were wrong by the map as given become right.
const ROUNDS: usize = 3;

/// What the measurements tell of the camera's mount.
pub(super) enum ExpectedMount {
    /// The mount that explains them, and they by the map with it.
    Learned(Box<DriveFit>, Vec<MeasuredKeyframe>),
    /// The map as given explains them until this keyframe, which the camera was moved before.
    MovedBefore(usize),
}

/// None if the map is right as given, if no likely mount explains the measurements, and without a camera or wheels.
pub(super) fn find(
    setup: &Setup,
    config: &LocalizeConfig,
    measured: &[MeasuredKeyframe],
    configured: &Explanation,
) -> Option<ExpectedMount> {
    let moves = measured.iter().any(|keyframe| keyframe.odometry.is_some());
    if !config.map_correction.enabled || !moves {
        return None;
    }
    let mut config = config.clone();
    if let Some(height) = setup.viewpoint_height {
        config.matching.viewpoint_height = height;
    }
    let basis = setup.map_basis(&config).ok()??;
    let field = Field::new(setup.field.config.clone()).ok()?;
    let mut tables = FieldTables::new(&field, &config);
    let variant = SetupVariant::configured(setup);
    let given = variant.apply(setup, measured);
    let mut explanation = configured.clone();
    let mut best = None;
    for _ in 0..ROUNDS {
        let fit = tables.fit_map(&basis, &config, &given, &explanation)?;
        let corrected: Vec<MeasuredKeyframe> = measured
            .iter()
            .map(|keyframe| MeasuredKeyframe {
                points: fit.correct(&keyframe.points),
                ..keyframe.clone()
            })
            .collect();
        let explained = explain(&mut tables, &variant.apply(setup, &corrected));
        if !compare(&explained, &explanation).is_worse() {
            break;
        }
        explanation = explained;
        let fits = fit.is_expected && explanation.on_markings() >= FIRM_MIN;
        best = fits.then_some((fit, corrected));
    }
    let (fit, corrected) = best?;
    Some(match first_after_knock(configured, &explanation) {
        Some(first) => ExpectedMount::MovedBefore(first),
        None => ExpectedMount::Learned(Box::new(fit), corrected),
    })
}

/// The keyframe before which the camera was moved: the map as `given` explains those until then clearly better than one mount for all
/// does, `learned`. A mount that nobody measured is the same in all of them.
fn first_after_knock(given: &Explanation, learned: &Explanation) -> Option<usize> {
    let pairs = given.keyframes.iter().zip(&learned.keyframes);
    let mut lead = 0.0;
    let leads = pairs.map(|(given, learned)| {
        lead += learned.cost - given.cost;
        lead
    });
    let (before, _) = leads.enumerate().max_by(|(_, a), (_, b)| a.total_cmp(b))?;
    let until = |explanation: &Explanation| Explanation {
        keyframes: explanation.keyframes[..=before].to_vec(),
    };
    let lead = compare(&until(learned), &until(given));
    (lead.gain >= KNOCK_GAIN_MIN && lead.is_consistent()).then_some(before + 1)
}

#[cfg(test)]
mod tests {
    use localize::setup_check::{Explanation, KeyframeFit};

    use super::first_after_knock;

    fn explanation(costs: impl Iterator<Item = f32>) -> Explanation {
        let keyframes = costs.map(|cost| KeyframeFit {
            pose: None,
            cost,
            points: 60,
            on_markings: 0.9,
            residual: 0.02,
            wheel_step: None,
            by_matrix: None,
            wheels_agree: None,
            compass_agrees: None,
        });
        Explanation {
            keyframes: keyframes.collect(),
        }
    }

    #[test]
    fn a_knock_is_where_the_given_map_ceases_to_be_the_better_one() {
        // The learned mount is a compromise: a little worse than the given map before the knock, much better after it.
        let given = explanation((0..38).map(|k| if k < 18 { 1.0 } else { 5.0 }));
        let learned = explanation((0..38).map(|k| 1.6 + 0.02 * (k % 5) as f32));
        assert_eq!(first_after_knock(&given, &learned), Some(18));
    }

    #[test]
    fn a_mount_that_nobody_measured_is_no_knock() {
        let given = explanation((0..38).map(|k| 3.0 + 0.5 * (k % 7) as f32));
        // The first images may be better with the given map by chance.
        let learned = explanation((0..38).map(|k| {
            if k < 3 {
                3.6
            } else {
                1.0 + 0.3 * (k % 5) as f32
            }
        }));
        assert_eq!(first_after_knock(&given, &learned), None);
    }
}
