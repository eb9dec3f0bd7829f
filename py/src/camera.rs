//! The camera and the mount of its mirror in Python: the keys of robot.toml with units in their names.

use std::ops::RangeInclusive;

use localize::robot::CameraConfig;
use localize::robot::{RobotConfig, RobotConfigError};
use localize::toml_file::TomlFileError;
use pyo3::exceptions::{PyFileNotFoundError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};

use crate::arguments::{self, Keywords, single};
use crate::ground_map::GroundMap;

/// The number that was written: 0.6, not the 0.600000024 that 32 bits make of it.
fn as_written(value: f32) -> f64 {
    value
        .to_string()
        .parse()
        .unwrap_or_else(|_| f64::from(value))
}

fn known(name: &str, value: Option<f32>) -> PyResult<f64> {
    value
        .map(as_written)
        .ok_or_else(|| PyValueError::new_err(format!("the camera has no {name}")))
}

/// A pinhole camera looking straight up into the mirror, as `[camera]` of robot.toml states it.
#[pyclass(frozen, module = "mirrorball._core")]
pub(crate) struct Camera(pub(crate) CameraConfig);

/// Sides of an image, as robot.toml may state them.
const SIDE_PX: RangeInclusive<u64> = 2..=8192;

impl Camera {
    /// From an argument named `camera`.
    pub(crate) fn from_argument<'a>(camera: &'a Bound<'_, PyAny>) -> PyResult<&'a Self> {
        arguments::instance::<Camera>("camera", camera).map(Bound::get)
    }
}

