//! Is the ball in the air? Its sightings as rays in the odometry frame, and the tracked flight in the robot's and the field's.

use nalgebra::{Matrix2, Matrix3, Matrix6, SMatrix};

use super::observation::{Measurement, ObjectObservation, OdometryFrame};
use crate::flight::{
    BallMotionState, BallRay, FlightConfig, FlightTracker, Landing, TrackedFlight, predict_landing,
    ray_from_ground_point,
};
use crate::frames::{At, Pose, RobotFrame, Tf, wrap_angle};
use crate::math;
use crate::stamp::Stamp;
use crate::tilt::ground_from_map;

/// The direction in which the ball was seen in an image, robot frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BallSighting {
    /// Radians counter-clockwise from the robot's x axis.
    pub azimuth: f32,
    /// Angle above the horizontal at the viewpoint, radians.
    pub elevation: f32,
    /// Standard deviations of both, radians.
    pub std: [f32; 2],
    /// Height of the viewpoint above the ground, metres.
    pub viewpoint_height: f32,
    /// Distance of the centre by the apparent size, and its standard deviation, metres.
    pub distance: Option<[f32; 2]>,
}

/// A ball in the air.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BallInAir {
    /// Probability that it is in the air, 0 to 1.
    pub probability: f32,
    /// Robot frame; velocities are those over the ground.
    pub from_robot: AirborneState,
    /// Field frame; None while the robot is lost.
    pub on_field: Option<AirborneState>,
}

/// Position and velocity of a ball in the air.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AirborneState {
    /// x, y and height of its centre, metres.
    pub at: [f32; 3],
    /// m/s, the third upwards.
    pub velocity: [f32; 3],
    /// Covariance of the position: xx, xy, xz, yy, yz, zz, m².
    pub covariance: [f32; 6],
    /// Its next contact with the ground.
    pub landing: Option<Landing>,
}

/// Follows the ball in the odometry frame.
#[derive(Debug, Clone)]
pub(super) struct AirborneBall {
    config: FlightConfig,
    tracker: FlightTracker,
}

/// The flight at the last sighting, odometry frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct TrackedAirborne {
    probability: f32,
    state: BallMotionState,
    landing: Option<Landing>,
}

impl TrackedAirborne {
    /// Replaces the ground point of a detection by the point below the ball.
    pub(super) fn move_measurement(
        &self,
        measurement: &mut Measurement,
        robot_from_odometry: Tf<RobotFrame, OdometryFrame>,
    ) {
        let [x, y, ..] = self.state.state;
        let p = &self.state.covariance;
        measurement.at = At::new(x as f32, y as f32);
        measurement.in_robot_frame = robot_from_odometry * measurement.at;
        measurement.covariance = Matrix2::new(
            p[(0, 0)] as f32,
            p[(0, 1)] as f32,
            p[(1, 0)] as f32,
            p[(1, 1)] as f32,
        );
    }

    /// The flight relative to the robot and on the field.
    pub(super) fn output(
        &self,
        robot_from_odometry: Tf<RobotFrame, OdometryFrame>,
        pose: Option<(Pose, Matrix3<f32>)>,
    ) -> BallInAir {
        let robot_origin = robot_from_odometry * At::<OdometryFrame>::new(0.0, 0.0);
        let from_robot = AirborneState::new(&self.state, self.landing)
            .transformed(robot_from_odometry.theta, [robot_origin.x, robot_origin.y]);
        let on_field = pose.map(|(pose, covariance)| {
            let mut on_field = from_robot.transformed(pose.theta, [pose.x, pose.y]);
            on_field.add_pose_covariance(&pose, &covariance);
            on_field
        });
        BallInAir {
            probability: self.probability,
            from_robot,
            on_field,
        }
    }
}

impl AirborneBall {
    pub(super) fn new(config: &FlightConfig) -> Self {
        AirborneBall {
            config: config.clone(),
            tracker: FlightTracker::new(config.clone()),
        }
    }

    pub(super) fn reset(&mut self) {
        self.tracker.reset();
    }

    /// The direction of a detected ball; `tilt_std`: of the remaining tilt, radians.
    pub(super) fn sighting(
        &self,
        ball: &ObjectObservation,
        tilt: [f32; 2],
        tilt_std: f32,
        viewpoint_height: f32,
    ) -> Option<BallSighting> {
        let at = ground_from_map([ball.at.x, ball.at.y], tilt, viewpoint_height);
        let radius = self.config.ball_radius;
        let ([azimuth, elevation], stds) =
            ray_from_ground_point(at, ball.covariance, viewpoint_height, radius)?;
        let finite = azimuth.is_finite() && elevation.is_finite();
        finite.then_some(BallSighting {
            azimuth,
            elevation,
            std: stds.map(|std| math::hypot(std, tilt_std).max(STD_MIN)),
            viewpoint_height,
            distance: ball
                .distance
                .filter(|[distance, std]| distance.is_finite() && *std > 1e-3 && std.is_finite()),
        })
    }

