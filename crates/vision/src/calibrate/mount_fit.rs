//! Fits the mount of a mirror with known profile: tilt, offset and focal length by least squares.

use localize::math;
use nalgebra::{SMatrix, SVector};

use crate::calibrate::{CalibrationError, Correspondence};
use crate::optics::ground_map::GroundMap;
use crate::optics::mirror::Profile;
use crate::optics::ray_tracing::{Mount, Tracer, trace_rays};
use localize::robot::CameraConfig;

/// The fitted mount.
#[derive(Debug, Clone)]
pub struct MountFit {
    /// The camera with its focal length corrected.
    pub camera: CameraConfig,
    /// Tilt and offset of the mirror.
    pub mount: Mount,
    /// The map traced with both.
    pub map: GroundMap,
    /// Root mean square of the points' distances from the fit, in pixels on the ground there.
    pub rms_px: f64,
    /// Each point's distance from the fit, metres.
    pub residuals: Vec<f64>,
}

/// Tilt (2, degrees), offset (2, metres), focal length (relative); the centre stays fixed.
const UNKNOWNS: usize = 5;

/// Steps for the numeric derivatives: far above rounding, far below what changes the linearisation.
const DIFFERENCE_STEPS: [f64; UNKNOWNS] = [1e-3, 1e-3, 1e-5, 1e-5, 1e-5];

/// Prior standard deviations: 2°, 5 mm, 3 %; they constrain unobservable parameters.
const PRIOR_STD: [f64; UNKNOWNS] = [2.0, 2.0, 0.005, 0.005, 0.03];

/// Fits the mount to ground points with known image positions, e.g. of a strip.
pub fn fit_mount(
    camera: &CameraConfig,
    profile: &Profile,
    points: &[Correspondence],
) -> Result<MountFit, CalibrationError> {
    let mut unknowns = SVector::<f64, UNKNOWNS>::zeros();
    let mut damping = 1e-3;
    let mut cost = cost(camera, profile, points, &unknowns)?;
    for _ in 0..60 {
        let mut normal = SMatrix::<f64, UNKNOWNS, UNKNOWNS>::zeros();
        let mut gradient = SVector::<f64, UNKNOWNS>::zeros();
        let base = residuals(camera, profile, points, &unknowns)?;
        let mut moved = Vec::with_capacity(UNKNOWNS);
        for (i, step) in DIFFERENCE_STEPS.iter().enumerate() {
            let mut shifted = unknowns;
            shifted[i] += step;
            moved.push(residuals(camera, profile, points, &shifted)?);
        }
        for (index, here) in base.iter().enumerate() {
            let row = SVector::<f64, UNKNOWNS>::from_fn(|i, _| {
                (moved[i][index] - here) / DIFFERENCE_STEPS[i]
            });
            // Huber: residuals beyond one pixel count linearly.
            let weight = 1.0 / here.abs().max(1.0);
            normal += weight * row * row.transpose();
            gradient += weight * *here * row;
        }
        for i in 0..UNKNOWNS {
            let inverse = 1.0 / (PRIOR_STD[i] * PRIOR_STD[i]);
            normal[(i, i)] += inverse;
            gradient[i] += inverse * unknowns[i];
        }
        let mut damped = normal;
        for i in 0..UNKNOWNS {
            damped[(i, i)] *= 1.0 + damping;
        }
        let step = damped.lu().solve(&-gradient).ok_or_else(|| {
            CalibrationError::NoConvergence("the points do not constrain the mount".into())
        })?;
        let new_cost = self::cost(camera, profile, points, &(unknowns + step));
        match new_cost {
            Ok(new_cost) if new_cost < cost => {
                let decrease = cost - new_cost;
                unknowns += step;
                (cost, damping) = (new_cost, damping * 0.3);
                if decrease < 1e-9 * cost {
                    break;
                }
            }
            _ => damping *= 10.0,
        }
        if damping > 1e9 {
            break;
        }
    }
    let (camera, mount) = apply_parameters(camera, &unknowns);
    let tracer = Tracer::new(&camera, profile, &mount)?;
    let distances: Vec<f64> = points
        .iter()
        .filter_map(|point| {
            let ground = tracer
                .ray(point.position_px[0], point.position_px[1])?
                .at_height(0.0)?;
            let dx = f64::from(ground.x) - point.ground[0];
            let dy = f64::from(ground.y) - point.ground[1];
            Some(math::hypot(dx, dy))
        })
        .collect();
    let rms_px = reprojection_residuals(&camera, profile, points, &mount)?;
    let rms_px = (rms_px.iter().map(|r| r * r).sum::<f64>() / points.len().max(1) as f64).sqrt();
    Ok(MountFit {
        map: trace_rays(&camera, profile, &mount)?.ground_map(),
        camera,
        mount,
        rms_px,
        residuals: distances,
    })
}

