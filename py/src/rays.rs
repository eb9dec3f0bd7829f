//! Rays and ground points per pixel in Python; the arrays that the crates made move into numpy without a copy.

use std::path::PathBuf;

use numpy::{IntoPyArray, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use vision::optics::ray_tracing::{Ray, Tracer};

use crate::camera::{Camera, Mount};
use crate::errors;
use crate::profile::Profile;

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

fn mount_or_perfect(mount: Option<&Bound<'_, Mount>>) -> vision::Mount {
    mount.map_or_else(vision::Mount::default, |mount| mount.get().0)
}

type RayArrays<'py> = (Bound<'py, PyArray3<f32>>, Bound<'py, PyArray3<f32>>);

/// Origin (metres) and unit direction of each pixel's ray after the mirror: rows × columns × 3, NaN off the mirror.
#[pyfunction]
#[pyo3(signature = (*, camera, profile, mount=None))]
pub(crate) fn trace_rays<'py>(
    py: Python<'py>,
    camera: &Bound<'py, Camera>,
    profile: &Bound<'py, Profile>,
    mount: Option<&Bound<'py, Mount>>,
) -> PyResult<RayArrays<'py>> {
    let mount = mount_or_perfect(mount);
    let (camera, profile) = (&camera.get().0, &profile.get().0);
    let (origins, directions) = py
        .detach(|| {
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
#[pyfunction]
#[pyo3(signature = (*, camera, profile, u_px, v_px, mount=None))]
pub(crate) fn trace_points<'py>(
    py: Python<'py>,
    camera: &Bound<'py, Camera>,
    profile: &Bound<'py, Profile>,
    u_px: PyReadonlyArray1<'py, f64>,
    v_px: PyReadonlyArray1<'py, f64>,
    mount: Option<&Bound<'py, Mount>>,
) -> PyResult<PointArrays<'py>> {
    let mount = mount_or_perfect(mount);
    let (u_px, v_px) = (u_px.as_array(), v_px.as_array());
    if u_px.len() != v_px.len() {
        let message = format!("u_px has {} points but v_px {}", u_px.len(), v_px.len());
        return Err(PyValueError::new_err(message));
    }
    let tracer = Tracer::new(&camera.get().0, &profile.get().0, &mount)
        .map_err(|error| errors::optics(&error))?;
    let (origins, directions) = py.detach(|| {
        let rays: Vec<_> = u_px
            .iter()
            .zip(v_px)
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

/// Pixel → ground point in the robot frame, as calibration and tracing make it.
#[pyclass(frozen, module = "mirrorball._core")]
pub(crate) struct GroundMap {
    /// Forward, metres: rows × columns, NaN where no ground is seen.
    #[pyo3(get)]
    x_m: Py<PyArray2<f32>>,
    /// To the left, metres: rows × columns, NaN where no ground is seen.
    #[pyo3(get)]
    y_m: Py<PyArray2<f32>>,
}

impl GroundMap {
    pub(crate) fn of(py: Python<'_>, map: vision::GroundMap) -> PyResult<Self> {
        let shape = [map.height_px, map.width_px];
        Ok(GroundMap {
            x_m: map.x.into_pyarray(py).reshape(shape)?.unbind(),
            y_m: map.y.into_pyarray(py).reshape(shape)?.unbind(),
        })
    }
}

impl GroundMap {
    /// The map as vision measures with it.
    pub(crate) fn to_rust(&self, py: Python<'_>) -> PyResult<vision::GroundMap> {
        let values = |array: &Py<PyArray2<f32>>| -> (Vec<f32>, (usize, usize)) {
            let array = array.bind(py).readonly();
            let view = array.as_array();
            (view.iter().copied().collect(), view.dim())
        };
        let (x, (height_px, width_px)) = values(&self.x_m);
        let (y, shape) = values(&self.y_m);
        if shape != (height_px, width_px) {
            return Err(PyValueError::new_err("x_m and y_m have different shapes"));
        }
        Ok(vision::GroundMap {
            width_px,
            height_px,
            x,
            y,
        })
    }
}

#[pymethods]
impl GroundMap {
    /// Reads `x_m` and `y_m` from an npz archive.
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let map = py
            .detach(|| vision::GroundMap::load(&path))
            .map_err(|error| errors::map(&error))?;
        GroundMap::of(py, map)
    }

    /// From two arrays of metres, rows × columns, NaN where no ground is seen.
    #[new]
    #[pyo3(signature = (*, x_m, y_m))]
    fn new(
        py: Python<'_>,
        x_m: PyReadonlyArray2<'_, f32>,
        y_m: PyReadonlyArray2<'_, f32>,
    ) -> PyResult<Self> {
        let shape = x_m.as_array().dim();
        if shape != y_m.as_array().dim() {
            let message = format!("x_m is {shape:?} but y_m {:?}", y_m.as_array().dim());
            return Err(PyValueError::new_err(message));
        }
        let values = |array: &PyReadonlyArray2<'_, f32>| array.as_array().iter().copied().collect();
        let map = vision::GroundMap {
            width_px: shape.1,
            height_px: shape.0,
            x: values(&x_m),
            y: values(&y_m),
        };
        GroundMap::of(py, map)
    }

    /// Writes the npz archive that `mirrorball locate --map` reads.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let map = self.to_rust(py)?;
        py.detach(|| map.save(&path))
            .map_err(|error| errors::map(&error))
    }
}

/// Where each pixel's ray meets the ground.
#[pyfunction]
#[pyo3(signature = (*, camera, profile, mount=None))]
pub(crate) fn ground_map<'py>(
    py: Python<'py>,
    camera: &Bound<'py, Camera>,
    profile: &Bound<'py, Profile>,
    mount: Option<&Bound<'py, Mount>>,
) -> PyResult<GroundMap> {
    let mount = mount_or_perfect(mount);
    let (camera, profile) = (&camera.get().0, &profile.get().0);
    let map = py
        .detach(|| {
            vision::optics::trace_rays(camera, profile, &mount).map(|table| table.ground_map())
        })
        .map_err(|error| errors::optics(&error))?;
    GroundMap::of(py, map)
}
