//! A running scenario in Python: its samples one by one, its wheels under the caller's control.

use localize::Pose;
use localize::frames::At;
use localize::omni::Twist;
use numpy::{IntoPyArray, PyArray3, PyArrayMethods};
use pipeline::sample::{GroundTruth, ImageContent, Sample, SourceImage};
use pyo3::IntoPyObjectExt;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use sim::world::BallState;

use crate::arguments::{self, single, vector_within};
use crate::cycle::Cycle;
use crate::errors;
use crate::robot_pipeline::Pipeline;
use crate::settings::overrides;
use crate::simulation::{duration, seed as seed_or_none};
use crate::threads::detached;

/// Places farther from the field's centre are mistakes, metres and radians.
const FARTHEST: f64 = 1000.0;
/// Faster motions are mistakes, m/s and rad/s.
const FASTEST: f64 = 1000.0;
/// Stronger pushes are mistakes, N s.
const STRONGEST: f64 = 10_000.0;

/// A running scenario.
#[pyclass(module = "mirrorball._core")]
pub(crate) struct Simulation(pipeline::simulation::Simulation);

#[pymethods]
impl Simulation {
    #[new]
    #[pyo3(signature = (scenario, *, images, seed=None, duration_s=None, change=None))]
    fn new(
        py: Python<'_>,
        scenario: &Bound<'_, PyAny>,
        images: &Bound<'_, PyAny>,
        seed: Option<&Bound<'_, PyAny>>,
        duration_s: Option<&Bound<'_, PyAny>>,
        change: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let scenario = arguments::path("scenario", scenario)?;
        let images = arguments::flag("images", images)?;
        let (seed, duration_s) = (seed_or_none(seed)?, duration(duration_s)?);
        let changes = overrides("change", change)?;
        let loaded = detached(py, || {
            pipeline::simulation::Simulation::with_overrides(&scenario, &changes, seed, duration_s)
        });
        let simulation = loaded.map_err(|error| errors::from_anyhow(&error))?;
        Ok(Simulation(if images {
            simulation
        } else {
            simulation.without_images()
        }))
    }

    /// Length of the run, seconds.
    #[getter]
    fn duration_s(slf: &Bound<'_, Self>) -> PyResult<f64> {
        Ok(arguments::exclusive(slf)?.0.duration())
    }

    /// Seconds since the start.
    #[getter]
    fn time_s(slf: &Bound<'_, Self>) -> PyResult<f64> {
        Ok(arguments::exclusive(slf)?.0.sim().time())
    }

    /// Name and numbers of the next sample: ("odometry", stamp_s, …). Also beyond the end of the run.
    fn next_sample<'py>(slf: &Bound<'py, Self>, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let mut this = arguments::exclusive(slf)?;
        let simulation = &mut this.0;
        let sample = detached(py, || simulation.next_sample());
        sample_tuple(py, sample)
    }

    /// Drives with this velocity: forward, left (m/s), turn (rad/s). None: along the scenario's path.
    fn command(slf: &Bound<'_, Self>, velocity: Option<&Bound<'_, PyAny>>) -> PyResult<()> {
        let velocity = velocity.map(|velocity| vector_within("velocity", velocity, FASTEST));
        let velocity = velocity.transpose()?.map(single);
        let twist = velocity.map(|[x, y, theta]| Twist { x, y, theta });
        arguments::exclusive(slf)?.0.sim_mut().set_command(twist);
        Ok(())
    }

    /// Moves the robot to a pose, at rest.
    fn kidnap(slf: &Bound<'_, Self>, pose: &Bound<'_, PyAny>) -> PyResult<()> {
        let [x, y, theta] = single(vector_within("pose", pose, FARTHEST)?);
        arguments::exclusive(slf)?
            .0
            .sim_mut()
            .kidnap(Pose::new(x, y, theta));
        Ok(())
    }

    /// Pushes the robot: an impulse on the field, N s.
    fn push(slf: &Bound<'_, Self>, impulse: &Bound<'_, PyAny>) -> PyResult<()> {
        let impulse = single(vector_within("impulse", impulse, STRONGEST)?);
        arguments::exclusive(slf)?
            .0
            .sim_mut()
            .apply_impulse(impulse);
        Ok(())
    }

    /// Places the ball on the field (metres) with a velocity (m/s), its lowest point at a height.
    fn place_ball(
        slf: &Bound<'_, Self>,
        position: &Bound<'_, PyAny>,
        velocity: &Bound<'_, PyAny>,
        height: &Bound<'_, PyAny>,
        vertical_velocity: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        let height = arguments::number_within("height", height, 0.0..=100.0)? as f32;
        let speed =
            arguments::number_within("vertical_velocity", vertical_velocity, -100.0..=100.0)?;
        let [x, y] = single(vector_within("position", position, FARTHEST)?);
        let velocity = single(vector_within("velocity", velocity, FASTEST)?);
        arguments::exclusive(slf)?
            .0
            .sim_mut()
            .set_ball_state(&BallState {
                at: At::new(x, y),
                velocity,
                height,
                vertical_velocity: speed as f32,
            });
        Ok(())
    }

    /// Moves another robot to a pose, at rest; `index` as in the truth.
    fn place_robot(
        slf: &Bound<'_, Self>,
        index: &Bound<'_, PyAny>,
        pose: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        let [x, y, theta] = single(vector_within("pose", pose, FARTHEST)?);
        let count = arguments::exclusive(slf)?.0.sim().truth().others.len() as u64;
        if count == 0 {
            let message = "invalid index: the scenario has no other robot";
            return Err(PyValueError::new_err(message));
        }
        let index = arguments::whole("index", index, 0..=count - 1)? as usize;
        arguments::exclusive(slf)?
            .0
            .sim_mut()
            .place_other(index, Pose::new(x, y, theta));
        Ok(())
    }

    /// Light on the field in place of the scenario's, 1 = normal. None: the scenario's again.
    fn set_light(slf: &Bound<'_, Self>, level: Option<&Bound<'_, PyAny>>) -> PyResult<()> {
        let level = level.map(|level| arguments::number_within("level", level, 0.0..=100.0));
        let level = level.transpose()?.map(|level| level as f32);
        arguments::exclusive(slf)?
            .0
            .sim_mut()
            .set_light_level(level);
        Ok(())
    }

    /// Exposure and gain of the camera from the next image on.
    fn set_camera(
        slf: &Bound<'_, Self>,
        exposure: &Bound<'_, PyAny>,
        gain: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        let exposure = arguments::positive("exposure", exposure)?;
        let gain = arguments::positive("gain", gain)?;
        arguments::exclusive(slf)?
            .0
            .set_camera(exposure as f32, gain as f32);
        Ok(())
    }

    /// Sets the camera as the exposure control of a cycle's pipeline asks, with the delay of a real camera.
    fn apply_camera_command(slf: &Bound<'_, Self>, cycle: &Bound<'_, PyAny>) -> PyResult<()> {
        let cycle: &Bound<'_, Cycle> = arguments::instance("cycle", cycle)?;
        if let Some(command) = cycle.get().0.camera_command() {
            arguments::exclusive(slf)?.0.command_camera(command);
        }
        Ok(())
    }

    /// The pipeline of the simulated robot.
    #[pyo3(signature = (*, preset, config=None))]
    fn pipeline(
        slf: &Bound<'_, Self>,
        py: Python<'_>,
        preset: &Bound<'_, PyAny>,
        config: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Pipeline> {
        let mut this = arguments::exclusive(slf)?;
        let simulation = &mut this.0;
        let setup =
            detached(py, || simulation.setup()).map_err(|error| errors::from_anyhow(&error))?;
        Pipeline::from_setup(py, &setup, preset, config)
    }
}

