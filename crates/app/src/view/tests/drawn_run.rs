//! The run that the pictures show: images and motion of the sample recording, all results by formula. So a picture changes
//! when its panel draws something else, not when vision or localization computes something else.

use std::sync::OnceLock;

use localize::estimate::{Estimate, Fit, Mode, Reason};
use localize::field::marking_points;
use localize::global_search::branch_and_bound::Hypothesis;
use localize::map_correction::{MapCorrectionEstimate, TermEstimate, TermKind};
use localize::omni::Twist;
use localize::robot::ExposureSetting;
use localize::sample::{Imu, LinePoint};
use localize::team::{TeamBall, TeamView, Teammate};
use localize::tilt::map_from_ground;
use localize::world::{FieldState, TeamColour, TrackedObject, WorldView};
use localize::{At, FieldFrame, Stamp};
use nalgebra::{Matrix3, Matrix4, Vector3};
use pipeline::recording::Recording;
use pipeline::sample::{GroundTruth, ImageContent, Sample};
use pipeline::setup::Setup;
use pipeline::{Inputs, Timings};
use vision::exposure::ExposureStatus;
use vision::lines::detection::{LinePointDetection, RejectedCandidate, RejectionReason};
use vision::objects::ball::BallDetection;
use vision::objects::goals::{GoalDetection, GoalKind};
use vision::objects::robots::{ObstacleKind, RobotDetection};
use vision::process::Detections;

use super::*;
use crate::view::static_scene::{CameraModel, StaticScene};

/// The image that cannot be used, the one in which the pose is unknown, and those in which it is wrong.
const TORN: usize = 5;
const LOST: usize = 9;
const WRONG: std::ops::Range<usize> = 13..16;
/// Distances at which line points and objects are seen, metres.
const SEEN: std::ops::Range<f32> = 0.5..5.5;
/// Tilt of the robot (a, b), radians: what it sees lies beside its place on the upright map.
const TILT: [f32; 2] = [0.001, -0.001];
/// Spacing of the line points along the markings, metres.
const POINT_SPACING: f32 = 0.25;

/// The sample recording.
fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../samples/sequence")
}

/// The log of the run, recorded once.
pub(super) fn drawn_log() -> &'static Path {
    static LOG: OnceLock<(tempfile::TempDir, PathBuf)> = OnceLock::new();
    let (_, path) = LOG.get_or_init(|| {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("drawn.mcap");
        record_cycles(&path, &cycles());
        (folder, path)
    });
    path
}

fn setup() -> Setup {
    Setup::load(&folder().join("robot.toml"), None).expect("the sample's robot")
}

fn record_cycles(path: &Path, cycles: &[Cycle]) {
    let config = PipelineConfig::default();
    let log = LogConfig {
        images: ImageCompression::Png,
        ..LogConfig::default()
    };
    let mut recorder =
        start_log(path, "drawn run", Some(1), (&setup(), &config), &log).expect("a log");
    for cycle in cycles {
        recorder
            .record_cycle(Arc::new(cycle.clone()))
            .expect("written");
    }
    recorder.finish().expect("closed");
}

/// The cycles of the run.
pub(super) fn cycles() -> Vec<Cycle> {
    let recording = Recording::open(&folder(), 0.04).expect("the sample recording");
    let scene = StaticScene::new(setup());
    let (mut inputs, mut cycles) = (Inputs::default(), Vec::new());
    for sample in recording {
        match sample {
            Sample::Odometry(odometry) => inputs.odometry.push(odometry),
            Sample::Compass(compass) => inputs.compass.push(compass),
            Sample::GroundTruth(truth) => inputs.truth = Some(truth),
            Sample::Image(image) => {
                if let ImageContent::Pixels(pixels) = image.content {
                    inputs.image = Some(pixels);
                }
                inputs.imu = imu_readings(cycles.len(), image.stamp);
                let inputs = std::mem::take(&mut inputs);
                cycles.push(cycle(cycles.len(), image.stamp, inputs, &scene));
            }
            _ => {}
        }
    }
    cycles
}

/// A value in −1 to 1 that changes from cycle to cycle.
fn wave(number: usize, phase: f32) -> f32 {
    localize::math::sin(0.9 * number as f32 + phase)
}

