//! Vision in Python: OpenCV's arrays in, columns of numbers out; `mirrorball.vision` names them.

use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArrayMethods,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use vision::colour::colour_table::TableKind;
use vision::image::{Image, ImageView, PIXELS_MAX, PixelFormat, rgb_to_yuv};
use vision::lines::detection::RejectionReason;
use vision::objects::robots::ObstacleKind;
use vision::{Detections, VisionConfig, VisionError};

use crate::arguments;
use crate::camera::camera_or_from_map;
use crate::errors;
use crate::ground_map::GroundMap;
use crate::threads::detached;

/// An image as OpenCV reads it: rows × columns (grey) or rows × columns × 3 (blue, green, red), bytes.
///
/// Holds the caller's array: numpy refuses Rust's writers meanwhile, and other threads of Python must not write either. An array
/// of another order of its bytes (a slice, Fortran's order) is copied.
pub(crate) struct ImageArgument<'py> {
    width_px: usize,
    height_px: usize,
    format: PixelFormat,
    array: PyReadonlyArrayDyn<'py, u8>,
    /// The bytes row by row, where the array has them in another order.
    packed: Option<Vec<u8>>,
}

impl<'py> ImageArgument<'py> {
    /// `name`: the argument's, for messages. `size_px`: columns and rows of the camera; without one, 64 megapixels are the limit.
    ///
    /// The size is checked before anything is copied: a view of one pixel may claim any size.
    pub(crate) fn new(
        name: &str,
        image: &Bound<'py, PyAny>,
        size_px: Option<[usize; 2]>,
    ) -> PyResult<Self> {
        const EXPECTED: &str = "uint8, rows × columns × 3 (BGR) or rows × columns (grey)";
        let array = arguments::array::<u8>(name, image, EXPECTED)?;
        let (height_px, width_px, format) = match *array.shape() {
            [rows, columns] => (rows, columns, PixelFormat::Grey8),
            [rows, columns, 3] => (rows, columns, PixelFormat::Bgr8),
            _ => return Err(arguments::invalid(name, image, EXPECTED, None)),
        };
        if let Some([columns, rows]) = size_px
            && [width_px, height_px] != [columns, rows]
        {
            return Err(errors::vision(&VisionError::ImageSize {
                actual_width_px: width_px,
                actual_height_px: height_px,
                expected_width_px: columns,
                expected_height_px: rows,
            }));
        }
        if width_px.saturating_mul(height_px) > PIXELS_MAX {
            let expected = format!("{EXPECTED}, at most {PIXELS_MAX} pixels");
            return Err(arguments::invalid(name, image, &expected, None));
        }
        // `as_slice` alone also gives the bytes of Fortran's order, column by column.
        let packed = (!array.is_c_contiguous()).then(|| array.as_array().iter().copied().collect());
        Ok(ImageArgument {
            width_px,
            height_px,
            format,
            array,
            packed,
        })
    }

    fn bytes(&self) -> &[u8] {
        let packed = self.packed.as_deref();
        packed.unwrap_or_else(|| self.array.as_slice().unwrap_or_default())
    }

