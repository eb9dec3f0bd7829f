//! Fields in Python, and images of a robot on them: the simulator's renderer in one call.

use std::path::PathBuf;

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

use crate::camera::{Camera, Mount};
use crate::errors;
use crate::profile::Profile;

/// The league's field of 18 × 12 m.
const LEAGUE_FIELD: &str = include_str!("../../config/fields/msl_18x12.toml");

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

#[pymethods]
impl Field {
    /// Reads a field.toml; without a path, the league's field of 18 × 12 m.
    #[new]
    #[pyo3(signature = (path=None))]
    fn new(path: Option<PathBuf>) -> PyResult<Self> {
        let field = match path {
            Some(path) => localize::field::Field::load(&path),
            None => return Field::from_toml(LEAGUE_FIELD),
        };
        field.map(Field).map_err(|error| field_error(&error))
    }

    /// From the text of a field.toml.
    #[staticmethod]
    fn from_toml(text: &str) -> PyResult<Self> {
        let config: FieldConfig =
            toml::from_str(text).map_err(|error| PyValueError::new_err(error.to_string()))?;
        let field = localize::field::Field::new(config);
        field.map(Field).map_err(|error| field_error(&error))
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
#[pyo3(signature = (*, camera, profile, field, pose, mount=None, ball=None, robots=Vec::new(), own_body=true, exposure=1.0, blur_px=1.3, seed=1))]
#[expect(
    clippy::too_many_arguments,
    reason = "they are keywords where they are called"
)]
pub(crate) fn render<'py>(
    py: Python<'py>,
    camera: &Bound<'py, Camera>,
    profile: &Bound<'py, Profile>,
    field: &Bound<'py, Field>,
    pose: [f32; 3],
    mount: Option<&Bound<'py, Mount>>,
    ball: Option<[f32; 2]>,
    robots: Vec<[f32; 3]>,
    own_body: bool,
    exposure: f32,
    blur_px: f32,
    seed: u64,
) -> PyResult<Bound<'py, PyArray3<u8>>> {
    let numbers = pose.iter().chain(ball.iter().flatten());
    if !numbers
        .chain(robots.iter().flatten())
        .all(|v| v.is_finite())
    {
        return Err(PyValueError::new_err("poses must be finite numbers"));
    }
    if !(exposure > 0.0 && blur_px > 0.0) {
        return Err(PyValueError::new_err(
            "exposure and blur_px must be positive",
        ));
    }
    let mount = mount.map_or_else(vision::Mount::default, |mount| mount.get().0);
    let (camera, profile, field) = (&camera.get().0, &profile.get().0, &field.get().0);
    let body = if own_body {
        BodyConfig::default()
    } else {
        bare()
    };
    let image_sensor = ImageSensorConfig {
        exposure,
        blur_px,
        ..ImageSensorConfig::default()
    };
    let others: Vec<RobotState> = robots
        .iter()
        .map(|&[x, y, theta]| RobotState {
            pose: Pose::new(x, y, theta),
            velocity: [0.0; 2],
            yaw_rate: 0.0,
            team: TeamColour::Magenta,
        })
        .collect();
    let ball_kind = BallConfig::default();
    let mut rgb = Vec::new();
    py.detach(|| -> Result<(), vision::optics::ray_tracing::OpticsError> {
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
                diameter: ball_kind.diameter,
                colour: ball_kind.colour,
            }),
            ..Scene::default()
        };
        renderer.render(&scene, &image_sensor, &mut rgb);
        Ok(())
    })
    .map_err(|error| errors::optics(&error))?;
    rgb.into_pyarray(py)
        .reshape([camera.height_px, camera.width_px, 3])
}
