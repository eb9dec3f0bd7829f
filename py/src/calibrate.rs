//! The calibrations in Python: lists of OpenCV's arrays in, maps, masks and tables with their residuals out.

use std::path::PathBuf;

use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use vision::calibrate::strip::BarColour;
use vision::calibrate::{
    ImageResidual, NamedImage, Strip, StripImage, calibrate_lines as lines, calibrate_mask as mask,
    calibrate_sizes as sizes, calibrate_strip as strip, learn_colours as colours,
};
use vision::colour::colour_table::{ColourTable as Table, Label, TableKind};

use crate::camera::{Camera, camera_or_from_map};
use crate::detections::{ArrayImage, ColourTable, parse_vision_config};
use crate::errors;
use crate::ground_map::GroundMap;
use crate::scene::Field;

/// One image of a calibration: its number in the list, points, residual in pixels, and why it was left out, if it was.
type Residual = (usize, usize, f64, Option<String>);

fn residuals(images: Vec<ImageResidual>) -> Vec<Residual> {
    images
        .into_iter()
        .enumerate()
        .map(|(number, image)| (number, image.points, image.rms_px, image.left_out))
        .collect()
}

fn drive(images: &[Bound<'_, PyAny>]) -> PyResult<Vec<NamedImage>> {
    let image = |(number, array): (usize, &Bound<'_, PyAny>)| {
        Ok(NamedImage {
            name: format!("image {number}"),
            image: ArrayImage::from_argument(array)?.to_rgb_image(),
        })
    };
    images.iter().enumerate().map(image).collect()
}

/// The ground map from images beside a radial strip: map, residual (pixels), and each image's.
#[pyfunction]
#[pyo3(signature = (*, camera, images, directions_rad, first_edge_m, spacing_m, bars, width_m, first_bar="black"))]
#[expect(
    clippy::too_many_arguments,
    reason = "they are keywords where they are called"
)]
pub(crate) fn calibrate_strip(
    py: Python<'_>,
    camera: &Bound<'_, Camera>,
    images: Vec<Bound<'_, PyAny>>,
    directions_rad: Vec<f64>,
    first_edge_m: f64,
    spacing_m: f64,
    bars: usize,
    width_m: f64,
    first_bar: &str,
) -> PyResult<(GroundMap, f64, Vec<Residual>)> {
    let first_bar = match first_bar {
        "black" => BarColour::Black,
        "white" => BarColour::White,
        other => {
            let message = format!("first_bar is \"black\" or \"white\", not {other:?}");
            return Err(PyValueError::new_err(message));
        }
    };
    if images.len() != directions_rad.len() {
        return Err(PyValueError::new_err(format!(
            "{} images but {} directions",
            images.len(),
            directions_rad.len()
        )));
    }
    let target = Strip {
        first_edge: first_edge_m,
        spacing: spacing_m,
        bars,
        width: width_m,
        first_bar,
    };
    let images: Vec<StripImage> = drive(&images)?
        .into_iter()
        .zip(directions_rad)
        .map(|(image, direction)| StripImage {
            name: image.name,
            direction,
            image: image.image,
        })
        .collect();
    let camera = &camera.get().0;
    let found = py
        .detach(|| strip(camera, &target, &images))
        .map_err(|error| errors::calibration(&error))?;
    let map = GroundMap::of(py, found.map)?;
    Ok((map, found.rms_px, residuals(found.images)))
}

/// The ground map from images anywhere on a field: map, residual (metres), share of points on markings, each image's.
#[pyfunction]
#[pyo3(signature = (*, camera, start, field, images, settings_toml=None))]
pub(crate) fn calibrate_lines(
    py: Python<'_>,
    camera: &Bound<'_, Camera>,
    start: &Bound<'_, GroundMap>,
    field: &Bound<'_, Field>,
    images: Vec<Bound<'_, PyAny>>,
    settings_toml: Option<&str>,
) -> PyResult<(GroundMap, f64, f64, Vec<Residual>)> {
    let (start, images) = (start.get().to_rust(py)?, drive(&images)?);
    let config = parse_vision_config(settings_toml)?;
    let (camera, field) = (&camera.get().0, &field.get().0);
    let found = py
        .detach(|| lines(camera, &start, field, &images, &config))
        .map_err(|error| errors::calibration(&error))?;
    let map = GroundMap::of(py, found.map)?;
    Ok((map, found.rms, found.inlier_share, residuals(found.images)))
}

