//! Fields in Python, and images of a robot on them: the simulator's renderer in one call.

use std::ops::RangeInclusive;

use localize::field::{FieldConfig, FieldError};
use localize::frames::{At, Pose};
use localize::robot::BodyConfig;
use localize::toml_file::TomlFileError;
use localize::world::TeamColour;
use numpy::{IntoPyArray, PyArray3, PyArrayMethods};
use pyo3::exceptions::{PyFileNotFoundError, PyOSError, PyValueError};
use pyo3::prelude::*;
use sim::environment::EnvironmentConfig;
use sim::image_sensor::ImageSensorConfig;
use sim::light::LightConfig;
use sim::render::{Renderer, RendererConfig, Scene, SceneBall};
use sim::scenario::BallConfig;
use sim::world::RobotState;

use crate::arguments::{self, single};
use crate::camera::{Camera, Mount};
use crate::errors;
use crate::profile::Profile;
use crate::threads::detached;

/// The league's field of 18 × 12 m.
const LEAGUE_FIELD: &str = include_str!("../../config/fields/msl_18x12.toml");

/// Width of an image's blur, pixels, as a scenario may state it.
const BLUR_PX: RangeInclusive<f64> = 0.01..=20.0;

/// A soccer field with its markings.
#[pyclass(frozen, module = "mirrorball._core")]
pub(crate) struct Field(pub(crate) localize::field::Field);

fn field_error(error: &FieldError) -> PyErr {
    let message = error.to_string();
    match error {
        FieldError::File(file) if file.is_not_found() => PyFileNotFoundError::new_err(message),
        FieldError::File(TomlFileError::Read { .. }) => PyOSError::new_err(message),
        _ => PyValueError::new_err(message),
    }
}

impl Field {
    /// From an argument named `field`.
    pub(crate) fn from_argument<'a>(field: &'a Bound<'_, PyAny>) -> PyResult<&'a Self> {
        arguments::instance::<Field>("field", field).map(Bound::get)
    }

    fn parse(text: &str) -> PyResult<Self> {
        let config: FieldConfig = toml::from_str(text).map_err(|error| {
            PyValueError::new_err(format!("invalid text: {error} (expected a field.toml)"))
        })?;
        let field = localize::field::Field::new(config);
        field.map(Field).map_err(|error| field_error(&error))
    }
}

#[pymethods]
impl Field {
    /// Reads a field.toml; without a path, the league's field of 18 × 12 m.
    #[new]
    #[pyo3(signature = (path=None))]
    fn new(path: Option<&Bound<'_, PyAny>>) -> PyResult<Self> {
        let field = match path {
            Some(path) => localize::field::Field::load(&arguments::path("path", path)?),
            None => return Field::parse(LEAGUE_FIELD),
        };
        field.map(Field).map_err(|error| field_error(&error))
    }

    /// From the text of a field.toml.
    #[staticmethod]
    fn from_toml(text: &Bound<'_, PyAny>) -> PyResult<Self> {
        Field::parse(&arguments::text("text", text, "the text of a field.toml")?)
    }

    /// The text of its field.toml.
    fn to_toml(&self) -> PyResult<String> {
        toml::to_string(&self.0.config).map_err(|error| PyValueError::new_err(error.to_string()))
    }

    fn __eq__(&self, other: &Self) -> bool {
        self.0 == other.0
    }

    fn __repr__(&self) -> String {
        format!("Field({} × {} m)", self.0.length, self.0.width)
    }

    // For pickle and copy.
    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<(Bound<'py, PyAny>, (String,))> {
        let text = slf.get().to_toml()?;
        Ok((slf.get_type().getattr("from_toml")?, (text,)))
    }

    /// Between the centres of the goal lines, metres.
    #[getter]
    fn length_m(&self) -> f32 {
        self.0.length
    }

    /// Between the centres of the touch lines, metres.
    #[getter]
    fn width_m(&self) -> f32 {
        self.0.width
    }
}

/// A robot that is only its mirror: no hull, box or rods in the view.
fn bare() -> BodyConfig {
    BodyConfig {
        radius: 0.0,
        height: 0.0,
        camera_side: 0.0,
        rod_angles_deg: Vec::new(),
        ..BodyConfig::default()
    }
}

