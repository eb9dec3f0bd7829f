//! Mounting and constant errors of an inertial unit, from rest and a drive (docs/methods.md 7.6).
//!
//! At rest the rate is its error, and the specific force is gravity plus its error. In a turn on the spot the rate points along
//! the robot's vertical axis, which tells the mounting's tilt from the error of the force. Accelerations of the wheels tell
//! the mounting's yaw.

use nalgebra::{Matrix2, Matrix3, Rotation3, Unit, Vector2, Vector3};

use super::attitude;
use crate::math;
use crate::robot::ImuCalibration;
use crate::sample::{Imu, Odometry};

/// Result of the fit, with standard deviations.
#[derive(Debug, Clone, PartialEq)]
pub struct ImuFit {
    /// The calibration.
    pub calibration: ImuCalibration,
    /// Of roll and pitch (the larger one) and of yaw, degrees.
    pub mount_std_deg: [f32; 2],
    /// Of each component of the rate's error, degrees/s.
    pub rate_bias_std_deg: f32,
    /// Of each horizontal component of the force's error, m/s².
    pub acceleration_bias_std: f32,
    /// Time at rest, seconds.
    pub rest: f32,
    /// Angle through which the robot turned on the spot, degrees.
    pub turned_deg: f32,
    /// Intervals whose acceleration determined the yaw.
    pub accelerations: usize,
}

/// Why a drive gives no calibration.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ImuFitError {
    /// No inertial unit.
    #[error("no inertial readings, or no wheel motion at the same time")]
    NoReadings,
    /// The robot did not stand still.
    #[error("only {0:.1} s at rest (expected at least {REST_MIN}): let the robot stand still")]
    NoRest(f32),
    /// The robot did not accelerate.
    #[error(
        "the drive does not determine the yaw of the mounting: standard deviation {0:.1}° (at most {YAW_STD_MAX_DEG}). Start and stop more often, also sideways"
    )]
    Yaw(f32),
    /// The readings contradict gravity.
    #[error(
        "specific force at rest: {0:.2} m/s² (expected about 9.81). Check the unit's scale and that the robot stands on level ground"
    )]
    Gravity(f32),
}

const GRAVITY: f64 = attitude::GRAVITY as f64;
const REST_MIN: f32 = 2.0;
const YAW_STD_MAX_DEG: f32 = 2.0;
/// Speeds of the wheels below which the robot rests: m/s and rad/s.
const REST_SPEED: (f64, f64) = (0.003, 0.005);
/// Rest begins and ends this far inside the time without wheel motion, seconds: the body swings out.
const REST_MARGIN: f64 = 0.4;
/// Slowest turn that is used, rad/s.
const TURN_MIN: f64 = 0.3;
/// Largest centripetal acceleration of such a turn, m/s²: the body leans under it.
const CENTRIPETAL_MAX: f64 = 0.15;
/// Time over which the body's lean counts as one error, seconds.
const BLOCK: f64 = 1.0;
const BLOCKS_MIN: usize = 4;
/// Length of an interval over which accelerations are averaged, seconds.
const INTERVAL: f64 = 0.15;
/// Smallest acceleration that is used, m/s².
const ACCELERATION_MIN: f64 = 0.4;
/// Standard deviation of the force's constant error among low-cost units, m/s²: what gravity alone tells about the tilt.
const FORCE_BIAS_STD: f64 = 0.2;
/// Largest deviation of the force at rest from gravity, m/s².
const GRAVITY_ERROR_MAX: f64 = 1.0;

/// Velocity by the wheels.
#[derive(Clone, Copy)]
struct WheelSpeed {
    time: f64,
    twist: Vector3<f64>,
}

struct Reading {
    time: f64,
    force: Vector3<f64>,
    rate: Vector3<f64>,
}

/// What the readings at rest tell, axes of the unit.
struct Rest {
    seconds: f64,
    force: Vector3<f64>,
    rate: Vector3<f64>,
    rate_std: f64,
}

/// Sums over the readings of a part of a turn: wheels' rate times the unit's, and the wheels' squared.
struct TurnBlock {
    start: f64,
    rate: Vector3<f64>,
    square: f64,
}

/// The robot's vertical axis in the unit's axes, and its standard deviation in radians.
struct Vertical {
    axis: Vector3<f64>,
    std: f64,
    turned: f64,
}

