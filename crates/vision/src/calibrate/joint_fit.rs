//! Joint robust least squares of the map correction and all image poses, from line points to markings.

use localize::matching::distance_field::{DistanceField, DistanceFieldConfig, NearestMarking};
use localize::math;
use localize::{Field, Pose};
use nalgebra::{DMatrix, DVector};

use crate::calibrate::free_sizes::FreeSizes;

/// The markings of a field.
pub(super) struct Markings {
    pub(super) distances: DistanceField,
    half_extent: [f64; 2],
}

impl Markings {
    pub(super) fn new(field: &Field) -> Self {
        /// Beyond the centre of the boundary lines, metres: the line's half width and an error of the map.
        const MARGIN: f64 = 0.3;
        Markings {
            distances: DistanceField::new(field, &DistanceFieldConfig::default()),
            half_extent: [field.config.length, field.config.width]
                .map(|size| f64::from(size) / 2.0 + MARGIN),
        }
    }

    fn is_on_field(&self, [x, y]: [f64; 2]) -> bool {
        x.abs() <= self.half_extent[0] && y.abs() <= self.half_extent[1]
    }
}

/// Parameters of an image: x, y, θ and its tilt (a, b).
const IMAGE_PARAMETERS: usize = 5;

/// Standard deviation of one image's tilt, radians: photographs of real robots show 0.45°.
const IMAGE_TILT_STD: f64 = 0.45 * std::f64::consts::PI / 180.0;

/// Deviation of the painted markings from the rule book, metres; added to a point's pixel deviation.
const MARKING_STD: f64 = 0.015;

/// Gauss-Newton steps per scale.
const ITERATIONS_PER_SCALE: usize = 8;

/// Scale of the robust error per round: from a wrong map to the accuracy of paint.
#[derive(Debug, Clone, Copy)]
pub(super) struct Schedule {
    /// Metres, the same at every range.
    pub(super) metres: &'static [f64],
    /// Added in proportion to the range: of a map whose shape is a guess.
    pub(super) relative: &'static [f64],
}

/// For a map that is a fifth off.
pub(super) const CORRECTION_SCHEDULE: Schedule = Schedule {
    metres: &[0.6, 0.4, 0.25, 0.15, 0.1, 0.08],
    relative: &[0.0; 6],
};

/// A square to be added to the cost: `weight` × (row · parameters − target)².
pub(super) struct PriorTerm {
    pub(super) weight: f64,
    pub(super) target: f64,
    /// Index of a parameter and its coefficient.
    pub(super) row: Vec<(usize, f64)>,
}

/// A map with free parameters.
pub(super) trait MapModel {
    /// What the map needs to know of a line point.
    type Point: Clone;

    fn parameter_count(&self) -> usize;

    fn parameters(&self) -> &[f64];

    fn parameters_mut(&mut self) -> &mut [f64];

    /// Ground of a point with an additional tilt of its image; not finite beyond the horizon.
    fn ground(&self, point: &Self::Point, image_tilt: [f64; 2]) -> [f64; 2];

    /// Variance of a point on the ground from its position in the image, m².
    fn variance(&self, point: &Self::Point) -> f64;

    /// False for a point that is no line by this map, wherever the robot is.
    fn is_plausible_point(&self, _point: &Self::Point) -> bool {
        true
    }

    /// The ground and its derivatives by the image's tilt; appends its derivatives by the parameters to `row`.
    fn linearize(
        &self,
        point: &Self::Point,
        image_tilt: [f64; 2],
        row: &mut Vec<(usize, [f64; 2])>,
    ) -> ([f64; 2], [[f64; 2]; 2]);

    fn prior_terms(&self) -> Vec<PriorTerm>;
}

/// One image's points and the pose being fitted.
#[derive(Debug, Clone)]
pub(super) struct FitImage<P> {
    pub(super) index: usize,
    pub(super) points: Vec<P>,
    state: [f64; IMAGE_PARAMETERS],
    /// False once most of its points are outliers.
    pub(super) used: bool,
}

