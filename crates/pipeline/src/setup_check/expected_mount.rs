//! A camera whose mount nobody measured: the localizer expects such errors of the map and learns them. So does the check,
//! before it takes them for another mistake.

use localize::Field;
use localize::config::LocalizeConfig;
use localize::setup_check::{Explanation, FieldTables, compare, explain};

use super::measurements::MeasuredKeyframe;
use super::variant::SetupVariant;
use crate::setup::Setup;

/// Fits and searches in turn: poses that were wrong by the map as given become right.
const ROUNDS: usize = 3;

/// The measurements by the map with the mount that explains them. None if the map is right as given, if the mount is
/// no likely one, or without a camera.
pub(super) fn correct(
    setup: &Setup,
    config: &LocalizeConfig,
    measured: &[MeasuredKeyframe],
    configured: &Explanation,
) -> Option<Vec<MeasuredKeyframe>> {
    if !config.map_correction.enabled {
        return None;
    }
    let basis = setup.map_basis(config).ok()??;
    let field = Field::new(setup.field.config.clone()).ok()?;
    let mut tables = FieldTables::new(&field, config);
    let variant = SetupVariant::configured(setup);
    let given = variant.apply(setup, measured);
    let mut explanation = configured.clone();
    let mut best = None;
    for _ in 0..ROUNDS {
        let fit = tables.fit_map(&basis, config, &given, &explanation)?;
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
        best = fit.is_expected.then_some(corrected);
    }
    best
}
