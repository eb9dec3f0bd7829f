//! Which edit makes which variant? One change of a set-up with its text.

use std::path::PathBuf;

use localize::field::{Axis, FieldConfig, FieldSize, MeasuredTo};
use localize::robot::CameraConfig;
use localize::setup_check::Explanation;
use localize::wheel_steps::MatrixFit;
use nalgebra::{Matrix3, Vector3};

use super::field_sizes;
use super::variant::SetupVariant;
use crate::setup::{SensorSource, Setup};

/// Largest correction of the wheels that a filter learns while driving, as a share of the motion at the wheels.
const LEARNED_CORRECTION_MAX: f32 = 0.3;
/// Distance of the wheels from the centre that relates turns to motions, metres.
const BASE_RADIUS: f32 = 0.25;

/// Standard deviations by which a correction exceeds it.
const EXCEEDS_SIGMAS: f32 = 2.0;

/// A less certain matrix of the wheels is not worth to be written down.
const MATRIX_STD_MAX: f32 = 0.1;

/// One change of a set-up.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Change {
    /// Another field file.
    Field(PathBuf, Box<FieldConfig>),
    /// Other sizes of the field.
    Sizes {
        /// The field before.
        from: Box<FieldConfig>,
        /// The field with the same markings in other places.
        to: Box<FieldConfig>,
    },
    /// The field's sizes measured to another edge of the lines.
    MeasuredTo(MeasuredTo),
    /// The camera turned by quarters, then perhaps mirrored.
    Mount {
        /// Quarter turns.
        quarters: u8,
        /// Left and right exchanged.
        mirrored: bool,
    },
    /// The compass turned by an angle, degrees.
    CompassTurn(u16),
    /// The compass counts clockwise, and is then turned by an angle, degrees.
    CompassMirrored(u16),
    /// The camera turned by an angle, radians.
    CameraTurn(f32),
    /// The wheels' path in another unit.
    OdometryScale(f32),
    /// Forward and left of the wheels' motion exchanged, then signs changed.
    OdometryAxes {
        /// Exchanged.
        exchanged: bool,
        /// Signs of dx, dy and dtheta: 1 or -1.
        signs: [f32; 3],
    },
    /// The wheels' path in axes that do not turn with the robot, with its heading there at the first keyframe, radians.
    OdometryFixedAxes(f32),
    /// The wheels' motion (metres, metres, radians) multiplied by a matrix.
    WheelMatrix(MatrixFit),
    /// Headings in degrees.
    CompassInDegrees,
    /// Turns in degrees.
    OdometryRotationInDegrees,
    /// The mirror's centre in the image shifted, pixels.
    Centre([f32; 2]),
    /// Another height of the camera, metres.
    Height(f32),
    /// Another focal length, pixels.
    FocalLength(f32),
}

impl Change {
    /// Does it take the wheels' path or turns in another unit, or along other axes?
    pub(super) fn is_unit_or_axis_of_wheels(&self) -> bool {
        matches!(
            self,
            Change::OdometryRotationInDegrees
                | Change::OdometryScale(_)
                | Change::OdometryAxes { .. }
                | Change::OdometryFixedAxes(_)
        )
    }

    /// Does it correct wheels by more than a filter learns while driving? Poses are better without them.
    pub(super) fn exceeds_learned_wheels(&self) -> bool {
        let Change::WheelMatrix(MatrixFit { matrix, std }) = self else {
            return false;
        };
        let scale = Vector3::new(1.0, 1.0, BASE_RADIUS);
        let of_motions = |row: usize, column: usize| scale[row] / scale[column];
        let wrong = (matrix - Matrix3::identity()).component_mul(&Matrix3::from_fn(of_motions));
        // A differential drive tells nothing of a motion to the left.
        wrong.abs().max() > LEARNED_CORRECTION_MAX + EXCEEDS_SIGMAS * std
    }

    /// The same change of a compass by half a turn more. On a field that looks alike from both halves it explains as much.
    pub(super) fn half_turn_twin(&self) -> Option<Change> {
        match self {
            Change::CompassTurn(degrees) => Some(Change::CompassTurn((degrees + 180) % 360)),
            Change::CompassMirrored(degrees) => {
                Some(Change::CompassMirrored((degrees + 180) % 360))
            }
            _ => None,
        }
    }

