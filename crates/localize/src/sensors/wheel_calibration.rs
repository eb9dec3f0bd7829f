//! Calibration of the wheels and of the camera's latency from a drive with vision (docs/methods.md 7.5).
//!
//! Poses that the line points alone determine are compared with the wheels' motion between them. One fit estimates both
//! the 3 × 3 matrix of the wheels and the latency, so that neither is taken for the other.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use super::pose_pairs::{VisionPose, pose_pairs};
use crate::frames::wrap_angle;
use crate::math;
use crate::sample::Odometry;

/// Result of the fit, with standard deviations.
#[derive(Debug, Clone, PartialEq)]
pub struct DriveFit {
    /// Rows: true motion = matrix · measured motion, (forward, left, rotation).
    pub matrix: [[f32; 3]; 3],
    /// Of each entry.
    pub matrix_std: [[f32; 3]; 3],
    /// Time from the exposure of an image to its stamp, on the clock of the wheels, seconds.
    pub latency: f32,
    /// Of the latency.
    pub latency_std: f32,
    /// Pieces of the drive that were compared.
    pub pieces: usize,
    /// Pieces that were given less weight: slip, collisions, wrong poses.
    pub outliers: usize,
    /// Root mean square difference at the end of a piece, metres and degrees: with the matrix, and without it.
    pub residual: [f32; 2],
    /// The same before the fit.
    pub residual_before: [f32; 2],
}

/// Why a drive gives no calibration.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum DriveFitError {
    /// Too short, or too few images with a pose.
    #[error(
        "only {pieces} pieces of the drive have poses at both ends and {motion} between them (expected at least {pieces_min}): drive for a minute with field lines in view"
    )]
    TooShort {
        /// Pieces that can be compared.
        pieces: usize,
        /// Fewest pieces.
        pieces_min: usize,
        /// What is compared with the poses.
        motion: &'static str,
    },
    /// A motion is missing.
    #[error(
        "the drive does not determine the wheels' motion {axis}: standard deviation {std:.3} (at most {STD_MAX}). Drive more in this direction"
    )]
    Motion {
        /// "forward", "to the left" or "in rotation".
        axis: &'static str,
        /// Relative standard deviation.
        std: f32,
    },
    /// The velocity hardly changes.
    #[error(
        "the drive does not determine the latency: standard deviation {0:.3} s (at most {LATENCY_STD_MAX}). Start, stop and turn more often"
    )]
    Latency(f32),
    /// The fit does not converge.
    #[error(
        "no correction of the wheels explains the poses: check field, map and units with `mirrorball doctor --recording`"
    )]
    NoFit,
}

/// Length of a piece, seconds. Longer ones weigh slip more, shorter ones the errors of single poses.
const PIECE: f64 = 0.8;
/// Longest time between two wheel samples in a piece, seconds.
const GAP_MAX: f64 = 0.15;
const PIECES_MIN: usize = 20;
/// Largest standard deviation of a scale, and of a coupling between two motions (at `LEVER` from the centre).
const STD_MAX: f32 = 0.02;
const COUPLING_STD_MAX: f32 = 0.06;
pub(super) const LATENCY_STD_MAX: f32 = 0.01;
/// Latencies searched, seconds: a camera's image is older by less than a second.
const LATENCY_MAX: f64 = 0.5;
/// Random walk of the wheels' position, metres per square root of a metre, and of the heading, radians per square root of
/// a radian; the defaults of the filter.
const NOISE_PER_METRE: f64 = 0.02;
const NOISE_PER_RADIAN: f64 = 0.03;
/// Floor of the wheels' errors over a piece, metres and radians.
const NOISE_FLOOR: (f64, f64) = (0.002, 0.002);
/// Normalized residuals beyond this many standard deviations get less weight (Huber).
const HUBER: f64 = 2.0;
const ITERATIONS_MAX: usize = 30;
/// Distance from the centre at which a rotation counts as a motion, metres: makes the matrix's entries comparable.
const LEVER: f64 = 0.25;

