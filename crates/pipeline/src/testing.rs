//! Test helpers: cycles of arbitrary values, and functions to log and read them.

use std::sync::Arc;

use std::path::{Path, PathBuf};

use localize::advice::{Advice, MotionAdvice};
use localize::estimate::{Estimate, Fit, Mode, Reason};
use localize::flight::{BallMotionMode, Landing};
use localize::frames::At;
use localize::global_search::branch_and_bound::{Certificate, Hypothesis};
use localize::localizer::{SightingDirection, SightingOutcome};
use localize::map_correction::{MapCorrectionEstimate, TermEstimate, TermKind};
use localize::omni::Twist;
use localize::robot::ExposureSetting;
use localize::sample::{Compass, Imu, LinePoint, Odometry, VelocityCommand};
use localize::team::{self, TeamBall, TeamBallInSpace, TeamReport, TeamView, Teammate};
use localize::world::{
    AirborneState, BallInAir, BallSighting, FieldState, TeamColour, TrackedObject, WorldView,
};
use localize::{Field, Pose, Stamp};
use nalgebra::{Matrix3, Matrix4};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use vision::exposure::{ExposureCommand, ExposureStatus};
use vision::image::Image;
use vision::lines::detection::{LinePointDetection, RejectedCandidate, RejectionReason};
use vision::objects::ball::BallDetection;
use vision::objects::goals::{GoalDetection, GoalKind};
use vision::objects::rejection::{ObjectRejection, RejectedObject};
use vision::objects::robots::{ObstacleKind, RobotDetection};
use vision::objects::virtual_sensors::{Bumper, VirtualSensorReadings};
use vision::process::Detections;

use crate::cycle::{Cycle, Inputs, Timings};
use crate::log::read::LoggedCycle;

use crate::feed::Pace;
use crate::log::{Header, LogConfig, LogReader, LogStats, Recorder};
use crate::sample::GroundTruth;

/// Field of the sample recording.
pub fn field() -> Field {
    Field::load(&sample_recording().join("field.toml")).expect("a field")
}

/// The sample recording.
pub fn sample_recording() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../samples/sequence")
}

/// Arbitrary values, zeros of both signs and the smallest number among them.
struct RandomValues(ChaCha8Rng);

impl RandomValues {
    fn value(&mut self) -> f32 {
        match self.0.random_range(0..8) {
            0 => -0.0,
            1 => 0.0,
            2 => f32::from_bits(1),
            _ => self.0.random_range(-3.0_f32..3.0),
        }
    }

    fn values<const N: usize>(&mut self) -> [f32; N] {
        [(); N].map(|()| self.value())
    }

    fn at<F>(&mut self) -> At<F> {
        At::new(self.value(), self.value())
    }

    fn pose(&mut self) -> Pose {
        Pose::new(self.value(), self.value(), self.value())
    }

    fn matrix(&mut self) -> Matrix3<f32> {
        Matrix3::from_fn(|_, _| self.value())
    }

    fn inputs(&mut self, stamp: Stamp) -> Inputs {
        let mut odometry = || {
            let [dx, dy, dtheta, slip] = self.values();
            Odometry {
                stamp,
                dx,
                dy,
                dtheta,
                slip,
            }
        };
        Inputs {
            odometry: vec![odometry(), odometry(), odometry()],
            compass: vec![Compass {
                stamp,
                heading: self.value(),
                magnetic_field: Some([self.value(), self.value()]),
            }],
            imu: vec![Imu {
                stamp,
                specific_force: self.values(),
                angular_velocity: self.values(),
            }],
            commands: vec![VelocityCommand {
                stamp,
                twist: Twist {
                    x: self.value(),
                    y: self.value(),
                    theta: self.value(),
                },
            }],
            reports: vec![TeamReport {
                robot: 3,
                is_member: true,
                stamp,
                pose: Some(self.pose()),
                pose_std: self.values(),
                half_known: true,
                pose_by_markings: true,
                ball: Some(team::ReportedBall {
                    at: self.at(),
                    velocity: self.values(),
                    covariance: self.values(),
                    last_seen: stamp,
                }),
                obstacles: vec![team::ReportedObstacle {
                    at: self.at(),
                    covariance: self.values(),
                }],
                ball_sighting: Some(self.sighting()),
            }],
            truth: Some(GroundTruth {
                stamp,
                pose: self.pose(),
                ball: Some(self.at()),
                ball_height: self.value(),
                robots: vec![self.at()],
                robot_headings: Vec::new(),
                people: Vec::new(),
            }),
            image: None,
            exposure_setting: Some(ExposureSetting {
                exposure: self.value(),
                gain: self.value(),
            }),
            changed_config_toml: None,
            warm_start: None,
            setup_doubt: Some(Matrix3::from_fn(|_, _| self.value())),
            map_fit: None,
        }
    }

