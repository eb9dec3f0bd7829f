//! What does an image show, in Python? OpenCV's arrays in, columns of numbers out; `mirrorball.vision` names them.

use std::path::PathBuf;

use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2, PyReadonlyArrayDyn,
    PyUntypedArrayMethods,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use vision::image::{Image, ImageView, PixelFormat, rgb_to_yuv};
use vision::lines::detection::RejectionReason;
use vision::{Detections, VisionConfig};

use crate::camera::Camera;
use crate::errors;
use crate::rays::GroundMap;

/// An image as OpenCV reads it: rows × columns (grey) or rows × columns × 3 (blue, green, red), bytes.
pub(crate) struct Pixels {
    width_px: usize,
    height_px: usize,
    format: PixelFormat,
    bytes: Vec<u8>,
}

impl Pixels {
    pub(crate) fn of(array: &PyReadonlyArrayDyn<'_, u8>) -> PyResult<Self> {
        let (height_px, width_px, format) = match *array.shape() {
            [rows, columns] => (rows, columns, PixelFormat::Grey8),
            [rows, columns, 3] => (rows, columns, PixelFormat::Bgr8),
            ref other => {
                return Err(PyValueError::new_err(format!(
                    "an image is rows × columns (grey) or rows × columns × 3 (BGR), not {other:?}"
                )));
            }
        };
        Ok(Pixels {
            width_px,
            height_px,
            format,
            // Slices of larger arrays are not packed; iteration packs them.
            bytes: array.as_array().iter().copied().collect(),
        })
    }

    fn frame(&self) -> ImageView<'_> {
        ImageView::packed(self.width_px, self.height_px, self.format, &self.bytes)
    }

    /// Red, green, blue.
    pub(crate) fn image(&self) -> Image {
        let rgb = match self.format {
            PixelFormat::Grey8 => self.bytes.iter().flat_map(|&level| [level; 3]).collect(),
            _ => {
                let pixels = self.bytes.chunks_exact(3);
                pixels.flat_map(|bgr| [bgr[2], bgr[1], bgr[0]]).collect()
            }
        };
        Image {
            width_px: self.width_px,
            height_px: self.height_px,
            rgb,
        }
    }
}

/// The settings of `[vision]`, as an overlay file has them under that name.
pub(crate) fn settings(toml: Option<&str>) -> PyResult<VisionConfig> {
    toml.map_or_else(
        || Ok(VisionConfig::default()),
        |text| toml::from_str(text).map_err(|error| PyValueError::new_err(error.to_string())),
    )
}

/// The camera as given, or as the map shows it.
pub(crate) fn camera_or_of_map(
    camera: Option<&Bound<'_, Camera>>,
    map: &vision::GroundMap,
) -> PyResult<localize::robot::CameraConfig> {
    match camera {
        Some(camera) => Ok(camera.get().0.clone()),
        None => vision::optics::camera_from_map::camera_from_map(map)
            .ok_or_else(|| PyValueError::new_err("the map shows too little ground")),
    }
}

/// The eyes of one camera: tables built once, and the colours of the light it is in.
#[pyclass(module = "mirrorball._core")]
pub(crate) struct Eyes {
    eyes: vision::Vision,
    /// Different pixels that the scan lines read.
    #[pyo3(get)]
    scan_pixels: usize,
    /// Their share of the image.
    #[pyo3(get)]
    scan_coverage: f32,
}

#[pymethods]
impl Eyes {
    #[new]
    #[pyo3(signature = (*, map, camera=None, mask=None, line_width_m=0.125, settings_toml=None))]
    fn new(
        py: Python<'_>,
        map: &Bound<'_, GroundMap>,
        camera: Option<&Bound<'_, Camera>>,
        mask: Option<PyReadonlyArray2<'_, bool>>,
        line_width_m: f32,
        settings_toml: Option<&str>,
    ) -> PyResult<Self> {
        let map = map.get().to_rust(py)?;
        let camera = camera_or_of_map(camera, &map)?;
        let config = settings(settings_toml)?;
        let mask: Option<Vec<bool>> = mask.map(|mask| mask.as_array().iter().copied().collect());
        let eyes = py
            .detach(|| {
                vision::Vision::with_mask(&map, &camera, mask.as_deref(), line_width_m, config)
            })
            .map_err(|error| errors::vision(&error))?;
        Ok(Eyes {
            scan_pixels: eyes.scan_pattern().pixel_count,
            scan_coverage: eyes.scan_pattern().coverage,
            eyes,
        })
    }