fn apply_parameters(
    camera: &CameraConfig,
    unknowns: &SVector<f64, UNKNOWNS>,
) -> (CameraConfig, Mount) {
    let mut camera = camera.clone();
    camera.focal_px = camera
        .focal_px
        .map(|focal| (f64::from(focal) * (1.0 + unknowns[4])) as f32);
    let mount = Mount {
        mirror_tilt_deg: [unknowns[0], unknowns[1]],
        mirror_offset: [unknowns[2], unknowns[3]],
        ..Mount::default()
    };
    (camera, mount)
}

fn cost(
    camera: &CameraConfig,
    profile: &Profile,
    points: &[Correspondence],
    unknowns: &SVector<f64, UNKNOWNS>,
) -> Result<f64, CalibrationError> {
    let robust = |r: &f64| {
        if r.abs() <= 1.0 {
            r * r
        } else {
            2.0 * r.abs() - 1.0
        }
    };
    let points: f64 = residuals(camera, profile, points, unknowns)?
        .iter()
        .map(robust)
        .sum();
    let prior: f64 = (0..UNKNOWNS)
        .map(|i| (unknowns[i] / PRIOR_STD[i]).powi(2))
        .sum();
    Ok(points + prior)
}

fn residuals(
    camera: &CameraConfig,
    profile: &Profile,
    points: &[Correspondence],
    unknowns: &SVector<f64, UNKNOWNS>,
) -> Result<Vec<f64>, CalibrationError> {
    let (camera, mount) = apply_parameters(camera, unknowns);
    reprojection_residuals(&camera, profile, points, &mount)
}

/// Two residuals per point, along columns and rows, pixels; 10 for a point without ground.
fn reprojection_residuals(
    camera: &CameraConfig,
    profile: &Profile,
    points: &[Correspondence],
    mount: &Mount,
) -> Result<Vec<f64>, CalibrationError> {
    let tracer = Tracer::new(camera, profile, mount)?;
    let ground = |u: f64, v: f64| {
        tracer
            .ray(u, v)
            .and_then(|ray| ray.at_height(0.0))
            .map(|at| [f64::from(at.x), f64::from(at.y)])
    };
    let mut residuals = Vec::with_capacity(2 * points.len());
    for point in points {
        let [u, v] = point.position_px;
        let around = (ground(u, v), ground(u + 1.0, v), ground(u, v + 1.0));
        let (Some(here), Some(right), Some(down)) = around else {
            residuals.extend([10.0, 10.0]);
            continue;
        };
        // Solve the Jacobian for the pixel shift that explains the distance on the ground.
        let (ax, ay) = (right[0] - here[0], right[1] - here[1]);
        let (bx, by) = (down[0] - here[0], down[1] - here[1]);
        let determinant = ax * by - ay * bx;
        let (dx, dy) = (point.ground[0] - here[0], point.ground[1] - here[1]);
        let shift = [
            (by * dx - bx * dy) / determinant,
            (ax * dy - ay * dx) / determinant,
        ];
        residuals.extend(shift.map(|s| {
            if s.is_finite() {
                s.clamp(-50.0, 50.0)
            } else {
                10.0
            }
        }));
    }
    Ok(residuals)
}
