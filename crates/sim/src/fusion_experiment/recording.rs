//! What do the sensors measure on a disturbance? A simulated drive without images, with line points sampled at true poses.

use localize::frames::{At, Pose, wrap_angle};
use localize::omni::OmniKinematics;
use localize::random::standard_normal;
use localize::robot::RobotConfig;
use localize::sample::{Compass, Imu, LinePoint, Odometry, VelocityCommand};
use localize::sensors::attitude::GRAVITY;
use localize::synthetic::drive::{SyntheticDriveConfig, simulate_line_points};
use localize::tilt::map_from_ground;
use localize::{Field, Stamp};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::disturbance::Disturbance;
use crate::scenario::{PathConfig, Placement, Push, Scenario};
use crate::simulation::{SimError, SimSample, Simulator};

/// Latency from exposure to stamp with late images, seconds.
pub(super) const LATENCY: f32 = 0.08;
/// Real radius of the wheels over the configured one: odometry overestimates by 3 %.
pub(super) const RADIUS_SCALE: f32 = 1.0 / 1.03;
/// The same for wheels of unequal radius, in the order of the base's wheels; their mean is that of the others.
const UNEQUAL_RADIUS_SCALES: [f32; 3] = [1.0 / 1.03, 1.0 / 1.02, 1.0 / 1.04];
/// Images per second, and true poses per image.
const FRAME_RATE: f64 = 30.0;
const TRUTHS_PER_IMAGE: usize = 3;
/// Duration and period of vision loss, seconds.
const VISION_LOSS_TIME: f64 = 2.0;
const VISION_LOSS_PERIOD: f64 = 8.0;
/// Standard deviation of the tilt (radians) and its correlation time (seconds).
const TILT_STD: f32 = 0.45 * std::f32::consts::PI / 180.0;
const TILT_CORRELATION_TIME: f32 = 0.4;

/// One measurement of the robot.
#[derive(Debug, Clone)]
pub(super) enum SensorInput {
    Odometry(Odometry),
    Imu(Imu),
    Compass(Compass),
    Command(VelocityCommand),
    Points(PointObservation),
}

/// The line points of one image.
#[derive(Debug, Clone)]
pub(super) struct PointObservation {
    /// Stamp of the camera driver.
    pub(super) stamp: Stamp,
    pub(super) points: Vec<LinePoint>,
    /// True pose and velocity (field frame) at the stamp.
    pub(super) truth: Pose,
    pub(super) velocity: [f32; 2],
    /// True for the last image of a vision loss.
    pub(super) vision_loss_end: bool,
    pub(super) vision_lost: bool,
}

/// All measurements of a drive.
#[derive(Debug, Clone)]
pub(super) struct RecordedDrive {
    pub(super) inputs: Vec<SensorInput>,
    /// Times of the pushes.
    pub(super) push_stamps: Vec<Stamp>,
    pub(super) start: Pose,
    /// The wheels as the robot file describes them.
    pub(super) wheels: Option<OmniKinematics>,
}

struct TruthState {
    stamp: Stamp,
    pose: Pose,
    velocity: [f32; 2],
}

/// Simulates a drive on a disturbance and records its measurements.
pub(super) fn record_drive(
    disturbance: Disturbance,
    seed: u64,
    duration: f64,
    robot: &RobotConfig,
    field: &Field,
) -> Result<RecordedDrive, SimError> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(77);
    let scenario = scenario(disturbance, seed, duration, field, &mut rng);
    let mut robot = robot.clone();
    let wheels = robot.base.as_ref().and_then(|base| base.kinematics().ok());
    if matches!(disturbance, Disturbance::Slip | Disturbance::All)
        && let Some(base) = &mut robot.base
    {
        // 1.5 times what the traction on the carpet allows.
        base.acceleration_max = 5.0;
    }
    shrink_camera(&mut robot);
    let start = scenario.start.pose();
    let push_stamps = scenario
        .pushes
        .iter()
        .map(|push| Stamp::from_seconds(push.time))
        .collect();
    let mut truths = Vec::new();
    let mut inputs = Vec::new();
    for sample in Simulator::new(scenario, robot, field.clone())?.without_images() {
        match sample {
            SimSample::Odometry(odometry) => inputs.push(SensorInput::Odometry(odometry)),
            SimSample::Imu(imu) => inputs.push(SensorInput::Imu(imu)),
            SimSample::Compass(compass) => inputs.push(SensorInput::Compass(compass)),
            SimSample::Command(command) => inputs.push(SensorInput::Command(command)),
            SimSample::Truth(truth) => truths.push(TruthState {
                stamp: truth.stamp,
                pose: truth.robot.pose,
                velocity: truth.robot.velocity,
            }),
            SimSample::Image(_) => {}
        }
    }
    let tilt = add_tilt(disturbance, &mut inputs, &mut rng);
    let frames = frames(disturbance, &truths, &tilt, field, &mut rng);
    inputs.extend(frames.into_iter().map(SensorInput::Points));
    inputs.sort_by_key(|input| (input.stamp(), input.priority()));
    Ok(RecordedDrive {
        inputs,
        push_stamps,
        start,
        wheels,
    })
}

