//! Would another centre, height or focal length of the camera explain the points better?

use localize::setup_check::{Explanation, FieldTables, explain, refine};
use localize::{Field, math};
use rayon::prelude::*;

use super::assess::{Improvement, Trial};
use super::change::Change;
use super::field_search::SCAN_KEYFRAMES;
use super::measurements::{MeasuredKeyframe, thin_out};
use super::origin_offset::compare_with_offsets;
use super::variant::SetupVariant;

/// Steps of the mirror's centre, pixels.
const CENTRE_STEPS: [f32; 4] = [4.0, 2.0, 1.0, 0.5];
/// Farthest shift of the centre that is tried, pixels.
const CENTRE_REACH: f32 = 30.0;
/// Step of the grid of far centres (pixels), of which the best ones are refined.
const CENTRE_GRID: f32 = 5.0;
const CENTRE_STARTS: usize = 4;
/// Keyframes that the grid is compared on.
const CENTRE_KEYFRAMES: usize = 6;
/// A smaller shift of the centre is no mistake, pixels.
const CENTRE_MIN: f32 = 1.5;
/// Range of the camera's height against the configured one, metres.
const HEIGHT_RANGE: f32 = 0.12;
/// Steps of the height, metres: half of the first is within the matcher's reach.
const HEIGHT_STEPS: [f32; 4] = [0.01, 0.004, 0.002, 0.001];
/// A smaller change of the height is no mistake, metres.
const HEIGHT_MIN: f32 = 0.005;
/// Range and steps of the focal length, and its smallest change that is a mistake: shares of the focal length.
const FOCAL_RANGE: f32 = 0.3;
const FOCAL_STEPS: [f32; 4] = [0.025, 0.01, 0.005, 0.002];
const FOCAL_MIN: f32 = 0.01;
/// Share of the line points that must still show ground within reach: fewer points cost less without being explained.
const POINTS_KEPT_MIN: f32 = 0.6;

