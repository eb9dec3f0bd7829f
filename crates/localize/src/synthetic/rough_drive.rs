//! Rough drives: what does a robot measure whose errors are not those that the filter models?
//!
//! Independent of `drive` and of the filter's noise: speeds follow a ramp to random targets, wheels of unequal radius
//! turn a straight drive into an arc, odometry errors are correlated in time, the robot tilts by a full rotation, points
//! have heavy tails, clusters of outliers and an error that repeats in each image. Each of them can be switched off.

use nalgebra::{Rotation3, Vector3};
use rand::{Rng, RngExt};

use crate::field::Field;
use crate::field::ray::intersect_ray;
use crate::frames::{At, Pose, wrap_angle};
use crate::math;
use crate::omni::{OmniError, OmniKinematics};
use crate::random::standard_normal;
use crate::sample::{Compass, LinePoint, Odometry};
use crate::stamp::Stamp;

/// Errors of the wheels. All increments refer to one image interval.
#[derive(Debug, Clone, PartialEq)]
pub struct WheelErrors {
    /// Reported over true motion, for both translation and rotation.
    pub scale: f64,
    /// Real over assumed radius of three wheels at 60°, 180° and 300°, `BASE_RADIUS` from the centre.
    pub radius_ratio: [f64; 3],
    /// Independent error of each increment: share of the motion's length and of the rotation.
    pub white_share: f64,
    /// Independent error of each increment at rest too: metres along each axis.
    pub white_position: f64,
    /// Independent error of each increment at rest too: radians.
    pub white_heading: f64,
    /// Error with a correlation time of 0.5 s, share of the motion.
    pub slow_share: f64,
    /// Does the localizer know where the wheels are?
    pub known: bool,
}

/// Errors of the camera and of the line points.
#[derive(Debug, Clone, PartialEq)]
pub struct PointErrors {
    /// Rays, evenly around the robot. Each reports its first two markings.
    pub rays: usize,
    /// Largest range, metres.
    pub range_max: f64,
    /// Stated standard deviation of a point at ranges 0 and 5 m, metres.
    pub stated_std: [f64; 2],
    /// True over stated standard deviation.
    pub std_factor: f64,
    /// Share of the points whose error is three times larger (heavy tails).
    pub wide_share: f64,
    /// Share of outliers, uniform along their ray.
    pub outlier_share: f64,
    /// Share of all rays that end at bodies, which move with the robot's surroundings: outliers in clusters.
    pub body_share: f64,
    /// Error of the ground map at 5 m, metres: smooth over bearing, the same in each image.
    pub map_error: f64,
    /// Standard deviation of the tilt from image to image, per axis, degrees.
    pub tilt_std_deg: f64,
    /// Standard deviation of a tilt with a correlation time of 0.7 s, per axis, degrees.
    pub slow_tilt_std_deg: f64,
    /// Constant tilt, degrees.
    pub constant_tilt_deg: [f64; 2],
}

/// A rough drive.
#[derive(Debug, Clone, PartialEq)]
pub struct RoughDriveConfig {
    /// Images per second. One odometry sample precedes each.
    pub frame_rate: f64,
    /// Largest speed, m/s, and yaw rate, rad/s, of the random targets.
    pub speed_max: [f64; 2],
    /// Errors of the wheels.
    pub wheels: WheelErrors,
    /// Errors of the points.
    pub points: PointErrors,
    /// No points in the last of these seconds of each period: (period, blind). None sees always.
    pub blind: Option<(f64, f64)>,
    /// Share of the points of the first images after a blind interval that are outliers (overexposed).
    pub dazzled_outlier_share: f64,
    /// Standard deviation of the compass, degrees.
    pub compass_std_deg: f64,
}

impl Default for RoughDriveConfig {
    /// The conditions in which published systems were compared: 113 points within 5 m, σ 3 to 5 cm, 10 % outliers,
    /// odometry 3 % long with an error of 8 % and 1 mm per image, upright.
    fn default() -> Self {
        RoughDriveConfig {
            frame_rate: 30.0,
            speed_max: [3.0, 1.5],
            wheels: WheelErrors {
                scale: 1.03,
                radius_ratio: [1.0; 3],
                white_share: 0.08,
                white_position: 0.001,
                white_heading: 0.001,
                slow_share: 0.0,
                known: false,
            },
            points: PointErrors {
                rays: 120,
                range_max: 5.0,
                stated_std: [0.03, 0.05],
                std_factor: 1.0,
                wide_share: 0.0,
                outlier_share: 0.1,
                body_share: 0.0,
                map_error: 0.0,
                tilt_std_deg: 0.0,
                slow_tilt_std_deg: 0.0,
                constant_tilt_deg: [0.0; 2],
            },
            blind: None,
            dazzled_outlier_share: 0.0,
            compass_std_deg: 10.0,
        }
    }
}