impl SensorInput {
    pub(super) fn stamp(&self) -> Stamp {
        match self {
            SensorInput::Odometry(odometry) => odometry.stamp,
            SensorInput::Imu(imu) => imu.stamp,
            SensorInput::Compass(compass) => compass.stamp,
            SensorInput::Command(command) => command.stamp,
            SensorInput::Points(points) => points.stamp,
        }
    }

    /// Order among measurements of the same stamp, as in the pipeline.
    fn priority(&self) -> u8 {
        match self {
            SensorInput::Command(_) => 0,
            SensorInput::Imu(_) => 1,
            SensorInput::Odometry(_) => 2,
            SensorInput::Compass(_) => 3,
            SensorInput::Points(_) => 4,
        }
    }
}

fn scenario(
    disturbance: Disturbance,
    seed: u64,
    duration: f64,
    field: &Field,
    rng: &mut ChaCha8Rng,
) -> Scenario {
    let (half_x, half_y) = (field.length / 2.0 - 1.0, field.width / 2.0 - 1.0);
    let mut place = || Placement {
        x: half_x * (2.0 * rng.random::<f32>() - 1.0),
        y: half_y * (2.0 * rng.random::<f32>() - 1.0),
        theta_deg: 360.0 * rng.random::<f32>() - 180.0,
    };
    let start = place();
    let waypoints = (0..40).map(|_| place()).collect();
    let fast = matches!(disturbance, Disturbance::Late | Disturbance::UnknownLatency);
    let pushes = if matches!(disturbance, Disturbance::Hits | Disturbance::All) {
        let count = (duration / 5.0) as usize;
        (0..count)
            .map(|k| {
                let size = 30.0 + 45.0 * rng.random::<f32>();
                let (sin, cos) = (std::f32::consts::TAU * rng.random::<f32>()).sin_cos();
                Push {
                    time: 4.0 + 5.0 * k as f64 + f64::from(rng.random::<f32>()),
                    impulse: [size * cos, size * sin],
                }
            })
            .collect()
    } else {
        Vec::new()
    };
    Scenario {
        robot: "robot.toml".into(),
        field: None,
        seed,
        duration,
        frame_rate_hz: FRAME_RATE * TRUTHS_PER_IMAGE as f64,
        start,
        path: PathConfig {
            waypoints,
            speed: if fast { 3.0 } else { 2.0 },
            ..PathConfig::default()
        },
        ball: crate::scenario::BallConfig {
            present: false,
            ..Default::default()
        },
        others: Default::default(),
        squad: Vec::new(),
        radio: Default::default(),
        wheels: crate::scenario::WheelConfig {
            radius_scale: match disturbance {
                Disturbance::UnequalWheels | Disturbance::All => UNEQUAL_RADIUS_SCALES.to_vec(),
                _ => vec![RADIUS_SCALE],
            },
            ..Default::default()
        },
        mount: Default::default(),
        focal_scale: 1.0,
        image_sensor: Default::default(),
        light: Default::default(),
        environment: Default::default(),
        people: Default::default(),
        // Tilts of the disturbance are added to the samples, of the same size for each speed.
        rocking: crate::rocking::RockingConfig::upright(),
        kidnaps: Vec::new(),
        knocks: Vec::new(),
        kicks: Vec::new(),
        pushes,
        occlusions: Vec::new(),
        faults: Vec::new(),
    }
}

/// Shrinks the camera, which takes no images here, so that setting it up is fast.
fn shrink_camera(robot: &mut RobotConfig) {
    const SIDE_PX: usize = 64;
    if let Some(camera) = &mut robot.camera {
        let part = SIDE_PX as f32 / camera.width_px as f32;
        (camera.width_px, camera.height_px) = (SIDE_PX, SIDE_PX);
        let scaled = |value: &mut Option<f32>| *value = value.map(|value| value * part);
        scaled(&mut camera.focal_px);
        scaled(&mut camera.outer_radius_px);
        let middle = (SIDE_PX as f32 - 1.0) / 2.0;
        camera.centre_px = Some([middle, middle]);
    }
}