    /// The variant after this change.
    pub(super) fn apply(&self, variant: &SetupVariant) -> SetupVariant {
        let mut changed = variant.clone();
        match self {
            Change::Field(_, field) | Change::Sizes { to: field, .. } => {
                changed.field = (**field).clone();
            }
            Change::MeasuredTo(to) => changed.field.measured_to = *to,
            Change::Mount { quarters, mirrored } => {
                // Turned after the mount of `variant`: a mirrored one turns the other way.
                let own = if variant.mirrored {
                    4 - quarters % 4
                } else {
                    *quarters
                };
                changed.quarter_turns = (variant.quarter_turns + own) % 4;
                changed.mirrored ^= mirrored;
            }
            Change::CompassTurn(degrees) => {
                changed.compass_turn += f32::from(*degrees).to_radians();
            }
            Change::CompassMirrored(degrees) => {
                changed.compass_sign = -changed.compass_sign;
                changed.compass_turn = f32::from(*degrees).to_radians() - changed.compass_turn;
            }
            Change::CameraTurn(angle) => {
                changed.camera_turn += if variant.mirrored { -angle } else { *angle };
            }
            Change::OdometryScale(scale) => changed.path_unit_scale *= scale,
            Change::OdometryAxes { exchanged, signs } => {
                let mut axes = Matrix3::from_diagonal(&(*signs).into());
                if *exchanged {
                    axes.swap_columns(0, 1);
                }
                changed.wheel_matrix = axes * changed.wheel_matrix;
            }
            Change::OdometryFixedAxes(heading) => changed.fixed_axes = Some(*heading),
            Change::WheelMatrix(fit) => changed.wheel_matrix = fit.matrix * changed.wheel_matrix,
            Change::CompassInDegrees => changed.compass_unit_scale = 1.0_f32.to_radians(),
            Change::OdometryRotationInDegrees => changed.rotation_unit_scale = 1.0_f32.to_radians(),
            Change::Centre(shift) => changed.centre_shift = *shift,
            Change::Height(height) => changed.height = Some(*height),
            Change::FocalLength(focal_px) => changed.focal_px = Some(*focal_px),
        }
        changed
    }

    /// The edit to make; `after`: the variant with the change.
    pub(super) fn text(&self, setup: &Setup, after: &SetupVariant) -> String {
        if setup.sensors == SensorSource::Devices
            && let Some(text) = self.text_for_devices()
        {
            return text;
        }
        match self {
            Change::Field(path, _) => {
                format!("robot.toml: field = {:?}", path.display().to_string())
            }
            Change::Sizes { from, to } => {
                let sizes = field_sizes::changed(from, to);
                let edits = sizes.iter().map(|size| size.text(from, to));
                format!("field.toml: {}", edits.collect::<Vec<_>>().join(", "))
            }
            Change::MeasuredTo(to) => {
                let (now, to) = (to.other().name(), to.name());
                format!("field.toml: measured_to = {to:?} (now {now:?})")
            }
            Change::Mount { quarters, mirrored } => mount_text(setup, after, *quarters, *mirrored),
            Change::CompassTurn(degrees) => {
                format!(
                    "compass.csv: turn heading_rad by {degrees} degrees (the compass is mounted so)"
                )
            }
            Change::CompassMirrored(0) => {
                "compass.csv: change the sign of heading_rad (it counts counter-clockwise)"
                    .to_owned()
            }
            Change::CompassMirrored(degrees) => {
                format!(
                    "compass.csv: change the sign of heading_rad (it counts counter-clockwise), then turn it by {degrees} degrees"
                )
            }
            Change::CameraTurn(angle) => turn_text(setup, after, *angle),
            Change::OdometryScale(scale) if *scale < 1.0 => {
                let (unit, edit) = match scale {
                    0.0..0.005 => ("millimetres", "divide by 1000"),
                    0.005..0.02 => ("centimetres", "divide by 100"),
                    0.02..0.1 => ("inches", "multiply by 0.0254"),
                    _ => ("feet", "multiply by 0.3048"),
                };
                format!("odometry.csv: convert dx_m and dy_m from {unit} to metres ({edit})")
            }
            Change::OdometryScale(scale) => {
                format!("odometry.csv: multiply dx_m and dy_m by {scale}")
            }
            Change::OdometryAxes { exchanged, signs } => {
                let columns = ["dx_m", "dy_m", "dtheta_rad"].iter().zip(signs);
                let negated: Vec<&str> = columns
                    .filter(|(_, sign)| **sign < 0.0)
                    .map(|(column, _)| *column)
                    .collect();
                let edits = [
                    exchanged.then(|| "exchange dx_m and dy_m".to_owned()),
                    (!negated.is_empty())
                        .then(|| format!("change the sign of {}", negated.join(" and "))),
                ];
                let edits: Vec<String> = edits.into_iter().flatten().collect();
                format!(
                    "odometry.csv: {} (x is forward, y left, turns are counter-clockwise)",
                    edits.join(", then ")
                )
            }
            Change::OdometryFixedAxes(_) => {
                "odometry.csv: turn dx_m and dy_m by the negative heading of the robot: they are in axes that do not turn with it (x is forward, y left)"
                    .to_owned()
            }
            Change::WheelMatrix(fit) => wheels_text(setup, after, fit),
            Change::CompassInDegrees => {
                "compass.csv: convert heading_rad from degrees to radians (divide by 57.29578)"
                    .to_owned()
            }
            Change::OdometryRotationInDegrees => {
                "odometry.csv: convert dtheta_rad from degrees to radians (divide by 57.29578)"
                    .to_owned()
            }
            Change::Height(height) => {
                let now = configured_camera(setup, |camera| camera.height);
                format!("robot.toml: height = {height:.3} (now {now:.3})")
            }
            Change::FocalLength(focal_px) => {
                let now = configured_camera(setup, |camera| camera.focal_px);
                format!("robot.toml: focal_px = {focal_px:.1} (now {now:.1})")
            }
            Change::Centre([du, dv]) => match (&setup.camera, setup.is_calibrated()) {
                (Some((camera, _)), false) => {
                    let centre = after.camera(camera).centre_px;
                    format!(
                        "robot.toml: centre_px = [{:.1}, {:.1}] (now [{:.1}, {:.1}])",
                        centre[0], centre[1], camera.centre_px[0], camera.centre_px[1]
                    )
                }
                _ => format!(
                    "calibrate the map again: the image has moved by ({du:+.1}, {dv:+.1}) pixels"
                ),
            },
        }
    }