impl RoughDriveConfig {
    /// The default drive with the wheels' errors and the points' errors times a factor, and a tilt from image to image.
    pub fn with_scaled_errors(wheels: f64, tilt_std_deg: f64, points: f64) -> Self {
        let mut drive = RoughDriveConfig::default();
        drive.wheels.white_share *= wheels;
        drive.wheels.white_position *= wheels;
        drive.wheels.white_heading *= wheels;
        drive.points.tilt_std_deg = tilt_std_deg;
        drive.points.std_factor = points;
        drive
    }

    /// Blind for two seconds in every eight, then three images of outliers, with wheels of unequal radius and an error of
    /// 2 %: more would not allow 2 cm after two seconds.
    pub fn blind_with_unequal_wheels() -> Self {
        RoughDriveConfig {
            wheels: WheelErrors {
                scale: 1.0,
                radius_ratio: [1.03, 1.02, 1.04],
                white_share: 0.02,
                white_position: 0.0005,
                white_heading: 0.0005,
                slow_share: 0.0,
                known: false,
            },
            blind: Some((8.0, 2.0)),
            dazzled_outlier_share: 0.87,
            ..RoughDriveConfig::default()
        }
    }
}

/// Distance of the wheels from the robot's centre, metres.
const BASE_RADIUS: f64 = 0.22;
/// Height of the mirror above the ground, metres.
const MIRROR_HEIGHT: f64 = crate::robot::DEFAULT_VIEWPOINT_HEIGHT as f64;
/// Largest acceleration, m/s² and rad/s².
const ACCELERATION: [f64; 2] = [3.0, 6.0];
/// Integration steps of the true motion per image.
const STEPS: usize = 10;
/// The robot's body hides everything nearer, metres.
const RANGE_MIN: f64 = 0.35;
/// Number of images that a blind interval dazzles at its end.
const DAZZLED_IMAGES: usize = 3;
/// Bodies around the robot.
const BODIES: usize = 4;

/// The samples of one image.
#[derive(Debug, Clone, PartialEq)]
pub struct RoughSample {
    /// Stamp of all samples.
    pub stamp: Stamp,
    /// Ground truth.
    pub true_pose: Pose,
    /// Motion since the previous image, by the wheels.
    pub odometry: Odometry,
    /// Heading with noise.
    pub compass: Compass,
    /// Line points. Empty while blind.
    pub points: Vec<LinePoint>,
    /// Time since the last image with points, seconds; 0 with points.
    pub blind_for: f64,
}

/// An endless drive; iterates over its samples.
#[derive(Debug, Clone)]
pub struct RoughDrive<R> {
    field: Field,
    config: RoughDriveConfig,
    rng: R,
    /// x, y, θ on the field.
    pose: [f64; 3],
    /// On the field, m/s and rad/s.
    velocity: [f64; 3],
    target: [f64; 3],
    target_until: f64,
    /// Correlated relative error of the wheels along x, y and θ.
    slow_wheel_error: [f64; 3],
    /// Correlated tilt, radians.
    slow_tilt: [f64; 2],
    /// Amplitude and phase of the map's error over the bearing: radial, three harmonics.
    map_harmonics: [[f64; 2]; 3],
    /// Bearing on the field, half width (radians) and range (metres) of each body.
    bodies: [[f64; 3]; BODIES],
    index: i64,
    blind_images: usize,
    dazzled_images: usize,
}

impl<R: Rng> RoughDrive<R> {
    /// Starts at rest at a random pose of the field.
    pub fn new(field: &Field, config: RoughDriveConfig, mut rng: R) -> Self {
        let mut uniform = |half: f64| half * (2.0 * rng.random::<f64>() - 1.0);
        let half_extent = [f64::from(field.length) / 2.0, f64::from(field.width) / 2.0];
        let pose = [
            uniform(half_extent[0] - 0.5),
            uniform(half_extent[1] - 0.5),
            uniform(std::f64::consts::PI),
        ];
        let map_harmonics = std::array::from_fn(|_| [uniform(1.0), uniform(std::f64::consts::PI)]);
        let bodies = std::array::from_fn(|_| {
            [
                uniform(std::f64::consts::PI),
                0.5 + uniform(0.2),
                2.0 + uniform(1.0),
            ]
        });
        RoughDrive {
            field: field.clone(),
            config,
            rng,
            pose,
            velocity: [0.0; 3],
            target: [0.0; 3],
            target_until: 0.5,
            slow_wheel_error: [0.0; 3],
            slow_tilt: [0.0; 2],
            map_harmonics,
            bodies,
            index: 0,
            blind_images: 0,
            dazzled_images: 0,
        }
    }

