//! The calibrations in Python: lists of OpenCV's arrays in, maps, masks and tables with their residuals out.

use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use vision::calibrate::strip_target::BarColour;
use vision::calibrate::{
    ImageResidual, NamedImage, Strip, StripImage, calibrate_lines as lines, calibrate_mask as mask,
    calibrate_sizes as sizes, calibrate_strip as strip, learn_colours as colours,
};
use vision::colour::colour_table::{ColourTable as Table, Label, TableKind};

use crate::arguments;
use crate::camera::{Camera, camera_or_from_map};
use crate::detections::{ColourTable, ImageArgument, line_width, parse_vision_config};
use crate::errors;
use crate::ground_map::GroundMap;
use crate::scene::Field;
use crate::threads::detached;

/// One image of a calibration: its number in the list, points, residual in pixels, and why it was left out, if it was.
type Residual = (usize, usize, f64, Option<String>);

fn residuals(images: Vec<ImageResidual>) -> Vec<Residual> {
    images
        .into_iter()
        .enumerate()
        .map(|(number, image)| (number, image.points, image.rms_px, image.left_out))
        .collect()
}

/// The images of an argument named `images`.
fn drive(images: &Bound<'_, PyAny>) -> PyResult<Vec<NamedImage>> {
    let image = |(number, array): (usize, &Bound<'_, PyAny>)| {
        Ok(NamedImage {
            name: format!("image {number}"),
            image: ImageArgument::new(&format!("images[{number}]"), array, None)?.to_rgb_image(),
        })
    };
    let images = arguments::list("images", images, "a list of images")?;
    images.iter().enumerate().map(image).collect()
}

/// The ground map from images beside a radial strip: map, residual (pixels), and each image's.
#[pyfunction]
#[pyo3(signature = (*, camera, images, directions_rad, first_edge_m, spacing_m, bars, width_m, first_bar))]
#[expect(
    clippy::too_many_arguments,
    reason = "they are keywords where they are called"
)]
pub(crate) fn calibrate_strip(
    py: Python<'_>,
    camera: &Bound<'_, PyAny>,
    images: &Bound<'_, PyAny>,
    directions_rad: &Bound<'_, PyAny>,
    first_edge_m: &Bound<'_, PyAny>,
    spacing_m: &Bound<'_, PyAny>,
    bars: &Bound<'_, PyAny>,
    width_m: &Bound<'_, PyAny>,
    first_bar: &Bound<'_, PyAny>,
) -> PyResult<(GroundMap, f64, Vec<Residual>)> {
    let camera = &Camera::from_argument(camera)?.0;
    let directions_rad = arguments::finite_column("directions_rad", directions_rad)?;
    let colours = [("black", BarColour::Black), ("white", BarColour::White)];
    let target = Strip {
        first_edge: arguments::number("first_edge_m", first_edge_m)?,
        spacing: arguments::positive("spacing_m", spacing_m)?,
        bars: arguments::whole("bars", bars, 1..=10_000)? as usize,
        width: arguments::positive("width_m", width_m)?,
        first_bar: arguments::choice("first_bar", first_bar, colours)?,
    };
    let images = drive(images)?;
    if images.len() != directions_rad.len() {
        return Err(PyValueError::new_err(format!(
            "invalid directions_rad: {} numbers (expected {}, as images)",
            directions_rad.len(),
            images.len()
        )));
    }
    let images: Vec<StripImage> = images
        .into_iter()
        .zip(directions_rad)
        .map(|(image, direction)| StripImage {
            name: image.name,
            direction,
            image: image.image,
        })
        .collect();
    let found = detached(py, || strip(camera, &target, &images))
        .map_err(|error| errors::calibration(&error))?;
    let map = GroundMap::of(py, found.map)?;
    Ok((map, found.rms_px, residuals(found.images)))
}

/// The ground map from images anywhere on a field: map, residual (metres), share of points on markings, each image's.
#[pyfunction]
#[pyo3(signature = (*, camera, start, field, images, settings=None))]
pub(crate) fn calibrate_lines(
    py: Python<'_>,
    camera: &Bound<'_, PyAny>,
    start: &Bound<'_, PyAny>,
    field: &Bound<'_, PyAny>,
    images: &Bound<'_, PyAny>,
    settings: Option<&Bound<'_, PyAny>>,
) -> PyResult<(GroundMap, f64, f64, Vec<Residual>)> {
    let camera = &Camera::from_argument(camera)?.0;
    let field = &Field::from_argument(field)?.0;
    let start = GroundMap::from_argument("start", start)?;
    let config = parse_vision_config(settings)?;
    let images = drive(images)?;
    let found = detached(py, || {
        lines(camera, &start, field, &[], &images, &config, &|_| ())
    })
    .map_err(|error| errors::calibration(&error))?;
    let map = GroundMap::of(py, found.map)?;
    Ok((map, found.rms, found.inlier_share, residuals(found.images)))
}