/// The image from a pose on a field: rows × columns × (red, green, blue), bytes.
///
/// `pose` is x, y (metres) and θ (radians); `ball` its x, y; `robots` poses of others. The same seed gives the same noise.
#[pyfunction]
#[pyo3(
    signature = (*, camera, profile, field, pose, mount=None, ball=None, robots=None, own_body=None, exposure=None, blur_px=None, seed=None),
    text_signature = "(*, camera, profile, field, pose, mount=None, ball=None, robots=(), own_body=True, exposure=1.0, blur_px=1.3, seed=1)"
)]
#[expect(
    clippy::too_many_arguments,
    reason = "they are keywords where they are called"
)]
pub(crate) fn render<'py>(
    py: Python<'py>,
    camera: &Bound<'py, PyAny>,
    profile: &Bound<'py, PyAny>,
    field: &Bound<'py, PyAny>,
    pose: &Bound<'py, PyAny>,
    mount: Option<&Bound<'py, PyAny>>,
    ball: Option<&Bound<'py, PyAny>>,
    robots: Option<&Bound<'py, PyAny>>,
    own_body: Option<&Bound<'py, PyAny>>,
    exposure: Option<&Bound<'py, PyAny>>,
    blur_px: Option<&Bound<'py, PyAny>>,
    seed: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyArray3<u8>>> {
    let camera = &Camera::from_argument(camera)?.0;
    let profile = &Profile::from_argument(profile)?.0;
    let field = &Field::from_argument(field)?.0;
    let pose = single(arguments::vector::<3>("pose", pose)?);
    let mount = Mount::from_argument(mount)?;
    let ball = ball.map(|ball| arguments::vector::<2>("ball", ball));
    let ball = ball.transpose()?.map(single);
    let own_body = own_body.map_or(Ok(true), |value| arguments::flag("own_body", value))?;
    let exposure = exposure.map_or(Ok(1.0), |value| arguments::positive("exposure", value))?;
    let blur_px = blur_px.map_or(Ok(1.3), |value| {
        arguments::number_within("blur_px", value, BLUR_PX)
    })?;
    let seed = seed.map_or(Ok(1), |value| arguments::whole("seed", value, 0..=u64::MAX))?;
    let robots = robots.map_or(Ok((3, Vec::new())), |value| {
        arguments::rows("robots", value, &[3])
    })?;
    let body = if own_body {
        BodyConfig::default()
    } else {
        bare()
    };
    let image_sensor = ImageSensorConfig {
        exposure: exposure as f32,
        blur_px: blur_px as f32,
        ..ImageSensorConfig::default()
    };
    let robots = robots.1.chunks_exact(3);
    let others: Vec<RobotState> = robots
        .map(|pose| RobotState {
            pose: Pose::new(pose[0], pose[1], pose[2]),
            velocity: [0.0; 2],
            yaw_rate: 0.0,
            team: TeamColour::Magenta,
        })
        .collect();
    let ball_kind = BallConfig::default();
    let mut rgb = Vec::new();
    detached(
        py,
        || -> Result<(), vision::optics::ray_tracing::OpticsError> {
            let mut renderer = Renderer::new(&RendererConfig {
                camera,
                profile,
                mount,
                body: &body,
                field,
                light: &LightConfig::default(),
                environment: &EnvironmentConfig {
                    cables: 0,
                    ..EnvironmentConfig::default()
                },
                image_sensor: &image_sensor,
                seed,
            })?;
            let scene = Scene {
                pose: Pose::new(pose[0], pose[1], pose[2]),
                robots: &others,
                ball: ball.map(|[x, y]| SceneBall {
                    at: At::new(x, y),
                    height: 0.0,
                    diameter: ball_kind.diameter,
                    colour: ball_kind.colour,
                }),
                ..Scene::default()
            };
            renderer.render(&scene, &image_sensor, &mut rgb);
            Ok(())
        },
    )
    .map_err(|error| errors::optics(&error))?;
    rgb.into_pyarray(py)
        .reshape([camera.height_px, camera.width_px, 3])
}