    fn normal(&mut self, std: f64) -> f64 {
        std * f64::from(standard_normal(&mut self.rng))
    }

    /// A new target velocity: toward a random place, or rest.
    fn choose_target(&mut self, now: f64) {
        self.target_until = now + 0.7 + 1.8 * self.rng.random::<f64>();
        if self.rng.random::<f64>() < 0.15 {
            self.target = [0.0; 3];
            return;
        }
        let half_extent = [
            f64::from(self.field.length) / 2.0,
            f64::from(self.field.width) / 2.0,
        ];
        let [dx, dy] = std::array::from_fn(|k| {
            half_extent[k] * (2.0 * self.rng.random::<f64>() - 1.0) - self.pose[k]
        });
        let speed = self.config.speed_max[0] * self.rng.random::<f64>();
        let turn = self.config.speed_max[1] * (2.0 * self.rng.random::<f64>() - 1.0);
        let distance = math::hypot(dx, dy).max(0.1);
        let speed = speed.min(distance);
        self.target = [speed * dx / distance, speed * dy / distance, turn];
    }

    /// Moves the robot by one image interval. Returns the true motion in the robot frame at its start.
    fn advance(&mut self) -> [f64; 3] {
        let dt = 1.0 / self.config.frame_rate / STEPS as f64;
        let start = self.pose;
        let mut now = self.index as f64 / self.config.frame_rate;
        let mut twist_integral = [0.0; 3];
        for _ in 0..STEPS {
            now += dt;
            if now > self.target_until {
                self.choose_target(now);
            }
            let (dx, dy) = (
                self.target[0] - self.velocity[0],
                self.target[1] - self.velocity[1],
            );
            let change = math::hypot(dx, dy);
            let share = (ACCELERATION[0] * dt / change.max(1e-9)).min(1.0);
            self.velocity[0] += share * dx;
            self.velocity[1] += share * dy;
            let turn = self.target[2] - self.velocity[2];
            self.velocity[2] += turn.clamp(-ACCELERATION[1] * dt, ACCELERATION[1] * dt);
            let (sin, cos) = math::sin_cos(self.pose[2] + 0.5 * self.velocity[2] * dt);
            let [vx, vy, yaw_rate] = self.velocity;
            twist_integral[0] += (cos * vx + sin * vy) * dt;
            twist_integral[1] += (cos * vy - sin * vx) * dt;
            twist_integral[2] += yaw_rate * dt;
            self.pose = [
                self.pose[0] + vx * dt,
                self.pose[1] + vy * dt,
                self.pose[2] + yaw_rate * dt,
            ];
        }
        // The wheels integrate the twist. Its chord in the frame at the start follows from the true poses.
        let (sin, cos) = math::sin_cos(start[2]);
        let (dx, dy) = (self.pose[0] - start[0], self.pose[1] - start[1]);
        [cos * dx + sin * dy, cos * dy - sin * dx, twist_integral[2]]
    }

    /// Motion as the wheels report it.
    fn measure_wheels(&mut self, motion: [f64; 3]) -> [f64; 3] {
        let wheels = self.config.wheels.clone();
        let rolled = report_with_wrong_radii(motion, wheels.radius_ratio);
        let length = math::hypot(motion[0], motion[1]);
        let decay = math::exp(-1.0 / (0.5 * self.config.frame_rate));
        std::array::from_fn(|k| {
            let excitation = (1.0 - decay * decay).sqrt() * self.normal(wheels.slow_share);
            self.slow_wheel_error[k] = decay * self.slow_wheel_error[k] + excitation;
            let size = if k < 2 { length } else { motion[2].abs() };
            let floor = if k < 2 {
                wheels.white_position
            } else {
                wheels.white_heading
            };
            rolled[k] * wheels.scale
                + size * (self.slow_wheel_error[k] + self.normal(wheels.white_share))
                + self.normal(floor)
        })
    }

