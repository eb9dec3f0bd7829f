//! Would other sizes of the field, or another field, explain the measurements better?

use std::path::Path;

use localize::Field;
use localize::field::{Axis, FieldConfig, FieldSize};
use localize::setup_check::{Explanation, FieldTables, refine};
use rayon::prelude::*;

use super::assess::{Improvement, Trial};
use super::change::Change;
use super::field_sizes;
use super::measurements::{MeasuredKeyframe, thin_out};
use super::variant::SetupVariant;
use crate::paths;

/// Keyframes for the first selection of a field's size; the best sizes are then compared on all.
pub(super) const SCAN_KEYFRAMES: usize = 12;
/// Steps of a field's size, metres: half of the first is within the matcher's reach.
const SIZE_STEPS: [f32; 3] = [0.5, 0.2, 0.05];
/// Range of a field's size against the configured one.
const SIZE_RANGE: (f32, f32) = (0.5, 2.0);
/// A smaller change of a field's size is no mistake: share of the size, and metres for a large one.
const SIZE_SHARE_MIN: f32 = 0.02;
const SIZE_MIN: f32 = 0.1;

impl Trial<'_> {
    /// The fields of config/fields that differ from the variant's.
    pub(super) fn shipped_fields(variant: &SetupVariant) -> Vec<Change> {
        let Ok(folder) = paths::find_resource("config/fields") else {
            return Vec::new();
        };
        let mut files: Vec<_> = std::fs::read_dir(folder)
            .into_iter()
            .flatten()
            .flatten()
            .map(|entry| entry.path())
            .filter(|path| path.extension().is_some_and(|ext| ext == "toml"))
            .collect();
        files.sort();
        files
            .into_iter()
            .filter_map(|path| {
                let field = Field::load(&path).ok()?.config;
                (!is_same_size(&field, &variant.field))
                    .then(|| Change::Field(shorten(&path), Box::new(field)))
            })
            .collect()
    }

    /// The field's sizes measured to the other edge of the lines. Its poses are centimetres from those of the configured field.
    pub(super) fn search_measured_to(
        &self,
        variant: &SetupVariant,
        now: &Explanation,
    ) -> Option<(Change, Improvement)> {
        let change = Change::MeasuredTo(variant.field.measured_to.other());
        let after = change.apply(variant);
        let field = Field::new(after.field.clone()).ok()?;
        let mut tables = FieldTables::new(&field, &self.config);
        let keyframes = after.apply(self.setup, self.measured);
        let explanation = refine(&mut tables, &keyframes, now);
        let improvement = Improvement::over(now, change.clone(), after, explanation);
        Some((change, improvement))
    }

    /// The best length and the best width, each alone.
    pub(super) fn search_size(
        &self,
        variant: &SetupVariant,
        now: &Explanation,
    ) -> Vec<(Change, Improvement)> {
        let stride = self.measured.len().div_ceil(SCAN_KEYFRAMES).max(1);
        let subset = thin_out(self.measured, stride);
        let changes = [Axis::X, Axis::Y].map(|axis| self.best_extent(variant, &subset, axis));
        let changes = changes.into_iter().flatten().collect();
        self.evaluate(variant, now, changes)
    }

    /// All sizes of the field together: a field of another kind, of which no single size explains much.
    pub(super) fn search_all_sizes(
        &self,
        variant: &SetupVariant,
        now: &Explanation,
    ) -> Option<Improvement> {
        let keyframes = variant.apply(self.setup, self.measured);
        let field = field_sizes::search(&variant.field, &keyframes, now, &self.config);
        let changed = field_sizes::changed(&variant.field, &field).len();
        if changed == 0 {
            return None;
        }
        let change = Change::Sizes {
            from: Box::new(variant.field.clone()),
            to: Box::new(field),
        };
        let found = self.evaluate(variant, now, vec![change]);
        let mut improvement = found.into_iter().next()?.1;
        improvement.comparison.gain -= field_sizes::PRIOR_COST * changed as f32;
        improvement.comparison.is_better().then_some(improvement)
    }

    /// The best distance between the field's ends or sides. None for the configured one.
    fn best_extent(
        &self,
        variant: &SetupVariant,
        subset: &[MeasuredKeyframe],
        axis: Axis,
    ) -> Option<Change> {
        let extent = FieldSize::between_ends(&variant.field, axis)?;
        let start = extent.get(&variant.field);
        let change = |metres: f32| Change::Sizes {
            from: Box::new(variant.field.clone()),
            to: Box::new(extent.with(&variant.field, metres)),
        };
        let cost = |size: f32| {
            let explanation = self.explain(&change(size).apply(variant), subset)?;
            Some((size, explanation.cost()))
        };
        let cheapest = |sizes: Vec<f32>| -> Option<(f32, f32)> {
            let costs: Vec<(f32, f32)> = sizes.into_par_iter().filter_map(cost).collect();
            costs.into_iter().min_by(|a, b| a.1.total_cmp(&b.1))
        };
        let [coarse, fine @ ..] = SIZE_STEPS;
        let (below, above) = (
            (start * (1.0 - SIZE_RANGE.0) / coarse) as i32,
            (start * (SIZE_RANGE.1 - 1.0) / coarse) as i32,
        );
        let sizes = (-below..=above).map(|k| start + coarse * k as f32);
        let (mut best, _) = cheapest(sizes.collect())?;
        for step in fine {
            let sizes = (-2..=2).map(|k| best + step * k as f32);
            (best, _) = cheapest(sizes.collect())?;
        }
        ((best - start).abs() > SIZE_MIN.min(SIZE_SHARE_MIN * start))
            .then(|| change((best * 100.0).round() / 100.0))
    }
}

fn is_same_size(a: &FieldConfig, b: &FieldConfig) -> bool {
    (a.length - b.length).abs() < SIZE_SHARE_MIN * b.length
        && (a.width - b.width).abs() < SIZE_SHARE_MIN * b.width
}

/// The path below the repository, if it is there.
fn shorten(path: &Path) -> std::path::PathBuf {
    let name = path.file_name().unwrap_or_default();
    Path::new("config/fields").join(name)
}
