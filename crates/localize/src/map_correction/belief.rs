//! The estimate of a map's unknowns: an information filter over all tracked images.

use nalgebra::Matrix3;

use super::basis::{MapBasis, NODES, TERMS_MAX, TermKind};
use super::config::MapCorrectionConfig;
use super::sums::{
    ImageSums, MapEvidence, PoseByTerm, PoseMatrix, PoseVector, TermMatrix, TermVector, widen,
};
use crate::frames::{At, Pose, RobotFrame, wrap_angle};
use crate::matching::distance_field::DistanceField;
use crate::matching::{Match, MatchConfig, Matrix5, PARAMETERS};
use crate::math;
use crate::sample::LinePoint;
use crate::stamp::Stamp;
use crate::tilt::ground_from_map;

/// Information of pose and tilt that is assumed where an image alone decides: 10 m, π and 10°.
const FREE_POSE_INFORMATION: [f64; 3] = [1e-2, 1e-2, 1e-1];
const FREE_TILT_INFORMATION: f64 = 32.0;

/// Points that carry the information of an image; more are too close together to be independent.
const INDEPENDENT_POINTS: f32 = 120.0;

/// Independent images between two tests for a small knock.
const BLOCK_IMAGES: u32 = 20;

/// Tests in a row that must find a large knock: one image may be misled by what covers the markings.
const KNOCK_TESTS: u32 = 2;

/// Distance from the map as given beyond which an estimate is discarded, in standard deviations of a new map.
const PLAUSIBLE_SIGMAS: f64 = 8.0;

/// Largest mean information of an image, relative to what is known already.
const RELATIVE_INFORMATION_MAX: f64 = 0.5;

/// Variance of the residuals over the stated one before any was seen.
const INITIAL_NOISE: f64 = 4.0;

/// Share by which an image changes the learned variance of the residuals.
const NOISE_RATE: f64 = 0.1;

/// One unknown of the map, in the unit of its kind.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TermEstimate {
    /// What it stands for.
    pub kind: TermKind,
    /// Estimated value.
    pub value: f32,
    /// Its standard deviation.
    pub std: f32,
}

/// What is known about the map's errors.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MapCorrectionEstimate {
    /// The unknowns.
    pub terms: Vec<TermEstimate>,
    /// Independent images that were used.
    pub images: u32,
    /// Knocks noticed so far.
    pub knocks: u32,
    /// Root mean square displacement of the points 3 m away, metres.
    pub displacement_at_3_m: f32,
    /// Standard deviation of it, metres.
    pub displacement_std_at_3_m: f32,
}

/// One tracked image.
#[derive(Debug, Clone, Copy)]
pub struct TrackedImage<'a> {
    /// Its exposure.
    pub stamp: Stamp,
    /// The points after [`MapCorrection::correct`] and the compensation of the tilt.
    pub points: &'a [LinePoint],
    /// Their match.
    pub matched: &'a Match,
    /// The pose before the match.
    pub predicted: Pose,
    /// Information of pose and tilt before the match. None: the match had no prior.
    pub prior_information: Option<Matrix5>,
    /// Standard deviation of the tilt where it is independent in each image, radians. None: part of the filter's state.
    pub independent_tilt_std: Option<f32>,
}

/// A line point before its correction: its own variances, m², and the derivatives of the corrected one.
#[derive(Debug, Clone, Copy)]
pub(super) struct RawPoint {
    pub(super) radial_variance: f32,
    pub(super) tangential_variance: f32,
    pub(super) derivatives: [[f32; 2]; TERMS_MAX],
}

/// Estimate of a map's errors.
#[derive(Debug, Clone)]
pub struct MapCorrection {
    basis: MapBasis,
    config: MapCorrectionConfig,
    coefficients: TermVector,
    covariance: TermMatrix,
    prior: TermMatrix,
    /// Error of (x, y, θ, a, b) per error of each unknown.
    sensitivity: PoseByTerm,
    points: Vec<RawPoint>,
    /// Variance of a displaced point, radial and tangential, by node.
    variances: [[f32; 2]; NODES],
    stamp: Option<Stamp>,
    /// Pose of the last tracked image, and of the last one used.
    last_pose: Option<Pose>,
    used_pose: Option<Pose>,
    /// Learned variance of the residuals over the stated one.
    noise: f64,
    block: Block,
    images: u32,
    knocks: u32,
    /// Exposure of the last image tested for a large knock, and the tests in a row that found one.
    knock_checked: Option<Stamp>,
    knock_tests: u32,
}

