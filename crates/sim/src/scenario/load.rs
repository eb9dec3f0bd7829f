//! How is a scenario loaded? Parsed, checked key by key, its paths resolved.

use std::path::Path;

use localize::robot::RobotConfig;
use localize::toml_file::{self, TomlFileError};
use localize::toml_location::key_location;

use super::{RadioConfig, Scenario};
use crate::world::STEP;

/// Why a scenario cannot be loaded.
#[derive(Debug, thiserror::Error)]
pub enum ScenarioError {
    /// The file cannot be read, or its content is something else.
    #[error(transparent)]
    File(#[from] TomlFileError),
    /// An invalid value.
    #[error("{place}: {key}: {reason}")]
    Value {
        /// The file, and the line if known.
        place: String,
        /// The key in the file.
        key: String,
        /// What is wrong with it.
        reason: String,
    },
    /// An error in its robot file.
    #[error(transparent)]
    Robot(#[from] localize::robot::RobotConfigError),
}

/// Largest accepted coordinate, metres.
const COORDINATE_MAX: f32 = 1000.0;

/// Largest accepted direction, degrees.
const DIRECTION_MAX: f32 = 360.0;

/// Largest accepted height (metres) and speed (m/s) of a ball in the air.
const HEIGHT_MAX: f32 = 100.0;
const SPEED_MAX: f32 = 100.0;

/// Most other robots: five against five and a referee.
const OTHERS_MAX: usize = 10;

impl Scenario {
    /// Reads and checks a scenario file and its robot file; resolves paths relative to the scenario's folder.
    pub fn load(path: &Path) -> Result<(Self, RobotConfig), ScenarioError> {
        let (scenario, text): (Scenario, _) = toml_file::read(path)?;
        scenario.check_and_resolve(path, &text)
    }

    /// From the table of the scenario file `path`, in which values may have been changed.
    pub fn from_table(
        table: toml::Table,
        path: &Path,
    ) -> Result<(Self, RobotConfig), ScenarioError> {
        let scenario: Scenario = table
            .try_into()
            .map_err(|source| TomlFileError::parse(path, source))?;
        scenario.check_and_resolve(path, "")
    }

    /// Checks the scenario and reads its robot file; `text` is the file's content, for line numbers in errors.
    fn check_and_resolve(
        self,
        path: &Path,
        text: &str,
    ) -> Result<(Self, RobotConfig), ScenarioError> {
        let mut scenario = self;
        scenario
            .check()
            .map_err(|(key, reason)| ScenarioError::Value {
                place: key_location(path, text, &key),
                key,
                reason,
            })?;
        let folder = path.parent().unwrap_or(Path::new(""));
        scenario.robot = folder.join(&scenario.robot);
        let robot = RobotConfig::load(&scenario.robot)?;
        scenario.field = Some(match scenario.field.take() {
            Some(field) => folder.join(field),
            None => robot.field.clone(),
        });
        Ok((scenario, robot))
    }

    /// The first key with an invalid value, and the reason.
    fn check(&self) -> Result<(), (String, String)> {
        let refuse = |key: &str, reason: String| Err((key.to_owned(), reason));
        if !(self.duration.is_finite() && self.duration > 0.0) {
            return refuse(
                "duration",
                format!(
                    "invalid duration: {} (expected seconds above 0)",
                    self.duration
                ),
            );
        }
        for (key, value) in [
            ("frame_rate_hz", self.frame_rate_hz),
            ("focal_scale", self.focal_scale),
            ("path.speed", self.path.speed.into()),
            ("path.turn_rate_deg", self.path.turn_rate_deg.into()),
            ("ball.diameter", self.ball.diameter.into()),
            ("ball.mass", self.ball.mass.into()),
            ("others.speed", self.others.speed.into()),
            ("wheels.traction", self.wheels.traction.into()),
            ("wheels.grip", self.wheels.grip.into()),
        ] {
            if !(value.is_finite() && value > 0.0) {
                return refuse(
                    key,
                    format!("invalid value: {value} (expected a number above 0)"),
                );
            }
        }
        // At most one image per time step.
        let rate_max = (1.0 / f64::from(STEP)).round();
        if self.frame_rate_hz > rate_max {
            let reason = format!(
                "invalid rate: {} (expected at most {rate_max})",
                self.frame_rate_hz
            );
            return refuse("frame_rate_hz", reason);
        }
        let [ball_x, ball_y] = self.ball.position;
        for (key, value) in [
            ("start.x", self.start.x),
            ("start.y", self.start.y),
            ("ball.position", ball_x),
            ("ball.position", ball_y),
        ] {
            if !(value.abs() <= COORDINATE_MAX) {
                return refuse(
                    key,
                    format!(
                        "invalid value: {value} (expected -{COORDINATE_MAX} to {COORDINATE_MAX})"
                    ),
                );
            }
        }
        self.check_directions()?;
        self.check_ball()?;
        let others =
            self.others.opponents + self.others.mates + self.others.placed.len() + self.squad.len();
        let RadioConfig {
            rate_hz,
            loss,
            delay: [delay_min, delay_max],
        } = self.radio;
        let delay_ok = 0.0 <= delay_min && delay_min <= delay_max && delay_max <= 10.0;
        let rate_ok = rate_hz > 0.0 && rate_hz <= 1000.0;
        if !(rate_ok && delay_ok && (0.0..=1.0).contains(&loss)) {
            return refuse(
                "radio",
                "invalid value (expected rate_hz above 0 to 1000, loss 0 to 1, delay 0 to 10 in increasing order)"
                    .to_owned(),
            );
        }
        if others > OTHERS_MAX {
            return refuse(
                "others",
                format!("too many robots: {others} (expected at most {OTHERS_MAX})"),
            );
        }
        let radius_ok = |scale: &f32| scale.is_finite() && *scale > 0.0;
        if self.wheels.radius_scale.is_empty() || !self.wheels.radius_scale.iter().all(radius_ok) {
            return refuse(
                "wheels.radius_scale",
                "invalid scales (expected one number above 0 per wheel)".to_owned(),
            );
        }
        self.check_timed_events()?;
        self.image_sensor
            .check()
            .map_err(|(key, reason)| (format!("film.{key}"), reason))?;
        self.light
            .check()
            .map_err(|(key, reason)| (format!("light.{key}"), reason))?;
        self.environment
            .check()
            .map_err(|(key, reason)| (format!("hall.{key}"), reason))?;
        self.people
            .check()
            .map_err(|(key, reason)| (format!("people.{key}"), reason))?;
        self.rocking
            .check()
            .map_err(|(key, reason)| (format!("rocking.{key}"), reason))
    }

    /// The first direction beyond a turn, and the reason.
    fn check_directions(&self) -> Result<(), (String, String)> {
        let start = [("start.theta_deg".to_owned(), self.start.theta_deg)];
        let placed = self.others.placed.iter().enumerate();
        let placed =
            placed.map(|(i, robot)| (format!("others.placed[{i}].theta_deg"), robot.theta_deg));
        let kidnaps = self.kidnaps.iter().enumerate();
        let kidnaps =
            kidnaps.map(|(i, kidnap)| (format!("kidnaps[{i}].theta_deg"), kidnap.theta_deg));
        let occlusions = self.occlusions.iter().enumerate();
        let occlusions = occlusions.map(|(i, sector)| {
            (
                format!("occlusions[{i}].direction_deg"),
                sector.direction_deg,
            )
        });
        for (key, value) in start
            .into_iter()
            .chain(placed)
            .chain(kidnaps)
            .chain(occlusions)
        {
            if !(value.abs() <= DIRECTION_MAX) {
                let reason = format!(
                    "invalid value: {value} (expected -{DIRECTION_MAX} to {DIRECTION_MAX})"
                );
                return Err((key, reason));
            }
        }
        Ok(())
    }

    /// The first invalid value of the ball and its kicks, and the reason.
    fn check_ball(&self) -> Result<(), (String, String)> {
        let (ball, others) = (&self.ball, &self.others);
        let mut values = vec![
            ("ball.restitution".to_owned(), ball.restitution, 0.0, 1.0),
            (
                "ball.floor_restitution".to_owned(),
                ball.floor_restitution,
                0.0,
                0.99,
            ),
            (
                "ball.drag_coefficient".to_owned(),
                ball.drag_coefficient,
                0.0,
                100.0,
            ),
            ("ball.height".to_owned(), ball.height, 0.0, HEIGHT_MAX),
            (
                "ball.vertical_velocity".to_owned(),
                ball.vertical_velocity,
                -SPEED_MAX,
                SPEED_MAX,
            ),
            (
                "others.lofted_share".to_owned(),
                others.lofted_share,
                0.0,
                1.0,
            ),
            ("others.loft_deg".to_owned(), others.loft_deg, 0.0, 85.0),
        ];
        for (index, kick) in self.kicks.iter().enumerate() {
            let key = |name: &str| format!("kicks[{index}].{name}");
            values.extend([
                (key("time"), kick.time as f32, 0.0, f32::MAX),
                (key("height"), kick.height, 0.0, HEIGHT_MAX),
                (
                    key("vertical_velocity"),
                    kick.vertical_velocity,
                    -SPEED_MAX,
                    SPEED_MAX,
                ),
            ]);
            values.extend(
                kick.velocity
                    .map(|value| (key("velocity"), value, -SPEED_MAX, SPEED_MAX)),
            );
            let position = kick.position.unwrap_or_default();
            let position =
                position.map(|value| (key("position"), value, -COORDINATE_MAX, COORDINATE_MAX));
            values.extend(position);
        }
        for (key, value, least, most) in values {
            if !(least..=most).contains(&value) {
                return Err((
                    key,
                    format!("invalid value: {value} (expected {least} to {most})"),
                ));
            }
        }
        Ok(())
    }

    /// The first occlusion or fault with invalid times, and the reason.
    fn check_timed_events(&self) -> Result<(), (String, String)> {
        for (index, occlusion) in self.occlusions.iter().enumerate() {
            if !(occlusion.start <= occlusion.stop && occlusion.width_deg >= 0.0) {
                let key = format!("occlusions[{index}]");
                return Err((
                    key,
                    "invalid occlusion (expected stop after start, width_deg of at least 0)"
                        .to_owned(),
                ));
            }
        }
        for (index, fault) in self.faults.iter().enumerate() {
            if !(fault.start <= fault.stop) {
                return Err((
                    format!("faults[{index}]"),
                    "invalid fault (expected stop after start)".to_owned(),
                ));
            }
        }
        Ok(())
    }
}