    /// The edit to make on a robot, whose sensors have no tables. None where it is the same as for a recording.
    fn text_for_devices(&self) -> Option<String> {
        match self {
            Change::CompassTurn(degrees) => Some(format!(
                "hardware.toml: add {degrees} to north_deg of the compass"
            )),
            Change::CompassMirrored(degrees) => Some(format!(
                "hardware.toml: clockwise of the compass is the other way round (then north_deg = {degrees} less the present one)"
            )),
            Change::OdometryScale(scale) => Some(format!(
                "robot.toml: multiply wheel_radius by {scale}, or the base counts in another unit"
            )),
            Change::OdometryFixedAxes(_) => Some(
                "the base reports its path in axes that do not turn with the robot: report motion forward and to the left"
                    .to_owned(),
            ),
            Change::OdometryAxes { .. } => Some(
                "robot.toml: the wheels' order and directions, or hardware.toml: reversed of [base] (`mirrorball calibrate wheels` \
                 measures them)"
                    .to_owned(),
            ),
            _ => None,
        }
    }

    /// Share that is explained of what this change affects; `explanation`: by the set-up with it.
    pub(super) fn explained(&self, explanation: &Explanation) -> f32 {
        let share = match self {
            Change::CompassTurn(_) | Change::CompassMirrored(_) | Change::CompassInDegrees => {
                explanation.compass_agrees()
            }
            Change::OdometryScale(_)
            | Change::OdometryAxes { .. }
            | Change::OdometryFixedAxes(_)
            | Change::WheelMatrix(_)
            | Change::OdometryRotationInDegrees
            | Change::CameraTurn(_) => explanation.wheels_agree(),
            _ => Some(explanation.fit()),
        };
        share.unwrap_or(1.0)
    }

    /// What is probably wrong, for a warning of one line.
    pub(super) fn cause(&self) -> &'static str {
        match self {
            Change::Field(..) => "the field file is of another field",
            Change::Sizes { from, to } => {
                let sizes = field_sizes::changed(from, to);
                let is = |axis| sizes.as_slice() == FieldSize::between_ends(from, axis).as_slice();
                if is(Axis::X) {
                    "the field's length is wrong"
                } else if is(Axis::Y) {
                    "the field's width is wrong"
                } else {
                    "the field's markings are of other sizes"
                }
            }
            Change::MeasuredTo(_) => "the field's sizes are those between other edges of the lines",
            Change::Mount { mirrored: true, .. } => "left and right of the image are exchanged",
            Change::Mount { .. } => "the camera's forward direction is wrong",
            Change::CompassTurn(_) => "the compass is turned",
            Change::CompassMirrored(_) => "the compass counts clockwise",
            Change::CameraTurn(_) => "the camera's forward direction is wrong",
            Change::OdometryScale(_) => "the odometry's path is in another unit",
            Change::OdometryAxes {
                exchanged: false,
                signs: [-1.0, -1.0, 1.0],
            } => "the odometry is turned by 180 degrees",
            Change::OdometryAxes { .. } => "the odometry's axes or signs are wrong",
            Change::OdometryFixedAxes(_) => {
                "the odometry's path is in axes that do not turn with the robot"
            }
            Change::WheelMatrix(_) => "the wheels' radii or directions are wrong",
            Change::CompassInDegrees => "the compass's headings are in degrees",
            Change::OdometryRotationInDegrees => "the odometry's turns are in degrees",
            Change::Centre(_) => "the mirror's centre in the image is wrong",
            Change::Height(_) => "the camera's height is wrong",
            Change::FocalLength(_) => "the camera's focal length is wrong",
        }
    }
}