    /// Tilt (a, b) of this image, radians.
    fn tilt(&mut self) -> [f64; 2] {
        let points = self.config.points.clone();
        let decay = math::exp(-1.0 / (0.7 * self.config.frame_rate));
        std::array::from_fn(|k| {
            let excitation =
                (1.0 - decay * decay).sqrt() * self.normal(points.slow_tilt_std_deg.to_radians());
            self.slow_tilt[k] = decay * self.slow_tilt[k] + excitation;
            points.constant_tilt_deg[k].to_radians()
                + self.slow_tilt[k]
                + self.normal(points.tilt_std_deg.to_radians())
        })
    }

    fn measure_points(&mut self, dazzled: bool) -> Vec<LinePoint> {
        let settings = self.config.points.clone();
        let upright_from_world = camera_rotation(self.tilt());
        let outlier_share = if dazzled {
            self.config
                .dazzled_outlier_share
                .max(settings.outlier_share)
        } else {
            settings.outlier_share
        };
        let mut points = Vec::new();
        let mut hits = Vec::new();
        for ray in 0..settings.rays {
            let bearing = std::f64::consts::TAU * ray as f64 / settings.rays as f64;
            let direction = self.pose[2] + bearing;
            let from = [self.pose[0] as f32, self.pose[1] as f32];
            let towards = [math::cos(direction) as f32, math::sin(direction) as f32];
            intersect_ray(&self.field.markings, from, towards, &mut hits);
            let mut ranges: Vec<f64> = hits.iter().map(|&range| f64::from(range)).collect();
            ranges.retain(|range| *range > RANGE_MIN && *range < settings.range_max);
            ranges.sort_by(f64::total_cmp);
            ranges.truncate(2);
            let blocked = self.body_range(direction, settings.body_share);
            if let Some(body) = blocked {
                ranges.retain(|range| *range < body);
                ranges.push(body);
            }
            for range in ranges {
                let is_outlier = self.rng.random::<f64>() < outlier_share;
                let seen = if is_outlier {
                    let range =
                        RANGE_MIN + (settings.range_max - RANGE_MIN) * self.rng.random::<f64>();
                    [range * math::cos(bearing), range * math::sin(bearing)]
                } else {
                    let range = range + self.map_error(bearing, range);
                    let ground = [range * math::cos(bearing), range * math::sin(bearing)];
                    tilted_map_point(&upright_from_world, ground)
                };
                points.push(self.add_point_error(seen, is_outlier));
            }
        }
        points
    }

    /// Adds the independent error of a point (robot frame, metres).
    fn add_point_error(&mut self, seen: [f64; 2], is_outlier: bool) -> LinePoint {
        let settings = &self.config.points;
        let range = math::hypot(seen[0], seen[1]);
        let [near, far] = settings.stated_std;
        let stated = near + (far - near) * range / 5.0;
        let wide = self.rng.random::<f64>() < settings.wide_share;
        let std = stated * settings.std_factor * if wide { 3.0 } else { 1.0 };
        let error: [f64; 2] = if is_outlier {
            [0.0; 2]
        } else {
            [self.normal(std), self.normal(std)]
        };
        LinePoint {
            at: At::new((seen[0] + error[0]) as f32, (seen[1] + error[1]) as f32),
            std_radial: stated as f32,
            std_tangential: stated as f32,
        }
    }

    /// Radial error of the map, metres.
    fn map_error(&self, bearing: f64, range: f64) -> f64 {
        let harmonics = self.map_harmonics.iter().enumerate();
        let sum: f64 = harmonics
            .map(|(k, [amplitude, phase])| amplitude * math::cos((k + 1) as f64 * bearing + phase))
            .sum();
        // The amplitudes have variance 1/3 and their cosines 1/2: three harmonics together have 1/2.
        self.config.points.map_error * std::f64::consts::SQRT_2 * sum * (range / 5.0).powi(2)
    }

    /// Range at which a body ends the ray. None for a free ray.
    fn body_range(&self, direction: f64, share: f64) -> Option<f64> {
        // Four bodies of half width 0.5 rad cover 0.64 of the circle.
        let widening = share / 0.64;
        self.bodies.iter().find_map(|[bearing, half_width, range]| {
            let off = wrap_angle((direction - bearing) as f32);
            (f64::from(off).abs() < half_width * widening).then_some(*range)
        })
    }
}

impl<R: Rng> Iterator for RoughDrive<R> {
    type Item = RoughSample;