/// Images since the last test for a small knock.
#[derive(Debug, Clone)]
struct Block {
    /// The belief at its start.
    coefficients: TermVector,
    covariance: TermMatrix,
    /// Of all its images, at those coefficients.
    information: TermMatrix,
    gradient: TermVector,
    images: u32,
}

impl MapCorrection {
    /// Nothing seen yet.
    pub fn new(basis: MapBasis, config: MapCorrectionConfig) -> Self {
        let prior = TermMatrix::from_fn(|i, j| match basis.terms().get(i) {
            Some(term) if i == j => f64::from(term.std).powi(2),
            _ => 0.0,
        });
        let mut correction = MapCorrection {
            coefficients: TermVector::zeros(),
            covariance: prior,
            prior,
            sensitivity: PoseByTerm::zeros(),
            points: Vec::new(),
            variances: [[0.0; 2]; NODES],
            stamp: None,
            last_pose: None,
            used_pose: None,
            noise: INITIAL_NOISE,
            block: Block::new(TermVector::zeros(), prior),
            images: 0,
            knocks: 0,
            knock_checked: None,
            knock_tests: 0,
            basis,
            config,
        };
        correction.update_variances();
        correction
    }

    /// The fields of the unknowns.
    pub fn basis(&self) -> &MapBasis {
        &self.basis
    }

    /// The settings.
    pub fn config(&self) -> &MapCorrectionConfig {
        &self.config
    }

    /// The estimate, for logs and views.
    pub fn estimate(&self) -> MapCorrectionEstimate {
        let terms = self.basis.terms().iter().enumerate();
        let [mut squares, mut variance] = [0.0; 2];
        const DIRECTIONS: usize = 8;
        for k in 0..DIRECTIONS {
            let (sin, cos) = math::sin_cos(std::f32::consts::TAU * k as f32 / DIRECTIONS as f32);
            let at = At::new(3.0 * cos, 3.0 * sin);
            squares += at.distance_to(self.correct_point(at)).powi(2) / DIRECTIONS as f32;
            let [xx, _, yy] = self.point_covariance(at);
            variance += (xx + yy) / DIRECTIONS as f32;
        }
        MapCorrectionEstimate {
            terms: terms
                .map(|(k, term)| TermEstimate {
                    kind: term.kind,
                    value: self.coefficients[k] as f32,
                    std: self.covariance[(k, k)].max(0.0).sqrt() as f32,
                })
                .collect(),
            images: self.images,
            knocks: self.knocks,
            displacement_at_3_m: squares.sqrt(),
            displacement_std_at_3_m: variance.sqrt(),
        }
    }

    /// The ground point that the corrected map shows where the map shows `at`.
    pub fn correct_point(&self, at: At<RobotFrame>) -> At<RobotFrame> {
        let prepared = self.basis.prepare(self.single_coefficients());
        let [x, y] = prepared.displace([at.x, at.y]).at;
        At::new(x, y)
    }

    /// Covariance (xx, xy, yy; m²) of a corrected point by the map's remaining uncertainty.
    pub fn point_covariance(&self, at: At<RobotFrame>) -> [f32; 3] {
        let range = math::hypot(at.x, at.y).max(1e-3);
        let [radial, tangential] = self.variances_at(range);
        let (c, s) = (at.x / range, at.y / range);
        [
            radial * c * c + tangential * s * s,
            (radial - tangential) * s * c,
            radial * s * s + tangential * c * c,
        ]
    }