/// Residual of one image.
pub(super) struct ImageFit {
    pub(super) sum_squared: f64,
    pub(super) inlier_count: f64,
    /// Points inside the boundary lines: clutter beside the field says nothing about the map.
    pub(super) on_field_count: f64,
    pub(super) rms_px: f64,
    /// Mean cost of its points: the negative logarithm of a density with heavy tails, which outliers hardly change.
    pub(super) cost: f64,
}

/// Residual of one point.
struct PointFit {
    /// From the nearest marking, metres.
    distance: f64,
    /// Square metres.
    variance: f64,
    is_inlier: bool,
    is_on_field: bool,
}

impl<P> FitImage<P> {
    pub(super) fn new(index: usize, points: Vec<P>, pose: Pose) -> Self {
        let [x, y, theta] = [pose.x, pose.y, pose.theta].map(f64::from);
        FitImage {
            index,
            points,
            state: [x, y, theta, 0.0, 0.0],
            used: true,
        }
    }

    pub(super) fn pose(&self) -> Pose {
        Pose::new(
            self.state[0] as f32,
            self.state[1] as f32,
            self.state[2] as f32,
        )
    }
}

/// A field of unknown sizes, and what is known of the map instead.
struct SizesFit {
    sizes: FreeSizes,
    /// The parameters of the map that are free.
    free: &'static [usize],
}

/// The joint fit: map and images.
pub(super) struct JointFit<'a, M: MapModel> {
    markings: &'a Markings,
    sizes: Option<SizesFit>,
    pub(super) model: M,
    pub(super) images: Vec<FitImage<M::Point>>,
}

impl<'a, M: MapModel> JointFit<'a, M> {
    pub(super) fn new(markings: &'a Markings, model: M, images: Vec<FitImage<M::Point>>) -> Self {
        JointFit {
            markings,
            sizes: None,
            model,
            images,
        }
    }

    /// The same fit with the sizes of the field unknown. `free`: the parameters of the map that are not known.
    pub(super) fn with_sizes(self, sizes: FreeSizes, free: &'static [usize]) -> Self {
        JointFit {
            sizes: Some(SizesFit { sizes, free }),
            ..self
        }
    }

    /// The map, and the field if its sizes were unknown.
    pub(super) fn into_model_and_field(self) -> (M, Option<Field>) {
        (self.model, self.sizes.map(|fit| fit.sizes.into_field()))
    }

    /// The marking nearest to a place of the field. Appends the derivatives of its distance by unknown sizes.
    fn nearest(&self, at: [f64; 2], row: &mut Vec<(usize, f64)>) -> NearestMarking {
        let [x, y] = at.map(|axis| axis as f32);
        match &self.sizes {
            Some(fit) => fit.sizes.nearest([x, y], self.model.parameter_count(), row),
            None => self.markings.distances.nearest(x, y),
        }
    }

    /// Runs all rounds; excludes images whose points are mostly outliers after a late round.
    pub(super) fn optimize(&mut self, schedule: &Schedule) {
        let scales = schedule.metres.iter().zip(schedule.relative);
        for (round, (&metres, &relative)) in scales.enumerate() {
            // First only the poses under the initial map, then everything.
            for step in 0..ITERATIONS_PER_SCALE {
                let fit_map = round > 0 || step >= 3;
                if self.gauss_newton_step([metres, relative], fit_map) < 1e-5 {
                    break;
                }
            }
            if round >= 3 {
                for index in 0..self.images.len() {
                    let evaluation = self.evaluate(&self.images[index]);
                    let image = &mut self.images[index];
                    image.used = evaluation.inlier_count >= 0.5 * image.points.len() as f64;
                }
            }
        }
    }