/// Standard deviation of the matrix's entries before the drive.
const ENTRY_STD: f64 = 0.3;
/// Share of the path to the left up to which a drive is that of a robot that cannot move so: rows of a curve have a little.
const SIDEWAYS_MAX: f32 = 0.05;

const PARAMETERS: usize = 10;
type Parameters = SVector<f64, PARAMETERS>;

/// Fits matrix and latency. Samples of each list are ordered by stamp.
pub fn fit_drive(odometry: &[Odometry], poses: &[VisionPose]) -> Result<DriveFit, DriveFitError> {
    let track = WheelTrack::new(odometry);
    let pieces = track.pieces(poses);
    if pieces.len() < PIECES_MIN {
        return Err(DriveFitError::TooShort {
            pieces: pieces.len(),
            pieces_min: PIECES_MIN,
            motion: "wheel motion",
        });
    }
    let mut parameters = identity();
    // The latency may be longer than the linear range of the fit: the best of a coarse search starts it.
    let cost = |latency: f64| {
        let mut start = identity();
        start[9] = latency;
        let squares = pieces
            .iter()
            .map(|piece| piece.residual(&track, &start).norm_squared().min(100.0));
        squares.sum::<f64>()
    };
    let latencies = (-4..=20).map(|step| f64::from(step) * LATENCY_MAX / 20.0);
    if let Some(best) = latencies.min_by(|a, b| cost(*a).total_cmp(&cost(*b))) {
        parameters[9] = best;
    }
    let before = identity();
    let mut information = SMatrix::<f64, PARAMETERS, PARAMETERS>::zeros();
    let mut converged = false;
    for _ in 0..ITERATIONS_MAX {
        let mut gradient = Parameters::zeros();
        information.fill(0.0);
        for piece in &pieces {
            let residual = piece.residual(&track, &parameters);
            let weight = huber_weight(residual.norm());
            let jacobian = piece.jacobian(&track, &parameters);
            information += weight * jacobian.transpose() * jacobian;
            gradient += weight * jacobian.transpose() * residual;
        }
        let prior = prior_information();
        information += prior;
        gradient += prior * (parameters - before);
        let step = information.try_inverse().ok_or(DriveFitError::NoFit)? * -gradient;
        parameters += step;
        parameters[9] = parameters[9].clamp(-LATENCY_MAX, LATENCY_MAX);
        if step.norm() < 1e-6 {
            converged = true;
            break;
        }
    }
    if !converged || !parameters.iter().all(|value| value.is_finite()) {
        return Err(DriveFitError::NoFit);
    }
    summarize(&track, &pieces, &parameters, &before, &information)
}

fn summarize(
    track: &WheelTrack<'_>,
    pieces: &[Piece],
    parameters: &Parameters,
    before: &Parameters,
    information: &SMatrix<f64, PARAMETERS, PARAMETERS>,
) -> Result<DriveFit, DriveFitError> {
    let norms: Vec<f64> = pieces
        .iter()
        .map(|piece| piece.residual(track, parameters).norm())
        .collect();
    let weighted: f64 = norms
        .iter()
        .map(|norm| huber_weight(*norm) * norm * norm)
        .sum();
    // Three residuals per piece. Larger than stated residuals widen the result; smaller ones do not narrow it.
    let freedom = (3 * pieces.len() - PARAMETERS) as f64;
    let inflation = (weighted / freedom).max(1.0);
    let covariance = information.try_inverse().ok_or(DriveFitError::NoFit)? * inflation;
    let std = |index: usize| covariance[(index, index)].max(0.0).sqrt();
    let scale = |row: usize, column: usize| lever(row) / lever(column);
    let entry = |row: usize, column: usize| parameters[3 * row + column] / scale(row, column);
    for (axis, name) in ["forward", "to the left", "in rotation"].iter().enumerate() {
        if axis == 1 && track.never_moves_sideways() {
            continue;
        }
        let coupling = |row| std(3 * row + axis) * f64::from(STD_MAX / COUPLING_STD_MAX);
        let others = (0..3).filter(|row| *row != axis).map(coupling);
        let std = others.fold(std(4 * axis), f64::max) as f32;
        if !(std <= STD_MAX) {
            return Err(DriveFitError::Motion { axis: name, std });
        }
    }
    Ok(DriveFit {
        matrix: [0, 1, 2].map(|row| [0, 1, 2].map(|column| entry(row, column) as f32)),
        matrix_std: [0, 1, 2]
            .map(|row| [0, 1, 2].map(|column| (std(3 * row + column) / scale(row, column)) as f32)),
        latency: parameters[9] as f32,
        latency_std: std(9) as f32,
        pieces: pieces.len(),
        outliers: norms.iter().filter(|norm| **norm > 2.0 * HUBER).count(),
        residual: root_mean_square(track, pieces, parameters),
        residual_before: root_mean_square(track, pieces, before),
    })
}