/// Adds a random tilt to the IMU readings and returns the tilt at each of them.
fn add_tilt(
    disturbance: Disturbance,
    inputs: &mut [SensorInput],
    rng: &mut ChaCha8Rng,
) -> Vec<(Stamp, [f32; 2])> {
    if !matches!(disturbance, Disturbance::Lean | Disturbance::All) {
        return Vec::new();
    }
    let mut tilts = Vec::new();
    let (mut tilt, mut filtered) = ([0.0_f32; 2], [0.0_f32; 2]);
    let mut last: Option<Stamp> = None;
    for input in inputs {
        let SensorInput::Imu(imu) = input else {
            continue;
        };
        let seconds = last.map_or(0.01, |last| (imu.stamp - last) as f32);
        last = Some(imu.stamp);
        let decay = (-seconds / TILT_CORRELATION_TIME).exp();
        let before = filtered;
        for k in 0..2 {
            // A low pass of 0.1 s keeps the tilt continuous; the factor 1.12 restores its standard deviation.
            tilt[k] = decay * tilt[k]
                + (1.0 - decay * decay).sqrt() * 1.12 * TILT_STD * standard_normal(rng);
            filtered[k] += (tilt[k] - filtered[k]) * (seconds / 0.1).min(1.0);
        }
        let [a, b] = std::array::from_fn(|k| (filtered[k] - before[k]) / seconds);
        // The up vector rotates in the robot frame by u̇ = u × ω: the gyro of a rotating robot also measures a constant tilt.
        let spin = imu.angular_velocity[2];
        imu.angular_velocity[0] += b + filtered[0] * spin;
        imu.angular_velocity[1] += filtered[1] * spin - a;
        for (acceleration, tilt) in imu.specific_force.iter_mut().zip(filtered) {
            *acceleration += GRAVITY * tilt;
        }
        tilts.push((imu.stamp, filtered));
    }
    tilts
}

fn frames(
    disturbance: Disturbance,
    truths: &[TruthState],
    tilt: &[(Stamp, [f32; 2])],
    field: &Field,
    rng: &mut ChaCha8Rng,
) -> Vec<PointObservation> {
    let late = matches!(disturbance, Disturbance::Late | Disturbance::UnknownLatency);
    let loses_vision = matches!(
        disturbance,
        Disturbance::Blind | Disturbance::UnequalWheels | Disturbance::All
    );
    let sensing = SyntheticDriveConfig::default();
    let height = localize::matching::MatchConfig::default().viewpoint_height;
    let is_lost_at = |seconds: f64| {
        loses_vision
            && seconds.rem_euclid(VISION_LOSS_PERIOD) >= VISION_LOSS_PERIOD - VISION_LOSS_TIME
    };
    let mut frames = Vec::new();
    for exposure in truths.iter().step_by(TRUTHS_PER_IMAGE) {
        let stamp = if late {
            exposure.stamp + f64::from(LATENCY)
        } else {
            exposure.stamp
        };
        let Some(truth) = interpolate_truth(truths, stamp) else {
            continue;
        };
        let seconds = stamp.seconds();
        let blind = is_lost_at(seconds);
        let mut points = if blind {
            Vec::new()
        } else {
            simulate_line_points(field, &sensing, exposure.pose, rng)
        };
        let at = tilt.partition_point(|(stamp, _)| *stamp <= exposure.stamp);
        if let Some((_, tilt)) = at.checked_sub(1).and_then(|at| tilt.get(at)) {
            for point in &mut points {
                let At { x, y, .. } = point.at;
                let [x, y] = map_from_ground([x, y], *tilt, height).unwrap_or([x, y]);
                point.at = At::new(x, y);
            }
        }
        frames.push(PointObservation {
            stamp,
            points,
            truth: truth.pose,
            velocity: truth.velocity,
            vision_lost: blind,
            vision_loss_end: false,
        });
    }
    for k in 1..frames.len() {
        frames[k - 1].vision_loss_end = frames[k - 1].vision_lost && !frames[k].vision_lost;
    }
    frames
}

/// The true state at a time, interpolated.
fn interpolate_truth(truths: &[TruthState], stamp: Stamp) -> Option<TruthState> {
    let after = truths.partition_point(|truth| truth.stamp < stamp);
    let (b, a) = (truths.get(after)?, truths.get(after.saturating_sub(1))?);
    let length = b.stamp - a.stamp;
    let part = if length > 0.0 {
        ((stamp - a.stamp) / length) as f32
    } else {
        0.0
    };
    let turn = wrap_angle(b.pose.theta - a.pose.theta);
    Some(TruthState {
        stamp,
        pose: Pose::new(
            a.pose.x + part * (b.pose.x - a.pose.x),
            a.pose.y + part * (b.pose.y - a.pose.y),
            a.pose.theta + part * turn,
        ),
        velocity: b.velocity,
    })
}
