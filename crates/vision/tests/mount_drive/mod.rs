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

/// Drives and localizes.
pub(crate) fn drive(
    optics: &Optics,
    field: &Field,
    localizer: &mut Localizer,
    config: &DriveConfig,
) -> Vec<Scored> {
    let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
    let distances = DistanceField::new(field, &Default::default());
    let map = optics.trace(TrueMount::default());
    let truths: Vec<_> = config
        .mounts
        .iter()
        .map(|(time, mount)| (*time, optics.trace(*mount)))
        .collect();
    let mut pose = Pose::new(
        (rng.random::<f32>() - 0.5) * 0.6 * field.length,
        (rng.random::<f32>() - 0.5) * 0.6 * field.width,
        (rng.random::<f32>() - 0.5) * 6.0,
    );
    let covariance = nalgebra::Matrix3::from_diagonal(&nalgebra::Vector3::new(0.04, 0.04, 0.01));
    localizer.set_pose(Stamp(0), pose, &covariance);
    let dt = (1.0 / config.rate) as f32;
    let mut velocity = [0.0f32; 3];
    let mut scored = Vec::new();
    for k in 1..(config.seconds * config.rate) as i64 {
        let seconds = k as f64 / config.rate;
        let stamp = Stamp::from_seconds(seconds);
        let decay = math::exp(-dt);
        for (value, std) in
            velocity
                .iter_mut()
                .zip([config.speed, config.speed, 0.4 * config.speed])
        {
            *value = decay * *value + (1.0 - decay * decay).sqrt() * std * normal(&mut rng);
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
        .map(|part| part * (1.02 + config.odometry_noise * normal(&mut rng)));
        pose = Pose::new(pose.x + vx * dt, pose.y + vy * dt, pose.theta + w * dt);
        let truth = &truths
            .iter()
            .rev()
            .find(|(time, _)| *time <= seconds)
            .expect("a mount")
            .1;
        let tilt = [0, 1].map(|_| config.tilt_std_deg.to_radians() * normal(&mut rng));
        let points = observe(
            optics, &distances, &map, truth, pose, tilt, config, &mut rng,
        );
        localizer.add_odometry(&Odometry {
            stamp,
            dx: motion[0],
            dy: motion[1],
            dtheta: motion[2],
            slip: 0.0,
        });
        let estimate = localizer.process_points(stamp, &points);
        scored.push(score(seconds, pose, &estimate, localizer));
    }
    scored
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