impl DriveFit {
    /// The latency, if the drive determines it.
    pub fn checked_latency(&self) -> Result<f32, DriveFitError> {
        if self.latency_std <= LATENCY_STD_MAX {
            return Ok(self.latency);
        }
        Err(DriveFitError::Latency(self.latency_std))
    }
}

/// Factor that turns an entry of x, y or θ into metres.
fn lever(axis: usize) -> f64 {
    if axis == 2 { LEVER } else { 1.0 }
}

fn identity() -> Parameters {
    let mut parameters = Parameters::zeros();
    for axis in 0..3 {
        parameters[4 * axis] = 1.0;
    }
    parameters
}

/// Nothing is known of the latency, and wheels are roughly right: what a drive does not determine, such as the motion to the left of a
/// differential drive, stays as it is.
fn prior_information() -> SMatrix<f64, PARAMETERS, PARAMETERS> {
    let mut information = SMatrix::identity() / (ENTRY_STD * ENTRY_STD);
    information[(9, 9)] = 1e-6;
    information
}

fn huber_weight(norm: f64) -> f64 {
    // Three residuals at once: the expected norm is √3.
    let limit = HUBER * 1.732;
    if norm <= limit { 1.0 } else { limit / norm }
}

fn root_mean_square(track: &WheelTrack<'_>, pieces: &[Piece], parameters: &Parameters) -> [f32; 2] {
    let mut squares: Vec<[f64; 2]> = pieces
        .iter()
        .map(|piece| {
            let error = piece.error(track, parameters);
            [error[0].powi(2) + error[1].powi(2), error[2].powi(2)]
        })
        .collect();
    squares.sort_by(|a, b| a[0].total_cmp(&b[0]));
    // Without the worst twentieth, which slip dominates.
    squares.truncate(squares.len() - squares.len() / 20);
    let mean = |index: usize| {
        let sum: f64 = squares.iter().map(|square| square[index]).sum();
        (sum / squares.len() as f64).sqrt()
    };
    [mean(0) as f32, mean(1).to_degrees() as f32]
}

/// The wheels' samples, for integration between any two times.
struct WheelTrack<'a> {
    odometry: &'a [Odometry],
}

/// Two poses with wheel motion between them.
struct Piece {
    /// Stamps of the poses, seconds.
    from: f64,
    to: f64,
    /// The later pose in the frame of the earlier one.
    step: [f64; 3],
    /// Maps an error to independent residuals of variance 1.
    whitening: Matrix3<f64>,
}

impl<'a> WheelTrack<'a> {
    fn new(odometry: &'a [Odometry]) -> Self {
        WheelTrack { odometry }
    }

    /// True of a differential drive.
    fn never_moves_sideways(&self) -> bool {
        let path =
            |of: fn(&Odometry) -> f32| self.odometry.iter().map(|row| of(row).abs()).sum::<f32>();
        path(|row| row.dy) < SIDEWAYS_MAX * path(|row| row.dx)
    }

    fn pieces(&self, poses: &[VisionPose]) -> Vec<Piece> {
        pose_pairs(poses, PIECE)
            .filter(|(from, to)| {
                let (start, end) = (from.stamp.seconds(), to.stamp.seconds());
                self.covers(start - LATENCY_MAX, end + LATENCY_MAX)
            })
            .filter_map(|(from, to)| self.piece(from, to))
            .collect()
    }

