//! Where does a ray meet the ground when the mirror is mounted otherwise? The law of reflection on a tabulated profile
//! (docs/methods.md 2.5), fast enough for every point of every image.
//!
//! Profiles of several parts have kinks, and near the apex a millimetre of offset is a large part of the profile's
//! radius. Linear fields are centimetres wrong there.

use std::f32::consts::FRAC_PI_2;

use nalgebra::{Matrix3, Vector3};

use crate::math;

/// Samples of the profile from its axis to its rim.
const PROFILE_SAMPLES: usize = 1024;

/// Samples of the camera ray by γ.
const RAY_SAMPLES: usize = 2048;

/// Image radii at which the upright mirror is traced.
const TRACED_RADII: usize = 4096;

/// Change of γ between two neighbouring image radii that a smooth profile does not show, in samples: 0.7°.
const LEAP_SAMPLES: f32 = 16.0;

/// Newton steps. The start is the upright mirror's solution, so the error falls below a micrometre.
const NEWTON_STEPS: usize = 4;

/// A mirror of revolution over a pinhole.
#[derive(Debug, Clone, PartialEq)]
pub struct MirrorModel {
    /// Height above the pinhole and slope of the profile at even radii, metres.
    profile: Vec<[f32; 2]>,
    radius_step: f32,
    pinhole_height: f32,
    viewpoint_height: f32,
    /// Tangent of the camera ray, and height of its reflection above the pinhole, by γ of the ground point. None: no
    /// ray shows such a point.
    rays: Vec<Option<[f32; 2]>>,
    /// Ground nearer than this is seen twice, metres.
    ambiguous_range: f32,
}

/// A mounting of the mirror, prepared for many rays.
#[derive(Debug, Clone, Copy)]
pub struct PreparedMount {
    camera_from_mirror: Matrix3<f32>,
    pivot: Vector3<f32>,
    moved_pivot: Vector3<f32>,
    focal_scale: f32,
}

impl MirrorModel {
    /// `profile`: height above the ground and slope at a radius, up to `outer_radius`. `tangent_max`: of the camera's
    /// ray to the rim of the image. `viewpoint_height`: that of the map's basis. All lengths in metres.
    pub fn new(
        profile: impl Fn(f64) -> (f64, f64),
        outer_radius: f64,
        pinhole_height: f64,
        tangent_max: f32,
        viewpoint_height: f32,
    ) -> Self {
        let step = outer_radius / (PROFILE_SAMPLES - 1) as f64;
        let profile = (0..PROFILE_SAMPLES)
            .map(|k| {
                let (height, slope) = profile(k as f64 * step);
                [(height - pinhole_height) as f32, slope as f32]
            })
            .collect();
        let mut model = MirrorModel {
            profile,
            radius_step: step as f32,
            pinhole_height: pinhole_height as f32,
            viewpoint_height,
            rays: vec![None; RAY_SAMPLES],
            ambiguous_range: 0.0,
        };
        model.trace_upright(tangent_max);
        model
    }

    /// Ground nearer than this is seen twice, metres; 0 if there is none.
    pub fn ambiguous_range(&self) -> f32 {
        self.ambiguous_range
    }

    /// Prepares a mounting: tilt of the mirror's axis (2, radians) and its offset (2, metres) towards the robot's x and y,
    /// and the relative error of the focal length.
    pub fn prepare(&self, [tilt_x, tilt_y, offset_x, offset_y, focal]: [f32; 5]) -> PreparedMount {
        let pivot = Vector3::new(0.0, 0.0, self.profile[0][0]);
        PreparedMount {
            camera_from_mirror: rotation_of_tilt([tilt_x, tilt_y]),
            pivot,
            moved_pivot: pivot + Vector3::new(offset_x, offset_y, 0.0),
            focal_scale: 1.0 + focal,
        }
    }

    /// The ground point that the pixel really shows which the map of the upright mirror assigns to `point` (metres, robot
    /// frame). None if the mirror does not show the point.
    pub fn displace(&self, [x, y]: [f32; 2], mount: &PreparedMount) -> Option<[f32; 2]> {
        let range = math::hypot(x, y);
        let place =
            math::atan(range / self.viewpoint_height) / FRAC_PI_2 * (RAY_SAMPLES - 1) as f32;
        let node = (place as usize).min(RAY_SAMPLES - 2);
        let share = place - node as f32;
        let (low, high) = (self.rays[node]?, self.rays[node + 1]?);
        let [tangent, height] = [0, 1].map(|k| low[k] + share * (high[k] - low[k]));
        let scale = tangent / range.max(1e-6) / mount.focal_scale;
        self.trace(Vector3::new(x * scale, y * scale, 1.0), height, mount)
    }

