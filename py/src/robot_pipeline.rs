//! A robot's pipeline in Python: stamped samples in, one cycle per image out, with Python's lock released.

use std::path::PathBuf;
use std::sync::Arc;

use localize::Field;
use localize::frames::{At, Pose};
use localize::omni::Twist;
use localize::sample::{Compass, Imu, LinePoint, Odometry, VelocityCommand};
use nalgebra::Matrix3;
use pipeline::sample::{CameraImage, ImageContent, RawImage, Sample, SourceImage};
use pipeline::setup::Setup;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::arguments;
use crate::cycle::Cycle;
use crate::detections::ArrayImage;
use crate::errors;

/// A robot's pipeline: vision and localization in order.
#[pyclass(module = "mirrorball._core")]
pub(crate) struct Pipeline {
    pipeline: pipeline::Pipeline,
    has_camera: bool,
}

impl Pipeline {
    pub(crate) fn from_setup(
        py: Python<'_>,
        setup: &Setup,
        preset: &str,
        config: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let config = arguments::settings(preset, config)?;
        let pipeline = py
            .detach(|| pipeline::Pipeline::new(setup, &config))
            .map_err(|error| errors::from_anyhow(&error))?;
        Ok(Pipeline {
            pipeline,
            has_camera: setup.camera.is_some(),
        })
    }

    fn process(&mut self, py: Python<'_>, stamp_s: f64, content: ImageContent) -> PyResult<Cycle> {
        let sample = Sample::Image(CameraImage {
            stamp: arguments::stamp(stamp_s)?,
            setting: None,
            content,
        });
        let cycle = py.detach(|| {
            let mut cycle = self.pipeline.process_sample(sample)?;
            // The caller has the image.
            cycle.inputs.image = None;
            Some(cycle)
        });
        cycle
            .map(Cycle)
            .ok_or_else(|| PyValueError::new_err("the image gave no cycle"))
    }
}

#[pymethods]
impl Pipeline {
    /// `robot`: path of a robot.toml, or none for line points of another vision system on `field`.
    #[new]
    #[pyo3(signature = (*, robot=None, field=None, map=None, preset="default", config=None))]
    fn new(
        py: Python<'_>,
        robot: Option<PathBuf>,
        field: Option<&Bound<'_, crate::scene::Field>>,
        map: Option<PathBuf>,
        preset: &str,
        config: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let field: Option<Field> = field.map(|field| field.get().0.clone());
        let setup = match (robot, field) {
            (Some(robot), field) => {
                py.detach(|| Setup::load_on_field(&robot, field, map.as_deref()))
            }
            (None, Some(field)) => Ok(Setup::without_camera(field)),
            (None, None) => return Err(PyValueError::new_err("neither robot nor field")),
        };
        let setup = setup.map_err(|error| errors::from_anyhow(&error))?;
        Pipeline::from_setup(py, &setup, preset, config)
    }