    /// One Gauss-Newton step on the reweighted squares; returns its size. `fit_map`: the map (and unknown sizes) are free too.
    fn gauss_newton_step(&mut self, [metres, relative]: [f64; 2], fit_map: bool) -> f64 {
        let model_parameters = self.model.parameter_count();
        let size_count = self.sizes.as_ref().map_or(0, |fit| fit.sizes.count());
        let map_parameters = model_parameters + size_count;
        let unknowns = map_parameters + IMAGE_PARAMETERS * self.images.len();
        let mut normal = DMatrix::<f64>::zeros(unknowns, unknowns);
        let mut gradient = DVector::<f64>::zeros(unknowns);
        let mut by_map: Vec<(usize, [f64; 2])> = Vec::new();
        let mut row: Vec<(usize, f64)> = Vec::new();
        for (number, image) in self.images.iter().enumerate() {
            let start = map_parameters + IMAGE_PARAMETERS * number;
            let [x, y, theta, a, b] = image.state;
            let (sin, cos) = math::sin_cos(theta);
            for point in image.points.iter().filter(|_| image.used) {
                by_map.clear();
                let (ground, by_tilt) = self.model.linearize(point, [a, b], &mut by_map);
                let variance = MARKING_STD * MARKING_STD + self.model.variance(point);
                let on_field = [
                    x + cos * ground[0] - sin * ground[1],
                    y + sin * ground[0] + cos * ground[1],
                ];
                if !(on_field[0].is_finite() && on_field[1].is_finite() && variance.is_finite()) {
                    continue;
                }
                row.clear();
                let nearest = self.nearest(on_field, &mut row);
                let distance = f64::from(nearest.signed_distance);
                let [nx, ny] = nearest.normal.map(f64::from);
                // The normal in the robot frame.
                let (rx, ry) = (cos * nx + sin * ny, cos * ny - sin * nx);
                let along_normal = |[gx, gy]: [f64; 2]| rx * gx + ry * gy;
                // Geman and McClure's weight (c²/(c² + t²))², over the point's own variance.
                let scale = metres + relative * math::hypot(ground[0], ground[1]);
                let c2 = scale * scale + 9.0 * variance;
                let weight =
                    (c2 / (c2 + distance * distance)).powi(2) / (variance + 0.01 * scale * scale);
                if fit_map {
                    row.extend(by_map.iter().map(|&(i, moved)| (i, along_normal(moved))));
                }
                let by_theta = ny * (on_field[0] - x) - nx * (on_field[1] - y);
                row.extend([(start, nx), (start + 1, ny), (start + 2, by_theta)]);
                row.extend([
                    (start + 3, along_normal(by_tilt[0])),
                    (start + 4, along_normal(by_tilt[1])),
                ]);
                for &(i, di) in &row {
                    gradient[i] += weight * distance * di;
                    for &(j, dj) in &row {
                        normal[(i, j)] += weight * di * dj;
                    }
                }
            }
            let information = 1.0 / (IMAGE_TILT_STD * IMAGE_TILT_STD);
            for (i, tilt) in [(start + 3, a), (start + 4, b)] {
                normal[(i, i)] += information;
                gradient[i] += information * tilt;
            }
            for i in start..start + 3 {
                normal[(i, i)] += 1.0;
            }
        }
        for term in self.model.prior_terms() {
            let PriorTerm {
                weight,
                target,
                row,
            } = term;
            let parameters = self.model.parameters();
            let value: f64 = row.iter().map(|&(i, di)| di * parameters[i]).sum();
            let value = value - target;
            for &(i, di) in &row {
                gradient[i] += weight * value * di;
                for &(j, dj) in &row {
                    normal[(i, j)] += weight * di * dj;
                }
            }
        }
        if let Some(fit) = &self.sizes {
            for (i, (weight, off)) in (model_parameters..).zip(fit.sizes.prior_terms()) {
                gradient[i] += weight * off;
                normal[(i, i)] += weight;
            }
        }
        let is_held = |i: usize| {
            let is_known = self
                .sizes
                .as_ref()
                .is_some_and(|fit| !fit.free.contains(&i));
            !fit_map || i < model_parameters && is_known
        };
        for i in (0..map_parameters).filter(|&i| is_held(i)) {
            gradient[i] = 0.0;
            normal[(i, i)] += 1e12;
        }
        let Some(cholesky) = normal.cholesky() else {
            return 0.0;
        };
        let step = -cholesky.solve(&gradient);
        self.add(&step)
    }

