//! Which sizes would the field have by the points? All sizes together, from the poses under the configured ones.
//!
//! A field of another kind differs in every size a little. Poses then compromise, most points stay within reach of some
//! marking, and no single size explains much (docs/methods.md 16.2).

use localize::Field;
use localize::config::LocalizeConfig;
use localize::field::{FieldConfig, FieldSize};
use localize::setup_check::{Explanation, FieldTables, Keyframe, refine};

/// Log likelihood that a size must gain to be changed: half the logarithm of some ten thousand points, as in Schwarz's
/// criterion.
pub(super) const PRIOR_COST: f32 = 5.0;
/// Steps of a size, metres.
const STEPS: [f32; 4] = [0.4, 0.2, 0.1, 0.04];
/// Passes over all sizes for each step.
const PASSES_MAX: usize = 3;
/// Cells of the distance field, metres. Distances to straight lines are exact in larger ones too, and many fields are tried.
const CELL: f32 = 0.1;
/// Changes below half a line's width are taken back, metres.
const CHANGE_MIN: f32 = 0.06;
/// The largest change that an imperfect map may explain: metres, and share of the size. No size beyond it, no mistake.
const MISTAKE_MIN: (f32, f32) = (0.15, 0.02);

/// The sizes in which two fields differ.
pub(super) fn changed(from: &FieldConfig, to: &FieldConfig) -> Vec<FieldSize> {
    let mut sizes = FieldSize::all(from);
    sizes.retain(|size| (size.get(from) - size.get(to)).abs() > 1e-3);
    sizes
}

/// A field with its cost, the number of its changed sizes included, and the poses on it.
struct Candidate {
    field: FieldConfig,
    cost: f32,
    explanation: Explanation,
}

struct Search<'a> {
    configured: &'a FieldConfig,
    sizes: Vec<FieldSize>,
    keyframes: &'a [Keyframe],
    config: LocalizeConfig,
}

/// The sizes that explain the keyframes best, starting at the poses of `now`.
pub(super) fn search(
    configured: &FieldConfig,
    keyframes: &[Keyframe],
    now: &Explanation,
    config: &LocalizeConfig,
) -> FieldConfig {
    let mut config = config.clone();
    config.distance_field.cell = config.distance_field.cell.max(CELL);
    let search = Search {
        configured,
        sizes: FieldSize::all(configured),
        keyframes,
        config,
    };
    let Some(mut best) = search.candidate(configured.clone(), now) else {
        return configured.clone();
    };
    for step in STEPS {
        for _ in 0..PASSES_MAX {
            let before = best.cost;
            for size in &search.sizes {
                search.descend(&mut best, size, step);
            }
            if best.cost >= before {
                break;
            }
        }
    }
    for size in &search.sizes {
        best.field = search.restored(&best.field, size);
    }
    let is_mistake = |size: &FieldSize| {
        let (old, new) = (size.get(configured), size.get(&best.field));
        (new - old).abs() > MISTAKE_MIN.0.max(MISTAKE_MIN.1 * old)
    };
    if changed(configured, &best.field).iter().any(is_mistake) {
        best.field
    } else {
        configured.clone()
    }
}