    /// Adds a sighting; the flight, if the ball is more probably in the air than on the ground.
    pub(super) fn update(
        &mut self,
        stamp: Stamp,
        sighting: &BallSighting,
        odometry_from_robot: Tf<OdometryFrame, RobotFrame>,
    ) -> Option<TrackedAirborne> {
        let origin = odometry_from_robot.origin();
        let tracked: TrackedFlight = self.tracker.update(&BallRay {
            stamp,
            origin: [origin.x, origin.y, sighting.viewpoint_height],
            azimuth: wrap_angle(sighting.azimuth + odometry_from_robot.theta),
            elevation: sighting.elevation,
            azimuth_std: sighting.std[0],
            elevation_std: sighting.std[1],
            distance: sighting.distance,
        })?;
        let state = tracked.in_air?;
        (tracked.airborne_probability > 0.5).then_some(TrackedAirborne {
            probability: tracked.airborne_probability,
            state,
            landing: (tracked.flight).and_then(|flight| predict_landing(&flight, &self.config)),
        })
    }
}

/// No direction is known better, radians: a tenth of a pixel.
const STD_MIN: f32 = 5e-4;

impl AirborneState {
    /// A state with its next contact with the ground.
    pub(crate) fn new(state: &BallMotionState, landing: Option<Landing>) -> Self {
        let p: &Matrix6<f64> = &state.covariance;
        let entry = |row: usize, column: usize| p[(row, column)] as f32;
        let [x, y, z, vx, vy, vz] = state.state.map(|value| value as f32);
        AirborneState {
            at: [x, y, z],
            velocity: [vx, vy, vz],
            covariance: [
                entry(0, 0),
                entry(0, 1),
                entry(0, 2),
                entry(1, 1),
                entry(1, 2),
                entry(2, 2),
            ],
            landing,
        }
    }

    /// Rotated about the vertical, then moved.
    fn transformed(&self, theta: f32, [dx, dy]: [f32; 2]) -> Self {
        let (sin, cos) = math::sin_cos(theta);
        let turn = |x: f32, y: f32| [cos * x - sin * y, sin * x + cos * y];
        let [x, y, z] = self.at;
        let [vx, vy, vz] = self.velocity;
        let [px, py] = turn(x, y);
        let [wx, wy] = turn(vx, vy);
        let [xx, xy, xz, yy, yz, zz] = self.covariance;
        let [turned_xx, turned_xy, turned_yy] = turned_covariance([xx, xy, yy], sin, cos);
        let [turned_xz, turned_yz] = turn(xz, yz);
        AirborneState {
            at: [px + dx, py + dy, z],
            velocity: [wx, wy, vz],
            covariance: [turned_xx, turned_xy, turned_xz, turned_yy, turned_yz, zz],
            landing: self.landing.map(|landing| {
                let [x, y] = turn(landing.at[0], landing.at[1]);
                Landing {
                    at: [x + dx, y + dy],
                    covariance: turned_covariance(landing.covariance, sin, cos),
                    ..landing
                }
            }),
        }
    }

    fn add_pose_covariance(&mut self, pose: &Pose, covariance: &Matrix3<f32>) {
        let added = |at: [f32; 2]| {
            let mut by_pose = SMatrix::<f32, 2, 3>::identity();
            (by_pose[(0, 2)], by_pose[(1, 2)]) = (pose.y - at[1], at[0] - pose.x);
            by_pose * covariance * by_pose.transpose()
        };
        let here = added([self.at[0], self.at[1]]);
        self.covariance[0] += here[(0, 0)];
        self.covariance[1] += here[(0, 1)];
        self.covariance[3] += here[(1, 1)];
        if let Some(landing) = &mut self.landing {
            let there = added(landing.at);
            landing.covariance[0] += there[(0, 0)];
            landing.covariance[1] += there[(0, 1)];
            landing.covariance[2] += there[(1, 1)];
        }
    }
}

fn turned_covariance([xx, xy, yy]: [f32; 3], sin: f32, cos: f32) -> [f32; 3] {
    [
        cos * cos * xx - 2.0 * cos * sin * xy + sin * sin * yy,
        cos * sin * (xx - yy) + (cos * cos - sin * sin) * xy,
        sin * sin * xx + 2.0 * cos * sin * xy + cos * cos * yy,
    ]
}
