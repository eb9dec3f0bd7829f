//! Which sizes has the field, if those of its file do not fit and nothing is known of the mirror?
//!
//! The lines of the floor are straight by one shape of mirror alone, whatever the field is. Only its scale is searched: in each scale
//! poses on the field of the file start a fit of the sizes, and fits of sizes and of the mirror alternate. Images do not tell the scale
//! of field and mirror together, so that the median size is taken to be right.

use localize::Field;
use localize::field::{FieldConfig, FieldSize};
use localize::math;
use rayon::prelude::*;

use crate::calibrate::free_sizes::SIZE_STD;
use crate::calibrate::joint_fit::Markings;
use crate::calibrate::line_pixels::SearchImage;
use crate::calibrate::mirror_search::{MirrorHypothesis, MirrorSearch};
use crate::calibrate::radial_model::{KnownSizes, RadialModel};
use crate::calibrate::straight_lines::find_straight_mirror;

/// Scales to both sides of a guess: together as wide as the family of mirrors.
const SCALES: i32 = 14;
const SCALE_STEP: f64 = 1.07;

/// Scales whose sizes are fitted: those that explain most points with the sizes of the file.
const FITTED: usize = 10;

/// A size that differs by less, metres and as a share, is that of the file.
const SAME_SIZE: (f32, f32) = (0.05, 0.02);

/// Fits that explain the images alike and are passed on.
const FIELDS_MAX: usize = 3;

/// Fits that explain the images alike tell a size if they agree to this share.
const TOLD_SHARE: f64 = 0.04;

/// A field with the share of the points that it explains.
struct SizedField {
    field: FieldConfig,
    score: f64,
}

/// Sizes that explain the images.
pub(super) struct FoundSizes {
    /// Fields that explain them alike, the best first.
    pub(super) fields: Vec<Field>,
    /// The sizes in which they agree, but for the scale.
    pub(super) told: Vec<FieldSize>,
}

/// The sizes near those of `configured` by which the images fit best. `explains_as_well`: whether a share of points is no worse than
/// another one. `progress`: called with the work done, 0 to 1. None if no mirror explains the images.
pub(super) fn find_sizes(
    images: &[SearchImage],
    configured: &Field,
    known: KnownSizes,
    explains_as_well: impl Fn(f64, f64) -> bool,
    progress: &(dyn Fn(f32) + Sync),
) -> Option<FoundSizes> {
    let straight = find_straight_mirror(images, known)?;
    progress(0.1);
    let scales: Vec<f64> = (-SCALES..=SCALES).map(|k| SCALE_STEP.powi(k)).collect();
    let markings = Markings::new(configured);
    let search = MirrorSearch::new(configured, &markings, known);
    let mut starts: Vec<MirrorHypothesis> = scales
        .into_par_iter()
        .map(|scale| {
            let start = search.locate_and_refine_guess(&straight.scaled(scale), images);
            search.locate_and_refine(&start.model, images)
        })
        .collect();
    progress(0.4);
    starts.sort_by(|a, b| b.score.total_cmp(&a.score));
    starts.truncate(FITTED);
    let mut found: Vec<SizedField> = starts
        .into_par_iter()
        .filter_map(|start| fit_sizes(start.model, images, configured, known))
        .collect();
    progress(1.0);
    found.sort_by(|a, b| b.score.total_cmp(&a.score));
    let best = found.first()?;
    let alike: Vec<&SizedField> = found
        .iter()
        .filter(|other| explains_as_well(other.score, best.score))
        .collect();
    let mut told = FieldSize::all(&configured.config);
    for other in &alike {
        told = agreeing_sizes(&told, &best.field, &other.field);
    }
    let fields = alike.iter().filter_map(|found| {
        let scaled = in_file_scale(&configured.config, &found.field);
        Field::new(with_sizes(&configured.config, &scaled)).ok()
    });
    Some(FoundSizes {
        fields: fields.take(FIELDS_MAX).collect(),
        told,
    })
}

/// The sizes that agree in two fields, but for the scale in which most of them do. One alone agrees in some scale always.
fn agreeing_sizes(sizes: &[FieldSize], a: &FieldConfig, b: &FieldConfig) -> Vec<FieldSize> {
    let ratio = |size: &FieldSize| math::ln(f64::from(size.get(a) / size.get(b)));
    let near = |scale: f64| {
        let agrees = |size: &&FieldSize| (ratio(size) - scale).abs() < TOLD_SHARE;
        sizes.iter().filter(agrees).cloned().collect::<Vec<_>>()
    };
    let groups = sizes.iter().map(|size| near(ratio(size)));
    let most = groups.max_by_key(Vec::len);
    most.filter(|sizes| sizes.len() > 1).unwrap_or_default()
}

