//! The result of one image in Python: numbers and columns, made when they are asked for.

use localize::advice::Advice;
use localize::estimate::Estimate;
use localize::frames::Pose;
use localize::world::TrackedObject;
use nalgebra::Matrix4;
use numpy::{PyArray2, PyArrayMethods, ToPyArray};
use pipeline::log::reason_text;
use pipeline::result_files::mode_name;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::detections::{detection_columns, f32_column};

/// What is known after one image.
#[pyclass(frozen, module = "mirrorball._core")]
pub(crate) struct Cycle(pub(crate) pipeline::Cycle);

#[pymethods]
impl Cycle {
    /// Pose, covariance, mode and fit, by the names of `mirrorball.Estimate`.
    fn estimate<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        estimate_fields(py, &self.0.estimate)
    }

    /// The line points that localization used, robot frame: x_m, y_m, std_radial_m, std_tangential_m.
    fn line_points<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let rows = &self.0.line_points;
        let columns = PyDict::new(py);
        columns.set_item("x_m", f32_column(py, rows, |row| row.at.x))?;
        columns.set_item("y_m", f32_column(py, rows, |row| row.at.y))?;
        columns.set_item("std_radial_m", f32_column(py, rows, |row| row.std_radial))?;
        let std_tangential = f32_column(py, rows, |row| row.std_tangential);
        columns.set_item("std_tangential_m", std_tangential)?;
        Ok(columns)
    }

    /// Columns of the detections, as `Vision.process` returns them. None without a usable image.
    fn detections<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyDict>>> {
        let detections = self.0.detections.as_ref();
        detections
            .map(|detections| detection_columns(py, detections))
            .transpose()
    }

    /// The tracked ball, by the names of `mirrorball.TrackedObject`.
    fn ball<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyDict>>> {
        let ball = self.0.world.ball.as_ref();
        ball.map(|ball| object_fields(py, ball)).transpose()
    }

    /// The tracked robots, the oldest track first.
    fn robots<'py>(&self, py: Python<'py>) -> PyResult<Vec<Bound<'py, PyDict>>> {
        let robots = self.0.world.robots.iter();
        robots.map(|robot| object_fields(py, robot)).collect()
    }

    /// Why the image could not be used.
    #[getter]
    fn image_fault(&self) -> Option<&str> {
        self.0.image_fault.as_deref()
    }

    /// Duration of vision and of localization, milliseconds.
    #[getter]
    fn timings_ms(&self) -> (f32, f32) {
        (self.0.timings.see_ms, self.0.timings.localize_ms)
    }

    /// Next exposure and gain of the camera. None: unchanged.
    #[getter]
    fn camera_command(&self) -> Option<(f32, f32)> {
        let command = self.0.camera_command()?;
        Some((command.setting.exposure, command.setting.gain))
    }
}

fn pose_tuple(pose: Pose) -> (f32, f32, f32) {
    (pose.x, pose.y, pose.theta)
}

fn estimate_fields<'py>(py: Python<'py>, estimate: &Estimate) -> PyResult<Bound<'py, PyDict>> {
    let fields = PyDict::new(py);
    let covariance: [f64; 9] =
        std::array::from_fn(|k| f64::from(estimate.covariance[(k / 3, k % 3)]));
    let fit = &estimate.fit;
    let runners_up = estimate.runners_up.iter();
    let runners_up: Vec<_> = runners_up
        .map(|other| (pose_tuple(other.pose), other.probability))
        .collect();
    fields.set_item("stamp_s", estimate.stamp.seconds())?;
    fields.set_item("pose", estimate.pose.map(pose_tuple))?;
    fields.set_item("covariance", covariance.to_pyarray(py).reshape([3, 3])?)?;
    fields.set_item("mode", mode_name(estimate.mode))?;
    fields.set_item("reason", estimate.reason.map(|_| reason_text(estimate)))?;
    fields.set_item("points_used", estimate.line_points)?;
    fields.set_item("inlier_share", estimate.inlier_share)?;
    fields.set_item("residual_m", estimate.inlier_rms)?;
    fields.set_item("tilt_rad", (estimate.tilt[0], estimate.tilt[1]))?;
    fields.set_item("half_known", estimate.half_known)?;
    let twist = estimate.twist.map(|twist| (twist.x, twist.y, twist.theta));
    fields.set_item("twist", twist)?;
    fields.set_item("collision", estimate.collision)?;
    fields.set_item("runners_up", runners_up)?;
    let certificate = estimate.certificate.map(|certificate| {
        (
            certificate.points,
            certificate.answer_share,
            certificate.others_share_max,
            certificate.unlisted_share_max,
            certificate.is_attained,
        )
    });
    fields.set_item("certificate", certificate)?;
    let advice = estimate.advice.map(|advice| {
        let motion = match advice {
            Advice::Move(advice) => Some((advice.motion[0], advice.motion[1], advice.motion[2])),
            Advice::ObserveHalf => None,
        };
        (advice.text(), motion)
    });
    fields.set_item("advice", advice)?;
    fields.set_item(
        "fit",
        (
            fit.on_markings,
            fit.inlier_rms,
            fit.markings_seen,
            fit.wheel_agreement,
            fit.compass_agreement,
        ),
    )?;
    Ok(fields)
}

fn object_fields<'py>(py: Python<'py>, object: &TrackedObject) -> PyResult<Bound<'py, PyDict>> {
    let fields = PyDict::new(py);
    fields.set_item("id", object.id)?;
    fields.set_item("position_m", (object.at.x, object.at.y))?;
    let [vx, vy] = object.velocity;
    fields.set_item("velocity_mps", (vx, vy))?;
    fields.set_item("covariance", matrix_array(py, &object.covariance)?)?;
    let on_field = object.on_field.as_ref();
    let at = on_field.map(|state| (state.at.x, state.at.y));
    let velocity = on_field.map(|state| (state.velocity[0], state.velocity[1]));
    let covariance = on_field.map(|state| matrix_array(py, &state.covariance));
    fields.set_item("field_position_m", at)?;
    fields.set_item("field_velocity_mps", velocity)?;
    fields.set_item("field_covariance", covariance.transpose()?)?;
    fields.set_item("probability", object.probability)?;
    fields.set_item("last_seen_s", object.last_seen.seconds())?;
    let team = object.team.map(|team| format!("{team:?}").to_lowercase());
    fields.set_item("team", team)?;
    Ok(fields)
}

fn matrix_array<'py>(
    py: Python<'py>,
    matrix: &Matrix4<f32>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let values: [f64; 16] = std::array::from_fn(|k| f64::from(matrix[(k / 4, k % 4)]));
    values.to_pyarray(py).reshape([4, 4])
}
