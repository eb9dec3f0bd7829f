//! How accurate is each sensor fusion? Simulated drives with wheel slip, pushes, tilt, vision loss and latency.
//!
//! Dynamics, wheels, inertial unit and compass are simulated. Line points are sampled at the true pose
//! (`localize::synthetic::drive`), since images would add vision's own errors. A seed determines the table.

mod disturbance;
mod recording;
mod score;

use localize::Field;
use localize::config::LocalizeConfig;
use localize::filter::FilterKind;
use localize::robot::RobotConfig;

pub use disturbance::{Disturbance, Estimator};
pub use score::FusionScore;

use crate::simulation::SimError;
use recording::{RecordedDrive, record_drive};
use score::{ScoreSums, run_dead_reckoning, run_localizer};

/// Seeds, durations and settings of the experiment.
#[derive(Debug, Clone)]
pub struct FusionExperiment {
    /// Seeds of each disturbance.
    pub seeds: std::ops::Range<u64>,
    /// Duration of a drive, seconds.
    pub duration: f64,
    /// Courses to drive.
    pub disturbances: Vec<Disturbance>,
    /// Estimators to score.
    pub estimators: Vec<Estimator>,
    /// Settings of localization; estimator and disturbance override some.
    pub localize: LocalizeConfig,
}

impl Default for FusionExperiment {
    fn default() -> Self {
        FusionExperiment {
            seeds: 0..3,
            duration: 90.0,
            disturbances: Disturbance::ALL.to_vec(),
            estimators: Estimator::ALL.to_vec(),
            localize: LocalizeConfig::default(),
        }
    }
}

impl FusionExperiment {
    /// Drives every disturbance with every seed and scores every estimator on the same samples.
    ///
    /// `robot` needs a camera and a mirror, as in any simulation.
    pub fn run(&self, robot: &RobotConfig, field: &Field) -> Result<Vec<FusionScore>, SimError> {
        let mut rows = Vec::new();
        for &disturbance in &self.disturbances {
            let mut scores = vec![ScoreSums::default(); self.estimators.len()];
            for seed in self.seeds.clone() {
                let drive = record_drive(disturbance, seed, self.duration, robot, field)?;
                for (sums, &estimator) in scores.iter_mut().zip(&self.estimators) {
                    self.score_estimator(disturbance, estimator, &drive, field, sums);
                }
            }
            for (sums, &estimator) in scores.iter().zip(&self.estimators) {
                rows.push(sums.score(disturbance, estimator));
            }
        }
        Ok(rows)
    }

    fn score_estimator(
        &self,
        disturbance: Disturbance,
        estimator: Estimator,
        drive: &RecordedDrive,
        field: &Field,
        sums: &mut ScoreSums,
    ) {
        if estimator == Estimator::Odometry {
            run_dead_reckoning(drive, sums);
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
        match disturbance {
            Disturbance::Late => config.filter.camera_latency = recording::LATENCY,
            Disturbance::UnknownLatency => config.filter.camera_latency_std = 0.05,
            _ => {}
        }
        run_localizer(estimator, config, drive, field, sums);
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
            disturbances: vec![Disturbance::Hits, Disturbance::Blind],
            estimators: vec![
                Estimator::Joint,
                Estimator::Decentralised,
                Estimator::Vision,
                Estimator::Odometry,
            ],
            ..FusionExperiment::default()
        };
        let rows = run(&experiment);
        for disturbance in rows.chunks(experiment.estimators.len()) {
            let joint = &disturbance[0];
            assert!(joint.position < 0.015, "{joint:?}");
            assert!(joint.heading_deg < 0.3 && joint.searched == 0, "{joint:?}");
            assert!(joint.blind.is_none_or(|blind| blind < 0.05), "{joint:?}");
            for other in &disturbance[1..] {
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
            disturbances: vec![Disturbance::All],
            estimators: vec![Estimator::Joint, Estimator::NoImu],
            ..FusionExperiment::default()
        });
        let joint = &rows[0];
        assert!(joint.blind.is_some_and(|blind| blind < 0.05), "{rows:?}");
        assert!(joint.blind_max.is_some_and(|most| most < 0.1), "{rows:?}");
        assert!(joint.position < 0.01 && joint.searched == 0, "{rows:?}");
        assert!((1.0..5.0).contains(&joint.nees), "{rows:?}");
        // Without an inertial unit only the wheels measure the yaw rate.
        assert!(rows[1].blind.is_some_and(|blind| blind > 0.1), "{rows:?}");
    }

    #[test]
    fn unknown_latency_is_estimated_within_10_ms() {
        let rows = run(&FusionExperiment {
            seeds: 2..3,
            duration: 30.0,
            disturbances: vec![Disturbance::UnknownLatency],
            estimators: vec![Estimator::Joint],
            ..FusionExperiment::default()
        });
        assert!(
            (rows[0].latency - recording::LATENCY).abs() < 0.01,
            "{rows:?}"
        );
    }
}