    pub(crate) fn view(&self) -> ImageView<'_> {
        ImageView::packed(self.width_px, self.height_px, self.format, self.bytes())
    }

    /// Red, green, blue.
    pub(crate) fn to_rgb_image(&self) -> Image {
        let rgb = match self.format {
            PixelFormat::Grey8 => self.bytes().iter().flat_map(|&level| [level; 3]).collect(),
            _ => {
                let pixels = self.bytes().chunks_exact(3);
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
pub(crate) fn parse_vision_config(settings: Option<&Bound<'_, PyAny>>) -> PyResult<VisionConfig> {
    let Some(settings) = settings else {
        return Ok(VisionConfig::default());
    };
    let text = arguments::text("settings", settings, "text of [vision] of an overlay file")?;
    toml::from_str(&text)
        .map_err(|error| PyValueError::new_err(format!("invalid settings: {error}")))
}

/// The width of the field's lines, metres.
pub(crate) fn line_width(line_width_m: &Bound<'_, PyAny>) -> PyResult<f32> {
    arguments::number_within("line_width_m", line_width_m, 0.001..=10.0).map(|width| width as f32)
}

/// Where an image counts: a mask of the map's size.
fn mask(mask: &Bound<'_, PyAny>, map: &vision::GroundMap) -> PyResult<Vec<bool>> {
    let shape = [map.height_px, map.width_px];
    let expected = format!("bool, rows × columns of the map: {shape:?}");
    let found = arguments::array::<bool>("mask", mask, &expected)?;
    if found.shape() != shape {
        return Err(arguments::invalid("mask", mask, &expected, None));
    }
    Ok(found.as_array().iter().copied().collect())
}

/// Vision of one camera: tables that are built once, and the colour model of the present light.
#[pyclass(module = "mirrorball._core")]
pub(crate) struct Vision {
    vision: vision::Vision,
    /// Columns and rows of the map.
    size_px: [usize; 2],
    /// Different pixels that the scan lines read.
    #[pyo3(get)]
    scan_pixels: usize,
    /// Their share of the image.
    #[pyo3(get)]
    scan_coverage: f32,
}

#[pymethods]
impl Vision {
    #[new]
    #[pyo3(signature = (*, map, line_width_m, camera=None, mask=None, settings=None))]
    fn new(
        py: Python<'_>,
        map: &Bound<'_, PyAny>,
        line_width_m: &Bound<'_, PyAny>,
        camera: Option<&Bound<'_, PyAny>>,
        mask: Option<&Bound<'_, PyAny>>,
        settings: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let map = GroundMap::from_argument("map", map)?;
        let camera = camera_or_from_map(camera, &map)?;
        let line_width = line_width(line_width_m)?;
        let config = parse_vision_config(settings)?;
        let mask = mask.map(|mask| self::mask(mask, &map)).transpose()?;
        let vision = detached(py, || {
            vision::Vision::with_mask(&map, &camera, mask.as_deref(), line_width, config)
        })
        .map_err(|error| errors::vision(&error))?;
        Ok(Vision {
            scan_pixels: vision.scan_pattern().pixel_count,
            scan_coverage: vision.scan_pattern().coverage,
            size_px: [map.width_px, map.height_px],
            vision,
        })
    }

    /// Takes colour classes from a learned table.
    fn set_colour_table(slf: &Bound<'_, Self>, colours: &Bound<'_, PyAny>) -> PyResult<()> {
        let colours: &Bound<'_, ColourTable> = arguments::instance("colours", colours)?;
        let mut this = arguments::exclusive(slf)?;
        this.vision.set_colour_table(colours.get().0.clone());
        Ok(())
    }

    /// Discards the colour model; the next image gives a new one.
    fn reset_colour_model(slf: &Bound<'_, Self>) -> PyResult<()> {
        arguments::exclusive(slf)?.vision.reset_colour_model();
        Ok(())
    }

    /// Detections in an image: columns of numbers or texts by name.
    fn process<'py>(
        slf: &Bound<'py, Self>,
        py: Python<'py>,
        image: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let mut this = arguments::exclusive(slf)?;
        let image = ImageArgument::new("image", image, Some(this.size_px))?;
        let (view, vision) = (image.view(), &mut this.vision);
        let detections =
            detached(py, || vision.process(&view)).map_err(|error| errors::vision(&error))?;
        detection_columns(py, &detections)
    }
}

fn rejection_reason_name(reason: RejectionReason) -> &'static str {
    match reason {
        RejectionReason::NoAdjacentCarpet => "no carpet beside",
        RejectionReason::TooNarrow => "too narrow",
        RejectionReason::TooWide => "too wide",
        RejectionReason::TooFaint => "too faint",
        RejectionReason::NotWhite => "not white",
        RejectionReason::BeyondCarpet => "beyond carpet",
    }
}

pub(crate) fn f32_column<'py, T>(
    py: Python<'py>,
    rows: &[T],
    value: impl Fn(&T) -> f32,
) -> Bound<'py, PyArray1<f32>> {
    rows.iter()
        .map(value)
        .collect::<Vec<f32>>()
        .into_pyarray(py)
}

