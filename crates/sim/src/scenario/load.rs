//! Is this file a scenario? Read, checked key by key, its paths resolved.

use std::path::{Path, PathBuf};

use localize::robot::RobotConfig;
use localize::toml_location::key_location;

use super::{RadioConfig, Scenario};
use crate::world::STEP;

/// Why there is no scenario.
#[derive(Debug, thiserror::Error)]
pub enum ScenarioError {
    /// The file cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's word.
        source: std::io::Error,
    },
    /// The file is not a scenario.
    #[error("{}: {source}", path.display())]
    Parse {
        /// The file.
        path: PathBuf,
        /// Line and reason.
        source: Box<toml::de::Error>,
    },
    /// A value that no scenario can have.
    #[error("{place}: {key}: {reason}")]
    Value {
        /// The file, and the line where there is one.
        place: String,
        /// The key in the file.
        key: String,
        /// What is wrong with it.
        reason: String,
    },
    /// The robot file it names.
    #[error(transparent)]
    Robot(#[from] localize::robot::RobotConfigError),
}

impl ScenarioError {
    fn parse(path: &Path, source: toml::de::Error) -> Self {
        ScenarioError::Parse {
            path: path.to_owned(),
            source: Box::new(source),
        }
    }
}

/// Places and headings beyond this (metres, degrees) are slips of the pen.
const COORDINATE_MAX: f32 = 1000.0;

/// More than five against five and a referee is no game.
const OTHERS_MAX: usize = 10;

impl Scenario {
    /// Reads and checks a scenario file and its robot file; paths come back relative to the working folder.
    pub fn load(path: &Path) -> Result<(Self, RobotConfig), ScenarioError> {
        let text = std::fs::read_to_string(path).map_err(|source| ScenarioError::Read {
            path: path.to_owned(),
            source,
        })?;
        toml::from_str::<Scenario>(&text)
            .map_err(|source| ScenarioError::parse(path, source))?
            .check_and_resolve(path, &text)
    }

    /// From a scenario file's table, single values of which may have been changed; `path` is that file.
    pub fn from_table(
        table: toml::Table,
        path: &Path,
    ) -> Result<(Self, RobotConfig), ScenarioError> {
        let scenario: Scenario = table
            .try_into()
            .map_err(|source| ScenarioError::parse(path, source))?;
        scenario.check_and_resolve(path, "")
    }

    /// Checks it and reads its robot; `text`: what the file says, for the line of what is refused.
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

    /// The first key whose value makes no scenario, and why.
    fn check(&self) -> Result<(), (String, String)> {
        let refuse = |key: &str, reason: String| Err((key.to_owned(), reason));
        if !(self.duration.is_finite() && self.duration > 0.0) {
            return refuse(
                "duration",
                format!("{} must be a positive number of seconds", self.duration),
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
                return refuse(key, format!("{value} must be a positive number"));
            }
        }
        // The world goes on in steps, and no two images are of the same one.
        let most = (1.0 / f64::from(STEP)).round();
        if self.frame_rate_hz > most {
            let reason = format!("{} must be at most {most}", self.frame_rate_hz);
            return refuse("frame_rate_hz", reason);
        }
        let [ball_x, ball_y] = self.ball.position;
        for (key, value) in [
            ("start.x", self.start.x),
            ("start.y", self.start.y),
            ("start.theta_deg", self.start.theta_deg),
            ("ball.position", ball_x),
            ("ball.position", ball_y),
        ] {
            if !(value.abs() <= COORDINATE_MAX) {
                return refuse(
                    key,
                    format!("{value} must be a number up to ±{COORDINATE_MAX}"),
                );
            }
        }
        if !(0.0..=1.0).contains(&self.ball.restitution) {
            return refuse(
                "ball.restitution",
                format!("{} must lie between 0 and 1", self.ball.restitution),
            );
        }
        let others =
            self.others.opponents + self.others.mates + self.others.placed.len() + self.squad.len();
        let RadioConfig {
            rate_hz,
            loss,
            delay: [soonest, latest],
        } = self.radio;
        let delayed = 0.0 <= soonest && soonest <= latest && latest <= 10.0;
        let spoken = rate_hz > 0.0 && rate_hz <= 1000.0;
        if !(spoken && delayed && (0.0..=1.0).contains(&loss)) {
            return refuse(
                "radio",
                "wants rate_hz above 0, to 1000, loss from 0 to 1, delay from 0 to 10 in order"
                    .to_owned(),
            );
        }
        if others > OTHERS_MAX {
            return refuse(
                "others",
                format!("{others} robots: at most {OTHERS_MAX} are simulated"),
            );
        }
        let radius_ok = |scale: &f32| scale.is_finite() && *scale > 0.0;
        if self.wheels.radius_scale.is_empty() || !self.wheels.radius_scale.iter().all(radius_ok) {
            return refuse(
                "wheels.radius_scale",
                "wants one positive number a wheel".to_owned(),
            );
        }
        for (index, occlusion) in self.occlusions.iter().enumerate() {
            if !(occlusion.start <= occlusion.stop && occlusion.width_deg >= 0.0) {
                let key = format!("occlusions[{index}]");
                return Err((
                    key,
                    "must stop after its start and have a width of at least 0".to_owned(),
                ));
            }
        }
        for (index, fault) in self.faults.iter().enumerate() {
            if !(fault.start <= fault.stop) {
                return Err((
                    format!("faults[{index}]"),
                    "must stop after its start".to_owned(),
                ));
            }
        }
        self.film
            .check()
            .map_err(|(key, reason)| (format!("film.{key}"), reason))?;
        self.light
            .check()
            .map_err(|(key, reason)| (format!("light.{key}"), reason))
    }
}