#[pymethods]
impl Camera {
    #[new]
    #[pyo3(
        signature = (*, width_px, height_px, focal_px=None, pinhole_height_m=None, centre_px=None, forward_deg=None, flipped=None, outer_radius_px=None),
        text_signature = "(*, width_px, height_px, focal_px=None, pinhole_height_m=None, centre_px=None, forward_deg=90.0, flipped=True, outer_radius_px=None)"
    )]
    #[expect(
        clippy::too_many_arguments,
        reason = "they are keywords where they are called"
    )]
    fn new(
        width_px: &Bound<'_, PyAny>,
        height_px: &Bound<'_, PyAny>,
        focal_px: Option<&Bound<'_, PyAny>>,
        pinhole_height_m: Option<&Bound<'_, PyAny>>,
        centre_px: Option<&Bound<'_, PyAny>>,
        forward_deg: Option<&Bound<'_, PyAny>>,
        flipped: Option<&Bound<'_, PyAny>>,
        outer_radius_px: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let side =
            |name: &str, value| arguments::whole(name, value, SIDE_PX).map(|side| side as usize);
        let length = |name: &str, value: Option<&Bound<'_, PyAny>>| {
            let length = value.map(|value| arguments::positive(name, value));
            length.transpose().map(|length| length.map(|v| v as f32))
        };
        let (width_px, height_px) = (side("width_px", width_px)?, side("height_px", height_px)?);
        let middle = |size: usize| (size as f32 - 1.0) / 2.0;
        Ok(Camera(CameraConfig {
            width_px,
            height_px,
            focal_px: length("focal_px", focal_px)?,
            centre_px: match centre_px {
                Some(centre) => single(arguments::vector("centre_px", centre)?),
                None => [middle(width_px), middle(height_px)],
            },
            height: length("pinhole_height_m", pinhole_height_m)?,
            forward_deg: forward_deg.map_or(Ok(90.0), |angle| {
                arguments::number("forward_deg", angle).map(|angle| angle as f32)
            })?,
            flipped: flipped.map_or(Ok(true), |value| arguments::flag("flipped", value))?,
            outer_radius_px: length("outer_radius_px", outer_radius_px)?,
        }))
    }

    /// The camera of a ground map: size, axis, forward direction and side as the map shows them.
    #[staticmethod]
    fn of_map(map: &Bound<'_, PyAny>) -> PyResult<Self> {
        camera_or_from_map(None, &GroundMap::from_argument("map", map)?).map(Camera)
    }

    /// `[camera]` of a robot.toml.
    #[staticmethod]
    fn load(path: &Bound<'_, PyAny>) -> PyResult<Self> {
        let path = arguments::path("path", path)?;
        let robot = RobotConfig::load(&path).map_err(|error| match &error {
            RobotConfigError::File(TomlFileError::Read { .. }) => {
                PyFileNotFoundError::new_err(error.to_string())
            }
            _ => PyValueError::new_err(error.to_string()),
        })?;
        let missing = || PyValueError::new_err(format!("{}: has no [camera]", path.display()));
        robot
            .camera
            .and_then(|camera| camera.camera())
            .map(Camera)
            .ok_or_else(missing)
    }

    /// Columns.
    #[getter]
    fn width_px(&self) -> usize {
        self.0.width_px
    }

    /// Rows.
    #[getter]
    fn height_px(&self) -> usize {
        self.0.height_px
    }

    /// Focal length, pixels. ValueError for the camera of a calibrated map, which has none.
    #[getter]
    fn focal_px(&self) -> PyResult<f64> {
        known("focal_px", self.0.focal_px)
    }

    /// Pinhole above the ground, metres. ValueError for the camera of a calibrated map, which has none.
    #[getter]
    fn pinhole_height_m(&self) -> PyResult<f64> {
        known("pinhole_height_m", self.0.height)
    }

    /// Where the mirror's axis meets the image (right, down), pixels.
    #[getter]
    fn centre_px(&self) -> (f32, f32) {
        (self.0.centre_px[0], self.0.centre_px[1])
    }

    /// Where the robot's x axis points in the image, degrees from right towards up.
    #[getter]
    fn forward_deg(&self) -> f32 {
        self.0.forward_deg
    }

    /// True if, with forward up, the robot's left is on the image's right.
    #[getter]
    fn flipped(&self) -> bool {
        self.0.flipped
    }

    /// The mirror's rim in the image, pixels from the centre.
    #[getter]
    fn outer_radius_px(&self) -> Option<f64> {
        self.0.outer_radius_px.map(as_written)
    }

    fn __eq__(&self, other: &Self) -> bool {
        self.0 == other.0
    }

    fn __repr__(&self) -> String {
        let camera = &self.0;
        let optional =
            |value: Option<f32>| value.map_or_else(|| "None".to_owned(), |value| value.to_string());
        format!(
            "Camera(width_px={}, height_px={}, focal_px={}, pinhole_height_m={}, centre_px=({}, {}), forward_deg={}, \
             flipped={}, outer_radius_px={})",
            camera.width_px,
            camera.height_px,
            optional(camera.focal_px),
            optional(camera.height),
            camera.centre_px[0],
            camera.centre_px[1],
            camera.forward_deg,
            if camera.flipped { "True" } else { "False" },
            optional(camera.outer_radius_px)
        )
    }

    // For pickle and copy.
    fn __getnewargs_ex__<'py>(&self, py: Python<'py>) -> PyResult<Keywords<'py>> {
        let keywords = PyDict::new(py);
        keywords.set_item("width_px", self.0.width_px)?;
        keywords.set_item("height_px", self.0.height_px)?;
        keywords.set_item("focal_px", self.0.focal_px)?;
        keywords.set_item("pinhole_height_m", self.0.height)?;
        keywords.set_item("centre_px", self.0.centre_px)?;
        keywords.set_item("forward_deg", self.0.forward_deg)?;
        keywords.set_item("flipped", self.0.flipped)?;
        keywords.set_item("outer_radius_px", self.0.outer_radius_px)?;
        Ok((PyTuple::empty(py), keywords))
    }
}

/// The camera as given, or as the map shows it.
pub(crate) fn camera_or_from_map(
    camera: Option<&Bound<'_, PyAny>>,
    map: &vision::GroundMap,
) -> PyResult<CameraConfig> {
    match camera {
        Some(camera) => Ok(Camera::from_argument(camera)?.0.clone()),
        None => vision::optics::camera_from_map::camera_from_map(map).ok_or_else(|| {
            PyValueError::new_err(
                "invalid map: too little ground is seen (expected a circle around the robot)",
            )
        }),
    }
}

