//! Which errors of the map explain many images whose poses are roughly known? For a check of the set-up, which takes the
//! mount for what it is, an expected error, before it takes it for another mistake.

use super::basis::MapBasis;
use super::certainty::REPETITION;
use super::config::MapCorrectionConfig;
use super::image_fit::ImageState;
use super::learning::{INDEPENDENT_POINTS, is_expected};
use super::map_fit::MapFit;
use super::state::{INITIAL_NOISE, MapCorrection};
use super::sums::{PoseMatrix, PoseVector, TermMatrix, TermVector};
use crate::frames::{At, Pose};
use crate::matching::distance_field::DistanceField;
use crate::matching::{MatchConfig, PARAMETERS};
use crate::math;
use crate::sample::LinePoint;
use crate::tilt::ground_from_map;

/// Shares of a new map's standard deviation by which the points' reach is widened, step by step.
const REACHES: [f32; 7] = [2.0, 1.0, 0.7, 0.4, 0.2, 0.1, 0.0];
/// Steps at each reach. The lean of the rig, the mean of all tilts, follows slowly.
const STEPS: usize = 4;
/// Information of a pose that its points alone determine: 1 m and 30°.
const POSE_INFORMATION: [f64; 3] = [1.0, 1.0, 3.6];

/// Errors of a map that explain the images of a drive.
#[derive(Debug, Clone, PartialEq)]
pub struct DriveFit {
    basis: MapBasis,
    coefficients: TermVector,
    covariance: TermMatrix,
    /// Mean tilt of robot and rig, radians, and the viewpoint's height, metres.
    lean: [f32; 2],
    height: f32,
    /// Are they such as a mount may have that nobody measured?
    pub is_expected: bool,
}

impl DriveFit {
    /// Fits the errors of a map, poses and tilts to images from their poses by the map as it was given. None if a step is
    /// singular.
    pub fn find(
        basis: &MapBasis,
        config: &MapCorrectionConfig,
        images: &[(Pose, &[LinePoint])],
        distances: &DistanceField,
        matching: &MatchConfig,
    ) -> Option<Self> {
        let mut map = MapCorrection::new(basis.clone(), config.clone());
        let tilt_std = f64::from(matching.tilt_std_deg.to_radians()).max(1e-3);
        let mut prior = PoseMatrix::zeros();
        for k in 0..PARAMETERS {
            let of_tilt = 1.0 / (tilt_std * tilt_std);
            prior[(k, k)] = POSE_INFORMATION.get(k).copied().unwrap_or(of_tilt);
        }
        let start = |(pose, _): &(Pose, &[LinePoint])| ImageState {
            coefficients: TermVector::zeros(),
            pose: *pose,
            tilt: [0.0; 2],
        };
        let mut states: Vec<ImageState> = images.iter().map(start).collect();
        let (mut coefficients, mut covariance) = (TermVector::zeros(), map.prior);
        let mut lean = [0.0; 2];
        for reach in REACHES.into_iter().flat_map(|reach| [reach; STEPS]) {
            let (mut information, mut gradient) = (TermMatrix::zeros(), TermVector::zeros());
            let mut sums = Vec::with_capacity(images.len());
            for (state, (pose, points)) in states.iter_mut().zip(images) {
                state.coefficients = coefficients;
                map.correct_single(&mut points.to_vec());
                let (image, _) = map.image_sums(state, reach, distances, matching);
                let offset = state.pose.difference(*pose);
                let deviation = PoseVector::from_fn(|i, _| match i {
                    0..3 => f64::from(offset[i]),
                    _ => f64::from(state.tilt[i - 3] - lean[i - 3]),
                });
                let evidence = image.eliminate_pose(&prior, &deviation)?;
                let independent = f64::from(INDEPENDENT_POINTS) / points.len().max(1) as f64;
                let share = independent.min(1.0) / (INITIAL_NOISE * REPETITION);
                information += evidence.information * share;
                gradient += evidence.gradient * share;
                sums.push((image, deviation));
            }
            // At the new coefficients: Σ₀⁻¹ c + g + I (c − c₀) = 0.
            let factor = TermMatrix::identity() + map.prior * information;
            covariance = factor.lu().solve(&map.prior)?;
            let target = covariance * (information * coefficients - gradient);
            let step = target - coefficients;
            for (state, (image, deviation)) in states.iter_mut().zip(&sums) {
                let moved = image.pose_step(&prior, deviation, &step)?;
                state.move_by(&moved);
            }
            coefficients = target;
            // A rig that leans tilts all images.
            let count = states.len().max(1) as f32;
            lean = [0, 1].map(|k| states.iter().map(|state| state.tilt[k]).sum::<f32>() / count);
        }
        coefficients
            .iter()
            .all(|value| value.is_finite())
            .then(|| DriveFit {
                is_expected: is_expected(&coefficients, &map.prior, basis.terms().len()),
                basis: basis.clone(),
                lean,
                height: matching.viewpoint_height,
                coefficients,
                covariance: (covariance + covariance.transpose()) * 0.5,
            })
    }

    /// What a localizer takes over.
    pub fn map_fit(&self) -> MapFit {
        let terms = self.basis.terms().len();
        let viewpoint_shift = math::hypot(self.lean[0], self.lean[1]) * self.height;
        MapFit::new(terms, &self.coefficients, &self.covariance, viewpoint_shift)
    }

    /// The points as the map without these errors shows them.
    pub fn correct(&self, points: &[LinePoint]) -> Vec<LinePoint> {
        let coefficients = self.coefficients.map(|value| value as f32);
        let prepared = self.basis.prepare(coefficients.into());
        let corrected = points.iter().map(|point| {
            let displaced = prepared.displace([point.at.x, point.at.y]).at;
            let [x, y] = ground_from_map(displaced, self.lean, self.height);
            LinePoint {
                at: At::new(x, y),
                ..*point
            }
        });
        corrected.collect()
    }
}
