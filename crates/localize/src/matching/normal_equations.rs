//! One pass over the points at a pose: normal equations of the reweighted squares, and the sums for the quality
//! (docs/methods.md 5.2 to 5.4).

use nalgebra::{SMatrix, SVector};

use super::distance_field::DistanceField;
use super::parameters::{Matrix5, PARAMETERS, Vector5};
use crate::{math, tilt};

/// A point with its quantities that are constant between steps.
#[derive(Debug, Clone, Copy)]
pub(super) struct PreparedPoint {
    pub(super) x: f32,
    pub(super) y: f32,
    /// Variance across the bearing plus the map's variance, m².
    pub(super) tangential_variance: f32,
    /// Radial minus tangential variance over the squared distance.
    pub(super) radial_excess_variance: f32,
}

/// Standard deviation of where a line ends by the last point on it, metres: the distance between points. Points lie anywhere along a line,
/// so one beyond its end says that the robot is nearer, and none says nothing: it is no measurement as exact as across the line.
const FREE_END_STD: f32 = 0.1;

/// Sums over the points at one pose.
pub(super) struct NormalEquations {
    pub(super) normal: Matrix5,
    pub(super) gradient: Vector5,
    /// Σ w, Σ ψ², Σ ψ′, Σ w d², Σ |d|, Σ (1 − e), inliers.
    pub(super) weight: f32,
    pub(super) psi_squared: f32,
    pub(super) psi_slope: f32,
    pub(super) weighted_squares: f32,
    pub(super) distance_sum: f32,
    pub(super) score: f32,
    pub(super) inliers: f32,
}

/// Points that are computed side by side: a vector register of 256 bits.
pub(super) const LANES: usize = 8;
/// One value of each of these points.
pub(super) type Lanes = [f32; LANES];

/// [`PreparedPoint`]s side by side.
#[derive(Debug, Clone, Copy)]
pub(super) struct PreparedLanes {
    x: Lanes,
    y: Lanes,
    tangential_variance: Lanes,
    radial_excess_variance: Lanes,
    /// 1 for a point, 0 for padding.
    pub(super) weight: Lanes,
}

impl PreparedLanes {
    /// All points in groups; the last group is padded.
    pub(super) fn groups(points: &[PreparedPoint]) -> impl Iterator<Item = PreparedLanes> {
        points.chunks(LANES).map(|group| {
            let value = |of: fn(&PreparedPoint) -> f32, padding: f32| {
                std::array::from_fn(|k| group.get(k).map_or(padding, of))
            };
            PreparedLanes {
                x: value(|point| point.x, 0.0),
                y: value(|point| point.y, 0.0),
                tangential_variance: value(|point| point.tangential_variance, 1.0),
                radial_excess_variance: value(|point| point.radial_excess_variance, 0.0),
                weight: value(|_| 1.0, 0.0),
            }
        })
    }
}

/// Sums by lane.
#[derive(Default)]
struct LaneSums {
    normal: [Lanes; 15],
    gradient: [Lanes; PARAMETERS],
    weight: Lanes,
    psi_squared: Lanes,
    psi_slope: Lanes,
    weighted_squares: Lanes,
    distance_sum: Lanes,
    score: Lanes,
    inliers: Lanes,
}

/// The pose and tilt of a pass.
pub(super) struct Pass {
    x: f32,
    y: f32,
    sin: f32,
    cos: f32,
    tilt: [f32; 2],
    height: f32,
    kernel_squared: f32,
}

impl Pass {
    /// At a state (x, y, θ, a, b). `height`: of the viewpoint, metres; `kernel_scale`: in standard deviations of a point.
    pub(super) fn new(state: &Vector5, height: f32, kernel_scale: f32) -> Self {
        let (sin, cos) = math::sin_cos(state[2]);
        Pass {
            x: state[0],
            y: state[1],
            sin,
            cos,
            tilt: [state[3], state[4]],
            height,
            kernel_squared: kernel_scale * kernel_scale,
        }
    }

    /// Sums over all points.
    pub(super) fn accumulate(
        &self,
        points: &[PreparedLanes],
        distances: &DistanceField,
    ) -> NormalEquations {
        let mut sums = LaneSums::default();
        for group in points {
            sums.add(group, self, distances);
        }
        sums.total()
    }

    /// The normal matrix alone, of products and sums in 64 bits. Points of one straight line determine nothing along it, and rounded
    /// products leave as much as 10⁻⁷ of what they determine across it, of either sign.
    pub(super) fn exact_normal(
        &self,
        points: &[PreparedLanes],
        distances: &DistanceField,
    ) -> SMatrix<f64, PARAMETERS, PARAMETERS> {
        let mut normal = SMatrix::zeros();
        for group in points {
            let LaneRows {
                rows,
                distance,
                variance,
                ..
            } = LaneRows::of(group, self, distances);
            for k in 0..LANES {
                let information = 1.0 / variance[k];
                let squared = distance[k] * distance[k] * information;
                let kept = self.kernel_squared / (self.kernel_squared + squared);
                let factor = f64::from(group.weight[k] * kept * kept * information);
                let row = SVector::<f64, PARAMETERS>::from_fn(|i, _| rows[i][k].into());
                normal += row * row.transpose() * factor;
            }
        }
        normal
    }
}