#[expect(clippy::too_many_lines, reason = "a list of columns")]
pub(crate) fn detection_columns<'py>(
    py: Python<'py>,
    detections: &Detections,
) -> PyResult<Bound<'py, PyDict>> {
    let all = PyDict::new(py);
    let points = PyDict::new(py);
    let rows = &detections.line_points;
    points.set_item("x_m", f32_column(py, rows, |row| row.point.at.x))?;
    points.set_item("y_m", f32_column(py, rows, |row| row.point.at.y))?;
    points.set_item(
        "std_radial_m",
        f32_column(py, rows, |row| row.point.std_radial),
    )?;
    points.set_item(
        "std_tangential_m",
        f32_column(py, rows, |row| row.point.std_tangential),
    )?;
    points.set_item("u_px", f32_column(py, rows, |row| row.position_px[0]))?;
    points.set_item("v_px", f32_column(py, rows, |row| row.position_px[1]))?;
    points.set_item("width_m", f32_column(py, rows, |row| row.width))?;
    points.set_item("contrast", f32_column(py, rows, |row| row.contrast))?;
    all.set_item("points", points)?;
    let refused = PyDict::new(py);
    let rows = &detections.rejected_candidates;
    refused.set_item("u_px", f32_column(py, rows, |row| row.position_px[0]))?;
    refused.set_item("v_px", f32_column(py, rows, |row| row.position_px[1]))?;
    let reasons: Vec<&str> = rows
        .iter()
        .map(|row| rejection_reason_name(row.reason))
        .collect();
    refused.set_item("reason", reasons)?;
    all.set_item("refused", refused)?;
    let ball = PyDict::new(py);
    let balls: Vec<_> = detections
        .ball
        .into_iter()
        .chain(detections.other_balls.iter().copied())
        .collect();
    let rows = &balls;
    set_object_columns(&ball, py, rows, |row| {
        (
            [row.at.x, row.at.y],
            row.covariance,
            row.position_px,
            row.score,
        )
    })?;
    let on_ground: Vec<bool> = rows.iter().map(|row| row.on_ground).collect();
    ball.set_item("on_ground", on_ground.into_pyarray(py))?;
    ball.set_item("pixels", f32_column(py, rows, |row| row.pixels as f32))?;
    all.set_item("ball", ball)?;
    let robots = PyDict::new(py);
    let rows = &detections.robots;
    set_object_columns(&robots, py, rows, |row| {
        (
            [row.at.x, row.at.y],
            row.covariance,
            row.position_px,
            row.score,
        )
    })?;
    robots.set_item("edge_x_m", f32_column(py, rows, |row| row.edge.x))?;
    robots.set_item("edge_y_m", f32_column(py, rows, |row| row.edge.y))?;
    robots.set_item("width_m", f32_column(py, rows, |row| row.width))?;
    let markers: Vec<String> = rows
        .iter()
        .map(|row| {
            row.marker
                .map_or(String::new(), |marker| format!("{marker:?}").to_lowercase())
        })
        .collect();
    robots.set_item("marker", markers)?;
    let kinds: Vec<&str> = rows
        .iter()
        .map(|row| match row.kind {
            ObstacleKind::Robot => "robot",
            ObstacleKind::Person => "person",
        })
        .collect();
    robots.set_item("kind", kinds)?;
    all.set_item("robots", robots)?;
    let goals = PyDict::new(py);
    let rows = &detections.goals;
    set_object_columns(&goals, py, rows, |row| {
        (
            [row.at.x, row.at.y],
            row.covariance,
            row.position_px,
            row.score,
        )
    })?;
    goals.set_item("width_m", f32_column(py, rows, |row| row.width))?;
    let kinds: Vec<String> = rows
        .iter()
        .map(|row| format!("{:?}", row.kind).to_lowercase())
        .collect();
    goals.set_item("kind", kinds)?;
    all.set_item("goals", goals)?;
    all.set_item(
        "carpet_end_m",
        detections.carpet_end.clone().into_pyarray(py),
    )?;
    all.set_item("carpet_share", detections.carpet_share)?;
    let bumpers: Vec<bool> = detections
        .virtual_sensors
        .bumpers
        .iter()
        .map(|bumper| bumper.hit)
        .collect();
    all.set_item("bumpers", bumpers.into_pyarray(py))?;
    all.set_item("kick", detections.virtual_sensors.kick)?;
    all.set_item("lens_centred", detections.virtual_sensors.lens_centred)?;
    Ok(all)
}

