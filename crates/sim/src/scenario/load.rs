//! How is a scenario loaded? Parsed, checked key by key, its paths resolved.

use std::path::Path;

use localize::field::{Field, FieldError};
use localize::robot::RobotConfig;
use localize::toml_file::{self, TomlFileError};
use localize::toml_location::key_location;

use super::{FaultKind, OthersConfig, Scenario, bounds, places};
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
    /// An error in its field file.
    #[error(transparent)]
    Field(#[from] FieldError),
}

/// Lowest rate of images: one in a hundred seconds.
const FRAME_RATE_MIN_HZ: f64 = 0.01;

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
        let refused = |(key, reason): (String, String)| ScenarioError::Value {
            place: key_location(path, text, &key),
            key,
            reason,
        };
        scenario.check().map_err(refused)?;
        let folder = path.parent().unwrap_or(Path::new(""));
        scenario.robot = folder.join(&scenario.robot);
        let robot = RobotConfig::load(&scenario.robot)?;
        scenario.check_wheels(&robot).map_err(refused)?;
        let field = match scenario.field.take() {
            Some(field) => folder.join(field),
            None => robot.field.clone(),
        };
        places::check_places(&scenario, &robot, &Field::load(&field)?).map_err(refused)?;
        scenario.field = Some(field);
        Ok((scenario, robot))
    }

    /// The first key with an invalid value, and the reason.
    fn check(&self) -> Result<(), (String, String)> {
        bounds::check_numbers(self)?;
        let refuse = |key: &str, reason: String| Err((key.to_owned(), reason));
        // At most one image per time step.
        let rate_max = (1.0 / f64::from(STEP)).round();
        if !(self.frame_rate_hz >= FRAME_RATE_MIN_HZ && self.frame_rate_hz <= rate_max) {
            let reason = format!(
                "invalid rate: {} (expected {FRAME_RATE_MIN_HZ} to {rate_max})",
                self.frame_rate_hz
            );
            return refuse("frame_rate_hz", reason);
        }
        let OthersConfig {
            opponents,
            mates,
            placed,
            ..
        } = &self.others;
        let others = [*opponents, *mates, placed.len(), self.squad.len()];
        let others = others.into_iter().fold(0, usize::saturating_add);
        if others > OTHERS_MAX {
            return refuse(
                "others",
                format!("too many robots: {others} (expected at most {OTHERS_MAX})"),
            );
        }
        if self.wheels.radius_scale.is_empty() {
            let reason = "no scale (expected one number per wheel)".to_owned();
            return refuse("wheels.radius_scale", reason);
        }
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

    /// The first key that is about a wheel that the robot does not have, and the reason.
    fn check_wheels(&self, robot: &RobotConfig) -> Result<(), (String, String)> {
        let base = robot.base.clone().unwrap_or_default();
        let wheels = base.wheel_angles_deg.len();
        let scales = self.wheels.radius_scale.len();
        if scales > wheels {
            let reason = format!("{scales} numbers (the robot has {wheels} wheels)");
            return Err(("wheels.radius_scale".to_owned(), reason));
        }
        for (index, fault) in self.faults.iter().enumerate() {
            if fault.kind == FaultKind::WheelStuck && fault.wheel >= wheels {
                let reason = format!(
                    "no such wheel: {} (the robot has {wheels}, counted from 0)",
                    fault.wheel
                );
                return Err((format!("faults[{index}].wheel"), reason));
            }
        }
        Ok(())
    }
}