/// Distances of a group of points to the nearest markings with their derivatives by the state.
pub(super) struct LaneRows {
    pub(super) rows: [Lanes; PARAMETERS],
    pub(super) distance: Lanes,
    /// Variance of the distance.
    pub(super) variance: Lanes,
    /// From the robot, metres, field frame.
    pub(super) offset: [Lanes; 2],
}

impl LaneRows {
    /// Each loop over `k` is a vector instruction or a few.
    #[inline(always)]
    pub(super) fn of(points: &PreparedLanes, pass: &Pass, distances: &DistanceField) -> Self {
        let [mut x, mut y, mut rx, mut ry] = [[0.0; LANES]; 4];
        let [mut field_x, mut field_y] = [[0.0; LANES]; 2];
        for k in 0..LANES {
            [x[k], y[k]] =
                tilt::ground_from_map([points.x[k], points.y[k]], pass.tilt, pass.height);
            rx[k] = pass.cos * x[k] - pass.sin * y[k];
            ry[k] = pass.sin * x[k] + pass.cos * y[k];
            field_x[k] = pass.x + rx[k];
            field_y[k] = pass.y + ry[k];
        }
        let [distance, nx, ny] = distances.nearest_lanes(&field_x, &field_y);
        let inverse_height = 1.0 / pass.height;
        let mut rows = [[0.0; LANES]; PARAMETERS];
        let end_variance = distances
            .free_end_lanes(&field_x, &field_y)
            .map_or([0.0; LANES], |ends| {
                ends.map(|end| end * FREE_END_STD * FREE_END_STD)
            });
        let mut variance = [0.0; LANES];
        for k in 0..LANES {
            let radial = nx[k] * rx[k] + ny[k] * ry[k];
            variance[k] = points.tangential_variance[k]
                + points.radial_excess_variance[k] * radial * radial
                + end_variance[k];
            // By the tilt: docs/methods.md 3.5.
            let along = radial * inverse_height;
            rows[0][k] = nx[k];
            rows[1][k] = ny[k];
            rows[2][k] = ny[k] * rx[k] - nx[k] * ry[k];
            rows[3][k] = x[k] * along;
            rows[4][k] = y[k] * along;
        }
        LaneRows {
            rows,
            distance,
            variance,
            offset: [rx, ry],
        }
    }
}

impl LaneSums {
    /// Adds a group of points.
    #[inline]
    fn add(&mut self, points: &PreparedLanes, pass: &Pass, distances: &DistanceField) {
        let LaneRows {
            rows,
            distance,
            variance,
            ..
        } = LaneRows::of(points, pass, distances);
        let mut factor = [0.0; LANES];
        for k in 0..LANES {
            let information = 1.0 / variance[k];
            let squared = distance[k] * distance[k] * information;
            // e(t) with t in standard deviations: 1 − e = k²/(k² + t²).
            let kept = pass.kernel_squared / (pass.kernel_squared + squared);
            let weight = points.weight[k];
            let root_weight = weight * kept * kept;
            factor[k] = root_weight * information;
            self.weight[k] += root_weight;
            self.psi_squared[k] += root_weight * root_weight * squared;
            self.psi_slope[k] += root_weight * (4.0 * kept - 3.0);
            self.weighted_squares[k] += root_weight * distance[k] * distance[k];
            self.distance_sum[k] += weight * distance[k].abs();
            self.score[k] += weight * kept;
            self.inliers[k] += if squared < pass.kernel_squared {
                weight
            } else {
                0.0
            };
        }
        let mut n = 0;
        for i in 0..PARAMETERS {
            let mut scaled = [0.0; LANES];
            for k in 0..LANES {
                scaled[k] = factor[k] * rows[i][k];
                self.gradient[i][k] += scaled[k] * distance[k];
            }
            for row in &rows[i..] {
                for k in 0..LANES {
                    self.normal[n][k] += scaled[k] * row[k];
                }
                n += 1;
            }
        }
    }

    /// Sums over the lanes.
    fn total(&self) -> NormalEquations {
        NormalEquations {
            normal: symmetric_from_upper(&self.normal.map(sum)),
            gradient: Vector5::from(self.gradient.map(sum)),
            weight: sum(self.weight),
            psi_squared: sum(self.psi_squared),
            psi_slope: sum(self.psi_slope),
            weighted_squares: sum(self.weighted_squares),
            distance_sum: sum(self.distance_sum),
            score: sum(self.score),
            inliers: sum(self.inliers),
        }
    }
}

fn sum(lanes: Lanes) -> f32 {
    lanes.iter().sum()
}

/// The full matrix from its upper triangle, row by row.
fn symmetric_from_upper(upper: &[f32; 15]) -> Matrix5 {
    let mut full = Matrix5::zeros();
    let mut k = 0;
    for i in 0..PARAMETERS {
        for j in i..PARAMETERS {
            full[(i, j)] = upper[k];
            full[(j, i)] = upper[k];
            k += 1;
        }
    }
    full
}
