//! A robot's pipeline in Python: stamped samples in, one cycle per image out, with Python's lock released.

use localize::frames::{At, Pose};
use localize::omni::Twist;
use localize::sample::{Compass, Imu, LinePoint, Odometry, VelocityCommand};
use nalgebra::Matrix3;
use pipeline::sample::Sample;
use pipeline::setup::Setup;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::arguments::{self, single};
use crate::cycle::Cycle;
use crate::detections::ImageArgument;
use crate::errors;
use crate::scene::Field;
use crate::settings::settings;
use crate::threads::detached;

/// A robot's pipeline: vision and localization in order. One thread at a time.
#[pyclass(module = "mirrorball._core")]
pub(crate) struct Pipeline {
    pipeline: pipeline::Pipeline,
    /// Columns and rows of the camera's map.
    image_size_px: Option<[usize; 2]>,
}

impl Pipeline {
    pub(crate) fn from_setup(
        py: Python<'_>,
        setup: &Setup,
        preset: &Bound<'_, PyAny>,
        config: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let config = settings(preset, config)?;
        let camera = setup.camera.as_ref();
        let pipeline = detached(py, || pipeline::Pipeline::new(setup, &config))
            .map_err(|error| errors::from_anyhow(&error))?;
        Ok(Pipeline {
            pipeline,
            image_size_px: camera.map(|(_, map)| [map.width_px, map.height_px]),
        })
    }
}

