//! Rays and ground points per pixel in Python. Arrays of the crates move into numpy without a copy.

use numpy::{IntoPyArray, PyArray2, PyArray3, PyArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use vision::optics::ray_tracing::{Ray, Tracer};

use crate::arguments::finite_column;
use crate::camera::{Camera, Mount};
use crate::errors;
use crate::ground_map::GroundMap;
use crate::profile::Profile;
use crate::threads::detached;

fn flat(rays: &[Option<Ray>]) -> (Vec<f32>, Vec<f32>) {
    let mut origins = Vec::with_capacity(3 * rays.len());
    let mut directions = Vec::with_capacity(3 * rays.len());
    for ray in rays {
        let (origin, direction) = ray.map_or(([f32::NAN; 3], [f32::NAN; 3]), |ray| {
            (ray.origin, ray.direction)
        });
        origins.extend(origin);
        directions.extend(direction);
    }
    (origins, directions)
}

type RayArrays<'py> = (Bound<'py, PyArray3<f32>>, Bound<'py, PyArray3<f32>>);

/// Origin (metres) and unit direction of each pixel's ray after the mirror: rows × columns × 3, NaN off the mirror.
///
/// Robot frame: x forward, y left, z up from the ground.
#[pyfunction]
#[pyo3(signature = (*, camera, profile, mount=None))]
pub(crate) fn trace_rays<'py>(
    py: Python<'py>,
    camera: &Bound<'py, PyAny>,
    profile: &Bound<'py, PyAny>,
    mount: Option<&Bound<'py, PyAny>>,
) -> PyResult<RayArrays<'py>> {
    let mount = Mount::from_argument(mount)?;
    let camera = &Camera::from_argument(camera)?.0;
    let profile = &Profile::from_argument(profile)?.0;
    let (origins, directions) = detached(py, || {
        vision::optics::trace_rays(camera, profile, &mount).map(|table| flat(&table.rays))
    })
    .map_err(|error| errors::optics(&error))?;
    let shape = [camera.height_px, camera.width_px, 3];
    Ok((
        origins.into_pyarray(py).reshape(shape)?,
        directions.into_pyarray(py).reshape(shape)?,
    ))
}

type PointArrays<'py> = (Bound<'py, PyArray2<f32>>, Bound<'py, PyArray2<f32>>);

/// Origin (metres) and unit direction of the rays of n image points: n × 3, NaN off the mirror.
///
/// Robot frame: x forward, y left, z up from the ground.
#[pyfunction]
#[pyo3(signature = (*, camera, profile, u_px, v_px, mount=None))]
pub(crate) fn trace_points<'py>(
    py: Python<'py>,
    camera: &Bound<'py, PyAny>,
    profile: &Bound<'py, PyAny>,
    u_px: &Bound<'py, PyAny>,
    v_px: &Bound<'py, PyAny>,
    mount: Option<&Bound<'py, PyAny>>,
) -> PyResult<PointArrays<'py>> {
    let mount = Mount::from_argument(mount)?;
    let camera = &Camera::from_argument(camera)?.0;
    let profile = &Profile::from_argument(profile)?.0;
    let u_px = finite_column("u_px", u_px)?;
    let v_px = finite_column("v_px", v_px)?;
    if u_px.len() != v_px.len() {
        return Err(PyValueError::new_err(format!(
            "invalid v_px: {} numbers (expected {}, as u_px)",
            v_px.len(),
            u_px.len()
        )));
    }
    let tracer = Tracer::new(camera, profile, &mount).map_err(|error| errors::optics(&error))?;
    let (origins, directions) = detached(py, || {
        let rays: Vec<_> = u_px
            .iter()
            .zip(&v_px)
            .map(|(&u, &v)| tracer.ray(u, v))
            .collect();
        flat(&rays)
    });
    let shape = [u_px.len(), 3];
    Ok((
        origins.into_pyarray(py).reshape(shape)?,
        directions.into_pyarray(py).reshape(shape)?,
    ))
}

/// Where each pixel's ray meets the ground, in the robot frame: x forward, y left, metres.
///
/// Its origin is the ground point below the pinhole of an upright rig. NaN off the mirror and where a ray meets no ground.
#[pyfunction]
#[pyo3(signature = (*, camera, profile, mount=None))]
pub(crate) fn ground_map<'py>(
    py: Python<'py>,
    camera: &Bound<'py, PyAny>,
    profile: &Bound<'py, PyAny>,
    mount: Option<&Bound<'py, PyAny>>,
) -> PyResult<GroundMap> {
    let mount = Mount::from_argument(mount)?;
    let camera = &Camera::from_argument(camera)?.0;
    let profile = &Profile::from_argument(profile)?.0;
    let map = detached(py, || {
        vision::optics::trace_rays(camera, profile, &mount).map(|table| table.ground_map())
    })
    .map_err(|error| errors::optics(&error))?;
    GroundMap::of(py, map)
}