fn sample_tuple<'py>(py: Python<'py>, sample: Sample) -> PyResult<Bound<'py, PyAny>> {
    match sample {
        Sample::Odometry(odometry) => (
            "odometry",
            odometry.stamp.seconds(),
            (odometry.dx, odometry.dy, odometry.dtheta),
        )
            .into_bound_py_any(py),
        Sample::Imu(imu) => (
            "imu",
            imu.stamp.seconds(),
            imu.specific_force,
            imu.angular_velocity,
        )
            .into_bound_py_any(py),
        Sample::Compass(compass) => (
            "compass",
            compass.stamp.seconds(),
            compass.heading,
            compass.magnetic_field,
        )
            .into_bound_py_any(py),
        Sample::Command(command) => (
            "command",
            command.stamp.seconds(),
            (command.twist.x, command.twist.y, command.twist.theta),
        )
            .into_bound_py_any(py),
        Sample::GroundTruth(truth) => truth_tuple(py, &truth),
        Sample::Image(image) => {
            let ImageContent::Pixels(pixels) = image.content else {
                return Err(PyValueError::new_err("an image without pixels"));
            };
            let stamp_s = image.stamp.seconds();
            ("image", stamp_s, bgr_array(py, &pixels)?).into_bound_py_any(py)
        }
        Sample::TeamReport(_) | Sample::Settings(_) | Sample::SetupDoubt(_) | Sample::MapFit(_) => {
            Err(PyValueError::new_err("not a sample of a simulated sensor"))
        }
    }
}

fn truth_tuple<'py>(py: Python<'py>, truth: &GroundTruth) -> PyResult<Bound<'py, PyAny>> {
    let robots: Vec<[f32; 3]> = truth
        .robots
        .iter()
        .zip(&truth.robot_headings)
        .map(|(at, heading)| [at.x, at.y, *heading])
        .collect();
    let people: Vec<[f32; 2]> = truth.people.iter().map(|at| [at.x, at.y]).collect();
    let pose = truth.pose;
    (
        "truth",
        truth.stamp.seconds(),
        (pose.x, pose.y, pose.theta),
        truth.ball.map(|ball| (ball.x, ball.y)),
        robots,
        people,
    )
        .into_bound_py_any(py)
}

/// The image as OpenCV has it: rows × columns × (blue, green, red).
fn bgr_array<'py>(py: Python<'py>, image: &SourceImage) -> PyResult<Bound<'py, PyArray3<u8>>> {
    let rgb = image
        .to_rgb()
        .ok_or_else(|| PyValueError::new_err("a truncated image"))?;
    let shape = [rgb.height_px, rgb.width_px, 3];
    let bgr: Vec<u8> = detached(py, || {
        let pixels = rgb.rgb.chunks_exact(3);
        pixels.flat_map(|rgb| [rgb[2], rgb[1], rgb[0]]).collect()
    });
    bgr.into_pyarray(py).reshape(shape)
}