fn imu_readings(number: usize, stamp: Stamp) -> Vec<Imu> {
    let reading = |part: i64| Imu {
        stamp: Stamp(stamp.0 - 25_000_000 * part),
        specific_force: [0.4 * wave(number, 0.1), 0.3 * wave(number, 0.7), 9.81],
        angular_velocity: [0.0, 0.01 * part as f32, 0.5 * wave(number, 0.2)],
    };
    (0..4).rev().map(reading).collect()
}

fn cycle(number: usize, stamp: Stamp, inputs: Inputs, scene: &StaticScene) -> Cycle {
    let truth = inputs.truth.clone().expect("a true pose");
    let camera = scene.camera.as_ref().expect("a camera");
    let seen = (number != TORN).then(|| detections(number, &truth, scene, camera));
    let estimate = estimate(number, stamp, truth.pose);
    let (world, team) = (world(&truth, stamp), team(number, &truth));
    let line_points = seen.iter().flat_map(|seen| &seen.line_points);
    Cycle {
        line_points: line_points.map(|seen| seen.point).collect(),
        detections: seen,
        world,
        team,
        exposure: Some(ExposureStatus {
            entropy: 14.0 + 0.3 * wave(number, 0.0),
            centre_brightness: 80.0 + 4.0 * wave(number, 1.0),
            applied_setting: Some(ExposureSetting {
                exposure: 1.0,
                gain: 1.5,
            }),
            searching: false,
            command: None,
            setting_changed_brightness: false,
            uncontrolled_light_change: false,
        }),
        image_fault: (number == TORN).then(|| "torn".to_owned()),
        timings: Timings {
            see_ms: 1.4 + 0.2 * wave(number, 2.0),
            localize_ms: 0.3 + 0.1 * wave(number, 3.0),
        },
        estimate,
        ..Cycle::from_inputs(stamp, inputs, Matrix3::identity())
    }
}

fn estimate(number: usize, stamp: Stamp, truth: Pose) -> Estimate {
    let error = if WRONG.contains(&number) { 0.6 } else { 0.02 };
    let pose = Pose::new(
        truth.x + error * (1.0 + 0.5 * wave(number, 0.0)),
        truth.y - 0.02 * wave(number, 1.0),
        truth.theta + 0.01 * wave(number, 2.0),
    );
    let std = Vector3::new(0.03, 0.04 + 0.01 * wave(number, 0.5), 0.01);
    let covariance = Matrix3::from_diagonal(&std.component_mul(&std));
    let half_turned = Hypothesis {
        pose: Pose::new(-pose.x, -pose.y, pose.theta + std::f32::consts::PI),
        covariance,
        score: 0.8,
        inlier_share: 0.9,
        inlier_rms: 0.03,
        tilt: [0.0; 2],
        probability: 0.12,
    };
    let terms = [
        (TermKind::MirrorTiltX, 0.004, 0.001),
        (TermKind::MirrorOffsetY, -0.0012, 0.0004),
        (TermKind::FocalLength, 0.006, 0.002),
    ];
    let known = Estimate {
        mode: Mode::Tracking,
        inlier_rms: 0.03 + 0.01 * wave(number, 1.5),
        inlier_share: 0.93 + 0.05 * wave(number, 2.5),
        tilt: TILT,
        twist: Some(Twist {
            x: 1.5,
            y: -0.4,
            theta: 0.3 * wave(number, 0.2),
        }),
        gyro_bias: 0.002,
        fit: Fit {
            on_markings: 0.94,
            inlier_rms: 0.031,
            markings_seen: 0.71,
            wheel_agreement: Some(0.98),
            compass_agreement: Some(0.9),
        },
        map_correction: Some(MapCorrectionEstimate {
            terms: terms
                .map(|(kind, value, std)| TermEstimate { kind, value, std })
                .into(),
            images: 40,
            knocks: 0,
            // Not in use: the overlay is that of the given map.
            displacement_at_3_m: 0.0,
            displacement_std_at_3_m: 0.012,
        }),
        runners_up: vec![half_turned],
        ..Estimate::tracked(stamp, pose, covariance)
    };
    if number == LOST {
        return Estimate {
            pose: None,
            mode: Mode::Lost,
            reason: Some(Reason::NoMatch),
            twist: None,
            ..known
        };
    }
    known
}

