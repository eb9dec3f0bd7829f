//! Drives of a robot whose mirror is mounted otherwise than its map says: line points traced pixel by pixel.
//!
//! Image radii are walked under the true mount until they cross a marking; the map then says where the point seems to
//! lie. No displacement field of the map's correction is used.

use localize::frames::{At, Pose, wrap_angle};
use localize::math;
use localize::robot::{CameraConfig, RobotConfig};
use localize::sample::{LinePoint, Odometry};
use localize::tilt::ground_from_map;
use localize::{DistanceField, Estimate, Field, Localizer, Mode, Stamp};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::path::{Path, PathBuf};
use vision::optics::ray_tracing::Tracer;
use vision::{Mount, Profile};

const LINES: usize = 100;
const STEP_PX: f32 = 1.0;
const PIXEL_STD: f32 = 0.5;

pub(crate) fn config_folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config")
}

/// The truth that the map does not know.
#[derive(Debug, Clone, Copy)]
pub(crate) struct TrueMount {
    pub(crate) mount: Mount,
    pub(crate) focal_scale: f32,
}

impl Default for TrueMount {
    fn default() -> Self {
        TrueMount {
            mount: Mount::default(),
            focal_scale: 1.0,
        }
    }
}

/// A robot's optics.
pub(crate) struct Optics {
    pub(crate) camera: CameraConfig,
    pub(crate) profile: Profile,
    pub(crate) height: f32,
}

impl Optics {
    pub(crate) fn load(robot: &str) -> Self {
        let robot = RobotConfig::load(&config_folder().join("robots").join(robot)).expect("robot");
        let profile = Profile::load(&robot.mirror.expect("a mirror").profile).expect("profile");
        let (inner, outer) = profile.radii();
        Optics {
            camera: robot
                .camera
                .and_then(|camera| camera.camera())
                .expect("a camera"),
            height: profile.height_and_slope((inner + outer) / 2.0).0 as f32,
            profile,
        }
    }

    /// Ground points along radial image lines.
    fn trace(&self, truth: TrueMount) -> Vec<Vec<Option<[f32; 2]>>> {
        let camera = CameraConfig {
            focal_px: self.camera.focal_px.map(|focal| focal * truth.focal_scale),
            outer_radius_px: None,
            ..self.camera.clone()
        };
        let tracer = Tracer::new(&camera, &self.profile, &truth.mount).expect("a tracer");
        let rim = self.camera.outer_radius_px.unwrap_or(230.0);
        (0..LINES)
            .map(|line| {
                let (sin, cos) = math::sin_cos(std::f32::consts::TAU * line as f32 / LINES as f32);
                (0..(rim / STEP_PX) as usize)
                    .map(|k| {
                        let radius = k as f32 * STEP_PX;
                        let u = camera.centre_px[0] + radius * cos;
                        let v = camera.centre_px[1] + radius * sin;
                        let at = tracer.ray(f64::from(u), f64::from(v))?.at_height(0.0)?;
                        Some([at.x, at.y])
                    })
                    .collect()
            })
            .collect()
    }
}

/// A computer that is too busy: images are dropped and late, and wheel samples come in bursts.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Starvation {
    /// Share of the images that are processed.
    pub(crate) kept_share: f32,
    /// Longest time from the exposure of an image to its processing, seconds.
    pub(crate) delay_max: f64,
    /// Longest time between two bursts of wheel samples, seconds.
    pub(crate) burst_max: f64,
    /// Stamps are times of arrival: the devices have no clock.
    pub(crate) stamped_on_arrival: bool,
    /// Standard deviation of a turn that each burst reports wrongly: rates of a gyro that were stamped late, degrees.
    pub(crate) turn_error_deg: f32,
}

pub(crate) struct DriveConfig {
    pub(crate) speed: f32,
    pub(crate) seconds: f64,
    pub(crate) rate: f64,
    pub(crate) tilt_std_deg: f32,
    pub(crate) outlier_share: f32,
    pub(crate) range_max: f32,
    pub(crate) odometry_noise: f32,
    pub(crate) seed: u64,
    /// The mount from a time on.
    pub(crate) mounts: Vec<(f64, TrueMount)>,
    pub(crate) starvation: Option<Starvation>,
}

impl Default for DriveConfig {
    fn default() -> Self {
        DriveConfig {
            speed: 1.5,
            seconds: 60.0,
            rate: 30.0,
            tilt_std_deg: 0.0,
            outlier_share: 0.05,
            range_max: 9.0,
            odometry_noise: 0.05,
            seed: 1,
            mounts: vec![(0.0, TrueMount::default())],
            starvation: None,
        }
    }
}