/// Fits the calibration. Samples of each list are ordered by stamp.
pub fn fit_imu(imu: &[Imu], odometry: &[Odometry]) -> Result<ImuFit, ImuFitError> {
    let readings: Vec<Reading> = imu.iter().map(Reading::new).collect();
    let wheels = wheel_speeds(odometry);
    if readings.len() < 2 || wheels.len() < 2 {
        return Err(ImuFitError::NoReadings);
    }
    let rest = rest(&readings, &wheels)?;
    if (rest.force.norm() - GRAVITY).abs() > GRAVITY_ERROR_MAX {
        return Err(ImuFitError::Gravity(rest.force.norm() as f32));
    }
    let vertical = vertical(&readings, &wheels, &rest);
    let upright = Rotation3::rotation_between(&vertical.axis, &Vector3::z())
        .unwrap_or_else(|| Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
    let force_bias = rest.force - GRAVITY * vertical.axis;
    let yaw = yaw(&readings, &wheels, &upright, &force_bias, &rest.rate)?;
    let turn = Rotation3::from_axis_angle(&Unit::new_unchecked(Vector3::z()), yaw.angle);
    let (roll, pitch, yaw_angle) = rpy(&(turn * upright));
    let degrees = |radians: f64| radians.to_degrees() as f32;
    let vector = |vector: Vector3<f64>| [vector.x as f32, vector.y as f32, vector.z as f32];
    Ok(ImuFit {
        calibration: ImuCalibration {
            mount_deg: [roll, pitch, yaw_angle].map(degrees),
            acceleration_bias: vector(force_bias),
            rate_bias_deg: [rest.rate.x, rest.rate.y, rest.rate.z].map(degrees),
        },
        mount_std_deg: [degrees(vertical.std), degrees(yaw.std)],
        rate_bias_std_deg: degrees(rest.rate_std),
        acceleration_bias_std: (GRAVITY * vertical.std) as f32,
        rest: rest.seconds as f32,
        turned_deg: degrees(vertical.turned),
        accelerations: yaw.intervals,
    })
}

impl Reading {
    fn new(imu: &Imu) -> Self {
        let vector = |values: [f32; 3]| Vector3::from(values.map(f64::from));
        Reading {
            time: imu.stamp.seconds(),
            force: vector(imu.specific_force),
            rate: vector(imu.angular_velocity),
        }
    }
}

fn wheel_speeds(odometry: &[Odometry]) -> Vec<WheelSpeed> {
    let pairs = odometry.windows(2).filter_map(|pair| {
        let seconds = pair[1].stamp - pair[0].stamp;
        let motion = Vector3::new(pair[1].dx, pair[1].dy, pair[1].dtheta).map(f64::from);
        (seconds > 1e-4 && seconds < 0.15).then(|| WheelSpeed {
            time: pair[1].stamp.seconds() - 0.5 * seconds,
            twist: motion / seconds,
        })
    });
    pairs.collect()
}

fn is_at_rest(speed: &WheelSpeed) -> bool {
    let twist = speed.twist;
    math::hypot(twist.x, twist.y) < REST_SPEED.0 && twist.z.abs() < REST_SPEED.1
}

/// Intervals without wheel motion, shortened by the margin at both ends.
fn rest_intervals(wheels: &[WheelSpeed]) -> Vec<(f64, f64)> {
    let mut intervals = Vec::new();
    let mut start: Option<f64> = None;
    let mut last = f64::NEG_INFINITY;
    for speed in wheels {
        let connected = speed.time - last < 0.3;
        if let Some(from) = start
            && (!is_at_rest(speed) || !connected)
        {
            intervals.push((from + REST_MARGIN, last - REST_MARGIN));
            start = None;
        }
        if is_at_rest(speed) && start.is_none() {
            start = Some(speed.time);
        }
        last = speed.time;
    }
    intervals.extend(start.map(|from| (from + REST_MARGIN, last - REST_MARGIN)));
    intervals.retain(|(from, to)| to > from);
    intervals
}

fn rest(readings: &[Reading], wheels: &[WheelSpeed]) -> Result<Rest, ImuFitError> {
    let intervals = rest_intervals(wheels);
    // The sum of no durations is -0.
    let seconds: f64 = 0.0 + intervals.iter().map(|(from, to)| to - from).sum::<f64>();
    let resting: Vec<&Reading> = readings
        .iter()
        .filter(|reading| {
            let inside = |(from, to): &(f64, f64)| (*from..=*to).contains(&reading.time);
            intervals.iter().any(inside)
        })
        .collect();
    if seconds < f64::from(REST_MIN) || resting.len() < 50 {
        return Err(ImuFitError::NoRest(seconds as f32));
    }
    let count = resting.len() as f64;
    let force = resting
        .iter()
        .map(|reading| reading.force)
        .sum::<Vector3<f64>>()
        / count;
    let rate = resting
        .iter()
        .map(|reading| reading.rate)
        .sum::<Vector3<f64>>()
        / count;
    let variance = resting
        .iter()
        .map(|reading| (reading.rate - rate).norm_squared())
        .sum::<f64>()
        / (3.0 * count);
    Ok(Rest {
        seconds,
        force,
        rate,
        rate_std: (variance / count).sqrt(),
    })
}

/// The vertical axis by gravity (as good as the force's constant error) and by the direction of the rate in turns.
fn vertical(readings: &[Reading], wheels: &[WheelSpeed], rest: &Rest) -> Vertical {
    let by_gravity = rest.force.normalize();
    let mut turned = 0.0;
    let mut blocks: Vec<TurnBlock> = Vec::new();
    let mut last = None;
    for reading in readings {
        let seconds = last
            .replace(reading.time)
            .map_or(0.0, |last| reading.time - last);
        let Some(twist) = twist_at(wheels, reading.time).filter(is_turn_on_the_spot) else {
            continue;
        };
        if blocks
            .last()
            .is_none_or(|block| reading.time - block.start > BLOCK)
        {
            blocks.push(TurnBlock {
                start: reading.time,
                rate: Vector3::zeros(),
                square: 0.0,
            });
        }
        if let Some(block) = blocks.last_mut() {
            block.rate += twist.z * (reading.rate - rest.rate);
            block.square += twist.z * twist.z;
        }
        turned += twist.z.abs() * seconds.clamp(0.0, 0.1);
    }
    let sum: Vector3<f64> = blocks.iter().map(|block| block.rate).sum();
    let square: f64 = blocks.iter().map(|block| block.square).sum();
    let gravity_variance = (FORCE_BIAS_STD / GRAVITY).powi(2);
    if blocks.len() < BLOCKS_MIN || sum.norm() < 0.1 * square {
        return Vertical {
            axis: by_gravity,
            std: gravity_variance.sqrt(),
            turned,
        };
    }
    let by_turns = sum.normalize();
    // The body leans and rocks for a while in one direction, so the spread of blocks tells the error, not that of readings.
    let scatter: f64 = blocks
        .iter()
        .map(|block| (block.rate - by_turns * by_turns.dot(&block.rate)).norm_squared() / 2.0)
        .sum();
    let turn_variance = scatter / sum.norm_squared();
    let share = gravity_variance / (gravity_variance + turn_variance);
    Vertical {
        axis: (share * by_turns + (1.0 - share) * by_gravity).normalize(),
        std: (share * turn_variance).sqrt(),
        turned,
    }
}

fn is_turn_on_the_spot(twist: &Vector3<f64>) -> bool {
    let centripetal = math::hypot(twist.x, twist.y) * twist.z.abs();
    twist.z.abs() > TURN_MIN && centripetal < CENTRIPETAL_MAX
}

/// The wheels' velocity at a time, by interpolation. None outside the samples.
fn twist_at(wheels: &[WheelSpeed], time: f64) -> Option<Vector3<f64>> {
    let after = wheels.partition_point(|speed| speed.time <= time);
    let (before, after) = (wheels.get(after.checked_sub(1)?)?, wheels.get(after)?);
    let seconds = after.time - before.time;
    if seconds > 0.1 {
        return None;
    }
    let share = (time - before.time) / seconds.max(1e-9);
    Some(before.twist + (after.twist - before.twist) * share)
}

struct Yaw {
    angle: f64,
    std: f64,
    intervals: usize,
}

/// The angle by which the unit's horizontal accelerations must be turned to agree with those of the wheels.
fn yaw(
    readings: &[Reading],
    wheels: &[WheelSpeed],
    upright: &Rotation3<f64>,
    force_bias: &Vector3<f64>,
    rate_bias: &Vector3<f64>,
) -> Result<Yaw, ImuFitError> {
    let pairs = acceleration_pairs(readings, wheels, upright, force_bias, rate_bias);
    let mut weights = vec![1.0; pairs.len()];
    let mut angle = 0.0;
    let mut std = f64::INFINITY;
    // Slip makes some pairs wrong: reweighted five times.
    for _ in 0..5 {
        let (mut dot, mut cross, mut square) = (0.0, 0.0, 0.0);
        for ((unit, robot), weight) in pairs.iter().zip(&weights) {
            dot += weight * unit.dot(robot);
            cross += weight * unit.perp(robot);
            square += weight * unit.norm_squared();
        }
        angle = math::atan2(cross, dot);
        let (sin, cos) = math::sin_cos(angle);
        let rotation = Matrix2::new(cos, -sin, sin, cos);
        // The body's lean adds to the acceleration's length, so its length may differ.
        let scale = math::hypot(dot, cross) / square.max(1e-9);
        let errors: Vec<f64> = pairs
            .iter()
            .map(|(unit, robot)| (robot - rotation * unit * scale).norm())
            .collect();
        let mut sorted = errors.clone();
        sorted.sort_by(f64::total_cmp);
        let typical = sorted
            .get(sorted.len() / 2)
            .map_or(1.0, |median| median / 1.18);
        for (weight, error) in weights.iter_mut().zip(&errors) {
            *weight = if *error > 2.0 * typical {
                2.0 * typical / error
            } else {
                1.0
            };
        }
        let weighted: f64 = errors
            .iter()
            .zip(&weights)
            .map(|(error, weight)| weight * error * error / 2.0)
            .sum();
        // Successive intervals share the body's swing: four count as one.
        let count = (pairs.len() as f64).max(1.0);
        std = (4.0 * weighted / count / (scale * scale * square).max(1e-9)).sqrt();
    }
    let std_deg = std.to_degrees() as f32;
    if !(std_deg <= YAW_STD_MAX_DEG) || pairs.len() < 10 {
        return Err(ImuFitError::Yaw(std_deg));
    }
    Ok(Yaw {
        angle,
        std,
        intervals: pairs.len(),
    })
}

/// Horizontal accelerations of unit (turned upright) and wheels, averaged over intervals.
fn acceleration_pairs(
    readings: &[Reading],
    wheels: &[WheelSpeed],
    upright: &Rotation3<f64>,
    force_bias: &Vector3<f64>,
    rate_bias: &Vector3<f64>,
) -> Vec<(Vector2<f64>, Vector2<f64>)> {
    let mut pairs = Vec::new();
    let mut first = 0;
    while first < readings.len() {
        let start = readings[first].time;
        let count = readings[first..]
            .iter()
            .take_while(|reading| reading.time < start + INTERVAL)
            .count();
        let interval = &readings[first..first + count];
        first += count;
        let end = interval[count - 1].time;
        let (Some(before), Some(after)) = (twist_at(wheels, start), twist_at(wheels, end)) else {
            continue;
        };
        if count < 3 || end - start < 0.5 * INTERVAL {
            continue;
        }
        let mean = |value: fn(&Reading) -> Vector3<f64>| {
            interval.iter().map(value).sum::<Vector3<f64>>() / count as f64
        };
        let force = upright * (mean(|reading| reading.force) - force_bias);
        let turn = (upright * (mean(|reading| reading.rate) - rate_bias)).z;
        let velocity = 0.5 * (before + after);
        let change = (after - before) / (end - start);
        // In the turning robot frame a velocity needs a force across it.
        let robot = Vector2::new(change.x - turn * velocity.y, change.y + turn * velocity.x);
        if robot.norm() > ACCELERATION_MIN {
            pairs.push((Vector2::new(force.x, force.y), robot));
        }
    }
    pairs
}

/// Roll, pitch and yaw of Rz(yaw)·Ry(pitch)·Rx(roll), radians.
fn rpy(rotation: &Rotation3<f64>) -> (f64, f64, f64) {
    let m: &Matrix3<f64> = rotation.matrix();
    (
        math::atan2(m[(2, 1)], m[(2, 2)]),
        math::asin((-m[(2, 0)]).clamp(-1.0, 1.0)),
        math::atan2(m[(1, 0)], m[(0, 0)]),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stamp::Stamp;

    #[test]
    fn drive_without_rest_has_zero_seconds_of_it() {
        let stamp = |number: i64| Stamp(number * 10_000_000);
        let wheels: Vec<Odometry> = (0..100)
            .map(|number| Odometry {
                stamp: stamp(number),
                dx: 0.01,
                dy: 0.0,
                dtheta: 0.0,
                slip: 0.0,
            })
            .collect();
        let readings: Vec<Imu> = (0..100)
            .map(|number| Imu {
                stamp: stamp(number),
                specific_force: [0.0, 0.0, 9.81],
                angular_velocity: [0.0; 3],
            })
            .collect();
        let error = fit_imu(&readings, &wheels).expect_err("no rest");
        assert!(
            error.to_string().starts_with("only 0.0 s at rest"),
            "{error}"
        );
    }
}
