//! The ground map in Python: two arrays of metres, read, written and converted.

use localize::math;
use numpy::{IntoPyArray, PyArray2, PyArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};

use crate::arguments::{self, Keywords};
use crate::errors;
use crate::threads::detached;

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

    /// The map of an argument.
    pub(crate) fn from_argument(
        name: &str,
        value: &Bound<'_, PyAny>,
    ) -> PyResult<vision::GroundMap> {
        let map: &Bound<'_, GroundMap> = arguments::instance(name, value)?;
        map.get().to_rust(value.py())
    }

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
    fn load(py: Python<'_>, path: &Bound<'_, PyAny>) -> PyResult<Self> {
        let path = arguments::path("path", path)?;
        let map =
            detached(py, || vision::GroundMap::load(&path)).map_err(|error| errors::map(&error))?;
        GroundMap::of(py, map)
    }

    /// From two arrays of metres, rows × columns, NaN where no ground is seen.
    #[new]
    #[pyo3(signature = (*, x_m, y_m))]
    fn new(py: Python<'_>, x_m: &Bound<'_, PyAny>, y_m: &Bound<'_, PyAny>) -> PyResult<Self> {
        let (height_px, width_px, x) = arguments::table("x_m", x_m)?;
        let (rows, columns, y) = arguments::table("y_m", y_m)?;
        if [rows, columns] != [height_px, width_px] {
            return Err(PyValueError::new_err(format!(
                "invalid y_m: shape {:?} (expected {:?}, as x_m)",
                [rows, columns],
                [height_px, width_px]
            )));
        }
        let map = vision::GroundMap {
            width_px,
            height_px,
            x,
            y,
        };
        GroundMap::of(py, map)
    }

    /// Writes the npz archive that `mirrorball locate --map` reads.
    fn save(&self, py: Python<'_>, path: &Bound<'_, PyAny>) -> PyResult<()> {
        let path = arguments::path("path", path)?;
        let map = self.to_rust(py)?;
        detached(py, || map.save(&path)).map_err(|error| errors::map(&error))
    }

    // NaN equals NaN: both see no ground.
    fn __eq__(&self, py: Python<'_>, other: &Self) -> PyResult<bool> {
        let (own, other) = (self.to_rust(py)?, other.to_rust(py)?);
        let same = |a: &[f32], b: &[f32]| {
            a.len() == b.len()
                && a.iter()
                    .zip(b)
                    .all(|(a, b)| a == b || (a.is_nan() && b.is_nan()))
        };
        Ok(own.width_px == other.width_px && same(&own.x, &other.x) && same(&own.y, &other.y))
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let map = self.to_rust(py)?;
        let distances = map.x.iter().zip(&map.y).map(|(x, y)| math::hypot(*x, *y));
        let farthest = distances.filter(|distance| distance.is_finite());
        Ok(format!(
            "GroundMap({} × {} pixels, ground to {:.1} m)",
            map.width_px,
            map.height_px,
            farthest.fold(0.0, f32::max)
        ))
    }

    // For pickle and copy.
    fn __getnewargs_ex__<'py>(&self, py: Python<'py>) -> PyResult<Keywords<'py>> {
        let keywords = PyDict::new(py);
        keywords.set_item("x_m", &self.x_m)?;
        keywords.set_item("y_m", &self.y_m)?;
        Ok((PyTuple::empty(py), keywords))
    }
}