/// One image's result.
pub(crate) struct Scored {
    pub(crate) seconds: f64,
    pub(crate) error: Option<f32>,
    /// Normalised estimation error squared over its three degrees of freedom.
    pub(crate) nees: f32,
    pub(crate) lost: bool,
    pub(crate) knocks: u32,
}

fn normal(rng: &mut impl Rng) -> f32 {
    localize::random::standard_normal(rng)
}

/// What reaches the localizer, with the true pose.
enum Input {
    Wheels(Odometry),
    Points(Vec<LinePoint>, Pose),
}

/// Drives and localizes.
pub(crate) fn drive(
    optics: &Optics,
    field: &Field,
    localizer: &mut Localizer,
    config: &DriveConfig,
) -> Vec<Scored> {
    let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
    let start = Pose::new(
        (rng.random::<f32>() - 0.5) * 0.6 * field.length,
        (rng.random::<f32>() - 0.5) * 0.6 * field.width,
        (rng.random::<f32>() - 0.5) * 6.0,
    );
    let covariance = nalgebra::Matrix3::from_diagonal(&nalgebra::Vector3::new(0.04, 0.04, 0.01));
    localizer.set_pose(Stamp(0), start, &covariance);
    let mut inputs = record(optics, field, config, start, &mut rng);
    if let Some(starvation) = config.starvation {
        inputs = starve(inputs, starvation, config.seed);
    }
    let mut scored = Vec::new();
    for (stamp, input) in inputs {
        match input {
            Input::Wheels(odometry) => localizer.add_odometry(&odometry),
            Input::Points(points, pose) => {
                let estimate = localizer.process_points(stamp, &points);
                scored.push(score(stamp.seconds(), pose, &estimate, localizer));
            }
        }
    }
    scored
}

/// Delays the inputs and drops images; the order is that of their arrival, samples before the image.
fn starve(inputs: Vec<(Stamp, Input)>, starvation: Starvation, seed: u64) -> Vec<(Stamp, Input)> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed + 1000);
    let (mut burst, mut image) = (0.0, 0.0_f64);
    let mut arrivals = Vec::new();
    for (stamp, mut input) in inputs {
        let seconds = stamp.seconds();
        let arrival = match &mut input {
            Input::Wheels(odometry) => {
                while burst < seconds {
                    burst += starvation.burst_max * rng.random::<f64>();
                    odometry.dtheta += starvation.turn_error_deg.to_radians() * normal(&mut rng);
                }
                (burst, 0)
            }
            Input::Points(..) if rng.random::<f32>() > starvation.kept_share => continue,
            Input::Points(..) => {
                image = image.max(seconds + starvation.delay_max * rng.random::<f64>());
                (image, 1)
            }
        };
        arrivals.push((arrival, stamp, input));
    }
    arrivals.sort_by(|(a, ..), (b, ..)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut last = 0.0_f64;
    arrivals
        .into_iter()
        .map(|((arrival, _), stamp, input)| {
            if !starvation.stamped_on_arrival {
                return (stamp, input);
            }
            // The samples of a burst are read one after the other.
            last = arrival.max(last + 2e-5);
            let stamp = Stamp::from_seconds(last);
            let input = match input {
                Input::Wheels(odometry) => Input::Wheels(Odometry { stamp, ..odometry }),
                points => points,
            };
            (stamp, input)
        })
        .collect()
}

