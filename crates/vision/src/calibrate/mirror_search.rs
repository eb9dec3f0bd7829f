//! Which mirror explains the line points of several images, if nothing is known of it?
//!
//! For each member of a family of mirrors, the poses of a few images are searched over the whole field. The members
//! that explain most points are refined jointly with the poses. Points are judged by distances relative to their range,
//! since the wrong scale must not decide.

use localize::field::FieldConfig;
use localize::frames::At;
use localize::global_search::branch_and_bound::{BranchAndBound, BranchAndBoundConfig};
use localize::matching::{MatchConfig, Matcher};
use localize::math;
use localize::sample::LinePoint;
use localize::{Field, Pose};
use rayon::prelude::*;

use crate::calibrate::free_sizes::FreeSizes;
use crate::calibrate::joint_fit::{FitImage, JointFit, Markings, Schedule};
use crate::calibrate::line_pixels::SearchImage;
use crate::calibrate::radial_family::{RadialFunction, family};
use crate::calibrate::radial_model::{KnownSizes, PixelPoint, RadialModel};

/// From a member of the family to the accuracy of paint.
const FAMILY_SCHEDULE: Schedule = Schedule {
    metres: &[0.10, 0.08, 0.06, 0.05, 0.05, 0.05, 0.04],
    relative: &[0.12, 0.08, 0.05, 0.035, 0.02, 0.01, 0.005],
};

/// From poses on a field that is a tenth off to the accuracy of paint.
const SIZES_SCHEDULE: Schedule = Schedule {
    metres: &[0.12, 0.09, 0.06, 0.036, 0.024, 0.018, 0.015],
    relative: &[0.05, 0.04, 0.03, 0.02, 0.01, 0.01, 0.005],
};

/// A point counts half at this share of its range from a marking; a twentieth, as members are that far from a mirror.
const RELATIVE_TOLERANCE: f64 = 0.05;

/// The same once the model is refined.
const REFINED_TOLERANCE: f64 = 0.01;

/// Points beyond this range are not searched, metres.
const RANGE_MAX: f64 = 9.0;

/// A mirror with the poses that it gives the images.
#[derive(Debug, Clone)]
pub(super) struct MirrorHypothesis {
    pub(super) model: RadialModel,
    /// One per image of the search.
    pub(super) poses: Vec<Option<Pose>>,
    /// Share of the points that the markings explain, 0 to 1.
    pub(super) score: f64,
    /// Image radii between which most of these points lie (5 and 95 %), pixels; of a refined mirror only.
    pub(super) radii_px: [f64; 2],
}

impl MirrorHypothesis {
    /// True if this mirror differs by less than a tenth in range from another one, where that explains line points.
    pub(super) fn is_similar_to(&self, other: &MirrorHypothesis) -> bool {
        self.model.is_similar(&other.model, other.radii_px)
    }
}

/// The search over a field's markings.
pub(super) struct MirrorSearch<'a> {
    pub(super) markings: &'a Markings,
    search: BranchAndBound,
    sizes: KnownSizes,
}

impl<'a> MirrorSearch<'a> {
    pub(super) fn new(field: &Field, markings: &'a Markings, sizes: KnownSizes) -> Self {
        let config = BranchAndBoundConfig {
            hypotheses_max: 3,
            runner_up_blocks: 200,
            ..BranchAndBoundConfig::default()
        };
        MirrorSearch {
            markings,
            search: BranchAndBound::new(field, &markings.distances, config),
            sizes,
        }
    }

    /// Number of members of the family.
    pub(super) fn family_size(&self) -> usize {
        family().count()
    }

    /// All members of the family with the poses of the images, best first.
    pub(super) fn search_family(
        &self,
        images: &[SearchImage],
        done: &(dyn Fn() + Sync),
    ) -> Vec<MirrorHypothesis> {
        let members: Vec<RadialFunction> = family().collect();
        let mut found: Vec<MirrorHypothesis> = members
            .par_iter()
            .map_init(
                || self.search.clone(),
                |search, &function| {
                    let model = RadialModel::new(function, self.sizes);
                    let hypothesis = self.locate(search, model, images, RELATIVE_TOLERANCE);
                    done();
                    hypothesis
                },
            )
            .collect();
        found.sort_by(|a, b| b.score.total_cmp(&a.score));
        found
    }

    fn locate(
        &self,
        search: &mut BranchAndBound,
        model: RadialModel,
        images: &[SearchImage],
        tolerance: f64,
    ) -> MirrorHypothesis {
        let found: Vec<Option<(f64, Pose)>> = images
            .iter()
            .map(|image| self.locate_image(search, &model, image, tolerance))
            .collect();
        let total: f64 = found.iter().flatten().map(|(score, _)| score).sum();
        MirrorHypothesis {
            model,
            score: total / images.len().max(1) as f64,
            poses: found.into_iter().map(|found| Some(found?.1)).collect(),
            radii_px: [0.0, f64::INFINITY],
        }
    }

