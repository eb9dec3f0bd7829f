//! The sizes of a field as unknowns of the joint fit.

use localize::Field;
use localize::field::{FieldConfig, FieldSize, Marking};
use localize::matching::distance_field::{NearestMarking, tangent};

/// Standard deviation of a size from that of the field file, as a share of it: what no image shows stays as it is there.
pub(super) const SIZE_STD: f64 = 0.2;

/// A size changes by no more than this share in a step of the fit.
const CHANGE_MAX: f32 = 0.2;

/// By this much markings move for the derivatives, metres.
const STEP: f32 = 0.01;

/// A field whose sizes are free.
pub(super) struct FreeSizes {
    configured: FieldConfig,
    field: Field,
    sizes: Vec<FieldSize>,
    /// The markings of the field with each size longer by `STEP`.
    moved: Vec<Vec<Marking>>,
}

impl FreeSizes {
    /// Sizes near those of `configured`, starting at those of `field`. None if one of them cannot be longer.
    pub(super) fn new(configured: &FieldConfig, field: &Field) -> Option<Self> {
        let sizes = FieldSize::all(configured);
        Some(FreeSizes {
            moved: moved_markings(&sizes, &field.config)?,
            configured: configured.clone(),
            field: field.clone(),
            sizes,
        })
    }

    /// The field with the present sizes.
    pub(super) fn into_field(self) -> Field {
        self.field
    }

    pub(super) fn count(&self) -> usize {
        self.sizes.len()
    }

    /// The nearest marking. Appends the derivatives of its signed distance by the sizes, whose first number is `first`.
    pub(super) fn nearest(
        &self,
        [x, y]: [f32; 2],
        first: usize,
        row: &mut Vec<(usize, f64)>,
    ) -> NearestMarking {
        let tangents = self.field.markings.iter().map(|it| tangent(it, x, y));
        let found = tangents
            .enumerate()
            .min_by(|a, b| (a.1.signed_distance.abs()).total_cmp(&b.1.signed_distance.abs()));
        let Some((index, nearest)) = found else {
            return NearestMarking {
                signed_distance: f32::MAX,
                normal: [1.0, 0.0],
            };
        };
        for (number, moved) in self.moved.iter().enumerate() {
            let change = tangent(&moved[index], x, y).signed_distance - nearest.signed_distance;
            // Past the end of a line the sign may turn.
            if change != 0.0 && change.abs() <= STEP {
                row.push((first + number, f64::from(change / STEP)));
            }
        }
        nearest
    }

    /// The weight of each size's square and how far it is from the file's.
    pub(super) fn prior_terms(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        self.sizes.iter().map(|size| {
            let configured = size.get(&self.configured);
            let std = SIZE_STD * f64::from(configured);
            let off = size.get(&self.field.config) - configured;
            (1.0 / (std * std), f64::from(off))
        })
    }

    /// Changes all sizes, metres; none if that field is impossible.
    pub(super) fn change(&mut self, changes: impl Iterator<Item = f64>) {
        let mut config = self.field.config.clone();
        for (size, change) in self.sizes.iter().zip(changes) {
            let now = size.get(&config);
            let limit = CHANGE_MAX * now;
            config = size.with(&config, now + (change as f32).clamp(-limit, limit));
        }
        let moved = moved_markings(&self.sizes, &config);
        if let (Ok(field), Some(moved)) = (Field::new(config), moved) {
            (self.field, self.moved) = (field, moved);
        }
    }
}

fn moved_markings(sizes: &[FieldSize], config: &FieldConfig) -> Option<Vec<Vec<Marking>>> {
    let markings = |size: &FieldSize| {
        let longer = size.with(config, size.get(config) + STEP);
        Some(Field::new(longer).ok()?.markings)
    };
    sizes.iter().map(markings).collect()
}