/// Where the robot does not see itself: rows × columns, from at least six images of it turning in place.
#[pyfunction]
#[pyo3(signature = (*, camera, images))]
pub(crate) fn calibrate_mask<'py>(
    py: Python<'py>,
    camera: &Bound<'py, Camera>,
    images: Vec<Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyArray2<bool>>> {
    let images: Vec<_> = drive(&images)?
        .into_iter()
        .map(|image| image.image)
        .collect();
    let camera = &camera.get().0;
    let found = py
        .detach(|| mask(camera, &images))
        .map_err(|error| errors::calibration(&error))?;
    found
        .into_pyarray(py)
        .reshape([camera.height_px, camera.width_px])
}

type SizeColumns<'py> = Vec<(&'static str, Bound<'py, PyArray1<f32>>)>;

/// Widths of lines and ball in pixels over distance, measured and by the map; NaN where too few were seen.
#[pyfunction]
#[pyo3(signature = (*, map, images, camera=None, line_width_m=0.125, settings_toml=None))]
pub(crate) fn calibrate_sizes<'py>(
    py: Python<'py>,
    map: &Bound<'py, GroundMap>,
    images: Vec<Bound<'py, PyAny>>,
    camera: Option<&Bound<'py, Camera>>,
    line_width_m: f32,
    settings_toml: Option<&str>,
) -> PyResult<SizeColumns<'py>> {
    let (map, images) = (map.get().to_rust(py)?, drive(&images)?);
    let camera = camera_or_from_map(camera, &map)?;
    let config = parse_vision_config(settings_toml)?;
    let found = py
        .detach(|| sizes(&camera, &map, line_width_m, &images, &config))
        .map_err(|error| errors::calibration(&error))?;
    let rows = &found.rows;
    let column = |value: &dyn Fn(&vision::calibrate::SizeBin) -> Option<f32>| {
        let values: Vec<f32> = rows
            .iter()
            .map(|row| value(row).unwrap_or(f32::NAN))
            .collect();
        values.into_pyarray(py)
    };
    Ok(vec![
        ("distance_m", column(&|row| Some(row.distance))),
        ("line_px", column(&|row| row.line_px)),
        ("line_px_by_map", column(&|row| row.line_px_by_map)),
        ("lines", column(&|row| Some(row.lines as f32))),
        ("ball_px", column(&|row| row.ball_px)),
        ("ball_px_by_map", column(&|row| row.ball_px_by_map)),
        ("balls", column(&|row| Some(row.balls as f32))),
    ])
}

/// A colour table from images without labels, and each image's residual; `over` is "yuv" or "uv".
#[pyfunction]
#[pyo3(signature = (*, map, images, camera=None, line_width_m=0.125, over="yuv", settings_toml=None))]
pub(crate) fn learn_colours(
    py: Python<'_>,
    map: &Bound<'_, GroundMap>,
    images: Vec<Bound<'_, PyAny>>,
    camera: Option<&Bound<'_, Camera>>,
    line_width_m: f32,
    over: &str,
    settings_toml: Option<&str>,
) -> PyResult<(ColourTable, Vec<Residual>)> {
    let (map, images, kind) = (map.get().to_rust(py)?, drive(&images)?, kind(over)?);
    let camera = camera_or_from_map(camera, &map)?;
    let config = parse_vision_config(settings_toml)?;
    let (table, images) = py
        .detach(|| {
            let mut vision = vision::Vision::new(&map, &camera, line_width_m, config.clone())
                .map_err(|error| errors::vision(&error))?;
            let learned =
                colours(&mut vision, &images).map_err(|error| errors::calibration(&error))?;
            Ok((learned.table(kind, &config), learned.images))
        })
        .map_err(|error: PyErr| error)?;
    Ok((ColourTable(table), residuals(images)))
}

/// A colour table from labels.csv (file,u,v,class).
#[pyfunction]
#[pyo3(signature = (path, *, over="yuv"))]
pub(crate) fn colours_from_labels(
    py: Python<'_>,
    path: PathBuf,
    over: &str,
) -> PyResult<ColourTable> {
    let kind = kind(over)?;
    let labels: Vec<Label> =
        vision::colour::colour_table::load_labels(&path).map_err(|error| errors::vision(&error))?;
    let table = py.detach(|| Table::learn(&labels, kind));
    table
        .map(ColourTable)
        .ok_or_else(|| PyValueError::new_err(format!("{}: has no label", path.display())))
}

fn kind(over: &str) -> PyResult<TableKind> {
    match over {
        "yuv" => Ok(TableKind::Yuv),
        "uv" => Ok(TableKind::Uv),
        other => Err(PyValueError::new_err(format!(
            "over is \"yuv\" or \"uv\", not {other:?}"
        ))),
    }
}