    /// Corrects the points of an image and adds the map's remaining uncertainty to their standard deviations.
    pub fn correct(&mut self, points: &mut [LinePoint]) {
        let prepared = self.basis.prepare(self.single_coefficients());
        self.points.clear();
        for point in points {
            let displaced = prepared.displace([point.at.x, point.at.y]);
            let [x, y] = displaced.at;
            point.at = At::new(x, y);
            let ambiguity = displaced.ambiguity * displaced.ambiguity;
            let raw = RawPoint {
                radial_variance: point.std_radial * point.std_radial + ambiguity,
                tangential_variance: point.std_tangential * point.std_tangential + ambiguity,
                derivatives: displaced.derivatives,
            };
            let [radial, tangential] = self.variances_at(math::hypot(x, y));
            point.std_radial = (raw.radial_variance + radial).sqrt();
            point.std_tangential = (raw.tangential_variance + tangential).sqrt();
            self.points.push(raw);
        }
    }

    /// Covariance of (x, y, θ) by the map's remaining uncertainty.
    pub fn pose_covariance(&self) -> Matrix3<f32> {
        let by_term = self.sensitivity.fixed_rows::<3>(0);
        let covariance = by_term * self.covariance * by_term.transpose();
        ((covariance + covariance.transpose()) * 0.5).map(|value| value as f32)
    }

    /// Learns from a tracked image. Returns the change of (x, y, θ, a, b) that follows for its pose.
    pub fn observe(
        &mut self,
        image: &TrackedImage,
        distances: &DistanceField,
        matching: &MatchConfig,
    ) -> Option<[f32; PARAMETERS]> {
        if image.points.len() != self.points.len() {
            return None;
        }
        self.drift_to(image.stamp);
        let moved = self.is_independent(image.matched.pose);
        let (stated, widened) = self.accumulate(image, distances, matching, moved);
        self.update_sensitivity(image, &widened);
        self.last_pose = Some(image.matched.pose);
        if !moved || image.prior_information.is_none() {
            return None;
        }
        let mut prior = PoseMatrix::zeros();
        for (k, information) in FREE_POSE_INFORMATION.into_iter().enumerate() {
            prior[(k, k)] = information;
        }
        for k in 3..PARAMETERS {
            prior[(k, k)] = FREE_TILT_INFORMATION;
        }
        let evidence = stated.eliminate_pose(&prior, &PoseVector::zeros())?;
        let share = f64::from(
            self.config.information_share
                * (INDEPENDENT_POINTS / image.points.len().max(1) as f32).min(1.0),
        );
        // Far from the truth an image's derivatives hold roughly: it may halve the uncertainty, and is then used again.
        let relative = share / self.noise * (self.covariance * evidence.information).trace();
        let cap = RELATIVE_INFORMATION_MAX * self.basis.terms().len() as f64 / relative.max(1e-9);
        self.used_pose = (cap >= 1.0).then_some(image.matched.pose);
        let step = self.update(&evidence, share * cap.min(1.0), f64::from(stated.weight))?;
        let shift = self.sensitivity * step;
        let mut pose = image.matched.pose;
        pose = Pose::new(
            pose.x + shift[0] as f32,
            pose.y + shift[1] as f32,
            pose.theta + shift[2] as f32,
        );
        self.last_pose = Some(pose);
        Some(std::array::from_fn(|k| shift[k] as f32))
    }

    /// A pose was found without a prediction: its error follows from this image alone.
    pub fn restart(
        &mut self,
        image: &TrackedImage,
        distances: &DistanceField,
        matching: &MatchConfig,
    ) {
        if image.points.len() != self.points.len() {
            return;
        }
        self.drift_to(image.stamp);
        self.last_pose = None;
        let (_, widened) = self.accumulate(image, distances, matching, false);
        self.update_sensitivity(image, &widened);
        self.last_pose = Some(image.matched.pose);
    }

    /// The pose was moved to the other field half.
    pub fn apply_half_turn(&mut self) {
        for i in 0..2 {
            for j in 0..TERMS_MAX {
                self.sensitivity[(i, j)] = -self.sensitivity[(i, j)];
            }
        }
        let turned = |pose: Pose| Pose::new(-pose.x, -pose.y, pose.theta + std::f32::consts::PI);
        self.last_pose = self.last_pose.map(turned);
        self.used_pose = self.used_pose.map(turned);
    }

