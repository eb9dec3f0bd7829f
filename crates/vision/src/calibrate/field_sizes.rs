//! Would another size of the field explain the images better? A map that is free bends to a field that is half a metre too short, and
//! halves of the images bend alike. Each size is changed by itself, and the map refined: the right size leaves less of each image
//! off the markings (docs/calibration.md).

use localize::Field;
use localize::field::{FieldConfig, FieldSize};
use localize::robot::CameraConfig;
use rayon::prelude::*;

use crate::calibrate::joint_fit::{FitImage, JointFit, Markings, Schedule};
use crate::calibrate::lines::{LinesCalibration, NamedImage, start_refinement};
use crate::calibrate::map_correction::{CorrectionPoint, MapCorrection};
use crate::calibrate::rival_fields::{compared_images, is_cheaper};
use crate::config::VisionConfig;

/// Steps of a size, metres: the first is within reach of the fit.
const STEPS: [f32; 3] = [0.2, 0.1, 0.05];

/// For markings that moved by a step.
const SCHEDULE: Schedule = Schedule {
    metres: &[0.25, 0.15, 0.08],
    relative: &[0.0; 3],
};

/// A field with the map and the poses that fit the images to it.
#[derive(Clone)]
struct Candidate {
    field: FieldConfig,
    model: MapCorrection,
    images: Vec<FitImage<CorrectionPoint>>,
    /// Mean cost of the points of each image.
    costs: Vec<f64>,
}

/// The size whose change explains the images best, as an edit of the field file. None if no change explains them better by more
/// than chance.
///
/// `found`: the calibration of `images` on `field`, by `camera`.
pub(super) fn find_better_size(
    found: &LinesCalibration,
    camera: &CameraConfig,
    field: &Field,
    images: &[NamedImage],
    vision_config: &VisionConfig,
) -> Option<String> {
    let compared = compared_images(found, images);
    let start = start_refinement(camera, &found.map, field, &compared, vision_config).ok()?;
    let own = fit(&field.config, start)?;
    let rivals = FieldSize::all(&field.config)
        .into_par_iter()
        .map(|size| {
            let best = descend(&size, &own);
            (size, best)
        })
        .filter(|(_, best)| is_cheaper(&best.costs, &own.costs));
    let (size, best) = rivals.min_by(|(_, a), (_, b)| a.cost().total_cmp(&b.cost()))?;
    Some(size.text(&field.config, &best.field))
}

/// Fits map and poses to a field. None for an impossible one.
fn fit(
    config: &FieldConfig,
    (model, images): (MapCorrection, Vec<FitImage<CorrectionPoint>>),
) -> Option<Candidate> {
    let markings = Markings::new(&Field::new(config.clone()).ok()?);
    let mut fit = JointFit::new(&markings, model, images);
    fit.optimize(&SCHEDULE);
    let costs = fit.images.iter().map(|image| fit.evaluate(image).cost);
    Some(Candidate {
        field: config.clone(),
        costs: costs.collect(),
        model: fit.model,
        images: fit.images,
    })
}

/// Changes one size while that costs less.
fn descend(size: &FieldSize, from: &Candidate) -> Candidate {
    let mut best = from.clone();
    for step in STEPS {
        for direction in [step, -step] {
            let mut moved = false;
            while let Some(next) = change(size, &best, direction) {
                best = next;
                moved = true;
            }
            if moved {
                break;
            }
        }
    }
    best
}

/// With a size changed by some metres, if that costs less.
fn change(size: &FieldSize, from: &Candidate, metres: f32) -> Option<Candidate> {
    let value = size.get(&from.field) + metres;
    let field = (value > 0.0).then(|| size.with(&from.field, value))?;
    let start = (from.model.clone(), from.images.clone());
    fit(&field, start).filter(|next| next.cost() < from.cost())
}

impl Candidate {
    fn cost(&self) -> f64 {
        self.costs.iter().sum()
    }
}