    /// True if samples without gaps span the interval.
    fn covers(&self, from: f64, to: f64) -> bool {
        let first = self.first_after(from);
        let last = self.first_after(to);
        if first == 0 || last >= self.odometry.len() {
            return false;
        }
        let window = &self.odometry[first - 1..=last];
        window
            .windows(2)
            .all(|pair| pair[1].stamp - pair[0].stamp <= GAP_MAX)
    }

    fn first_after(&self, time: f64) -> usize {
        self.odometry
            .partition_point(|sample| sample.stamp.seconds() <= time)
    }

    fn piece(&self, from: &VisionPose, to: &VisionPose) -> Option<Piece> {
        let (start, end) = (from.stamp.seconds(), to.stamp.seconds());
        let step = relative(
            [from.pose.x, from.pose.y, from.pose.theta].map(f64::from),
            [to.pose.x, to.pose.y, to.pose.theta].map(f64::from),
        );
        let (mut path, mut turned) = (0.0, 0.0);
        let range = self.first_after(start)..self.first_after(end);
        for sample in &self.odometry[range] {
            path += f64::from(math::hypot(sample.dx, sample.dy));
            turned += f64::from(sample.dtheta.abs());
        }
        let position = NOISE_FLOOR.0.powi(2) + NOISE_PER_METRE.powi(2) * path;
        let heading = NOISE_FLOOR.1.powi(2) + NOISE_PER_RADIAN.powi(2) * turned;
        let wheels = Matrix3::from_diagonal(&Vector3::new(position, position, heading));
        let vision = (from.covariance + to.covariance).map(f64::from);
        // In the frame of the earlier pose, whose heading error turns the whole step.
        let (sin, cos) = math::sin_cos(f64::from(from.pose.theta));
        let rotation = Matrix3::new(cos, sin, 0.0, -sin, cos, 0.0, 0.0, 0.0, 1.0);
        let turn = Vector3::new(-step[1], step[0], 0.0);
        let heading_variance = f64::from(from.covariance[(2, 2)]);
        let covariance = rotation * vision * rotation.transpose()
            + turn * turn.transpose() * heading_variance
            + wheels;
        let whitening = covariance.try_inverse()?.cholesky()?.l().transpose();
        Some(Piece {
            from: start,
            to: end,
            step,
            whitening,
        })
    }

    /// The corrected motion from one time to another, in the robot frame at the first.
    fn integrate(&self, from: f64, to: f64, parameters: &Parameters) -> [f64; 3] {
        let matrix = Matrix3::from_fn(|row, column| {
            parameters[3 * row + column] * lever(column) / lever(row)
        });
        let mut pose = [0.0; 3];
        for index in self.first_after(from)..self.odometry.len() {
            let sample = &self.odometry[index];
            let Some(before) = index.checked_sub(1).map(|index| &self.odometry[index]) else {
                continue;
            };
            let (start, end) = (before.stamp.seconds(), sample.stamp.seconds());
            if start >= to {
                break;
            }
            // Samples at both ends count by the share that lies inside.
            let share = (end.min(to) - start.max(from)) / (end - start).max(1e-9);
            let motion = matrix
                * Vector3::new(
                    f64::from(sample.dx),
                    f64::from(sample.dy),
                    f64::from(sample.dtheta),
                )
                * share.clamp(0.0, 1.0);
            let (sin, cos) = math::sin_cos(pose[2] + 0.5 * motion[2]);
            pose[0] += cos * motion[0] - sin * motion[1];
            pose[1] += sin * motion[0] + cos * motion[1];
            pose[2] += motion[2];
        }
        pose
    }
}

impl Piece {
    /// Motion of the poses minus that of the wheels, metres and radians.
    fn error(&self, track: &WheelTrack<'_>, parameters: &Parameters) -> Vector3<f64> {
        let latency = parameters[9];
        let wheels = track.integrate(self.from - latency, self.to - latency, parameters);
        Vector3::new(
            self.step[0] - wheels[0],
            self.step[1] - wheels[1],
            wrap_angle((self.step[2] - wheels[2]) as f32).into(),
        )
    }

    fn residual(&self, track: &WheelTrack<'_>, parameters: &Parameters) -> Vector3<f64> {
        self.whitening * self.error(track, parameters)
    }