impl Trial<'_> {
    /// The best centre of the mirror in the image, by steps to the neighbours. None for points without pixels.
    pub(super) fn search_centre(
        &self,
        variant: &SetupVariant,
        now: &Explanation,
    ) -> Option<(Change, Improvement)> {
        self.has_pixels()
            .then(|| self.descend_centre(variant, variant.centre_shift, now))?
            .and_then(|best| improved_centre(variant, now, best))
    }

    /// As [`Trial::search_centre`], but starts from the best centres of a grid: a wrong centre moves the poses with it, and
    /// markings beside the right ones hold both.
    pub(super) fn search_far_centre(
        &self,
        variant: &SetupVariant,
        now: &Explanation,
    ) -> Option<(Change, Improvement)> {
        if !self.has_pixels() {
            return None;
        }
        let stride = self.measured.len().div_ceil(CENTRE_KEYFRAMES).max(1);
        let subset = thin_out(self.measured, stride);
        let field = Field::new(variant.field.clone()).ok()?;
        let mut tables = FieldTables::new(&field, &self.config);
        let explain_at = |tables: &mut FieldTables, shift, measured: &[MeasuredKeyframe]| {
            let after = Change::Centre(shift).apply(variant);
            explain(tables, &after.apply(self.setup, measured))
        };
        // The first search completes the tables, of which each thread gets a copy.
        explain_at(&mut tables, [0.0; 2], &subset);
        let steps = (CENTRE_REACH / CENTRE_GRID).floor() as i32;
        let shifts = (-steps..=steps)
            .flat_map(|u| (-steps..=steps).map(move |v| [u, v].map(|k| k as f32 * CENTRE_GRID)))
            .filter(|[u, v]| math::hypot(*u, *v) <= CENTRE_REACH);
        let shifts: Vec<[f32; 2]> = shifts.collect();
        let costs = shifts.into_par_iter().map_init(
            || tables.clone(),
            |tables, shift| (explain_at(tables, shift, &subset).cost(), shift),
        );
        let mut costs: Vec<(f32, [f32; 2])> = costs.collect();
        costs.sort_by(|a, b| a.0.total_cmp(&b.0));
        let descents = costs.into_par_iter().take(CENTRE_STARTS);
        let best = descents
            .filter_map(|(_, shift)| {
                let start = explain_at(&mut tables.clone(), shift, self.measured);
                self.descend_centre(variant, shift, &start)
            })
            .min_by(|a, b| a.1.cost().total_cmp(&b.1.cost()))?;
        improved_centre(variant, now, best)
    }

    /// False for line points of another vision system.
    pub(super) fn has_pixels(&self) -> bool {
        let mut keyframes = self.measured.iter();
        keyframes.any(|keyframe| !keyframe.pixels.is_empty())
    }

    /// The best centre by steps to the neighbours of `shift` (pixels), from poses that explain this one.
    fn descend_centre(
        &self,
        variant: &SetupVariant,
        shift: [f32; 2],
        start: &Explanation,
    ) -> Option<(SetupVariant, Explanation)> {
        let field = Field::new(variant.field.clone()).ok()?;
        let mut tables = FieldTables::new(&field, &self.config);
        let mut refine_at = |centre_shift: [f32; 2], start: &Explanation| {
            let after = Change::Centre(centre_shift).apply(variant);
            let keyframes = after.apply(self.setup, self.measured);
            let explanation = refine(&mut tables, &keyframes, start);
            (after, explanation)
        };
        let mut best = refine_at(shift, start);
        for step in CENTRE_STEPS {
            loop {
                let [u, v] = best.0.centre_shift;
                let neighbours = [[step, 0.0], [-step, 0.0], [0.0, step], [0.0, -step]];
                // Poses move with the centre, by decimetres in all.
                let next = neighbours
                    .map(|[du, dv]| refine_at([u + du, v + dv], &best.1))
                    .into_iter()
                    .min_by(|a, b| a.1.cost().total_cmp(&b.1.cost()))?;
                let [du, dv] = next.0.centre_shift;
                if next.1.cost() >= best.1.cost() || math::hypot(du, dv) > CENTRE_REACH {
                    break;
                }
                best = next;
            }
        }
        Some(best)
    }

    /// The best height and the best focal length, each alone. Empty unless the map was traced from a mirror's profile.
    pub(super) fn search_optics(
        &self,
        variant: &SetupVariant,
        now: &Explanation,
    ) -> Vec<(Change, Improvement)> {
        let Some((height, focal)) = variant.optics(self.setup) else {
            return Vec::new();
        };
        let change =
            |value: f32, [range, least]: [f32; 2], steps: [f32; 4], of: fn(f32) -> Change| {
                let best = self.best_value(variant, value, range, steps, of)?;
                ((best - value).abs() >= least).then(|| of(best))
            };
        let changes = [
            change(
                height,
                [HEIGHT_RANGE, HEIGHT_MIN],
                HEIGHT_STEPS,
                Change::Height,
            ),
            change(
                focal,
                [FOCAL_RANGE * focal, FOCAL_MIN * focal],
                FOCAL_STEPS.map(|step| step * focal),
                Change::FocalLength,
            ),
        ];
        self.evaluate(variant, now, changes.into_iter().flatten().collect())
    }

    /// The value about `start` that explains a subset of the keyframes best.
    fn best_value(
        &self,
        variant: &SetupVariant,
        start: f32,
        range: f32,
        [coarse, fine @ ..]: [f32; 4],
        change: fn(f32) -> Change,
    ) -> Option<f32> {
        let stride = self.measured.len().div_ceil(SCAN_KEYFRAMES).max(1);
        let subset = thin_out(self.measured, stride);
        let reach = self.config.branch_and_bound.range_max;
        let field = Field::new(variant.field.clone()).ok()?;
        let mut tables = FieldTables::new(&field, &self.config);
        let configured = variant.apply(self.setup, &subset);
        explain(&mut tables, &configured);
        let within = |keyframes: &[localize::setup_check::Keyframe]| {
            let points = keyframes.iter().flat_map(|keyframe| &keyframe.points);
            points.filter(|point| point.at.distance() < reach).count() as f32
        };
        let points_min = POINTS_KEPT_MIN * within(&configured);
        let cost = |value: f32| {
            let keyframes = change(value).apply(variant).apply(self.setup, &subset);
            (within(&keyframes) >= points_min)
                .then(|| (value, explain(&mut tables.clone(), &keyframes).cost()))
        };
        let cheapest = |values: Vec<f32>| {
            let costs: Vec<(f32, f32)> = values.into_par_iter().filter_map(cost).collect();
            let best = costs.into_iter().min_by(|a, b| a.1.total_cmp(&b.1));
            best.map(|(value, _)| value)
        };
        let steps = (range / coarse).round() as i32;
        let mut best = cheapest(
            (-steps..=steps)
                .map(|k| start + coarse * k as f32)
                .collect(),
        )?;
        for step in fine {
            best = cheapest((-2..=2).map(|k| best + step * k as f32).collect())?;
        }
        Some(best)
    }
}

/// A centre's improvement over that of `variant`, which `now` explains. None for a shift that is no mistake.
fn improved_centre(
    variant: &SetupVariant,
    now: &Explanation,
    (after, explanation): (SetupVariant, Explanation),
) -> Option<(Change, Improvement)> {
    let [u, v] = after.centre_shift;
    let [u0, v0] = variant.centre_shift;
    if math::hypot(u - u0, v - v0) < CENTRE_MIN {
        return None;
    }
    let change = Change::Centre(after.centre_shift);
    let improvement = Improvement {
        change: change.clone(),
        after,
        comparison: compare_with_offsets(now, &explanation),
        by_steps: false,
        explanation,
    };
    Some((change, improvement))
}
