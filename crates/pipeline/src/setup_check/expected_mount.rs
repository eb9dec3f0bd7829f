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

/// Fits and searches in turn: poses that were wrong by the map as given become right.
const ROUNDS: usize = 3;

/// The mount that explains the measurements, and the measurements by the map with it. None if the map is right as given, if no likely mount
/// explains them, and without a camera or wheels.
pub(super) fn find(
    setup: &Setup,
    config: &LocalizeConfig,
    measured: &[MeasuredKeyframe],
    configured: &Explanation,
) -> Option<(DriveFit, Vec<MeasuredKeyframe>)> {
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
    best
}