    /// Motion since the previous sample, in the robot frame at that sample: forward and left (metres), turn (radians).
    fn odometry(&mut self, stamp_s: f64, motion: [f32; 3]) -> PyResult<()> {
        let [dx, dy, dtheta] = arguments::finite("motion", motion)?;
        let stamp = arguments::stamp(stamp_s)?;
        self.pipeline.process_sample(Sample::Odometry(Odometry {
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
        &mut self,
        stamp_s: f64,
        specific_force_mps2: [f32; 3],
        angular_velocity_radps: [f32; 3],
    ) -> PyResult<()> {
        self.pipeline.process_sample(Sample::Imu(Imu {
            stamp: arguments::stamp(stamp_s)?,
            specific_force: arguments::finite("specific_force_mps2", specific_force_mps2)?,
            angular_velocity: arguments::finite("angular_velocity_radps", angular_velocity_radps)?,
        }));
        Ok(())
    }

    /// Direction of the robot's x axis on the field, radians; `magnetic_field`: horizontal, robot frame.
    #[pyo3(signature = (stamp_s, heading_rad, magnetic_field=None))]
    fn compass(
        &mut self,
        stamp_s: f64,
        heading_rad: f32,
        magnetic_field: Option<[f32; 2]>,
    ) -> PyResult<()> {
        let [heading] = arguments::finite("heading_rad", [heading_rad])?;
        self.pipeline.process_sample(Sample::Compass(Compass {
            stamp: arguments::stamp(stamp_s)?,
            heading,
            magnetic_field,
        }));
        Ok(())
    }

    /// Velocity commanded to the motors from `stamp_s` on: forward, left (m/s), turn (rad/s).
    fn command(&mut self, stamp_s: f64, velocity: [f32; 3]) -> PyResult<()> {
        let [x, y, theta] = arguments::finite("velocity", velocity)?;
        self.pipeline
            .process_sample(Sample::Command(VelocityCommand {
                stamp: arguments::stamp(stamp_s)?,
                twist: Twist { x, y, theta },
            }));
        Ok(())
    }

    /// Starts from a known pose with a standard deviation of x, y (metres) and θ (radians).
    fn set_pose(&mut self, stamp_s: f64, pose: [f32; 3], std: [f32; 3]) -> PyResult<()> {
        let [x, y, theta] = arguments::finite("pose", pose)?;
        let std = arguments::finite("std", std)?;
        if std.iter().any(|&value| value <= 0.0) {
            return Err(PyValueError::new_err(format!(
                "invalid std: {std:?} (expected positive numbers)"
            )));
        }
        let covariance = Matrix3::from_diagonal(&std.map(|value| value * value).into());
        let stamp = arguments::stamp(stamp_s)?;
        self.pipeline
            .set_pose(stamp, Pose::new(x, y, theta), &covariance);
        Ok(())
    }

    /// An image: rows × columns × 3 (blue, green, red) or rows × columns (grey), bytes.
    fn image(&mut self, py: Python<'_>, stamp_s: f64, image: &Bound<'_, PyAny>) -> PyResult<Cycle> {
        if !self.has_camera {
            return Err(PyValueError::new_err(
                "an image, but the robot has no [camera] (expected points)",
            ));
        }
        let image = ArrayImage::from_argument(image)?;
        let view = image.view();
        let (width_px, height_px, format) = (view.width_px, view.height_px, view.format);
        let stride = view.stride;
        let content = ImageContent::Pixels(SourceImage::Raw(RawImage {
            width_px,
            height_px,
            format,
            stride,
            data: Arc::new(image.into_bytes()),
        }));
        self.process(py, stamp_s, content)
    }

    /// Line points of another vision system: n × 2 (x, y) or n × 4 (and standard deviations, radial and tangential).
    fn points(
        &mut self,
        py: Python<'_>,
        stamp_s: f64,
        points: &Bound<'_, PyAny>,
        std_m: f32,
    ) -> PyResult<Cycle> {
        let (columns, values) = arguments::rows("points", points, &[2, 4])?;
        if !values.iter().all(|value| value.is_finite()) {
            return Err(PyValueError::new_err(
                "invalid points: NaN or infinity (expected finite numbers)",
            ));
        }
        let stds = values.chunks_exact(columns).flat_map(|row| &row[2..]);
        if !(std_m > 0.0) || stds.copied().any(|std| std <= 0.0) {
            return Err(PyValueError::new_err(
                "invalid standard deviation of points: 0 or less (expected metres above 0)",
            ));
        }
        let line_point = |row: &[f32]| LinePoint {
            at: At::new(row[0], row[1]),
            std_radial: row.get(2).copied().unwrap_or(std_m),
            std_tangential: row.get(3).copied().unwrap_or(std_m),
        };
        let points = values.chunks_exact(columns).map(line_point).collect();
        let content = ImageContent::Features {
            points,
            goals: Vec::new(),
        };
        self.process(py, stamp_s, content)
    }
}
