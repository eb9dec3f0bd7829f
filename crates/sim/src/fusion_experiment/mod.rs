//! How well does each way of fusing know the robot's place? Simulated drives with slip, hits, leans, blindness, latency.
//!
//! Bodies, wheels, inertial unit and compass are the simulation's; line points are drawn from the true pose
//! (`localize::synthetic::drive`), since images would only add vision's own errors. One seed gives one table.

mod recording;
mod score;

use localize::Field;
use localize::config::LocalizeConfig;
use localize::filter::FilterKind;
use localize::robot::RobotConfig;
use serde::{Deserialize, Serialize};

use crate::simulation::SimError;
use recording::{RecordedDrive, record_drive};
use score::{ScoreSums, run_dead_reckoning, run_localizer};

/// What happens on a drive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Course {
    /// Waypoints at up to 2 m/s, wheels 3 % smaller than believed.
    Plain,
    /// The same with motors stronger than the wheels' grip.
    Slip,
    /// The same as plain with a hit every few seconds, wheels driving on.
    Hits,
    /// The robot leans by 0.45° in each direction, differently all the time.
    Lean,
    /// Two of every eight seconds without sight.
    Blind,
    /// Slip, hits, leans and blindness together.
    All,
    /// 3 m/s, frames stamped 80 ms after their exposure, as the configuration says.
    Late,
    /// The same, but the configuration does not know it.
    UnknownLatency,
}

impl Course {
    /// All of them, in the order of the table.
    pub const ALL: [Course; 8] = [
        Course::Plain,
        Course::Slip,
        Course::Hits,
        Course::Lean,
        Course::Blind,
        Course::All,
        Course::Late,
        Course::UnknownLatency,
    ];
}

/// Who says where the robot is?
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Estimator {
    /// The joint filter with every witness.
    Joint,
    /// minho2016's net of filters with every witness.
    Decentralised,
    /// The joint filter without inertial unit.
    NoImu,
    /// The joint filter without wheels.
    NoOdometry,
    /// Every frame by itself, with the compass.
    Vision,
    /// The wheels alone, from the true start.
    Odometry,
}

impl Estimator {
    /// All of them, in the order of the table.
    pub const ALL: [Estimator; 6] = [
        Estimator::Joint,
        Estimator::Decentralised,
        Estimator::NoImu,
        Estimator::NoOdometry,
        Estimator::Vision,
        Estimator::Odometry,
    ];
}

/// One line of the table: metres and degrees, over all seeds.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FusionScore {
    /// What happened.
    pub course: Course,
    /// Who estimated.
    pub estimator: Estimator,
    /// Frames with sight that were scored (two seconds after the start).
    pub frames: usize,
    /// Mean distance from the truth in them.
    pub position: f32,
    /// Largest.
    pub position_max: f32,
    /// Mean deviation of the heading.
    pub heading_deg: f32,
    /// Mean distance at the end of two seconds without sight; none where there is none.
    pub blind: Option<f32>,
    /// Largest of it.
    pub blind_max: Option<f32>,
    /// Mean over the hits of the largest distance in the second after each, in frames with sight.
    pub after_hit: Option<f32>,
    /// Mean deviation along the velocity, in frames with sight: what latency leaves.
    pub along: f32,
    /// Mean normalised error squared of frames with sight; 3 is honest.
    pub nees: f32,
    /// Share of frames with sight inside the 95 % band of χ² with three degrees of freedom.
    pub nees_inside: f32,
    /// Frames without a pose, or with one found by a search of the whole field.
    pub searched: usize,
    /// Largest deviation of the odometry's estimated scale from the true one, from 60 s on.
    pub scale_off: Option<f32>,
    /// Estimated latency at the end, seconds.
    pub latency: f32,
}

/// Seeds, lengths, and how localisation is set.
#[derive(Debug, Clone)]
pub struct FusionExperiment {
    /// Seeds of each course.
    pub seeds: std::ops::Range<u64>,
    /// Length of a drive, seconds.
    pub duration: f64,
    /// Courses to be driven.
    pub disturbances: Vec<Course>,
    /// Estimators to be judged.
    pub estimators: Vec<Estimator>,
    /// How localisation is set, but for the fusion and what the course asks.
    pub localize: LocalizeConfig,
}

impl Default for FusionExperiment {
    fn default() -> Self {
        let mut localize = LocalizeConfig::default();
        // Drawn points err independently; what frames repeat is the grid of the distance look-up alone.
        localize.filter.systematic_position_std = 0.0007;
        localize.filter.systematic_heading_std_deg = 0.02;
        FusionExperiment {
            seeds: 0..3,
            duration: 90.0,
            disturbances: Course::ALL.to_vec(),
            estimators: Estimator::ALL.to_vec(),
            localize,
        }
    }
}

