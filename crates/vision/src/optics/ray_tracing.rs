//! Traces each pixel's ray through pinhole, mirror and mount by the exact law of reflection (docs/methods.md 2.5; tilt: 3.2).

use localize::frames::{At, RobotFrame};
use localize::math;
use nalgebra::{Rotation3, Vector3};
use rayon::prelude::*;

use crate::optics::ground_map::GroundMap;
use crate::optics::mirror::Profile;
use localize::robot::CameraConfig;

/// Mounting errors of camera and mirror; all zero for a perfect mount.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Mount {
    /// Tilt of the whole rig, degrees: towards the robot's x (a) and y (b), about the ground point below.
    #[serde(deserialize_with = "localize::fixed_array::deserialize")]
    pub lean_deg: [f64; 2],
    /// Tilt of the mirror against the camera's axis, degrees: the top of its axis moves towards the robot's x and y.
    #[serde(deserialize_with = "localize::fixed_array::deserialize")]
    pub mirror_tilt_deg: [f64; 2],
    /// Offset of the mirror's axis from the camera's, metres along the robot's x and y.
    #[serde(deserialize_with = "localize::fixed_array::deserialize")]
    pub mirror_offset: [f64; 2],
    /// Height of the mirror above the profile's height, metres.
    pub mirror_raise: f64,
}

impl Mount {
    /// Largest tilt of rig or mirror, degrees. Beyond, the mirror is no longer in the image.
    pub const TILT_MAX_DEG: f64 = 20.0;
    /// Largest offset of the mirror along an axis, metres.
    pub const OFFSET_MAX: f64 = 0.2;
}

/// A pixel's ray after reflection, robot frame (z up from the ground).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ray {
    /// Point on the mirror, metres.
    pub origin: [f32; 3],
    /// Unit vector.
    pub direction: [f32; 3],
}

/// One ray per pixel, row by row; None if the pixel shows no mirror.
#[derive(Debug, Clone, PartialEq)]
pub struct RayTable {
    /// Columns.
    pub width_px: usize,
    /// Rows.
    pub height_px: usize,
    /// Row by row.
    pub rays: Vec<Option<Ray>>,
}

/// Why rays cannot be traced.
#[derive(Debug, thiserror::Error)]
pub enum OpticsError {
    /// A required value is missing.
    #[error("missing [camera] {0}: tracing a mirror profile needs it")]
    Missing(&'static str),
    /// A value is out of range.
    #[error("[camera] {key} = {value}: {reason}")]
    Value {
        /// The key.
        key: &'static str,
        /// Its value.
        value: f64,
        /// The requirement it fails.
        reason: &'static str,
    },
}

/// Traces the rays of all pixels.
pub fn trace_rays(
    camera: &CameraConfig,
    profile: &Profile,
    mount: &Mount,
) -> Result<RayTable, OpticsError> {
    let tracer = Tracer::new(camera, profile, mount)?;
    let (width_px, height_px) = (camera.width_px, camera.height_px);
    let rays = (0..height_px)
        .into_par_iter()
        .flat_map_iter(|v| (0..width_px).map(move |u| (u, v)))
        .map(|(u, v)| tracer.ray(u as f64, v as f64))
        .collect();
    Ok(RayTable {
        width_px,
        height_px,
        rays,
    })
}

impl RayTable {
    /// Intersects the rays with the ground.
    pub fn ground_map(&self) -> GroundMap {
        let (x, y) = self
            .rays
            .iter()
            .map(|ray| {
                ray.and_then(|ray| ray.at_height(0.0))
                    .map_or((f32::NAN, f32::NAN), |point| (point.x, point.y))
            })
            .unzip();
        GroundMap {
            width_px: self.width_px,
            height_px: self.height_px,
            x,
            y,
        }
    }
}

impl Ray {
    /// Intersection with a plane at a height above the ground, metres. None if the ray rises or starts below it.
    pub fn at_height(&self, height: f32) -> Option<At<RobotFrame>> {
        let drop = self.origin[2] - height;
        if !(self.direction[2] < 0.0 && drop >= 0.0) {
            return None;
        }
        let distance = drop / -self.direction[2];
        Some(At::new(
            self.origin[0] + distance * self.direction[0],
            self.origin[1] + distance * self.direction[1],
        ))
    }
}

/// Precomputed values for tracing.
pub struct Tracer<'a> {
    camera: &'a CameraConfig,
    profile: &'a Profile,
    focal_px: f64,
    pinhole_height: f64,
    mirror_from_camera: Rotation3<f64>,
    /// The mirror's pivot (profile's apex) in the camera's frame, before and after the mount moved it.
    pivot: Vector3<f64>,
    moved_pivot: Vector3<f64>,
    upright_from_rig: Rotation3<f64>,
}

