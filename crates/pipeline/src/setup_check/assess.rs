//! Does another set-up explain the measurements better? Tries single changes, then further ones on top of the best.

use localize::Field;
use localize::config::LocalizeConfig;
use localize::setup_check::{Comparison, Explanation, FieldTables, compare, explain};
use rayon::prelude::*;
use vision::calibrate::Rim;

use super::change::Change;
use super::effort::Effort;
use super::inertial;
use super::measurements::MeasuredKeyframe;
use super::variant::SetupVariant;
use crate::setup::Setup;

/// A change that explains the measurements better.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Improvement {
    /// The change.
    pub(super) change: Change,
    /// The set-up with it.
    pub(super) after: SetupVariant,
    /// Its explanation.
    pub(super) explanation: Explanation,
    /// Gain over the set-up without it.
    pub(super) comparison: Comparison,
    /// The steps of the wheels alone leave no doubt.
    pub(super) by_steps: bool,
}

impl Improvement {
    /// Of a change beside the set-up without it, which `now` explains.
    pub(super) fn over(
        now: &Explanation,
        change: Change,
        after: SetupVariant,
        explanation: Explanation,
    ) -> Self {
        Improvement {
            comparison: compare(now, &explanation),
            change,
            after,
            explanation,
            by_steps: false,
        }
    }

    /// Is what the change affects explained with it? Otherwise the change is a candidate only.
    pub(super) fn is_firm(&self) -> bool {
        self.change.explained(&self.explanation) >= FIRM_MIN
    }
}

/// What the trials found.
#[derive(Debug, Clone, Default)]
pub(super) struct Assessment {
    /// Explanation by the configured set-up.
    pub(super) configured: Explanation,
    /// Changes in the order in which they are to be made, each with equally good ones behind it.
    pub(super) improvements: Vec<Vec<Improvement>>,
    /// The configured field explains the points no better than an arbitrary one.
    pub(super) fits_no_better_than_random: bool,
}

impl Assessment {
    /// The changes to be made, the likeliest of each step.
    pub(super) fn edits(&self) -> impl DoubleEndedIterator<Item = &Improvement> {
        self.improvements.iter().filter_map(|found| found.first())
    }

    /// Is one of the changes to be made such a one?
    pub(super) fn has_edit(&self, is: impl Fn(&Change) -> bool) -> bool {
        self.edits().any(|found| is(&found.change))
    }

    /// Explanation with all changes made.
    pub(super) fn explained(&self) -> &Explanation {
        let last = self.edits().next_back();
        last.map_or(&self.configured, |best| &best.explanation)
    }
}

/// Share of what a change affects that a firm one explains.
pub(super) const FIRM_MIN: f32 = 0.85;
/// Most changes on top of each other.
const CHANGES_MAX: usize = 3;
/// Share of points above which no other field can be much better.
const POINTS_FINE: f32 = 0.93;
/// Share of wheel steps or compass readings above which they agree.
pub(super) const SENSORS_FINE: f32 = 0.9;
/// Agreement of the wheels below which their unit is tried.
const SCALES_TRIED_BELOW: f32 = 0.5;
/// Factors of the wheels' path: millimetres, centimetres, inches, feet, and the opposite confusions of the metric units.
const ODOMETRY_SCALES: [f32; 6] = [0.001, 0.01, 0.0254, 0.3048, 100.0, 1000.0];
/// Share of points below which a field may be an arbitrary one.
const ARBITRARY_MAX: f32 = 0.75;

/// The measurements that every set-up is tried on.
pub(super) struct Trial<'a> {
    /// The configured set-up.
    pub(super) setup: &'a Setup,
    /// The measurements.
    pub(super) measured: &'a [MeasuredKeyframe],
    /// Settings of the search of poses.
    pub(super) config: LocalizeConfig,
    /// The mirror's rim in the images. None where it is not known.
    pub(super) rim: Option<Rim>,
}

/// Tries other set-ups on the measurements.
pub(super) fn assess(trial: &Trial<'_>, effort: Effort) -> Assessment {
    let mut variant = SetupVariant::configured(trial.setup);
    let Some(configured) = trial.explain(&variant, trial.measured) else {
        return Assessment::default();
    };
    let mut explanation = configured.clone();
    let mut improvements: Vec<Vec<Improvement>> = Vec::new();
    let mut no_better_than_random = false;
    while improvements.len() < CHANGES_MAX {
        let (found, no_better) = trial.improve(&variant, &explanation, effort);
        no_better_than_random |= no_better && improvements.is_empty();
        let Some(best) = found.first() else { break };
        (variant, explanation) = (best.after.clone(), best.explanation.clone());
        // A second step of the centre is one with the first.
        let is_centre = |found: &Vec<Improvement>| matches!(found[0].change, Change::Centre(_));
        if is_centre(&found) {
            improvements.pop_if(|last| is_centre(last));
        }
        improvements.push(found);
    }
    Assessment {
        fits_no_better_than_random: no_better_than_random && improvements.is_empty(),
        configured,
        improvements,
    }
}