fn wheels_text(setup: &Setup, after: &SetupVariant, fit: &MatrixFit) -> String {
    if fit.std > MATRIX_STD_MAX {
        return "robot.toml: [odometry] matrix (`mirrorball calibrate wheels` measures it in a drive of a minute)"
            .to_owned();
    }
    let matrix = after.wheels(setup);
    let rows = [0, 1, 2].map(|row| {
        let [a, b, c] = [0, 1, 2].map(|column| matrix[(row, column)]);
        format!("[{a:.3}, {b:.3}, {c:.3}]")
    });
    format!(
        "robot.toml: [odometry] matrix = [{}] (+- {:.3}; `mirrorball calibrate wheels` measures it)",
        rows.join(", "),
        fit.std
    )
}

fn turn_text(setup: &Setup, after: &SetupVariant, angle: f32) -> String {
    let degrees = angle.to_degrees();
    match (&setup.camera, setup.is_calibrated()) {
        (Some((camera, _)), false) => format!(
            "robot.toml: forward_deg = {:.1} (now {:.1})",
            after.camera(camera).forward_deg,
            camera.forward_deg
        ),
        (Some(_), true) => {
            format!(
                "turn the map's ground points by {degrees:+.1} degrees (`mirrorball calibrate mount` does)"
            )
        }
        (None, _) => format!("points.csv: turn the points by {degrees:+.1} degrees"),
    }
}

fn configured_camera(setup: &Setup, value: fn(&CameraConfig) -> Option<f32>) -> f32 {
    let camera = setup.camera.as_ref().map(|(camera, _)| camera);
    camera.and_then(value).unwrap_or(f32::NAN)
}

fn mount_text(setup: &Setup, after: &SetupVariant, quarters: u8, mirrored: bool) -> String {
    match (&setup.camera, setup.is_calibrated()) {
        (Some((camera, _)), false) => {
            let changed = after.camera(camera);
            let mut edits = Vec::new();
            if changed.flipped != camera.flipped {
                edits.push(format!("flipped = {}", changed.flipped));
            }
            let turned = (changed.forward_deg - camera.forward_deg).rem_euclid(360.0);
            if turned.min(360.0 - turned) > 0.5 {
                edits.push(format!("forward_deg = {:.1}", changed.forward_deg));
            }
            format!("robot.toml: {}", edits.join(", "))
        }
        (camera, _) => {
            let (what, help) = if camera.is_some() {
                (
                    "the map's ground points are",
                    " (`mirrorball calibrate mount` corrects the map)",
                )
            } else {
                ("points.csv: the points are", "")
            };
            let turn = format!("turned by {} degrees", 90 * u16::from(quarters));
            let mirror = "mirrored (y_m has the wrong sign)".to_owned();
            let wrong = [(quarters > 0).then_some(turn), mirrored.then_some(mirror)];
            let wrong: Vec<String> = wrong.into_iter().flatten().collect();
            format!("{what} {}{help}", wrong.join(" and "))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edits_name_what_the_operator_can_change() {
        let path = crate::paths::find_resource("config/fields/msl_18x12.toml").expect("a file");
        let field = localize::Field::load(&path).expect("a field");
        let mut setup = Setup::without_camera(field);
        let text =
            |setup: &Setup, change: &Change| change.text(setup, &SetupVariant::configured(setup));
        let exchanged = Change::OdometryAxes {
            exchanged: true,
            signs: [1.0; 3],
        };
        let changes = [
            Change::CompassTurn(90),
            Change::CompassMirrored(180),
            Change::OdometryScale(0.001),
            exchanged,
        ];
        assert!(
            changes
                .iter()
                .all(|change| text(&setup, change).contains(".csv"))
        );
        setup.sensors = SensorSource::Devices;
        for change in &changes {
            let text = text(&setup, change);
            assert!(text.contains(".toml") && !text.contains(".csv"), "{text}");
        }
    }

    #[test]
    fn wheels_are_left_out_only_if_they_are_wrong_by_more_than_a_filter_learns() {
        let with = |row: usize, column: usize, wrong: f32| {
            let mut matrix = Matrix3::identity();
            matrix[(row, column)] += wrong;
            Change::WheelMatrix(MatrixFit { matrix, std: 0.05 })
        };
        for (row, column, wrong) in [(0, 0, 0.15), (1, 0, -0.2), (0, 2, 0.05), (2, 1, 0.5)] {
            assert!(!with(row, column, wrong).exceeds_learned_wheels());
        }
        for (row, column, wrong) in [(0, 0, -0.5), (2, 2, 1.0), (0, 2, 0.6), (2, 0, 2.0)] {
            assert!(with(row, column, wrong).exceeds_learned_wheels());
        }
    }
}