/// What lies on the field at `truth.pose`, as the camera sees it.
fn detections(
    number: usize,
    truth: &GroundTruth,
    scene: &StaticScene,
    camera: &CameraModel,
) -> Detections {
    let robot_from_field = truth.pose.inverse();
    let seen = |at: At<FieldFrame>| {
        let ground = robot_from_field * at;
        let range = ground.x.hypot(ground.y);
        let pixel = camera.project(ground, TILT, None)?;
        let [x, y] = map_from_ground([ground.x, ground.y], TILT, camera.viewpoint_height)?;
        SEEN.contains(&range).then_some((At::new(x, y), pixel))
    };
    let line_point = |(place, at): (usize, At<FieldFrame>)| {
        let aside = 0.03 * wave(place + number, 0.0);
        let (point, position_px) = seen(At::new(at.x + aside, at.y - aside))?;
        Some(LinePointDetection {
            point: LinePoint {
                at: point,
                std_radial: 0.02,
                std_tangential: 0.01,
            },
            position_px,
            contrast: 60.0,
            width: 0.125,
        })
    };
    let marking = marking_points(&scene.field.markings, POINT_SPACING);
    let ball = truth
        .ball
        .and_then(seen)
        .map(|(at, position_px)| BallDetection {
            at,
            covariance: [0.01, 0.0, 0.01],
            on_ground: true,
            score: 0.9,
            position_px,
            pixels: 280,
            distance: None,
        });
    let robots = truth.robots.iter().filter_map(|&robot| {
        let (at, position_px) = seen(robot)?;
        Some(RobotDetection {
            at,
            edge: at,
            covariance: [0.02, 0.0, 0.02],
            width: 0.5,
            marker: Some(TeamColour::Magenta),
            score: 1.0,
            position_px,
            kind: ObstacleKind::Robot,
        })
    });
    let post = seen(At::new(-9.0, -1.0)).map(|(at, position_px)| GoalDetection {
        kind: GoalKind::Post,
        at,
        covariance: [0.02, 0.0, 0.02],
        width: 0.125,
        score: 0.8,
        position_px,
    });
    let rejected = [
        ([120.0, 210.0], RejectionReason::TooNarrow),
        ([330.0, 140.0], RejectionReason::TooWide),
        ([300.0, 380.0], RejectionReason::NotWhite),
    ];
    Detections {
        line_points: marking
            .into_iter()
            .enumerate()
            .filter_map(line_point)
            .collect(),
        rejected_candidates: rejected
            .map(|(position_px, reason)| RejectedCandidate {
                position_px,
                reason,
            })
            .into(),
        ball,
        robots: robots.collect(),
        goals: post.into_iter().collect(),
        carpet_share: 0.8,
        ..Detections::default()
    }
}

fn tracked(id: u32, truth: &GroundTruth, at: At<FieldFrame>, stamp: Stamp) -> TrackedObject {
    let (velocity, covariance) = ([0.8, 0.5], Matrix4::identity() * 0.02_f32);
    TrackedObject {
        id,
        at: truth.pose.inverse() * at,
        velocity,
        covariance,
        on_field: Some(FieldState {
            at,
            velocity,
            covariance,
        }),
        probability: 0.97,
        last_seen: stamp,
        team: Some(TeamColour::Magenta),
    }
}

fn world(truth: &GroundTruth, stamp: Stamp) -> WorldView {
    let robots = truth.robots.iter().zip(1..3);
    WorldView {
        ball: truth.ball.map(|ball| tracked(0, truth, ball, stamp)),
        robots: robots
            .map(|(robot, id)| tracked(id, truth, *robot, stamp))
            .collect(),
        ..WorldView::default()
    }
}

fn team(number: usize, truth: &GroundTruth) -> TeamView {
    TeamView {
        ball: truth.ball.map(|ball| TeamBall {
            at: At::new(ball.x + 0.1, ball.y - 0.05),
            velocity: [0.0; 2],
            covariance: [0.02, 0.0, 0.02],
            inliers: vec![1, 3],
            outliers: Vec::new(),
        }),
        teammates: vec![Teammate {
            robot: 3,
            age: 0.1 + 0.05 * (1.0 + wave(number, 0.0)),
            pose: Some(Pose::new(3.0, 2.5, -2.5)),
            ball_agrees: Some(true),
        }],
        ..TeamView::default()
    }
}