/// The measurements of a drive, in the order of their stamps.
fn record(
    optics: &Optics,
    field: &Field,
    config: &DriveConfig,
    mut pose: Pose,
    rng: &mut ChaCha8Rng,
) -> Vec<(Stamp, Input)> {
    let distances = DistanceField::new(field, &Default::default());
    let map = optics.trace(TrueMount::default());
    let truths: Vec<_> = config
        .mounts
        .iter()
        .map(|(time, mount)| (*time, optics.trace(*mount)))
        .collect();
    let dt = (1.0 / config.rate) as f32;
    let mut velocity = [0.0f32; 3];
    let mut inputs = Vec::new();
    for k in 1..(config.seconds * config.rate) as i64 {
        let seconds = k as f64 / config.rate;
        let stamp = Stamp::from_seconds(seconds);
        let decay = math::exp(-dt);
        for (value, std) in
            velocity
                .iter_mut()
                .zip([config.speed, config.speed, 0.4 * config.speed])
        {
            *value = decay * *value + (1.0 - decay * decay).sqrt() * std * normal(rng);
        }
        for (n, at, half) in [
            (0, pose.x, field.length / 2.0),
            (1, pose.y, field.width / 2.0),
        ] {
            if at.abs() > half - 0.5 && velocity[n] * at > 0.0 {
                velocity[n] = -velocity[n];
            }
        }
        let (sin, cos) = math::sin_cos(pose.theta);
        let [vx, vy, w] = velocity;
        let motion = [
            (cos * vx + sin * vy) * dt,
            (cos * vy - sin * vx) * dt,
            w * dt,
        ]
        .map(|part| part * (1.02 + config.odometry_noise * normal(rng)));
        pose = Pose::new(pose.x + vx * dt, pose.y + vy * dt, pose.theta + w * dt);
        let truth = &truths
            .iter()
            .rev()
            .find(|(time, _)| *time <= seconds)
            .expect("a mount")
            .1;
        let tilt = [0, 1].map(|_| config.tilt_std_deg.to_radians() * normal(rng));
        let points = observe(optics, &distances, &map, truth, pose, tilt, config, rng);
        let odometry = Odometry {
            stamp,
            dx: motion[0],
            dy: motion[1],
            dtheta: motion[2],
            slip: 0.0,
        };
        inputs.push((stamp, Input::Wheels(odometry)));
        inputs.push((stamp, Input::Points(points, pose)));
    }
    inputs
}

fn score(seconds: f64, truth: Pose, estimate: &Estimate, localizer: &Localizer) -> Scored {
    let mut scored = Scored {
        seconds,
        error: None,
        nees: 0.0,
        lost: estimate.mode == Mode::Lost,
        knocks: localizer
            .map_correction()
            .map_or(0, |map| map.estimate().knocks),
    };
    if let Some(pose) = estimate.pose {
        let mut off = pose.difference(truth);
        let turned = Pose::new(-pose.x, -pose.y, pose.theta + std::f32::consts::PI);
        let other = turned.difference(truth);
        if math::hypot(other[0], other[1]) < math::hypot(off[0], off[1]) {
            off = other;
        }
        off[2] = wrap_angle(off[2]);
        scored.error = Some(math::hypot(off[0], off[1]));
        let inverse = estimate.covariance.try_inverse().expect("a covariance");
        scored.nees = off.dot(&(inverse * off)) / 3.0;
    }
    scored
}

#[expect(clippy::too_many_arguments, reason = "one call")]
fn observe(
    optics: &Optics,
    distances: &DistanceField,
    map: &[Vec<Option<[f32; 2]>>],
    truth: &[Vec<Option<[f32; 2]>>],
    pose: Pose,
    tilt: [f32; 2],
    config: &DriveConfig,
    rng: &mut impl Rng,
) -> Vec<LinePoint> {
    let (sin, cos) = math::sin_cos(pose.theta);
    let mut points = Vec::new();
    for (map, truth) in map.iter().zip(truth) {
        let mut last: Option<f32> = None;
        for (k, at) in truth.iter().enumerate() {
            let Some(at) = at.filter(|at| math::hypot(at[0], at[1]) > 0.3) else {
                last = None;
                continue;
            };
            let [x, y] = ground_from_map(at, tilt, optics.height);
            let here = distances
                .nearest(pose.x + cos * x - sin * y, pose.y + sin * x + cos * y)
                .signed_distance;
            if let Some(last) = last
                && last * here <= 0.0
                && (last - here).abs() < 0.25
                && k > 0
            {
                let share = last / (last - here);
                let mut place = (k - 1) as f32 + share + PIXEL_STD * normal(rng) / STEP_PX;
                if rng.random::<f32>() < config.outlier_share {
                    place = rng.random::<f32>() * map.len() as f32;
                }
                let (low, part) = (place as usize, place.fract());
                if let (Some(Some(a)), Some(Some(b))) = (map.get(low), map.get(low + 1)) {
                    let [mut px, mut py] = [0, 1].map(|n| a[n] + part * (b[n] - a[n]));
                    let range = math::hypot(px, py);
                    let std_radial = PIXEL_STD * math::hypot(b[0] - a[0], b[1] - a[1]) / STEP_PX;
                    let std_tangential = PIXEL_STD * range / (place * STEP_PX).max(1.0);
                    let across = std_tangential * normal(rng) / range;
                    (px, py) = (px - across * py, py + across * px);
                    if range > 0.5 && range < config.range_max && std_radial < 0.12 {
                        points.push(LinePoint {
                            at: At::new(px, py),
                            std_radial,
                            std_tangential,
                        });
                    }
                }
            }
            last = Some(here);
        }
    }
    points
}