/// Share of the compass readings that would agree with the poses if they were in degrees. None without a compass.
pub(super) fn compass_agreement_in_degrees(
    setup: &Setup,
    config: &LocalizeConfig,
    measured: &[MeasuredKeyframe],
) -> Option<f32> {
    let trial = Trial::new(setup, config, measured);
    let variant = Change::CompassInDegrees.apply(&SetupVariant::configured(setup));
    trial.explain(&variant, measured)?.compass_agrees()
}

impl<'a> Trial<'a> {
    /// Tries on these measurements, at the camera's own height.
    pub(super) fn new(
        setup: &'a Setup,
        config: &LocalizeConfig,
        measured: &'a [MeasuredKeyframe],
    ) -> Self {
        let mut config = config.clone();
        if let Some(height) = setup.viewpoint_height {
            config.matching.viewpoint_height = height;
        }
        Trial {
            setup,
            measured,
            config,
            rim: None,
        }
    }

    /// The same, with the mirror's rim in the images.
    pub(super) fn with_rim(self, rim: Option<Rim>) -> Self {
        Trial { rim, ..self }
    }
}

impl Trial<'_> {
    /// The explanation by a variant. None for an impossible field.
    pub(super) fn explain(
        &self,
        variant: &SetupVariant,
        measured: &[MeasuredKeyframe],
    ) -> Option<Explanation> {
        let field = Field::new(variant.field.clone()).ok()?;
        let mut tables = FieldTables::new(&field, &self.config);
        Some(explain(&mut tables, &variant.apply(self.setup, measured)))
    }

    /// The best single change with those that are as good; empty if none is clearly better. Second: no better than
    /// arbitrary fields.
    fn improve(
        &self,
        variant: &SetupVariant,
        now: &Explanation,
        effort: Effort,
    ) -> (Vec<Improvement>, bool) {
        let full = effort == Effort::Full;
        let sensors_fine = now.wheels_agree().unwrap_or(1.0) >= SENSORS_FINE
            && now.compass_agrees().unwrap_or(1.0) >= SENSORS_FINE;
        let points_fine = now.on_markings() >= POINTS_FINE;
        let mut changes = Vec::new();
        if full || !sensors_fine {
            changes.extend(mounts());
            changes.extend(Self::compass_quarter_turns());
        }
        if full || !sensors_fine || self.turns_are_fast() {
            changes.push(Change::OdometryRotationInDegrees);
            if self.headings_can_be_degrees() {
                changes.push(Change::CompassInDegrees);
            }
        }
        let wheels = now.wheels_agree().unwrap_or(1.0);
        if wheels < SCALES_TRIED_BELOW {
            changes.extend(ODOMETRY_SCALES.map(Change::OdometryScale));
        }
        if wheels < SENSORS_FINE {
            changes.extend(odometry_axes());
        }
        // Cheap, since the poses are known: a shifted centre takes points off the markings, too.
        let mut found: Vec<(Change, Improvement)> =
            self.search_centre(variant, now).into_iter().collect();
        let centre_explains = found.iter().any(|(_, improvement)| {
            improvement.comparison.is_better()
                && improvement.explanation.on_markings() >= POINTS_FINE
        });
        let other_fields = full || !(points_fine || centre_explains);
        if other_fields {
            changes.extend(Self::shipped_fields(variant));
        }
        if other_fields && !centre_explains {
            found.extend(self.search_far_centre(variant, now));
        }
        found.extend(self.search_measured_to(variant, now));
        found.extend(self.evaluate(variant, now, changes));
        found.extend(self.search_turn(variant, now, wheels < SENSORS_FINE));
        found.extend(self.search_wheels(variant, now));
        if wheels < SENSORS_FINE {
            found.extend(self.search_fixed_axes(variant, now));
        }
        let arbitrary = now.on_markings() < ARBITRARY_MAX
            && found.iter().any(|(change, improvement)| {
                matches!(change, Change::Field(..)) && !improvement.comparison.is_worse()
            });
        if other_fields {
            found.extend(self.search_size(variant, now));
            found.extend(self.search_optics(variant, now));
        }
        let mut better: Vec<Improvement> = found
            .into_iter()
            .map(|(_, improvement)| improvement)
            .filter(|improvement| {
                let comparison = &improvement.comparison;
                // A turn of a few degrees gains little: its own uncertainty has decided.
                let is_turn = matches!(improvement.change, Change::CameraTurn(_));
                let agree = improvement.explanation.wheels_agree().unwrap_or(0.0);
                if matches!(improvement.change, Change::OdometryScale(_)) {
                    // A longer path has larger expected errors: costs of two units say nothing.
                    return agree >= FIRM_MIN;
                }
                comparison.is_better() || (is_turn && comparison.gain > 0.0) || improvement.by_steps
            })
            .map(|improvement| self.refine_compass_turn(variant, now, improvement))
            .collect();
        // Line points hardly tell: the wheels have decided.
        let is_centre = |found: &Improvement| matches!(found.change, Change::Centre(_));
        if !better.iter().any(is_centre) {
            let by_wheels = self.search_centre_by_wheels(variant, now);
            better.extend(by_wheels.filter(|found| found.comparison.gain > 0.0));
        }
        // Nor does either tell much on a short drive: the rim has decided.
        if !better.iter().any(is_centre) {
            better.extend(self.search_centre_by_rim(variant, now));
        }
        // A field of another kind is explained half by many a change: it is tried unless a change explains the points.
        let explained = better
            .iter()
            .any(|improvement| improvement.explanation.on_markings() >= FIRM_MIN);
        if other_fields && !explained {
            better.extend(self.search_all_sizes(variant, now));
        }
        (self.ranked(better), arbitrary)
    }

    /// The likeliest changes, the best first: those that explain as much as it.
    fn ranked(&self, mut better: Vec<Improvement>) -> Vec<Improvement> {
        // A turned camera looks like wheels that are wrong in two directions.
        let is_turn = |found: &Improvement| matches!(found.change, Change::CameraTurn(_));
        if better.iter().any(is_turn) {
            better.retain(|found| !found.by_steps);
        }
        // A wrong unit or axis is likelier than wheels that are wrong in every way.
        let is_axis = |found: &Improvement| {
            matches!(
                found.change,
                Change::OdometryScale(_)
                    | Change::OdometryAxes { .. }
                    | Change::OdometryFixedAxes(_)
            )
        };
        if better.iter().any(|found| is_axis(found) && found.is_firm()) {
            better.retain(|found| !matches!(found.change, Change::WheelMatrix(_)));
        }
        better.sort_by(|a, b| b.comparison.gain.total_cmp(&a.comparison.gain));
        if let Some(best) = better.first().cloned() {
            better.retain(|other| !compare(&other.explanation, &best.explanation).is_better());
            // Of equally good ones the camera's mount, then a unit, is the likelier mistake, unless the inertial unit
            // contradicts the wheels, too.
            let wheels_are_turned = inertial::wheels_are_turned(self.measured);
            better.sort_by_key(|other| match other.change {
                Change::Mount { .. } if !wheels_are_turned => 0,
                Change::OdometryScale(_)
                | Change::OdometryAxes { .. }
                | Change::OdometryFixedAxes(_) => 1,
                _ => 2,
            });
        }
        better
    }

    /// Do turns of the odometry exceed what a robot does, so that they say little about the poses?
    fn turns_are_fast(&self) -> bool {
        let rows = self
            .measured
            .iter()
            .filter_map(|keyframe| keyframe.odometry.as_ref());
        rows.flatten().any(|[_, _, turn]| turn.abs() > 1.0)
    }

    /// Tries changes, each alone.
    pub(super) fn evaluate(
        &self,
        variant: &SetupVariant,
        now: &Explanation,
        changes: Vec<Change>,
    ) -> Vec<(Change, Improvement)> {
        changes
            .into_par_iter()
            .filter_map(|change| {
                let after = change.apply(variant);
                let explanation = self.explain(&after, self.measured)?;
                let improvement = Improvement::over(now, change.clone(), after, explanation);
                Some((change, improvement))
            })
            .collect()
    }
}

fn mounts() -> impl Iterator<Item = Change> {
    let all = [false, true]
        .into_iter()
        .flat_map(|mirrored| (0..4).map(move |quarters| Change::Mount { quarters, mirrored }));
    all.filter(|change| {
        *change
            != Change::Mount {
                quarters: 0,
                mirrored: false,
            }
    })
}

/// Axes of the odometry exchanged, or of other signs.
fn odometry_axes() -> impl Iterator<Item = Change> {
    let signs = [1.0_f32, -1.0];
    let all = [false, true].into_iter().flat_map(move |exchanged| {
        let of_x = signs.into_iter();
        of_x.flat_map(move |x| {
            let of_y = signs.into_iter();
            of_y.flat_map(move |y| {
                signs.map(|turn| Change::OdometryAxes {
                    exchanged,
                    signs: [x, y, turn],
                })
            })
        })
    });
    // The first one is the configured one.
    all.skip(1)
}