    fn locate_image(
        &self,
        search: &mut BranchAndBound,
        model: &RadialModel,
        image: &SearchImage,
        tolerance: f64,
    ) -> Option<(f64, Pose)> {
        // Upright: a guess is off by more than a tilt could compensate.
        let mut matcher = Matcher::new(MatchConfig {
            tilt_std_deg: 0.0,
            map_std: 0.06,
            ..MatchConfig::default()
        });
        let points: Vec<LinePoint> = image
            .points
            .iter()
            .filter(|point| model.is_wide_enough(point))
            .filter_map(|point| {
                let (ground, footprint) = model.ground_and_footprint(point.at_px, [0.0; 2])?;
                let [x, y] = ground.map(|axis| axis as f32);
                let range = math::hypot(ground[0], ground[1]);
                (range < RANGE_MAX).then(|| LinePoint {
                    at: At::new(x, y),
                    std_radial: math::hypot(footprint[0], tolerance * range) as f32,
                    std_tangential: math::hypot(footprint[1], tolerance * range) as f32,
                })
            })
            .collect();
        let thinned: Vec<LinePoint> = points
            .iter()
            .step_by(points.len().div_ceil(160).max(1))
            .copied()
            .collect();
        let found = search.find_hypotheses(&self.markings.distances, &mut matcher, &thinned, None);
        found
            .iter()
            .map(|hypothesis| {
                let score = self.score(&points, hypothesis.pose, tolerance);
                (score / image.points.len() as f64, hypothesis.pose)
            })
            .max_by(|a, b| a.0.total_cmp(&b.0))
    }

    /// Σ t²/(t² + d²) with a tolerance t relative to the range.
    fn score(&self, points: &[LinePoint], pose: Pose, tolerance: f64) -> f64 {
        let (sin, cos) = math::sin_cos(pose.theta);
        let score = points.iter().map(|point| {
            let (x, y) = (
                pose.x + cos * point.at.x - sin * point.at.y,
                pose.y + sin * point.at.x + cos * point.at.y,
            );
            let distance = f64::from(self.markings.distances.nearest(x, y).signed_distance);
            let tolerance = 0.02 + tolerance * f64::from(point.at.distance());
            tolerance * tolerance / (tolerance * tolerance + distance * distance)
        });
        score.sum()
    }

    /// Fits model and poses jointly.
    fn refine(
        &self,
        model: &RadialModel,
        poses: &[Option<Pose>],
        images: &[SearchImage],
    ) -> MirrorHypothesis {
        let mut fit = JointFit::new(self.markings, model.clone(), placed(images, poses));
        fit.optimize(&FAMILY_SCHEDULE);
        let points: usize = fit.images.iter().map(|image| image.points.len()).sum();
        let mut radii = explained_radii(&fit);
        radii.sort_by(f64::total_cmp);
        let quantile = |share: f64| {
            let index = (share * radii.len().saturating_sub(1) as f64) as usize;
            radii.get(index).copied().unwrap_or(0.0)
        };
        MirrorHypothesis {
            poses: poses.to_vec(),
            score: radii.len() as f64 / points.max(1) as f64,
            radii_px: [quantile(0.05), quantile(0.95)],
            model: fit.model,
        }
    }

    /// Searches the poses of all images on a field of unknown sizes, then fits them, the mirror's tilt and the sizes, which are near
    /// those of `configured`. `field`: the markings of this search. None if a size cannot change.
    pub(super) fn refine_sizes(
        &self,
        configured: &FieldConfig,
        field: &Field,
        model: &RadialModel,
        images: &[SearchImage],
    ) -> Option<(RadialModel, Field)> {
        let sizes = FreeSizes::new(configured, field)?;
        let poses = self.locate_images(model, images, REFINED_TOLERANCE);
        let fit_images = placed(images, &poses);
        let mut fit = JointFit::new(self.markings, model.clone(), fit_images)
            .with_sizes(sizes, &RadialModel::TILT);
        fit.optimize(&SIZES_SCHEDULE);
        let (model, field) = fit.into_model_and_field();
        Some((model, field?))
    }

    /// Alternates joint fits and searches of all poses; the score is that of the last fit.
    pub(super) fn refine_repeatedly(
        &self,
        start: MirrorHypothesis,
        images: &[SearchImage],
        rounds: usize,
    ) -> MirrorHypothesis {
        let mut hypothesis = self.refine(&start.model, &start.poses, images);
        for _ in 1..rounds {
            hypothesis = self.locate_and_refine(&hypothesis.model, images);
        }
        hypothesis
    }

    /// Searches the poses of all images under a model, then fits model and poses jointly.
    pub(super) fn locate_and_refine(
        &self,
        model: &RadialModel,
        images: &[SearchImage],
    ) -> MirrorHypothesis {
        let poses = self.locate_images(model, images, REFINED_TOLERANCE);
        self.refine(model, &poses, images)
    }

    /// As `locate_and_refine`, with a model whose scale is a guess.
    pub(super) fn locate_and_refine_guess(
        &self,
        model: &RadialModel,
        images: &[SearchImage],
    ) -> MirrorHypothesis {
        let poses = self.locate_images(model, images, RELATIVE_TOLERANCE);
        self.refine(model, &poses, images)
    }

    fn locate_images(
        &self,
        model: &RadialModel,
        images: &[SearchImage],
        tolerance: f64,
    ) -> Vec<Option<Pose>> {
        images
            .par_iter()
            .map_init(
                || self.search.clone(),
                |search, image| Some(self.locate_image(search, model, image, tolerance)?.1),
            )
            .collect()
    }
}

/// The images that have a pose.
fn placed(images: &[SearchImage], poses: &[Option<Pose>]) -> Vec<FitImage<PixelPoint>> {
    let pairs = images.iter().zip(poses);
    pairs
        .filter_map(|(image, pose)| {
            Some(FitImage::new(image.index, image.points.clone(), (*pose)?))
        })
        .collect()
}

/// Image radii of the points that lie on markings, pixels.
fn explained_radii(fit: &JointFit<'_, RadialModel>) -> Vec<f64> {
    let explained = fit.images.iter().flat_map(|image| {
        let points = image.points.iter();
        points.filter(|point| fit.is_inlier(image, point))
    });
    explained
        .map(|point| math::hypot(point.at_px[0], point.at_px[1]))
        .collect()
}