/// A camera ray reflected by the mirror, camera frame.
struct Reflection {
    /// Where it meets the mirror, metres from the pinhole.
    point: Vector3<f64>,
    /// Its direction afterwards, unit length.
    direction: Vector3<f64>,
}

/// Newton's method has converged below this step, metres.
const CONVERGED: f64 = 1e-12;

impl<'a> Tracer<'a> {
    /// Checks the camera and converts the mount to rotations.
    pub fn new(
        camera: &'a CameraConfig,
        profile: &'a Profile,
        mount: &Mount,
    ) -> Result<Self, OpticsError> {
        let focal_px = f64::from(camera.focal_px.ok_or(OpticsError::Missing("focal_px"))?);
        let pinhole_height = f64::from(camera.height.ok_or(OpticsError::Missing("height"))?);
        if !(focal_px.is_finite() && focal_px > 0.0) {
            return Err(OpticsError::Value {
                key: "focal_px",
                value: focal_px,
                reason: "must be positive",
            });
        }
        let apex = profile.height_and_slope(0.0).0 - pinhole_height;
        if !(pinhole_height >= 0.0 && apex > 0.0) {
            let reason = "must lie above the ground and below the mirror";
            return Err(OpticsError::Value {
                key: "height",
                value: pinhole_height,
                reason,
            });
        }
        let tilt = |[towards_x, towards_y]: [f64; 2]| {
            Rotation3::from_scaled_axis(Vector3::new(
                -towards_y.to_radians(),
                towards_x.to_radians(),
                0.0,
            ))
        };
        let pivot = Vector3::new(0.0, 0.0, apex);
        let offset = Vector3::new(
            mount.mirror_offset[0],
            mount.mirror_offset[1],
            mount.mirror_raise,
        );
        Ok(Tracer {
            camera,
            profile,
            focal_px,
            pinhole_height,
            mirror_from_camera: tilt(mount.mirror_tilt_deg).inverse(),
            pivot,
            moved_pivot: pivot + offset,
            upright_from_rig: tilt(mount.lean_deg),
        })
    }

    /// Ray of an image point. None beyond the mirror's rim.
    pub fn ray(&self, u: f64, v: f64) -> Option<Ray> {
        if !self.camera.is_inside_mirror(u as f32, v as f32) {
            return None;
        }
        let [xu, xv] = [
            u - f64::from(self.camera.centre_px[0]),
            v - f64::from(self.camera.centre_px[1]),
        ];
        let [row_u, row_v] = self.camera.image_from_robot().map(|row| row.map(f64::from));
        let tangent_x = (row_u[0] * xu + row_v[0] * xv) / self.focal_px;
        let tangent_y = (row_u[1] * xu + row_v[1] * xv) / self.focal_px;
        let Reflection { point, direction } =
            self.reflect(Vector3::new(tangent_x, tangent_y, 1.0))?;
        let origin = self.upright_from_rig * (point + Vector3::new(0.0, 0.0, self.pinhole_height));
        let direction = self.upright_from_rig * direction;
        let f32s = |v: Vector3<f64>| [v.x as f32, v.y as f32, v.z as f32];
        Some(Ray {
            origin: f32s(origin),
            direction: f32s(direction),
        })
    }