impl Search<'_> {
    /// Refines the poses of `start` on a field. None for impossible sizes.
    fn candidate(&self, field: FieldConfig, start: &Explanation) -> Option<Candidate> {
        let mut tables = FieldTables::new(&Field::new(field.clone()).ok()?, &self.config);
        let explanation = refine(&mut tables, self.keyframes, start);
        let is_changed =
            |size: &&FieldSize| (size.get(self.configured) - size.get(&field)).abs() > 1e-3;
        let prior = PRIOR_COST * self.sizes.iter().filter(is_changed).count() as f32;
        Some(Candidate {
            cost: explanation.cost() + prior,
            field,
            explanation,
        })
    }

    /// Changes one size while that explains more. A marking that is left out stays so.
    fn descend(&self, best: &mut Candidate, size: &FieldSize, step: f32) {
        for direction in [step, -step] {
            let mut moved = false;
            loop {
                let value = size.get(&best.field) + direction;
                let next = (value > 0.0)
                    .then(|| self.candidate(size.with(&best.field, value), &best.explanation))
                    .flatten()
                    .filter(|next| next.cost < best.cost);
                let Some(next) = next else { break };
                *best = next;
                moved = true;
            }
            if moved {
                break;
            }
        }
    }

    /// The field without a small change of a size; others are rounded to centimetres.
    fn restored(&self, field: &FieldConfig, size: &FieldSize) -> FieldConfig {
        let (old, new) = (size.get(self.configured), size.get(field));
        let value = if (new - old).abs() < CHANGE_MIN {
            old
        } else {
            (new * 100.0).round() / 100.0
        };
        size.with(field, value)
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use localize::setup_check::{WheelMotion, compare, explain};
    use localize::synthetic::drive::{SyntheticDrive, SyntheticDriveConfig};
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;

    fn shipped(name: &str) -> FieldConfig {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/fields");
        Field::load(&folder.join(name)).expect("a field").config
    }

    fn keyframes(field: &FieldConfig, drive: SyntheticDriveConfig, count: usize) -> Vec<Keyframe> {
        let field = Field::new(field.clone()).expect("a field");
        let drive = SyntheticDrive::new(&field, drive, ChaCha8Rng::seed_from_u64(7));
        let mut keyframes: Vec<Keyframe> = Vec::new();
        let mut rows = Vec::new();
        for sample in drive {
            let odometry = sample.odometry;
            rows.push([odometry.dx, odometry.dy, odometry.dtheta]);
            let motion = WheelMotion::from_increments(&rows);
            if !keyframes.is_empty() && motion.path + 0.5 * motion.turned < 1.0 {
                continue;
            }
            keyframes.push(Keyframe {
                stamp: sample.stamp,
                points: sample.points,
                motion: (!keyframes.is_empty()).then_some(motion),
                compass: Some(sample.compass.heading),
            });
            rows.clear();
            if keyframes.len() == count {
                break;
            }
        }
        keyframes
    }

    /// The sizes that are found, and whether they are better than the configured ones.
    fn found(configured: &FieldConfig, keyframes: &[Keyframe]) -> (FieldConfig, bool) {
        let config = LocalizeConfig::default();
        let explained = |field: &FieldConfig| {
            let field = Field::new(field.clone()).expect("a field");
            explain(&mut FieldTables::new(&field, &config), keyframes)
        };
        let now = explained(configured);
        let field = search(configured, keyframes, &now, &config);
        let mut comparison = compare(&now, &explained(&field));
        comparison.gain -= PRIOR_COST * changed(configured, &field).len() as f32;
        (field, comparison.is_better())
    }

    #[test]
    fn sizes_of_a_field_of_another_kind_are_found() {
        let configured = shipped("msl_12x8.toml");
        let mut real = configured.clone();
        (real.length, real.width) = (12.35, 8.4);
        (real.centre_circle_radius, real.penalty_spot) = (1.4, 2.05);
        (real.penalty_area.width, real.goal_area.width) = (4.4, 2.4);
        let (field, better) = found(&configured, &keyframes(&real, Default::default(), 14));
        assert!(better);
        // The goal area's sides are short: where few points lie on them, their size stays as it was.
        let edits = changed(&configured, &field);
        let texts: Vec<String> = edits
            .iter()
            .map(|size| size.text(&configured, &field))
            .collect();
        for expected in [
            "length",
            "width",
            "centre_circle_radius",
            "penalty_area.width",
        ] {
            assert!(
                texts.iter().any(|text| text.starts_with(expected)),
                "{texts:?}"
            );
        }
        for size in edits {
            let off = (size.get(&field) - size.get(&real)).abs();
            assert!(off < 0.12, "{texts:?}: {off} m off");
        }
    }

    #[test]
    fn right_sizes_are_kept_beside_false_lines() {
        let configured = shipped("msl_12x8.toml");
        let mut real = configured.clone();
        // Those of another sport.
        real.extra_lines = vec![
            [-6.0, 2.4, 6.0, 2.4],
            [-3.4, -4.0, -3.4, 4.0],
            [4.9, -4.0, 4.9, 4.0],
        ];
        let hard = SyntheticDriveConfig {
            outlier_share: 0.3,
            occluded_share: 0.3,
            ..SyntheticDriveConfig::default()
        };
        let (field, better) = found(&configured, &keyframes(&real, hard, 20));
        assert!(!better, "{:?}", changed(&configured, &field));
    }
}