/// Fits the sizes and the mirror. None if the result is no mirror.
fn fit_sizes(
    model: RadialModel,
    images: &[SearchImage],
    configured: &Field,
    known: KnownSizes,
) -> Option<SizedField> {
    /// Fits of the sizes before each fit of the mirror.
    const ROUNDS: [usize; 5] = [3, 1, 1, 1, 1];
    let fit = SizesFit {
        images,
        configured,
        known,
    };
    let found = fit.alternate(model, configured.clone(), &ROUNDS)?;
    let found = fit.release_caught_sizes(found);
    Some(SizedField {
        field: found.field.config,
        score: found.mirror.score,
    })
}

/// Fits of the sizes and of the mirror on the same images.
struct SizesFit<'a> {
    images: &'a [SearchImage],
    configured: &'a Field,
    known: KnownSizes,
}

/// A mirror and the field that fits with it.
struct FittedField {
    mirror: MirrorHypothesis,
    field: Field,
}

impl SizesFit<'_> {
    /// Alternates fits of the sizes and of the mirror. `rounds`: fits of the sizes before each fit of the mirror. None if the result is
    /// no mirror.
    fn alternate(
        &self,
        mut model: RadialModel,
        mut field: Field,
        rounds: &[usize],
    ) -> Option<FittedField> {
        let mut last = None;
        for &size_fits in rounds {
            for _ in 0..size_fits {
                let markings = Markings::new(&field);
                let search = MirrorSearch::new(&field, &markings, self.known);
                let configured = &self.configured.config;
                (model, field) = search.refine_sizes(configured, &field, &model, self.images)?;
            }
            let markings = Markings::new(&field);
            let search = MirrorSearch::new(&field, &markings, self.known);
            let refined = search.locate_and_refine(&model, self.images);
            model = refined.model.clone();
            last = Some(refined);
        }
        let mirror = last?;
        let [inner, outer] = mirror.radii_px;
        let is_plausible = mirror.model.is_plausible(inner, outer);
        is_plausible.then_some(FittedField { mirror, field })
    }

    /// While poses were wrong, a size may have caught another marking's points, and its own are outliers since. Each size that is
    /// farther from the file's than expected starts there again, and stays there if that explains more points.
    fn release_caught_sizes(&self, mut found: FittedField) -> FittedField {
        const ROUNDS: [usize; 3] = [1, 1, 1];
        let configured = &self.configured.config;
        for size in FieldSize::all(configured) {
            let scale = file_scale(configured, &found.field.config);
            let expected = size.get(configured) / scale;
            if (size.get(&found.field.config) / expected - 1.0).abs() < SIZE_STD as f32 {
                continue;
            }
            let Ok(start) = Field::new(size.with(&found.field.config, expected)) else {
                continue;
            };
            let released = self.alternate(found.mirror.model.clone(), start, &ROUNDS);
            if let Some(released) = released
                && released.mirror.score > found.mirror.score
            {
                found = released;
            }
        }
        found
    }
}

/// The factor to a field's sizes with which the median of them is that of the file.
fn file_scale(configured: &FieldConfig, field: &FieldConfig) -> f32 {
    let sizes = FieldSize::all(configured);
    let mut ratios: Vec<f32> = sizes
        .iter()
        .map(|size| size.get(configured) / size.get(field))
        .collect();
    ratios.sort_by(f32::total_cmp);
    ratios.get(ratios.len() / 2).copied().unwrap_or(1.0)
}

/// The field in the scale in which the median size is that of the file.
fn in_file_scale(configured: &FieldConfig, field: &FieldConfig) -> FieldConfig {
    let factor = file_scale(configured, field);
    let scaled =
        |field: FieldConfig, size: &FieldSize| size.with(&field, factor * size.get(&field));
    FieldSize::all(configured)
        .iter()
        .fold(field.clone(), scaled)
}

/// The field of the file with the sizes that differ, in centimetres.
fn with_sizes(configured: &FieldConfig, found: &FieldConfig) -> FieldConfig {
    let sizes = FieldSize::all(configured);
    let changed = |field: FieldConfig, size: &FieldSize| {
        let (old, new) = (size.get(configured), size.get(found));
        let (metres, share) = SAME_SIZE;
        match (new - old).abs() > metres.max(share * old) {
            true => size.with(&field, (100.0 * new).round() / 100.0),
            false => field,
        }
    };
    sizes.iter().fold(configured.clone(), changed)
}