    /// Traces camera rays of the upright mirror outward. Where a second ring shows near ground again, the first counts.
    fn trace_upright(&mut self, tangent_max: f32) {
        let upright = self.prepare([0.0; 5]);
        let mut last: Option<(f32, [f32; 2])> = None;
        // Farthest ground of the first ring, and of the ring after the last leap.
        let (mut first_range, mut ring_range) = (0.0_f32, 0.0_f32);
        let mut last_place = 0.0;
        let per_radian = (RAY_SAMPLES - 1) as f32 / FRAC_PI_2;
        let mut height = self.profile[0][0];
        for k in 1..TRACED_RADII {
            let tangent = tangent_max * k as f32 / (TRACED_RADII - 1) as f32;
            let towards = Vector3::new(tangent, 0.0, 1.0);
            let Some([range, _]) = self.trace(towards, height, &upright) else {
                continue;
            };
            // The height of the meeting point starts the next ray's search.
            height = self.meeting_height(towards, height, &upright);
            let place = math::atan(range / self.viewpoint_height) * per_radian;
            let here = (place, [tangent, height]);
            let Some((before, values)) = last else {
                last = Some(here);
                continue;
            };
            // At the edge between two rings the range leaps.
            if (place - last_place).abs() > LEAP_SAMPLES {
                ring_range = 0.0;
            }
            last_place = place;
            if place <= before {
                ring_range = range.max(ring_range);
                continue;
            }
            (first_range, ring_range) = (range, 0.0);
            for node in before.ceil() as usize..=(place as usize).min(RAY_SAMPLES - 1) {
                let share = (node as f32 - before) / (place - before);
                self.rays[node] = Some([0, 1].map(|k| values[k] + share * (here.1[k] - values[k])));
            }
            last = Some(here);
        }
        // Far ground next to the edge of the first ring may waver, which is no second ring.
        if ring_range < 0.5 * first_range {
            self.ambiguous_range = ring_range;
        }
    }

    /// Height above the pinhole and slope of the profile.
    fn profile_at(&self, radius: f32) -> [f32; 2] {
        let place = radius / self.radius_step;
        let node = (place as usize).min(PROFILE_SAMPLES - 2);
        let beyond = radius - node as f32 * self.radius_step;
        let ([height, slope], [_, next_slope]) = (self.profile[node], self.profile[node + 1]);
        let bend = (next_slope - slope) / self.radius_step;
        [
            height + beyond * (slope + 0.5 * bend * beyond),
            slope + bend * beyond,
        ]
    }

    /// Distance along a camera ray (z = 1) to the mirror, in the mirror's frame.
    fn meet(&self, start: Vector3<f32>, step: Vector3<f32>, height: f32) -> f32 {
        let mut distance = height;
        for _ in 0..NEWTON_STEPS {
            let point = start + step * distance;
            let radius = math::hypot(point.x, point.y);
            let [height, slope] = self.profile_at(radius);
            let outward = (point.x * step.x + point.y * step.y) / radius.max(1e-9);
            let rate = (step.z - slope * outward).max(1e-3);
            distance -= (point.z - height) / rate;
        }
        distance
    }

    fn meeting_height(&self, towards: Vector3<f32>, height: f32, mount: &PreparedMount) -> f32 {
        let start = mount.pivot - mount.moved_pivot;
        (start + towards * self.meet(start, towards, height)).z
    }

    /// Ground point of a camera ray (z = 1). `height`: a guess of the mirror's height there above the pinhole.
    fn trace(&self, towards: Vector3<f32>, height: f32, mount: &PreparedMount) -> Option<[f32; 2]> {
        let mirror_from_camera = mount.camera_from_mirror.transpose();
        let start = mount.pivot - mirror_from_camera * mount.moved_pivot;
        let step = mirror_from_camera * towards;
        let point = start + step * self.meet(start, step, height);
        let radius = math::hypot(point.x, point.y);
        if radius > self.radius_step * PROFILE_SAMPLES as f32 {
            return None;
        }
        let [_, slope] = self.profile_at(radius);
        let outward = 1.0 / radius.max(1e-9);
        let normal = Vector3::new(slope * point.x * outward, slope * point.y * outward, -1.0);
        let reflected = step - normal * (2.0 * step.dot(&normal) / normal.norm_squared());
        let direction = mount.camera_from_mirror * reflected;
        let origin = mount.camera_from_mirror * (point - mount.pivot) + mount.moved_pivot;
        let drop = (origin.z + self.pinhole_height) / -direction.z;
        (direction.z < 0.0).then(|| [origin.x + drop * direction.x, origin.y + drop * direction.y])
    }
}

/// Rotation that moves the top of an axis by `tilt` (radians) towards x and y.
fn rotation_of_tilt([x, y]: [f32; 2]) -> Matrix3<f32> {
    let angle = math::hypot(x, y);
    let (sin, cos) = math::sin_cos(angle);
    // Towards the direction of the tilt; without a tilt any direction will do.
    let (dx, dy) = if angle > 0.0 {
        (x / angle, y / angle)
    } else {
        (1.0, 0.0)
    };
    let bend = cos - 1.0;
    Matrix3::new(
        1.0 + bend * dx * dx,
        bend * dx * dy,
        sin * dx,
        bend * dx * dy,
        1.0 + bend * dy * dy,
        sin * dy,
        -sin * dx,
        -sin * dy,
        cos,
    )
}
