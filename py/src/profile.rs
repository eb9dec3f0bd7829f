//! A mirror's profile in Python: samples in, heights and slopes out.

use numpy::{IntoPyArray, PyArray1};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};

use crate::arguments::{self, Keywords, finite_column};
use crate::errors;

/// A mirror of revolution: height above the ground over radius, smooth between its samples.
#[pyclass(frozen, module = "mirrorball._core")]
pub(crate) struct Profile(pub(crate) vision::Profile);

/// Two arrays of one length.
type Pair<'py> = (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>);

impl Profile {
    /// From an argument named `profile`.
    pub(crate) fn from_argument<'a>(profile: &'a Bound<'_, PyAny>) -> PyResult<&'a Self> {
        arguments::instance::<Profile>("profile", profile).map(Bound::get)
    }
}

#[pymethods]
impl Profile {
    #[new]
    #[pyo3(signature = (*, radius_m, height_m))]
    fn new(radius_m: &Bound<'_, PyAny>, height_m: &Bound<'_, PyAny>) -> PyResult<Self> {
        let radius = finite_column("radius_m", radius_m)?;
        let height = finite_column("height_m", height_m)?;
        if radius.len() != height.len() {
            return Err(PyValueError::new_err(format!(
                "invalid height_m: {} numbers (expected {}, as radius_m)",
                height.len(),
                radius.len()
            )));
        }
        vision::Profile::new(radius, height)
            .map(Profile)
            .map_err(|error| errors::profile(&error))
    }

    /// Reads a CSV file `radius_m,height_m`.
    #[staticmethod]
    fn load(path: &Bound<'_, PyAny>) -> PyResult<Self> {
        vision::Profile::load(&arguments::path("path", path)?)
            .map(Profile)
            .map_err(|error| errors::profile(&error))
    }

    /// Radii of the samples, metres.
    #[getter]
    fn radius_m<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        let radii: Vec<f64> = self.0.samples().map(|(radius, _)| radius).collect();
        radii.into_pyarray(py)
    }

    /// Heights of the samples above the ground, metres.
    #[getter]
    fn height_m<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        let heights: Vec<f64> = self.0.samples().map(|(_, height)| height).collect();
        heights.into_pyarray(py)
    }

    /// Height above the ground (metres) and slope at each radius (metres, at least 0). Beyond the samples the mirror goes on
    /// straight, for a ray that meets it just beyond its edge.
    fn height_and_slope<'py>(
        &self,
        py: Python<'py>,
        radius_m: &Bound<'py, PyAny>,
    ) -> PyResult<Pair<'py>> {
        let radii = finite_column("radius_m", radius_m)?;
        if let Some(radius) = radii.iter().find(|radius| **radius < 0.0) {
            let message = format!("invalid radius_m: {radius} (expected at least 0)");
            return Err(PyValueError::new_err(message));
        }
        let (heights, slopes): (Vec<f64>, Vec<f64>) = radii
            .into_iter()
            .map(|radius| self.0.height_and_slope(radius))
            .unzip();
        Ok((heights.into_pyarray(py), slopes.into_pyarray(py)))
    }

    fn __eq__(&self, other: &Self) -> bool {
        self.0 == other.0
    }

    fn __repr__(&self) -> String {
        let (inner, outer) = self.0.radii();
        format!(
            "Profile({} samples, radius_m {inner} to {outer})",
            self.0.samples().count()
        )
    }

    // For pickle and copy.
    fn __getnewargs_ex__<'py>(&self, py: Python<'py>) -> PyResult<Keywords<'py>> {
        let keywords = PyDict::new(py);
        keywords.set_item("radius_m", self.radius_m(py))?;
        keywords.set_item("height_m", self.height_m(py))?;
        Ok((PyTuple::empty(py), keywords))
    }
}