/// Where the robot does not see itself: rows × columns, from at least six images of it turning in place.
#[pyfunction]
#[pyo3(signature = (*, camera, images))]
pub(crate) fn calibrate_mask<'py>(
    py: Python<'py>,
    camera: &Bound<'py, PyAny>,
    images: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyArray2<bool>>> {
    let camera = &Camera::from_argument(camera)?.0;
    let images = drive(images)?.into_iter();
    let images: Vec<_> = images.map(|image| image.image).collect();
    let found =
        detached(py, || mask(camera, &images)).map_err(|error| errors::calibration(&error))?;
    found
        .into_pyarray(py)
        .reshape([camera.height_px, camera.width_px])
}

type SizeColumns<'py> = Vec<(&'static str, Bound<'py, PyArray1<f32>>)>;

/// Widths of lines and ball in pixels over distance, measured and by the map; NaN where too few were seen.
#[pyfunction]
#[pyo3(signature = (*, map, images, line_width_m, camera=None, settings=None))]
pub(crate) fn calibrate_sizes<'py>(
    py: Python<'py>,
    map: &Bound<'py, PyAny>,
    images: &Bound<'py, PyAny>,
    line_width_m: &Bound<'py, PyAny>,
    camera: Option<&Bound<'py, PyAny>>,
    settings: Option<&Bound<'py, PyAny>>,
) -> PyResult<SizeColumns<'py>> {
    let map = GroundMap::from_argument("map", map)?;
    let camera = camera_or_from_map(camera, &map)?;
    let line_width = line_width(line_width_m)?;
    let config = parse_vision_config(settings)?;
    let images = drive(images)?;
    let found = detached(py, || sizes(&camera, &map, line_width, &images, &config))
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
#[pyo3(signature = (*, map, images, line_width_m, over, camera=None, settings=None))]
pub(crate) fn learn_colours(
    py: Python<'_>,
    map: &Bound<'_, PyAny>,
    images: &Bound<'_, PyAny>,
    line_width_m: &Bound<'_, PyAny>,
    over: &Bound<'_, PyAny>,
    camera: Option<&Bound<'_, PyAny>>,
    settings: Option<&Bound<'_, PyAny>>,
) -> PyResult<(ColourTable, Vec<Residual>)> {
    let map = GroundMap::from_argument("map", map)?;
    let camera = camera_or_from_map(camera, &map)?;
    let line_width = line_width(line_width_m)?;
    let kind = kind(over)?;
    let config = parse_vision_config(settings)?;
    let images = drive(images)?;
    let (table, images) = detached(py, || {
        let mut vision = vision::Vision::new(&map, &camera, line_width, config.clone())
            .map_err(|error| errors::vision(&error))?;
        let learned = colours(&mut vision, &images).map_err(|error| errors::calibration(&error))?;
        Ok((learned.table(kind, &config), learned.images))
    })
    .map_err(|error: PyErr| error)?;
    Ok((ColourTable(table), residuals(images)))
}

/// A colour table from labels.csv (file,u,v,class).
#[pyfunction]
#[pyo3(signature = (path, *, over))]
pub(crate) fn colours_from_labels(
    py: Python<'_>,
    path: &Bound<'_, PyAny>,
    over: &Bound<'_, PyAny>,
) -> PyResult<ColourTable> {
    let path = arguments::path("path", path)?;
    let kind = kind(over)?;
    let labels: Vec<Label> =
        vision::colour::colour_table::load_labels(&path).map_err(|error| errors::vision(&error))?;
    let table = detached(py, || Table::learn(&labels, kind));
    table
        .map(ColourTable)
        .ok_or_else(|| PyValueError::new_err(format!("{}: has no label", path.display())))
}

fn kind(over: &Bound<'_, PyAny>) -> PyResult<TableKind> {
    let kinds = [("yuv", TableKind::Yuv), ("uv", TableKind::Uv)];
    arguments::choice("over", over, kinds)
}