type ObjectColumns = ([f32; 2], [f32; 3], [f32; 2], f32);

/// Position (m), covariance (m²), image position (px) and score, which all objects have.
fn set_object_columns<'py, T>(
    columns: &Bound<'py, PyDict>,
    py: Python<'py>,
    rows: &[T],
    of: impl Fn(&T) -> ObjectColumns,
) -> PyResult<()> {
    columns.set_item("x_m", f32_column(py, rows, |row| of(row).0[0]))?;
    columns.set_item("y_m", f32_column(py, rows, |row| of(row).0[1]))?;
    columns.set_item("cov_xx_m2", f32_column(py, rows, |row| of(row).1[0]))?;
    columns.set_item("cov_xy_m2", f32_column(py, rows, |row| of(row).1[1]))?;
    columns.set_item("cov_yy_m2", f32_column(py, rows, |row| of(row).1[2]))?;
    columns.set_item("u_px", f32_column(py, rows, |row| of(row).2[0]))?;
    columns.set_item("v_px", f32_column(py, rows, |row| of(row).2[1]))?;
    columns.set_item("score", f32_column(py, rows, |row| of(row).3))
}

/// A class for every colour.
#[pyclass(frozen, module = "mirrorball._core")]
pub(crate) struct ColourTable(pub(crate) vision::ColourTable);

#[pymethods]
impl ColourTable {
    /// Reads a table's file.
    #[staticmethod]
    fn load(path: &Bound<'_, PyAny>) -> PyResult<Self> {
        vision::ColourTable::load(&arguments::path("path", path)?)
            .map(ColourTable)
            .map_err(|error| errors::vision(&error))
    }

    /// Writes the file that robot.toml's `colours` names.
    fn save(&self, path: &Bound<'_, PyAny>) -> PyResult<()> {
        let path = arguments::path("path", path)?;
        self.0.save(&path).map_err(|error| errors::vision(&error))
    }

    /// From the content of a table's file.
    #[staticmethod]
    fn from_bytes(content: &Bound<'_, PyAny>) -> PyResult<Self> {
        let content = arguments::bytes("content", content)?;
        vision::ColourTable::from_bytes(content.as_bytes())
            .map(ColourTable)
            .map_err(|reason| PyValueError::new_err(format!("invalid content: {reason}")))
    }

    /// The content of its file.
    fn to_bytes<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        PyBytes::new(py, &self.0.to_bytes())
    }

    fn __eq__(&self, other: &Self) -> bool {
        self.0 == other.0
    }

    fn __repr__(&self) -> String {
        let over = match self.0.kind() {
            TableKind::Uv => "uv",
            TableKind::Yuv => "yuv",
        };
        format!("ColourTable({over}: {})", self.names().join(", "))
    }

    // For pickle and copy.
    fn __reduce__<'py>(
        slf: &Bound<'py, Self>,
    ) -> PyResult<(Bound<'py, PyAny>, (Bound<'py, PyBytes>,))> {
        let content = slf.get().to_bytes(slf.py());
        Ok((slf.get_type().getattr("from_bytes")?, (content,)))
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
        image: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArray2<u8>>> {
        let image = ImageArgument::new("image", image, None)?.to_rgb_image();
        let classes: Vec<u8> = detached(py, || {
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