    fn detections(&mut self, number: u64) -> Detections {
        let mut line_point = || LinePointDetection {
            point: LinePoint {
                at: self.at(),
                std_radial: 0.01,
                std_tangential: -0.0,
            },
            position_px: [1.5, 2.5],
            contrast: self.value(),
            width: self.value(),
        };
        let line_points = (0..50).map(|_| line_point()).collect();
        Detections {
            line_points,
            rejected_candidates: vec![RejectedCandidate {
                position_px: self.values(),
                reason: RejectionReason::BeyondCarpet,
            }],
            ball: Some(BallDetection {
                at: self.at(),
                covariance: self.values(),
                on_ground: true,
                score: self.value(),
                position_px: self.values(),
                pixels: 99,
                distance: Some(self.values()),
            }),
            robots: vec![RobotDetection {
                at: self.at(),
                edge: self.at(),
                covariance: self.values(),
                width: self.value(),
                marker: number.is_multiple_of(2).then_some(TeamColour::Magenta),
                score: self.value(),
                position_px: self.values(),
                kind: ObstacleKind::Person,
            }],
            rejected_objects: vec![RejectedObject {
                position_px: self.values(),
                reason: ObjectRejection::NotAnObstacle,
                probability: self.value(),
            }],
            other_balls: vec![BallDetection {
                at: self.at(),
                covariance: self.values(),
                on_ground: true,
                score: self.value(),
                position_px: self.values(),
                pixels: 7,
                distance: None,
            }],
            goals: vec![GoalDetection {
                kind: GoalKind::Post,
                at: self.at(),
                covariance: self.values(),
                width: self.value(),
                score: self.value(),
                position_px: self.values(),
            }],
            virtual_sensors: VirtualSensorReadings {
                bumpers: vec![Bumper {
                    share: self.value(),
                    hit: true,
                }],
                blue_goal_px: Some(self.values()),
                ball_px: number.is_multiple_of(2).then(|| self.values()),
                kick: true,
                lens_px: Some(self.values()),
                lens_centred: Some(number.is_multiple_of(3)),
                ..VirtualSensorReadings::default()
            },
            carpet_end: vec![self.value(), f32::INFINITY],
            carpet_share: self.value(),
            colours_learned: number == 0,
        }
    }

    fn world(&mut self, stamp: Stamp, number: u64) -> WorldView {
        let mut object = |id| TrackedObject {
            id,
            at: self.at(),
            velocity: self.values(),
            covariance: Matrix4::from_fn(|_, _| self.value()),
            on_field: number.is_multiple_of(2).then(|| FieldState {
                at: self.at(),
                velocity: self.values(),
                covariance: Matrix4::from_fn(|_, _| self.value()),
            }),
            probability: self.value(),
            last_seen: stamp,
            team: [None, Some(TeamColour::Cyan), Some(TeamColour::Magenta)][number as usize % 3],
        };
        let (ball, robots) = (Some(object(7)), vec![object(8), object(9)]);
        WorldView {
            ball,
            robots,
            ball_in_air: number.is_multiple_of(2).then(|| BallInAir {
                probability: self.value(),
                from_robot: self.airborne(),
                on_field: Some(self.airborne()),
            }),
            ball_sighting: Some(self.sighting()),
        }
    }

    fn team(&mut self) -> TeamView {
        TeamView {
            ball: Some(TeamBall {
                at: self.at(),
                velocity: self.values(),
                covariance: self.values(),
                inliers: vec![1, 3],
                outliers: vec![2],
            }),
            teammates: [None, Some(true), Some(false)]
                .map(|agrees| Teammate {
                    robot: 3,
                    age: self.value(),
                    pose: Some(self.pose()),
                    ball_agrees: agrees,
                })
                .into(),
            half_log_odds: self.value(),
            triangulated: Some(TeamBallInSpace {
                mode: BallMotionMode::Flight,
                state: self.airborne(),
                inliers: vec![1, 2],
                outliers: vec![3],
            }),
            pose_by_markings: true,
            sightings: vec![team::JudgedSighting {
                robot: 3,
                direction: SightingDirection::OfMate,
                outcome: SightingOutcome::Ambiguous,
            }],
        }
    }

    fn sighting(&mut self) -> BallSighting {
        BallSighting {
            azimuth: self.value(),
            elevation: self.value(),
            std: self.values(),
            viewpoint_height: self.value(),
            distance: Some(self.values()),
        }
    }

    fn airborne(&mut self) -> AirborneState {
        AirborneState {
            at: self.values(),
            velocity: self.values(),
            covariance: self.values(),
            landing: Some(Landing {
                after: self.value(),
                at: self.values(),
                covariance: self.values(),
            }),
        }
    }