    /// Takes classes from a learned table.
    fn set_colours(&mut self, table: &Bound<'_, ColourTable>) {
        self.eyes.set_colour_table(table.get().0.clone());
    }

    /// Forgets the light, so that the next image is learned from.
    fn forget_light(&mut self) {
        self.eyes.reset_colour_model();
    }

    /// Everything that an image shows: a column of numbers or words by name.
    fn see<'py>(
        &mut self,
        py: Python<'py>,
        image: PyReadonlyArrayDyn<'py, u8>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let pixels = Pixels::of(&image)?;
        let seen = py
            .detach(|| self.eyes.process(&pixels.frame()))
            .map_err(|error| errors::vision(&error))?;
        columns(py, &seen)
    }
}

fn refusal(reason: RejectionReason) -> &'static str {
    match reason {
        RejectionReason::NoAdjacentCarpet => "no carpet beside",
        RejectionReason::TooNarrow => "too narrow",
        RejectionReason::TooWide => "too wide",
        RejectionReason::TooFaint => "too faint",
        RejectionReason::NotWhite => "not white",
        RejectionReason::BeyondCarpet => "beyond carpet",
    }
}

fn column<'py, T>(
    py: Python<'py>,
    rows: &[T],
    value: impl Fn(&T) -> f32,
) -> Bound<'py, PyArray1<f32>> {
    rows.iter()
        .map(value)
        .collect::<Vec<f32>>()
        .into_pyarray(py)
}

fn columns<'py>(py: Python<'py>, seen: &Detections) -> PyResult<Bound<'py, PyDict>> {
    let all = PyDict::new(py);
    let points = PyDict::new(py);
    let rows = &seen.line_points;
    points.set_item("x_m", column(py, rows, |row| row.point.at.x))?;
    points.set_item("y_m", column(py, rows, |row| row.point.at.y))?;
    points.set_item("std_radial_m", column(py, rows, |row| row.point.std_radial))?;
    points.set_item(
        "std_tangential_m",
        column(py, rows, |row| row.point.std_tangential),
    )?;
    points.set_item("u_px", column(py, rows, |row| row.position_px[0]))?;
    points.set_item("v_px", column(py, rows, |row| row.position_px[1]))?;
    points.set_item("width_m", column(py, rows, |row| row.width))?;
    points.set_item("contrast", column(py, rows, |row| row.contrast))?;
    all.set_item("points", points)?;
    let refused = PyDict::new(py);
    let rows = &seen.rejected_candidates;
    refused.set_item("u_px", column(py, rows, |row| row.position_px[0]))?;
    refused.set_item("v_px", column(py, rows, |row| row.position_px[1]))?;
    let reasons: Vec<&str> = rows.iter().map(|row| refusal(row.reason)).collect();
    refused.set_item("reason", reasons)?;
    all.set_item("refused", refused)?;
    let ball = PyDict::new(py);
    let rows = seen.ball.as_slice();
    place(&ball, py, rows, |row| {
        (
            [row.at.x, row.at.y],
            row.covariance,
            row.position_px,
            row.score,
        )
    })?;
    let on_ground: Vec<bool> = rows.iter().map(|row| row.on_ground).collect();
    ball.set_item("on_ground", on_ground.into_pyarray(py))?;
    ball.set_item("pixels", column(py, rows, |row| row.pixels as f32))?;
    all.set_item("ball", ball)?;
    let robots = PyDict::new(py);
    let rows = &seen.robots;
    place(&robots, py, rows, |row| {
        (
            [row.at.x, row.at.y],
            row.covariance,
            row.position_px,
            row.score,
        )
    })?;
    robots.set_item("edge_x_m", column(py, rows, |row| row.edge.x))?;
    robots.set_item("edge_y_m", column(py, rows, |row| row.edge.y))?;
    robots.set_item("width_m", column(py, rows, |row| row.width))?;
    let markers: Vec<String> = rows
        .iter()
        .map(|row| {
            row.marker
                .map_or(String::new(), |marker| format!("{marker:?}").to_lowercase())
        })
        .collect();
    robots.set_item("marker", markers)?;
    all.set_item("robots", robots)?;
    let goals = PyDict::new(py);
    let rows = &seen.goals;
    place(&goals, py, rows, |row| {
        (
            [row.at.x, row.at.y],
            row.covariance,
            row.position_px,
            row.score,
        )
    })?;
    goals.set_item("width_m", column(py, rows, |row| row.width))?;
    let kinds: Vec<String> = rows
        .iter()
        .map(|row| format!("{:?}", row.kind).to_lowercase())
        .collect();
    goals.set_item("kind", kinds)?;
    all.set_item("goals", goals)?;
    all.set_item("carpet_end_m", seen.carpet_end.clone().into_pyarray(py))?;
    all.set_item("carpet_share", seen.carpet_share)?;
    let bumpers: Vec<bool> = seen
        .virtual_sensors
        .bumpers
        .iter()
        .map(|bumper| bumper.hit)
        .collect();
    all.set_item("bumpers", bumpers.into_pyarray(py))?;
    all.set_item("kick", seen.virtual_sensors.kick)?;
    all.set_item("lens_centred", seen.virtual_sensors.lens_centred)?;
    Ok(all)
}