    /// Adds a step of all unknowns; returns the largest change of an image's.
    fn add(&mut self, step: &DVector<f64>) -> f64 {
        let model_parameters = self.model.parameter_count();
        let size_count = self.sizes.as_ref().map_or(0, |fit| fit.sizes.count());
        let map_parameters = model_parameters + size_count;
        for (value, step) in self.model.parameters_mut().iter_mut().zip(step.iter()) {
            *value += step;
        }
        if let Some(fit) = &mut self.sizes {
            let changes = step.iter().skip(model_parameters).take(size_count);
            fit.sizes.change(changes.copied());
        }
        let mut size = 0.0f64;
        for (number, image) in self.images.iter_mut().enumerate() {
            for (i, value) in image.state.iter_mut().enumerate() {
                let change = step[map_parameters + IMAGE_PARAMETERS * number + i];
                *value += change;
                size = size.max(change.abs());
            }
        }
        size
    }

    /// Residual of an image at the present fit.
    pub(super) fn evaluate(&self, image: &FitImage<M::Point>) -> ImageFit {
        let (mut squares, mut inliers, mut relative, mut on_field) = (0.0, 0.0, 0.0, 0.0);
        let mut costs = 0.0;
        for fit in image.points.iter().filter_map(|it| self.fit_of(image, it)) {
            on_field += f64::from(u8::from(fit.is_on_field));
            costs += math::ln(1.0 + fit.distance * fit.distance / fit.variance);
            if fit.is_inlier {
                let squared = fit.distance * fit.distance;
                squares += squared;
                relative += squared / fit.variance;
                inliers += 1.0;
            }
        }
        ImageFit {
            sum_squared: squares,
            inlier_count: inliers,
            on_field_count: on_field,
            rms_px: 0.5 * (relative / f64::max(inliers, 1.0)).sqrt(),
            cost: costs / image.points.len() as f64,
        }
    }

    /// True if a point of an image lies on a marking at the present fit.
    pub(super) fn is_inlier(&self, image: &FitImage<M::Point>, point: &M::Point) -> bool {
        self.fit_of(image, point).is_some_and(|fit| fit.is_inlier)
    }

    /// None at the horizon.
    fn fit_of(&self, image: &FitImage<M::Point>, point: &M::Point) -> Option<PointFit> {
        let [x, y, theta, a, b] = image.state;
        let (sin, cos) = math::sin_cos(theta);
        let [gx, gy] = self.model.ground(point, [a, b]);
        let variance = MARKING_STD * MARKING_STD + self.model.variance(point);
        let (fx, fy) = (x + cos * gx - sin * gy, y + sin * gx + cos * gy);
        if !(fx.is_finite() && fy.is_finite() && variance.is_finite()) {
            return None;
        }
        let nearest = self.nearest([fx, fy], &mut Vec::new());
        let distance = f64::from(nearest.signed_distance);
        Some(PointFit {
            distance,
            variance,
            is_inlier: distance * distance <= 9.0 * (variance + MARKING_STD * MARKING_STD)
                && self.model.is_plausible_point(point),
            is_on_field: self.markings.is_on_field([fx, fy]),
        })
    }
}

/// Where a point of an upright map lies on the ground (docs/methods.md 3.3); NaN at the horizon.
///
/// The mirror tilts about the viewpoint, the robot in one image about its foot.
pub(super) fn tilt_ground_point(
    point: [f64; 2],
    mirror_tilt: [f64; 2],
    image_tilt: [f64; 2],
    height: f64,
) -> [f64; 2] {
    let tilt = [0, 1].map(|i| mirror_tilt[i] + image_tilt[i]);
    localize::tilt::ground_above_depth(point, tilt, height, 0.05 * height)
        .map_or([f64::NAN; 2], |ground| {
            [0, 1].map(|i| ground[i] + mirror_tilt[i] * height)
        })
}

/// Derivatives of a ground point by the mirror's tilt from those by the image's: the viewpoint stays in place.
pub(super) fn by_mirror_tilt([by_a, by_b]: [[f64; 2]; 2], height: f64) -> [[f64; 2]; 2] {
    [[by_a[0] + height, by_a[1]], [by_b[0], by_b[1] + height]]
}