    /// Tests an image for a large knock: another map explains `margin` points more than the present one. Two tests in
    /// a row make a knock. Returns the pose under the new map.
    ///
    /// Tests a `poor` match at once, others once per `knock_check_period`.
    pub fn detect_knock(
        &mut self,
        image: &TrackedImage,
        poor: bool,
        margin: f32,
        distances: &DistanceField,
        matching: &MatchConfig,
    ) -> Option<Pose> {
        let elapsed = self
            .knock_checked
            .map_or(f64::INFINITY, |last| last.seconds_until(image.stamp));
        let due = poor || self.knock_tests > 0 || elapsed >= self.config.knock_check_period;
        if !due || image.points.len() != self.points.len() {
            return None;
        }
        self.knock_checked = Some(image.stamp);
        let present = image.matched.score * image.points.len() as f32;
        let refit = self
            .refit(image, distances, matching)
            .filter(|refit| refit.score - present > margin);
        let Some(refit) = refit else {
            self.knock_tests = 0;
            return None;
        };
        self.knock_tests += 1;
        if self.knock_tests < KNOCK_TESTS {
            return None;
        }
        self.coefficients = refit.coefficients;
        // One image finds the way; the next ones learn from there.
        self.covariance = self.prior;
        self.sensitivity = PoseByTerm::zeros();
        self.knocks += 1;
        self.restart_learning();
        Some(refit.pose)
    }

    fn restart_learning(&mut self) {
        self.knock_tests = 0;
        self.block = Block::new(self.coefficients, self.covariance);
        self.used_pose = None;
        self.last_pose = None;
        self.update_variances();
    }

    pub(super) fn coefficients(&self) -> TermVector {
        self.coefficients
    }

    pub(super) fn covariance(&self) -> TermMatrix {
        self.covariance
    }

    pub(super) fn prior(&self) -> &TermMatrix {
        &self.prior
    }

    pub(super) fn raw_points(&self) -> &[RawPoint] {
        &self.points
    }

    /// Forgets what was learned, as after a knock. The coefficients stay the best guess.
    pub fn forget(&mut self) {
        self.covariance = self.prior;
        self.restart_learning();
    }

    /// Random walk of the unknowns since the last image.
    fn drift_to(&mut self, stamp: Stamp) {
        let seconds = self
            .stamp
            .replace(stamp)
            .map_or(0.0, |last| last.seconds_until(stamp).clamp(0.0, 1.0));
        let share = seconds / f64::from(self.config.drift_time);
        self.covariance += self.prior * share;
        self.block.covariance += self.prior * share;
        for k in 0..TERMS_MAX {
            // Never less certain than a new map.
            let excess = self.covariance[(k, k)] - self.prior[(k, k)];
            if excess > 0.0 {
                self.covariance[(k, k)] -= excess;
            }
        }
    }

    /// Did the robot move far enough that the points' errors differ from those of the last image used?
    fn is_independent(&self, pose: Pose) -> bool {
        self.used_pose.is_none_or(|used| {
            let turn = wrap_angle(pose.theta - used.theta).abs();
            math::hypot(pose.x - used.x, pose.y - used.y) >= self.config.step_distance
                || turn >= self.config.step_turn_deg.to_radians()
        })
    }