type Place = ([f32; 2], [f32; 3], [f32; 2], f32);

/// What all objects have: place, covariance, place in the image, score.
fn place<'py, T>(
    columns: &Bound<'py, PyDict>,
    py: Python<'py>,
    rows: &[T],
    of: impl Fn(&T) -> Place,
) -> PyResult<()> {
    columns.set_item("x_m", column(py, rows, |row| of(row).0[0]))?;
    columns.set_item("y_m", column(py, rows, |row| of(row).0[1]))?;
    columns.set_item("cov_xx_m2", column(py, rows, |row| of(row).1[0]))?;
    columns.set_item("cov_xy_m2", column(py, rows, |row| of(row).1[1]))?;
    columns.set_item("cov_yy_m2", column(py, rows, |row| of(row).1[2]))?;
    columns.set_item("u_px", column(py, rows, |row| of(row).2[0]))?;
    columns.set_item("v_px", column(py, rows, |row| of(row).2[1]))?;
    columns.set_item("score", column(py, rows, |row| of(row).3))
}

/// A class for every colour.
#[pyclass(frozen, module = "mirrorball._core")]
pub(crate) struct ColourTable(pub(crate) vision::ColourTable);

#[pymethods]
impl ColourTable {
    /// Reads a table's file.
    #[staticmethod]
    fn load(path: PathBuf) -> PyResult<Self> {
        vision::ColourTable::load(&path)
            .map(ColourTable)
            .map_err(|error| errors::vision(&error))
    }

    /// Writes the file that robot.toml's `colours` names.
    fn save(&self, path: PathBuf) -> PyResult<()> {
        self.0.save(&path).map_err(|error| errors::vision(&error))
    }

    /// Names of the classes, by class.
    #[getter]
    fn names(&self) -> Vec<String> {
        (0..=u8::MAX)
            .map_while(|class| {
                self.0
                    .name(vision::colour::lookup_table::ColourClass(class))
            })
            .map(str::to_owned)
            .collect()
    }

    /// The class of every pixel: rows × columns.
    fn classify<'py>(
        &self,
        py: Python<'py>,
        image: PyReadonlyArrayDyn<'py, u8>,
    ) -> PyResult<Bound<'py, PyArray2<u8>>> {
        let image = Pixels::of(&image)?.image();
        let classes: Vec<u8> = py.detach(|| {
            let pixels = image.rgb.chunks_exact(3);
            pixels
                .map(|rgb| self.0.class(rgb_to_yuv([rgb[0], rgb[1], rgb[2]])).0)
                .collect()
        });
        classes
            .into_pyarray(py)
            .reshape([image.height_px, image.width_px])
    }
}