/// How far camera and mirror sit off from where they should; without arguments, not at all.
///
/// Pairs are along the robot's x (forward) and y (left).
///
/// - `lean_deg`: tilt of the whole rig about the ground point below it, degrees. A positive x moves its top forward, and the
///   camera sees less far ahead. `Estimate.tilt_rad` has the opposite sign (docs/methods.md 3.1).
/// - `mirror_tilt_deg`: tilt of the mirror against the camera's axis about the mirror's apex, degrees. A positive x moves the
///   top of the mirror's axis forward.
/// - `mirror_offset_m`: offset of the mirror's axis from the camera's, metres.
/// - `mirror_raise_m`: height of the mirror above the one that its profile states, metres.
///
/// ValueError for numbers that are not finite.
#[pyclass(frozen, module = "mirrorball._core")]
pub(crate) struct Mount(pub(crate) vision::Mount);

impl Mount {
    /// From an argument named `mount`; without one, a perfect mount.
    pub(crate) fn from_argument(mount: Option<&Bound<'_, PyAny>>) -> PyResult<vision::Mount> {
        mount.map_or_else(
            || Ok(vision::Mount::default()),
            |mount| arguments::instance::<Mount>("mount", mount).map(|mount| mount.get().0),
        )
    }
}

#[pymethods]
impl Mount {
    #[new]
    #[pyo3(
        signature = (*, lean_deg=None, mirror_tilt_deg=None, mirror_offset_m=None, mirror_raise_m=None),
        text_signature = "(*, lean_deg=(0.0, 0.0), mirror_tilt_deg=(0.0, 0.0), mirror_offset_m=(0.0, 0.0), mirror_raise_m=0.0)"
    )]
    fn new(
        lean_deg: Option<&Bound<'_, PyAny>>,
        mirror_tilt_deg: Option<&Bound<'_, PyAny>>,
        mirror_offset_m: Option<&Bound<'_, PyAny>>,
        mirror_raise_m: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let pair = |name: &str, value: Option<&Bound<'_, PyAny>>, largest: f64| {
            value.map_or(Ok([0.0; 2]), |value| {
                arguments::vector_within(name, value, largest)
            })
        };
        let (tilt_max, offset_max) = (vision::Mount::TILT_MAX_DEG, vision::Mount::OFFSET_MAX);
        Ok(Mount(vision::Mount {
            lean_deg: pair("lean_deg", lean_deg, tilt_max)?,
            mirror_tilt_deg: pair("mirror_tilt_deg", mirror_tilt_deg, tilt_max)?,
            mirror_offset: pair("mirror_offset_m", mirror_offset_m, offset_max)?,
            mirror_raise: mirror_raise_m.map_or(Ok(0.0), |value| {
                arguments::number_within("mirror_raise_m", value, -offset_max..=offset_max)
            })?,
        }))
    }

    fn __eq__(&self, other: &Self) -> bool {
        self.0 == other.0
    }

    fn __repr__(&self) -> String {
        let pair = |values: [f64; 2]| format!("({}, {})", values[0], values[1]);
        format!(
            "Mount(lean_deg={}, mirror_tilt_deg={}, mirror_offset_m={}, mirror_raise_m={})",
            pair(self.0.lean_deg),
            pair(self.0.mirror_tilt_deg),
            pair(self.0.mirror_offset),
            self.0.mirror_raise
        )
    }

    // For pickle and copy.
    fn __getnewargs_ex__<'py>(&self, py: Python<'py>) -> PyResult<Keywords<'py>> {
        let keywords = PyDict::new(py);
        keywords.set_item("lean_deg", self.0.lean_deg)?;
        keywords.set_item("mirror_tilt_deg", self.0.mirror_tilt_deg)?;
        keywords.set_item("mirror_offset_m", self.0.mirror_offset)?;
        keywords.set_item("mirror_raise_m", self.0.mirror_raise)?;
        Ok((PyTuple::empty(py), keywords))
    }
}