impl FusionExperiment {
    /// Drives every course with every seed and judges every estimator on the same samples.
    ///
    /// `robot` needs camera and mirror, as for any simulation.
    pub fn run(&self, robot: &RobotConfig, field: &Field) -> Result<Vec<FusionScore>, SimError> {
        let mut rows = Vec::new();
        for &course in &self.disturbances {
            let mut scores = vec![ScoreSums::default(); self.estimators.len()];
            for seed in self.seeds.clone() {
                let drive = record_drive(course, seed, self.duration, robot, field)?;
                for (frames, &estimator) in scores.iter_mut().zip(&self.estimators) {
                    self.score_estimator(course, estimator, &drive, field, frames);
                }
            }
            for (frames, &estimator) in scores.iter().zip(&self.estimators) {
                rows.push(frames.score(course, estimator));
            }
        }
        Ok(rows)
    }

    fn score_estimator(
        &self,
        course: Course,
        estimator: Estimator,
        drive: &RecordedDrive,
        field: &Field,
        frames: &mut ScoreSums,
    ) {
        if estimator == Estimator::Odometry {
            run_dead_reckoning(drive, frames);
            return;
        }
        let mut config = match estimator {
            Estimator::Decentralised => LocalizeConfig {
                filter: localize::filter::FilterConfig {
                    kind: FilterKind::Decentralised,
                    ..self.localize.filter.clone()
                },
                ..self.localize.clone()
            },
            _ => self.localize.clone(),
        };
        match course {
            Course::Late => config.filter.camera_latency = recording::LATENCY,
            Course::UnknownLatency => config.filter.camera_latency_std = 0.05,
            _ => {}
        }
        run_localizer(estimator, config, drive, field, frames);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn run(experiment: &FusionExperiment) -> Vec<FusionScore> {
        let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config");
        let robot = RobotConfig::load(&config.join("robots/default.toml")).expect("a robot");
        let field = Field::load(&robot.field).expect("a field");
        experiment.run(&robot, &field).expect("drives")
    }

    #[test]
    fn joint_filter_beats_single_sensors_under_pushes_and_vision_loss() {
        let experiment = FusionExperiment {
            seeds: 1..2,
            duration: 20.0,
            disturbances: vec![Course::Hits, Course::Blind],
            estimators: vec![
                Estimator::Joint,
                Estimator::Decentralised,
                Estimator::Vision,
                Estimator::Odometry,
            ],
            ..FusionExperiment::default()
        };
        let rows = run(&experiment);
        for course in rows.chunks(experiment.estimators.len()) {
            let joint = &course[0];
            assert!(joint.position < 0.015, "{joint:?}");
            assert!(joint.heading_deg < 0.3 && joint.searched == 0, "{joint:?}");
            assert!(joint.blind.is_none_or(|blind| blind < 0.05), "{joint:?}");
            for other in &course[1..] {
                assert!(joint.position < other.position, "{joint:?}\n{other:?}");
            }
        }
        assert_eq!(rows, run(&experiment));
    }

    #[test]
    fn dead_reckoning_error_stays_below_10_cm_under_all_disturbances() {
        let rows = run(&FusionExperiment {
            seeds: 2..4,
            duration: 33.0,
            disturbances: vec![Course::All],
            estimators: vec![Estimator::Joint, Estimator::NoImu],
            ..FusionExperiment::default()
        });
        let joint = &rows[0];
        assert!(joint.blind.is_some_and(|blind| blind < 0.05), "{rows:?}");
        assert!(joint.blind_max.is_some_and(|most| most < 0.1), "{rows:?}");
        assert!(joint.position < 0.01 && joint.searched == 0, "{rows:?}");
        assert!((1.0..5.0).contains(&joint.nees), "{rows:?}");
        // Without an inertial unit the wheels' word is all there is.
        assert!(rows[1].blind.is_some_and(|blind| blind > 0.1), "{rows:?}");
    }

    #[test]
    fn unknown_latency_is_estimated_within_10_ms() {
        let rows = run(&FusionExperiment {
            seeds: 2..3,
            duration: 30.0,
            disturbances: vec![Course::UnknownLatency],
            estimators: vec![Estimator::Joint],
            ..FusionExperiment::default()
        });
        assert!(
            (rows[0].latency - recording::LATENCY).abs() < 0.01,
            "{rows:?}"
        );
    }
}