    fn next(&mut self) -> Option<RoughSample> {
        let motion = self.advance();
        self.index += 1;
        let seconds = self.index as f64 / self.config.frame_rate;
        let stamp = Stamp::from_seconds(seconds);
        let [dx, dy, dtheta] = self.measure_wheels(motion).map(|value| value as f32);
        let blind = self
            .config
            .blind
            .is_some_and(|(period, blind)| seconds % period >= period - blind);
        if blind {
            self.blind_images += 1;
            self.dazzled_images = DAZZLED_IMAGES;
        } else {
            self.blind_images = 0;
        }
        let dazzled = !blind && self.dazzled_images > 0;
        if dazzled {
            self.dazzled_images -= 1;
        }
        let points = if blind {
            Vec::new()
        } else {
            self.measure_points(dazzled)
        };
        let heading = self.pose[2] + self.normal(self.config.compass_std_deg.to_radians());
        Some(RoughSample {
            stamp,
            true_pose: Pose::new(
                self.pose[0] as f32,
                self.pose[1] as f32,
                wrap_angle(self.pose[2] as f32),
            ),
            odometry: Odometry {
                stamp,
                dx,
                dy,
                dtheta,
                slip: 0.0,
            },
            compass: Compass {
                stamp,
                heading: wrap_angle(heading as f32),
                magnetic_field: None,
            },
            points,
            blind_for: self.blind_images as f64 / self.config.frame_rate,
        })
    }
}

/// The wheels as the robot's file describes them.
pub(super) fn wheels_as_described() -> Result<OmniKinematics, OmniError> {
    let angles = [1.0, 3.0, 5.0].map(|thirds| thirds * std::f32::consts::FRAC_PI_3);
    OmniKinematics::new(&angles, 0.05, BASE_RADIUS as f32)
}

/// The motion that a base with these wheels reports under the assumption of equal radii.
fn report_with_wrong_radii(motion: [f64; 3], radius_ratio: [f64; 3]) -> [f64; 3] {
    let rows: [Vector3<f64>; 3] = std::array::from_fn(|wheel| {
        let angle = std::f64::consts::FRAC_PI_3 * (1.0 + 2.0 * wheel as f64);
        Vector3::new(-math::sin(angle), math::cos(angle), BASE_RADIUS)
    });
    let wheels = nalgebra::Matrix3::from_rows(&rows.map(|row| row.transpose()));
    // A larger wheel turns less over the same distance.
    let turned = (wheels * Vector3::from(motion)).component_div(&Vector3::from(radius_ratio));
    wheels
        .try_inverse()
        .map_or(motion, |inverse| (inverse * turned).into())
}

/// Rotation of directions of the world into the camera of a robot whose up direction is (a, b, 1) in its own frame.
fn camera_rotation([a, b]: [f64; 2]) -> Rotation3<f64> {
    let up = Vector3::new(a, b, 1.0);
    Rotation3::rotation_between(&Vector3::z(), &up).unwrap_or_else(Rotation3::identity)
}

/// Where the map of an upright robot shows a ground point of a robot that is tilted about its foot.
fn tilted_map_point(camera_from_world: &Rotation3<f64>, [x, y]: [f64; 2]) -> [f64; 2] {
    let body = camera_from_world * Vector3::new(x, y, 0.0);
    let seen = body - Vector3::new(0.0, 0.0, MIRROR_HEIGHT);
    let scale = MIRROR_HEIGHT / (-seen.z).max(0.05);
    [seen.x * scale, seen.y * scale]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tilt_agrees_with_the_map_of_the_matcher() {
        let tilt = [0.006, -0.004];
        let ground = [3.0, 1.5];
        let [x, y] = tilted_map_point(&camera_rotation(tilt), ground);
        let [u, v] = crate::tilt::ground_from_map([x, y], tilt, MIRROR_HEIGHT);
        assert!(
            math::hypot(u - ground[0], v - ground[1]) < 1e-3,
            "({u}, {v})"
        );
    }

    #[test]
    fn wheels_of_unequal_radius_turn_a_straight_way_into_an_arc() {
        let [x, y, turn] = report_with_wrong_radii([1.0, 0.0, 0.0], [1.03, 1.02, 1.04]);
        assert!(
            (x - 1.0 / 1.03).abs() < 0.01 && y.abs() < 0.01,
            "({x}, {y})"
        );
        assert!(turn.abs() > 0.01, "{turn}");
    }
}