#[pymethods]
impl Pipeline {
    /// `robot`: path of a robot.toml, or none for line points of another vision system on `field`.
    #[new]
    #[pyo3(signature = (*, preset, robot=None, field=None, map=None, config=None))]
    fn new(
        py: Python<'_>,
        preset: &Bound<'_, PyAny>,
        robot: Option<&Bound<'_, PyAny>>,
        field: Option<&Bound<'_, PyAny>>,
        map: Option<&Bound<'_, PyAny>>,
        config: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let path = |name: &str, value: Option<&Bound<'_, PyAny>>| {
            value.map(|path| arguments::path(name, path)).transpose()
        };
        let (robot, map) = (path("robot", robot)?, path("map", map)?);
        let field = field.map(|field| Field::from_argument(field).map(|field| field.0.clone()));
        let field = field.transpose()?;
        let setup = match (robot, field) {
            (Some(robot), field) => {
                detached(py, || Setup::load_on_field(&robot, field, map.as_deref()))
            }
            (None, Some(field)) => Ok(Setup::without_camera(field)),
            (None, None) => {
                return Err(PyValueError::new_err(
                    "invalid field: None (expected a mirrorball.Field, or its path)",
                ));
            }
        };
        let setup = setup.map_err(|error| errors::from_anyhow(&error))?;
        Pipeline::from_setup(py, &setup, preset, config)
    }

    /// Motion since the previous sample, in the robot frame at that sample: forward and left (metres), turn (radians).
    fn odometry(
        slf: &Bound<'_, Self>,
        stamp_s: &Bound<'_, PyAny>,
        motion: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        let stamp = arguments::stamp(stamp_s)?;
        let [dx, dy, dtheta] = single(arguments::vector("motion", motion)?);
        arguments::exclusive(slf)?
            .pipeline
            .process_sample(Sample::Odometry(Odometry {
                stamp,
                dx,
                dy,
                dtheta,
                slip: 0.0,
            }));
        Ok(())
    }

    /// Specific force (m/s²) and angular velocity (rad/s), robot frame.
    fn imu(
        slf: &Bound<'_, Self>,
        stamp_s: &Bound<'_, PyAny>,
        specific_force_mps2: &Bound<'_, PyAny>,
        angular_velocity_radps: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        let vector = |name: &str, value| arguments::vector(name, value).map(single);
        arguments::exclusive(slf)?
            .pipeline
            .process_sample(Sample::Imu(Imu {
                stamp: arguments::stamp(stamp_s)?,
                specific_force: vector("specific_force_mps2", specific_force_mps2)?,
                angular_velocity: vector("angular_velocity_radps", angular_velocity_radps)?,
            }));
        Ok(())
    }

    /// Direction of the robot's x axis on the field, radians; `magnetic_field`: horizontal, robot frame.
    #[pyo3(signature = (stamp_s, heading_rad, magnetic_field=None))]
    fn compass(
        slf: &Bound<'_, Self>,
        stamp_s: &Bound<'_, PyAny>,
        heading_rad: &Bound<'_, PyAny>,
        magnetic_field: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<()> {
        let field = magnetic_field.map(|field| arguments::vector("magnetic_field", field));
        arguments::exclusive(slf)?
            .pipeline
            .process_sample(Sample::Compass(Compass {
                stamp: arguments::stamp(stamp_s)?,
                heading: arguments::number("heading_rad", heading_rad)? as f32,
                magnetic_field: field.transpose()?.map(single),
            }));
        Ok(())
    }

    /// Velocity commanded to the motors from `stamp_s` on: forward, left (m/s), turn (rad/s).
    fn command(
        slf: &Bound<'_, Self>,
        stamp_s: &Bound<'_, PyAny>,
        velocity: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        let [x, y, theta] = single(arguments::vector("velocity", velocity)?);
        arguments::exclusive(slf)?
            .pipeline
            .process_sample(Sample::Command(VelocityCommand {
                stamp: arguments::stamp(stamp_s)?,
                twist: Twist { x, y, theta },
            }));
        Ok(())
    }

    /// Starts from a known pose with a standard deviation of x, y (metres) and θ (radians).
    fn set_pose(
        slf: &Bound<'_, Self>,
        stamp_s: &Bound<'_, PyAny>,
        pose: &Bound<'_, PyAny>,
        std: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        let stamp = arguments::stamp(stamp_s)?;
        let [x, y, theta] = single(arguments::vector("pose", pose)?);
        let deviations = single(arguments::vector::<3>("std", std)?);
        if deviations.iter().any(|&value| value <= 0.0) {
            return Err(arguments::invalid(
                "std",
                std,
                "three numbers above 0",
                None,
            ));
        }
        let covariance = Matrix3::from_diagonal(&deviations.map(|value| value * value).into());
        arguments::exclusive(slf)?
            .pipeline
            .set_pose(stamp, Pose::new(x, y, theta), &covariance);
        Ok(())
    }

    /// An image: rows × columns × 3 (blue, green, red) or rows × columns (grey), bytes.
    fn image(
        slf: &Bound<'_, Self>,
        py: Python<'_>,
        stamp_s: &Bound<'_, PyAny>,
        image: &Bound<'_, PyAny>,
    ) -> PyResult<Cycle> {
        let stamp = arguments::stamp(stamp_s)?;
        let mut this = arguments::exclusive(slf)?;
        let Some(size_px) = this.image_size_px else {
            return Err(PyValueError::new_err(
                "an image, but the robot has no [camera] (expected points)",
            ));
        };
        let image = ImageArgument::new("image", image, Some(size_px))?;
        let (view, pipeline) = (image.view(), &mut this.pipeline);
        Ok(Cycle(detached(py, || {
            pipeline.process_pixels(stamp, &view)
        })))
    }

    /// Line points of another vision system: n × 2 (x, y) or n × 4 (and standard deviations, radial and tangential).
    fn points(
        slf: &Bound<'_, Self>,
        py: Python<'_>,
        stamp_s: &Bound<'_, PyAny>,
        points: &Bound<'_, PyAny>,
        std_m: &Bound<'_, PyAny>,
    ) -> PyResult<Cycle> {
        let stamp = arguments::stamp(stamp_s)?;
        let std_m = arguments::positive("std_m", std_m)? as f32;
        let (columns, values) = arguments::rows("points", points, &[2, 4])?;
        let stds = values.chunks_exact(columns).flat_map(|row| &row[2..]);
        if stds.copied().any(|std| std <= 0.0) {
            return Err(PyValueError::new_err(
                "invalid points: a standard deviation of 0 or less (expected metres above 0)",
            ));
        }
        let line_point = |row: &[f32]| LinePoint {
            at: At::new(row[0], row[1]),
            std_radial: row.get(2).copied().unwrap_or(std_m),
            std_tangential: row.get(3).copied().unwrap_or(std_m),
        };
        let points = values.chunks_exact(columns).map(line_point).collect();
        let mut this = arguments::exclusive(slf)?;
        let pipeline = &mut this.pipeline;
        Ok(Cycle(detached(py, || {
            pipeline.process_line_points(stamp, points)
        })))
    }
}