    fn jacobian(
        &self,
        track: &WheelTrack<'_>,
        parameters: &Parameters,
    ) -> SMatrix<f64, 3, PARAMETERS> {
        let mut jacobian = SMatrix::<f64, 3, PARAMETERS>::zeros();
        for column in 0..PARAMETERS {
            let step = 1e-3;
            let (mut below, mut above) = (*parameters, *parameters);
            below[column] -= step;
            above[column] += step;
            let slope = (self.error(track, &above) - self.error(track, &below)) / (2.0 * step);
            jacobian.set_column(column, &(self.whitening * slope));
        }
        jacobian
    }
}

/// A pose in the frame of another.
fn relative(from: [f64; 3], to: [f64; 3]) -> [f64; 3] {
    let (sin, cos) = math::sin_cos(from[2]);
    let (x, y) = (to[0] - from[0], to[1] - from[1]);
    [
        cos * x + sin * y,
        -sin * x + cos * y,
        f64::from(wrap_angle((to[2] - from[2]) as f32)),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frames::Pose;
    use crate::stamp::Stamp;

    const LATENCY: f64 = 0.06;

    /// A minute of a robot that cannot move sideways, measured by wheels after `matrix`⁻¹, with images of another age. Every eighth pose
    /// is a little off.
    fn differential_drive(matrix: &Matrix3<f32>) -> (Vec<Odometry>, Vec<VisionPose>) {
        let inverse = matrix.try_inverse().expect("a matrix");
        let (mut odometry, mut poses) = (Vec::new(), Vec::new());
        let mut pose = Pose::new(0.0, 0.0, 0.0);
        let mut path = vec![pose];
        for k in 1..6000 {
            let time = 0.01 * k as f32;
            let forward = 0.01 * (0.8 + 0.6 * math::sin(0.7 * time));
            let turn = 0.01 * (1.2 * math::sin(0.9 * time) + 0.3);
            let (sin, cos) = math::sin_cos(pose.theta + 0.5 * turn);
            pose = Pose::new(
                pose.x + cos * forward,
                pose.y + sin * forward,
                pose.theta + turn,
            );
            path.push(pose);
            let measured = inverse * Vector3::new(forward, 0.0, turn);
            odometry.push(Odometry {
                stamp: Stamp::from_seconds(0.01 * f64::from(k)),
                dx: measured.x,
                dy: 0.0,
                dtheta: measured.z,
                slip: 0.0,
            });
            if k % 10 == 0 && k > 20 {
                let exposed = path[k as usize - (100.0 * LATENCY) as usize];
                let off = if k % 80 == 0 { 0.004 } else { 0.0 };
                poses.push(VisionPose {
                    stamp: Stamp::from_seconds(0.01 * f64::from(k)),
                    pose: Pose::new(exposed.x + off, exposed.y - off, exposed.theta),
                    covariance: Matrix3::from_diagonal(&Vector3::new(1e-5, 1e-5, 1e-6)),
                });
            }
        }
        (odometry, poses)
    }

    #[test]
    fn wheels_of_a_differential_drive_are_calibrated_in_the_motions_that_it_has() {
        let scaled = Matrix3::from_diagonal(&Vector3::new(1.03, 1.0, 0.98));
        for matrix in [Matrix3::identity(), scaled] {
            let (odometry, poses) = differential_drive(&matrix);
            let fit = fit_drive(&odometry, &poses).expect("a fit");
            assert!(
                (fit.matrix[0][0] - matrix[(0, 0)]).abs() < 0.01
                    && (fit.matrix[2][2] - matrix[(2, 2)]).abs() < 0.01,
                "{:?}",
                fit.matrix
            );
            assert!(
                (f64::from(fit.latency) - LATENCY).abs() < 0.005,
                "{}",
                fit.latency
            );
            let [left, std] = [fit.matrix, fit.matrix_std].map(|matrix| matrix[1][1]);
            assert!(
                (left - 1.0).abs() < 0.1 && std > 0.2,
                "{left} +- {std}: not measured"
            );
        }
    }
}