    /// Sums over the points at the matched pose: with their own variances (for the map), and with the widened ones, as
    /// the matcher used them (for the pose).
    fn accumulate(
        &self,
        image: &TrackedImage,
        distances: &DistanceField,
        matching: &MatchConfig,
        for_map: bool,
    ) -> (ImageSums, ImageSums) {
        let terms = self.basis.terms().len();
        let (mut stated, mut widened) = (ImageSums::new(terms), ImageSums::new(terms));
        let Pose { x, y, theta, .. } = image.matched.pose;
        let (sin, cos) = math::sin_cos(theta);
        let height = matching.viewpoint_height;
        let kernel_squared = matching.kernel_scale_sigmas * matching.kernel_scale_sigmas;
        let map_variance = matching.map_std * matching.map_std;
        for (point, raw) in image.points.iter().zip(&self.points) {
            let [px, py] = ground_from_map([point.at.x, point.at.y], image.matched.tilt, height);
            let (rx, ry) = (cos * px - sin * py, sin * px + cos * py);
            let near = distances.nearest(x + rx, y + ry);
            let [nx, ny] = near.normal;
            let along = nx * rx + ny * ry;
            let radial_share = along * along / (rx * rx + ry * ry).max(1e-6);
            let variance = |radial: f32, tangential: f32| {
                tangential + map_variance + (radial - tangential) * radial_share
            };
            let wide = variance(
                point.std_radial * point.std_radial,
                point.std_tangential * point.std_tangential,
            );
            let kept = kernel_squared / (kernel_squared + near.signed_distance.powi(2) / wide);
            let robust_weight = kept * kept;
            let (mx, my) = (cos * nx + sin * ny, cos * ny - sin * nx);
            let per_height = along / height;
            let pose_row = [
                nx,
                ny,
                ny * rx - nx * ry,
                mx * height + px * per_height,
                my * height + py * per_height,
            ];
            let map_row = raw.derivatives.map(|[dx, dy]| mx * dx + my * dy);
            widened.add_cross(&pose_row, &map_row, robust_weight / wide);
            if for_map {
                let own = variance(raw.radial_variance, raw.tangential_variance);
                stated.add(
                    &pose_row,
                    &map_row,
                    near.signed_distance,
                    robust_weight,
                    own,
                );
            }
        }
        (stated, widened)
    }

    /// Error of pose and tilt per error of the unknowns after the match: X ← P (Λ X − N_pc).
    fn update_sensitivity(&mut self, image: &TrackedImage, sums: &ImageSums) {
        let moved = match self.last_pose {
            Some(last) => [image.predicted.x - last.x, image.predicted.y - last.y],
            None => [0.0; 2],
        };
        for k in 0..TERMS_MAX {
            // A heading error moves the pose sideways while the robot drives.
            let heading = self.sensitivity[(2, k)];
            self.sensitivity[(0, k)] -= heading * f64::from(moved[1]);
            self.sensitivity[(1, k)] += heading * f64::from(moved[0]);
            if image.independent_tilt_std.is_some() {
                self.sensitivity[(3, k)] = 0.0;
                self.sensitivity[(4, k)] = 0.0;
            }
        }
        let posterior = widen(&image.matched.pose_tilt_covariance);
        let scale = f64::from(image.matched.variance_scale);
        let prior = image
            .prior_information
            .map_or(PoseByTerm::zeros(), |information| {
                widen(&information) * self.sensitivity
            });
        self.sensitivity = posterior * (prior - sums.cross_information() / scale);
    }

    /// Updates the belief by an image; returns the step of the coefficients.
    fn update(&mut self, evidence: &MapEvidence, share: f64, weight: f64) -> Option<TermVector> {
        let share = share / self.noise;
        let information = evidence.information * share;
        let gradient = evidence.gradient * share;
        let posterior = Posterior::new(&self.covariance, &information, &gradient)?;
        let freedom = weight - (PARAMETERS + self.basis.terms().len()) as f64;
        if freedom > 10.0 {
            let explained = -gradient.dot(&posterior.step) / share;
            let remaining = ((evidence.squares - explained) / freedom).clamp(0.25, 25.0);
            self.noise += NOISE_RATE * (remaining - self.noise);
        }
        self.block.add(&information, &gradient, &self.coefficients);
        let step = posterior.step;
        self.covariance = posterior.covariance;
        self.coefficients += step;
        if self.is_implausible() {
            // Something else than the mount misled it: back to the map as it was given.
            let step = -self.coefficients;
            self.coefficients = TermVector::zeros();
            self.forget();
            return Some(step);
        }
        if self.block.images >= BLOCK_IMAGES {
            let log_odds_min = f64::from(self.config.knock_log_odds);
            if self.block.is_knocked(&self.prior, log_odds_min) {
                self.knocks += 1;
                self.covariance = self.prior;
            }
            self.block = Block::new(self.coefficients, self.covariance);
        }
        self.images += 1;
        self.update_variances();
        Some(step)
    }

