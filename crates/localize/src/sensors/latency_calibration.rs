//! The camera's latency from headings by line points and the rate of a gyro (docs/methods.md 7.5).
//!
//! A gyro does not slip. Wheels do when the robot accelerates, which looks like some milliseconds of latency.

use nalgebra::{Matrix3, Vector3};

use super::pose_pairs::{VisionPose, pose_pairs};
use super::wheel_calibration::DriveFitError;
use crate::frames::wrap_angle;
use crate::sample::Imu;

/// A latency with its standard deviation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LatencyFit {
    /// Time from the exposure of an image to its stamp, on the clock of the gyro, seconds.
    pub latency: f32,
    /// Of the latency, seconds.
    pub std: f32,
    /// Pieces of the drive that were compared.
    pub pieces: usize,
}

/// Length of a piece, seconds: about that of an acceleration.
const PIECE: f64 = 0.4;
/// Longest time between two readings in a piece, seconds.
const GAP_MAX: f64 = 0.1;
const PIECES_MIN: usize = 40;
const LATENCY_MAX: f64 = 0.5;
const ITERATIONS: usize = 20;
/// Floor of the heading's standard deviation over a piece, radians: errors of the map and of the gyro's noise.
const HEADING_STD_MIN: f64 = 0.003;
/// Standard deviations beyond which a piece gets less weight.
const HUBER: f64 = 2.0;

/// Two headings.
struct Piece {
    from: f64,
    to: f64,
    turned: f64,
    std: f64,
}

/// Angle turned about the vertical axis since the first reading.
struct TurnedAngle {
    times: Vec<f64>,
    angles: Vec<f64>,
}

/// Fits latency, scale and bias of the gyro. Samples of each list are ordered by stamp.
pub fn fit_latency(imu: &[Imu], poses: &[VisionPose]) -> Result<LatencyFit, DriveFitError> {
    let angle = TurnedAngle::new(imu);
    let pieces = pieces(&angle, poses);
    if pieces.len() < PIECES_MIN {
        return Err(DriveFitError::TooShort {
            pieces: pieces.len(),
            pieces_min: PIECES_MIN,
            motion: "the gyro's rates",
        });
    }
    let cost = |latency: f64| {
        let squares = pieces.iter().map(|piece| {
            piece
                .residual(&angle, &Vector3::new(latency, 1.0, 0.0))
                .powi(2)
        });
        squares.map(|square| square.min(100.0)).sum::<f64>()
    };
    let starts = (-4..=20).map(|step| f64::from(step) * LATENCY_MAX / 20.0);
    let start = starts.min_by(|a, b| cost(*a).total_cmp(&cost(*b)));
    let mut parameters = Vector3::new(start.unwrap_or(0.0), 1.0, 0.0);
    let mut information = Matrix3::zeros();
    for _ in 0..ITERATIONS {
        let mut gradient = Vector3::zeros();
        information = Matrix3::zeros();
        for piece in &pieces {
            let residual = piece.residual(&angle, &parameters);
            let weight = huber_weight(residual);
            let slope = piece.slope(&angle, &parameters);
            information += weight * slope * slope.transpose();
            gradient += weight * slope * residual;
        }
        let damped = information + Matrix3::identity() * 1e-6;
        parameters -= damped.try_inverse().ok_or(DriveFitError::NoFit)? * gradient;
        parameters[0] = parameters[0].clamp(-LATENCY_MAX, LATENCY_MAX);
    }
    let squares = pieces.iter().map(|piece| {
        let residual = piece.residual(&angle, &parameters);
        huber_weight(residual) * residual * residual
    });
    let inflation = (squares.sum::<f64>() / (pieces.len() - 3) as f64).max(1.0);
    let inverse = (information + Matrix3::identity() * 1e-9)
        .try_inverse()
        .ok_or(DriveFitError::NoFit)?;
    // A gyro that disagrees by a fifth is no gyro about the vertical axis.
    if !((parameters[1] - 1.0).abs() < 0.2) {
        return Err(DriveFitError::NoFit);
    }
    let std = (inverse[(0, 0)] * inflation).sqrt() as f32;
    if !(std <= super::wheel_calibration::LATENCY_STD_MAX) {
        return Err(DriveFitError::Latency(std));
    }
    Ok(LatencyFit {
        latency: parameters[0] as f32,
        std,
        pieces: pieces.len(),
    })
}

fn pieces(angle: &TurnedAngle, poses: &[VisionPose]) -> Vec<Piece> {
    pose_pairs(poses, PIECE)
        .filter_map(|(from, to)| {
            let (start, end) = (from.stamp.seconds(), to.stamp.seconds());
            if !angle.covers(start - LATENCY_MAX, end + LATENCY_MAX) {
                return None;
            }
            let variance = f64::from(from.covariance[(2, 2)] + to.covariance[(2, 2)]);
            Some(Piece {
                from: start,
                to: end,
                turned: f64::from(wrap_angle(to.pose.theta - from.pose.theta)),
                std: (variance + HEADING_STD_MIN * HEADING_STD_MIN).sqrt(),
            })
        })
        .collect()
}

impl TurnedAngle {
    fn new(imu: &[Imu]) -> Self {
        let mut angle = TurnedAngle {
            times: Vec::with_capacity(imu.len()),
            angles: Vec::with_capacity(imu.len()),
        };
        let mut turned = 0.0;
        let mut last: Option<&Imu> = None;
        for reading in imu {
            if let Some(before) = last {
                let mean =
                    0.5 * f64::from(before.angular_velocity[2] + reading.angular_velocity[2]);
                turned += mean * (reading.stamp - before.stamp);
            }
            last = Some(reading);
            angle.times.push(reading.stamp.seconds());
            angle.angles.push(turned);
        }
        angle
    }

    /// True if readings without gaps span the interval.
    fn covers(&self, from: f64, to: f64) -> bool {
        let first = self.times.partition_point(|time| *time <= from);
        let last = self.times.partition_point(|time| *time <= to);
        if first == 0 || last >= self.times.len() {
            return false;
        }
        let window = &self.times[first - 1..=last];
        window.windows(2).all(|pair| pair[1] - pair[0] <= GAP_MAX)
    }

    fn at(&self, time: f64) -> f64 {
        let after = self
            .times
            .partition_point(|other| *other <= time)
            .clamp(1, self.times.len() - 1);
        let (start, end) = (self.times[after - 1], self.times[after]);
        let share = (time - start) / (end - start).max(1e-9);
        self.angles[after - 1] + share * (self.angles[after] - self.angles[after - 1])
    }
}

impl Piece {
    /// `parameters`: latency, scale of the gyro, bias of the gyro.
    fn residual(&self, angle: &TurnedAngle, parameters: &Vector3<f64>) -> f64 {
        let [latency, scale, bias] = (*parameters).into();
        let gyro = angle.at(self.to - latency) - angle.at(self.from - latency);
        let error = self.turned - scale * gyro - bias * (self.to - self.from);
        f64::from(wrap_angle(error as f32)) / self.std
    }

    fn slope(&self, angle: &TurnedAngle, parameters: &Vector3<f64>) -> Vector3<f64> {
        Vector3::from_fn(|index, _| {
            let step = 2e-3;
            let (mut below, mut above) = (*parameters, *parameters);
            below[index] -= step;
            above[index] += step;
            (self.residual(angle, &above) - self.residual(angle, &below)) / (2.0 * step)
        })
    }
}

fn huber_weight(residual: f64) -> f64 {
    (HUBER / residual.abs().max(1e-9)).min(1.0)
}