    /// Reflects a camera ray (z = 1), camera frame.
    fn reflect(&self, towards: Vector3<f64>) -> Option<Reflection> {
        // In the mirror's frame the pivot is at the profile's apex.
        let start = self.mirror_from_camera * -self.moved_pivot + self.pivot;
        let step = self.mirror_from_camera * towards;
        let profile_at = |radius: f64| {
            let (height, slope) = self.profile.height_and_slope(radius);
            (height - self.pinhole_height, slope)
        };
        // Newton on z(t) − profile(radius(t)), t along the ray: monotone, since a ray meets the mirror once.
        let mut distance = self.pivot.z;
        let mut meeting_point = None;
        for _ in 0..50 {
            let point = start + distance * step;
            let radius = math::hypot(point.x, point.y);
            let (height, slope) = profile_at(radius);
            let outward = if radius > 0.0 {
                (point.x * step.x + point.y * step.y) / radius
            } else {
                0.0
            };
            let rate = step.z - slope * outward;
            if !(rate > 0.0) {
                return None;
            }
            let correction = (point.z - height) / rate;
            distance -= correction;
            if correction.abs() < CONVERGED {
                meeting_point = Some(start + distance * step);
                break;
            }
        }
        let point = meeting_point?;
        let radius = math::hypot(point.x, point.y);
        let (innermost, outermost) = self.profile.radii();
        if radius > outermost || (innermost > 0.0 && radius < innermost) {
            return None;
        }
        let (_, slope) = profile_at(radius);
        let normal = if radius > 1e-12 {
            Vector3::new(slope * point.x / radius, slope * point.y / radius, -1.0).normalize()
        } else {
            Vector3::new(0.0, 0.0, -1.0)
        };
        let incoming = step.normalize();
        let outgoing = incoming - 2.0 * incoming.dot(&normal) * normal;
        let camera_from_mirror = self.mirror_from_camera.inverse();
        Some(Reflection {
            point: camera_from_mirror * (point - self.pivot) + self.moved_pivot,
            direction: camera_from_mirror * outgoing,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> CameraConfig {
        CameraConfig {
            width_px: 101,
            height_px: 101,
            focal_px: Some(120.0),
            centre_px: [50.0, 50.0],
            height: Some(0.6),
            forward_deg: 90.0,
            flipped: true,
            outer_radius_px: None,
        }
    }

    /// A paraboloid 0.8 m above the ground.
    fn profile() -> Profile {
        let radius: Vec<f64> = (0..=300).map(|i| f64::from(i) * 0.0005).collect();
        let height = radius.iter().map(|r| 0.8 + 2.0 * r * r).collect();
        Profile::new(radius, height).expect("a profile")
    }

    #[test]
    fn traced_rays_match_the_meridional_solution() {
        let (camera, profile) = (camera(), profile());
        let tracer = Tracer::new(&camera, &profile, &Mount::default()).expect("a tracer");
        for ahead_px in [5.0, 20.0, 37.0, 48.0] {
            let tangent = ahead_px / 120.0;
            // Meet the profile in the meridian plane: X = t·(0.2 + 2X²).
            let x = (1.0 - (1.0f64 - 1.6 * tangent * tangent).sqrt()) / (4.0 * tangent);
            let (height, slope) = (0.2 + 2.0 * x * x, 4.0 * x);
            let gamma = tangent.atan() + 2.0 * slope.atan();
            let expected = x + (height + 0.6) * gamma.tan();
            let ray = tracer.ray(50.0, 50.0 - ahead_px).expect("a ray");
            match ray.at_height(0.0) {
                Some(ground) => {
                    assert!(
                        (f64::from(ground.x) - expected).abs() < 1e-5 * expected,
                        "{} {expected}",
                        ground.x
                    );
                    assert!(ground.y.abs() < 1e-6);
                }
                None => assert!(gamma >= std::f64::consts::FRAC_PI_2),
            }
        }
    }

    #[test]
    fn forward_rig_tilt_shifts_the_ray_origin_forward() {
        let (camera, profile) = (camera(), profile());
        let mount = Mount {
            lean_deg: [1.0, 0.0],
            ..Mount::default()
        };
        let tilted = Tracer::new(&camera, &profile, &mount).expect("a tracer");
        let below = tilted
            .ray(50.0, 50.0)
            .and_then(|ray| ray.at_height(0.0))
            .expect("ground");
        // The central ray returns along the axis, which is tilted about the ground point.
        assert!(below.x.abs() < 1e-6 && below.y.abs() < 1e-6);
        let origin = tilted.ray(50.0, 50.0).expect("a ray").origin;
        assert!((f64::from(origin[0]) - 0.8 * 1f64.to_radians().sin()).abs() < 1e-6);
    }

    #[test]
    fn ray_meets_a_tilted_mirror_on_its_surface() {
        let (camera, profile) = (camera(), profile());
        let mount = Mount {
            mirror_tilt_deg: [0.0, 2.0],
            mirror_offset: [0.003, 0.0],
            ..Mount::default()
        };
        let tracer = Tracer::new(&camera, &profile, &mount).expect("a tracer");
        let Reflection { point, direction } = tracer
            .reflect(Vector3::new(0.1, -0.2, 1.0))
            .expect("a reflection");
        // The point is on the camera's ray; reflection preserves the length.
        assert!((point.x / point.z - 0.1).abs() < 1e-10 && (point.y / point.z + 0.2).abs() < 1e-10);
        assert!((direction.norm() - 1.0).abs() < 1e-12);
    }
}