    fn exposure(&mut self, number: u64) -> ExposureStatus {
        let mut setting = || ExposureSetting {
            exposure: self.value(),
            gain: self.value(),
        };
        ExposureStatus {
            applied_setting: Some(setting()),
            command: number.is_multiple_of(4).then(|| ExposureCommand {
                setting: setting(),
                from_frame: number,
            }),
            searching: true,
            setting_changed_brightness: number.is_multiple_of(3),
            uncontrolled_light_change: false,
            entropy: self.value(),
            centre_brightness: self.value(),
        }
    }

    fn estimate(&mut self, stamp: Stamp, number: u64) -> Estimate {
        let lost = number.is_multiple_of(3);
        Estimate {
            stamp,
            pose: (!lost).then(|| self.pose()),
            covariance: self.matrix(),
            repeated_covariance: self.matrix(),
            mode: [Mode::Lost, Mode::Tracking, Mode::Global][number as usize % 3],
            reason: lost.then_some(Reason::NoMatch),
            inlier_rms: self.value(),
            inlier_share: self.value(),
            line_points: 50,
            tilt: self.values(),
            half_known: number.is_multiple_of(2),
            odometry_scales: self.values(),
            odometry_correction: [self.values(), self.values(), self.values()],
            twist: (!lost).then(|| Twist {
                x: self.value(),
                y: self.value(),
                theta: self.value(),
            }),
            collision: number.is_multiple_of(2),
            gyro_bias: self.value(),
            latency: self.value(),
            fit: Fit {
                on_markings: self.value(),
                inlier_rms: self.value(),
                markings_seen: self.value(),
                wheel_agreement: (!lost).then(|| self.value()),
                compass_agreement: lost.then(|| self.value()),
            },
            map_correction: number.is_multiple_of(2).then(|| MapCorrectionEstimate {
                terms: [TermKind::MirrorTiltX, TermKind::Range(3)]
                    .map(|kind| TermEstimate {
                        kind,
                        value: self.value(),
                        std: self.value(),
                    })
                    .into(),
                images: 7,
                knocks: 1,
                displacement_at_3_m: self.value(),
                displacement_std_at_3_m: self.value(),
            }),
            runners_up: vec![Hypothesis {
                pose: self.pose(),
                covariance: self.matrix(),
                score: self.value(),
                inlier_share: self.value(),
                inlier_rms: self.value(),
                tilt: self.values(),
                probability: self.value(),
            }],
            certificate: lost.then(|| Certificate {
                points: 40,
                answer_share: self.value(),
                others_share_max: self.value(),
                unlisted_share_max: self.value(),
                is_attained: number.is_multiple_of(2),
            }),
            advice: match number % 3 {
                0 => None,
                1 => Some(Advice::ObserveHalf),
                _ => Some(Advice::Move(MotionAdvice {
                    motion: self.values(),
                    expected_log_odds: self.value(),
                })),
            },
        }
    }
}

/// A cycle of arbitrary values, the same for the same number.
pub fn random_cycle(number: u64) -> Cycle {
    let mut any = RandomValues(ChaCha8Rng::seed_from_u64(number));
    let stamp = Stamp(33_333_333 * number as i64);
    let seen = any.detections(number);
    Cycle {
        stamp,
        inputs: Inputs {
            image: Some(random_image(number).into()),
            ..any.inputs(stamp)
        },
        line_points: seen.line_points.iter().map(|seen| seen.point).collect(),
        detections: Some(seen),
        estimate: any.estimate(stamp, number),
        world: any.world(stamp, number),
        team: any.team(),
        exposure: number.is_multiple_of(2).then(|| any.exposure(number)),
        image_fault: None,
        timings: Timings {
            see_ms: 0.25,
            localize_ms: 0.0625,
        },
    }
}

/// picture
pub fn random_image(number: u64) -> Image {
    let mut rng = ChaCha8Rng::seed_from_u64(number);
    Image {
        width_px: 64,
        height_px: 48,
        rgb: (0..3 * 64 * 48).map(|_| rng.random()).collect(),
    }
}

/// Records cycles to a log.
pub fn record(path: &Path, count: u64, config: &LogConfig) -> LogStats {
    let header = Header::new("test", Some(7)).with_file("robot.toml", "field = \"field.toml\"\n");
    let mut recorder =
        Recorder::create(path, &header, &field(), Pace::Lockstep, config).expect("a recorder");
    for number in 0..count {
        recorder
            .record_cycle(Arc::new(random_cycle(number)))
            .expect("taken");
    }
    recorder.finish().expect("written")
}

/// Reads all cycles of a log.
pub fn read(path: &Path) -> Vec<LoggedCycle> {
    LogReader::open(path)
        .expect("a log")
        .collect::<anyhow::Result<_>>()
        .expect("cycles")
}

/// The error message of a log that cannot be read to its end.
pub fn read_error(path: &Path) -> String {
    let read = LogReader::open(path).and_then(|log| log.collect::<anyhow::Result<Vec<_>>>());
    format!("{:#}", read.map(|_| ()).expect_err("an error"))
}