    /// Is an unknown farther from the map as given than any mount may be?
    fn is_implausible(&self) -> bool {
        (0..TERMS_MAX).any(|k| {
            let limit = PLAUSIBLE_SIGMAS * self.prior[(k, k)].sqrt();
            self.coefficients[k].abs() > limit
        })
    }

    fn single_coefficients(&self) -> [f32; TERMS_MAX] {
        std::array::from_fn(|k| self.coefficients[k] as f32)
    }

    /// Variances of a displaced point at `range` metres: radial, tangential; m².
    fn variances_at(&self, range: f32) -> [f32; 2] {
        let (node, share) = self.basis.node_at(range);
        let slope = range / self.basis.height();
        let per_radian = self.basis.height() * (1.0 + slope * slope);
        // Across the line of sight a radian of φ sin γ is as long as the ray.
        let across = self.basis.height() * (1.0 + slope * slope).sqrt();
        let between = |axis: usize| {
            let (low, high) = (self.variances[node][axis], self.variances[node + 1][axis]);
            low + share * (high - low)
        };
        [
            between(0) * per_radian * per_radian,
            between(1) * across * across,
        ]
    }

    /// Variances by node, means over the bearing.
    fn update_variances(&mut self) {
        let terms = self.basis.terms();
        for node in 0..NODES {
            let mut sums = [0.0; 2];
            for (i, a) in terms.iter().enumerate() {
                for (j, b) in terms.iter().enumerate() {
                    // Different harmonics are uncorrelated over the bearing.
                    if a.harmonic != b.harmonic {
                        continue;
                    }
                    let covariance = self.covariance[(i, j)] as f32;
                    let [radial, tangential] = a.harmonic.mean_squares();
                    sums[0] += covariance * radial * a.radial[node] * b.radial[node];
                    sums[1] += covariance * tangential * a.tangential[node] * b.tangential[node];
                }
            }
            self.variances[node] = sums.map(|sum| sum.max(0.0));
        }
    }
}

impl Block {
    fn new(coefficients: TermVector, covariance: TermMatrix) -> Self {
        Block {
            coefficients,
            covariance,
            information: TermMatrix::zeros(),
            gradient: TermVector::zeros(),
            images: 0,
        }
    }

    /// `gradient`: at the coefficients `at`.
    fn add(&mut self, information: &TermMatrix, gradient: &TermVector, at: &TermVector) {
        self.gradient += gradient - information * (at - self.coefficients);
        self.information += information;
        self.images += 1;
    }

    /// Do the images prefer a knock within the block by `log_odds_min`?
    fn is_knocked(&self, prior: &TermMatrix, log_odds_min: f64) -> bool {
        let evidence = |covariance: &TermMatrix| {
            Posterior::new(covariance, &self.information, &self.gradient)
                .map(|posterior| posterior.log_evidence)
        };
        let (calm, knocked) = (
            evidence(&self.covariance),
            evidence(&(self.covariance + prior)),
        );
        calm.zip(knocked)
            .is_some_and(|(calm, knocked)| knocked - calm > log_odds_min)
    }
}

/// The belief after some images.
struct Posterior {
    covariance: TermMatrix,
    step: TermVector,
    /// Log likelihood of the images up to a constant.
    log_evidence: f64,
}

impl Posterior {
    /// Σ' = (1 + Σ I)⁻¹ Σ, step = −Σ' g. Unused unknowns have no variance and stay zero.
    fn new(
        covariance: &TermMatrix,
        information: &TermMatrix,
        gradient: &TermVector,
    ) -> Option<Self> {
        let factor = TermMatrix::identity() + covariance * information;
        let lu = factor.lu();
        let posterior = lu.solve(covariance)?;
        let posterior = (posterior + posterior.transpose()) * 0.5;
        let step = -(posterior * gradient);
        let determinant = lu.determinant();
        if !(determinant > 0.0 && step.iter().all(|value| value.is_finite())) {
            return None;
        }
        Some(Posterior {
            covariance: posterior,
            log_evidence: -0.5 * gradient.dot(&step) - 0.5 * math::ln(determinant),
            step,
        })
    }
}
