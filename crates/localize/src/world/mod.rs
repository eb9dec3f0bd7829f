//! World model: tracks of the ball and of robots, from each image's detections and the pose.
//!
//! Objects are tracked in the odometry frame, which is continuous when the pose is corrected or lost: driving to the
//! ball needs no position on the field. The robot moves in it as localization found by all sensors, so that slipping wheels
//! move no object. Field coordinates follow from the pose and include its covariance. Stamps are
//! arguments, and equal inputs give equal bits.

mod airborne;
mod config;
mod existence;
mod motion;
mod observation;
mod odometry_buffer;
#[cfg(test)]
mod tests;
mod track;

use nalgebra::{Matrix2, Matrix3, Matrix4, SMatrix, Vector2, Vector3};

pub use airborne::{AirborneState, BallInAir, BallSighting};
pub use config::{ObjectTrackConfig, WorldConfig};
pub use observation::{ObjectObservation, OdometryFrame, TeamColour, WorldObservation};

use airborne::{AirborneBall, TrackedAirborne};
use observation::Measurement;
use odometry_buffer::OdometryBuffer;
use track::ObjectTrack;

use crate::estimate::Estimate;
use crate::frames::{At, FieldFrame, Pose, RobotFrame, Tf};
use crate::localizer::ImageMotion;
use crate::math;
use crate::sample::Odometry;
use crate::stamp::Stamp;
use crate::tilt::ground_from_map;

/// A tracked object at an image's stamp.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackedObject {
    /// Constant over the life of the track.
    pub id: u32,
    /// Position relative to the robot, metres.
    pub at: At<RobotFrame>,
    /// Its velocity over the ground in the robot's axes, m/s.
    pub velocity: [f32; 2],
    /// Covariance of position and velocity, robot frame: m², m²/s, m²/s².
    pub covariance: Matrix4<f32>,
    /// The same on the field; None while the robot is lost.
    pub on_field: Option<FieldState>,
    /// Probability of existence, 0 to 1.
    pub probability: f32,
    /// Stamp of the last detection.
    pub last_seen: Stamp,
    /// Its team's colour, by the majority of the detections.
    pub team: Option<TeamColour>,
}

/// An object in field coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FieldState {
    /// Metres.
    pub at: At<FieldFrame>,
    /// Its velocity, m/s.
    pub velocity: [f32; 2],
    /// Covariance of position and velocity, the pose's included: m², m²/s, m²/s².
    pub covariance: Matrix4<f32>,
}

/// All confirmed objects at an image's stamp.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct WorldView {
    /// The ball.
    pub ball: Option<TrackedObject>,
    /// Robots, the oldest track first.
    pub robots: Vec<TrackedObject>,
    /// The ball in the air. None if it is on the ground, or was not seen in this image. `ball` then is the point below it.
    pub ball_in_air: Option<BallInAir>,
    /// Direction in which the ball was seen in this image.
    pub ball_sighting: Option<BallSighting>,
}

/// Standard deviation of the wheels while no pose is known, as a multiple of the usual one: nothing then notices that they slip.
const LOST_ODOMETRY_FACTOR: f32 = 3.0;

/// Tracks objects from image to image.
#[derive(Debug, Clone)]
pub struct WorldModel {
    config: WorldConfig,
    /// Height of the viewpoint above the ground, metres: a tilt moves far objects by their squared distance over it.
    viewpoint_height: f32,
    motion: OdometryBuffer,
    balls: Vec<ObjectTrack>,
    robots: Vec<ObjectTrack>,
    airborne: AirborneBall,
    next_id: u32,
    last: Option<LastImage>,
}

/// Stamp and pose of the image before.
#[derive(Debug, Clone, Copy)]
struct LastImage {
    stamp: Stamp,
    pose: Option<Pose>,
}

impl WorldModel {
    /// A model without tracks; `viewpoint_height`: of the mirror above the ground, metres.
    pub fn new(config: WorldConfig, viewpoint_height: f32) -> Self {
        WorldModel {
            airborne: AirborneBall::new(&config.flight),
            config,
            viewpoint_height,
            motion: OdometryBuffer::default(),
            balls: Vec::new(),
            robots: Vec::new(),
            next_id: 0,
            last: None,
        }
    }

    /// Adds an odometry increment; in the order of stamps.
    pub fn add_odometry(&mut self, odometry: &Odometry) {
        self.motion.add(odometry);
    }

    /// Updates the tracks with an image's detections. `observation` is None if the image was not processed: tracks are
    /// then only predicted, and not counted as missed. `motion` is that of [`crate::Localizer::image_motion`]; without it
    /// the wheels move the robot.
    pub fn update(
        &mut self,
        stamp: Stamp,
        observation: Option<&WorldObservation>,
        estimate: &Estimate,
        motion: Option<&ImageMotion>,
    ) -> WorldView {
        let pose = estimate.pose;
        let Some(odometry_from_robot) = self.predict(stamp, estimate, motion) else {
            // An image older than the last one is ignored.
            return WorldView::default();
        };
        let (mut ball_sighting, mut airborne) = (None, None);
        if let Some(observation) = observation {
            (ball_sighting, airborne) =
                self.follow_flight(stamp, observation, estimate.tilt, odometry_from_robot);
            let airborne = airborne.as_ref();
            self.update_tracks(
                stamp,
                observation,
                estimate.tilt,
                odometry_from_robot,
                airborne,
            );
        }
        let config = &self.config;
        for (tracks, object) in [
            (&mut self.balls, &config.ball),
            (&mut self.robots, &config.robots),
        ] {
            tracks.retain(|track| track.is_kept(stamp, object));
        }
        let view = OutputTransform {
            robot_from_odometry: odometry_from_robot.inverse(),
            pose: pose.map(|pose| (pose, estimate.covariance)),
        };
        WorldView {
            ball: most_probable(&self.balls, &config.ball)
                .map(|track| view.tracked_object(track, &config.ball)),
            robots: self
                .robots
                .iter()
                .filter(|track| track.is_confirmed(&config.robots))
                .map(|track| view.tracked_object(track, &config.robots))
                .collect(),
            ball_in_air: airborne
                .map(|airborne| airborne.output(view.robot_from_odometry, view.pose)),
            ball_sighting,
        }
    }

    /// Predicts all tracks to an image's stamp; None if the image is older than the last one.
    fn predict(
        &mut self,
        stamp: Stamp,
        estimate: &Estimate,
        motion: Option<&ImageMotion>,
    ) -> Option<Tf<OdometryFrame, RobotFrame>> {
        let pose = estimate.pose;
        let gap = match self.last {
            Some(last) => last.stamp.seconds_until(stamp) as f32,
            None => 0.0,
        };
        if gap < -self.config.gap_max || gap > self.config.gap_max {
            // A clock was reset, or there were no images for long.
            self.balls.clear();
            self.robots.clear();
            self.airborne.reset();
            self.last = None;
        } else if gap < 0.0 {
            return None;
        }
        let before = self.motion.pose_at_image();
        let last_pose = self.last.and_then(|last| last.pose);
        let pose_increment = last_pose
            .zip(pose)
            .map(|(last, pose)| last.inverse() * pose);
        let correction = estimate.odometry_correction;
        let mut is_motion_known = self.motion.advance_to(stamp, pose_increment, correction);
        // One that began at another image is not the motion since the last one here.
        let motion = motion.filter(|motion| {
            motion.to == stamp && self.last.is_some_and(|last| last.stamp == motion.from)
        });
        let covariance = if let Some(ImageMotion { estimate, .. }) = motion {
            self.motion.set_pose_at_image(before * estimate.motion);
            is_motion_known = true;
            estimate.covariance
        } else {
            let step = before.inverse() * self.motion.pose_at_image();
            let is_lost = pose.is_none();
            self.wheel_motion_covariance(step, is_lost, is_motion_known, gap)
        };
        self.last = Some(LastImage { stamp, pose });
        if !is_motion_known {
            // A path in a frame that jumps is none.
            self.airborne.reset();
        }
        // In the axes of the odometry frame.
        let mut turn = Matrix3::identity();
        turn.fixed_view_mut::<2, 2>(0, 0)
            .copy_from(&rotation(before.theta));
        let covariance = turn * covariance * turn.transpose();
        let robot = self.motion.pose_at_image();
        let config = &self.config;
        for (tracks, object) in [
            (&mut self.balls, &config.ball),
            (&mut self.robots, &config.robots),
        ] {
            for track in tracks {
                track.predict(gap, robot.origin(), &covariance, object);
            }
        }
        Some(robot)
    }

    /// Covariance (x, y, θ) of a motion by the wheels alone, or of an unknown one.
    fn wheel_motion_covariance(
        &self,
        step: Tf<RobotFrame, RobotFrame>,
        is_lost: bool,
        is_known: bool,
        seconds: f32,
    ) -> Matrix3<f32> {
        let config = &self.config;
        let share = config.odometry_std * if is_lost { LOST_ODOMETRY_FACTOR } else { 1.0 };
        let translation = share * step.origin().distance();
        // Without odometry and poses the robot may have driven in any direction.
        let unknown = if is_known {
            0.0
        } else {
            config.own_speed_max * seconds
        };
        let position = translation * translation + unknown * unknown;
        let rotation = (share * step.theta).powi(2);
        Matrix3::from_diagonal(&Vector3::new(position, position, rotation))
    }

    /// The direction of the ball in an image, and its flight if it is in the air.
    fn follow_flight(
        &mut self,
        stamp: Stamp,
        observation: &WorldObservation,
        tilt: [f32; 2],
        odometry_from_robot: Tf<OdometryFrame, RobotFrame>,
    ) -> (Option<BallSighting>, Option<TrackedAirborne>) {
        let tilt_std = self.config.tilt_std_deg.to_radians();
        let height = self.viewpoint_height;
        let ball = observation.ball.as_ref();
        let sighting = ball.and_then(|ball| self.airborne.sighting(ball, tilt, tilt_std, height));
        let airborne = sighting
            .as_ref()
            .and_then(|sighting| self.airborne.update(stamp, sighting, odometry_from_robot));
        (sighting, airborne)
    }

    fn update_tracks(
        &mut self,
        stamp: Stamp,
        observation: &WorldObservation,
        tilt: [f32; 2],
        odometry_from_robot: Tf<OdometryFrame, RobotFrame>,
        airborne: Option<&TrackedAirborne>,
    ) {
        let measure =
            |object: &ObjectObservation| self.measurement_from(object, tilt, odometry_from_robot);
        let mut balls: Vec<Measurement> = observation.ball.iter().filter_map(measure).collect();
        if let Some(airborne) = airborne {
            // The point below a ball in the air, in place of the ground behind it.
            for ball in &mut balls {
                airborne.move_measurement(ball, odometry_from_robot.inverse());
            }
        }
        let robots: Vec<Measurement> = observation.robots.iter().filter_map(measure).collect();
        let view = VisibleArea {
            robot_from_odometry: odometry_from_robot.inverse(),
            robots: robots.iter().map(|robot| robot.in_robot_frame).collect(),
            radius: self.config.robot_radius,
        };
        let mut next_id = self.next_id;
        for (tracks, measurements, config) in [
            (&mut self.balls, &balls, &self.config.ball),
            (&mut self.robots, &robots, &self.config.robots),
        ] {
            let context = AssociationContext {
                stamp,
                config,
                view: &view,
            };
            associate(tracks, measurements, &context, &mut next_id);
            remove_duplicates(tracks, config.separation_min);
        }
        self.next_id = next_id;
    }

    /// A detection in the odometry frame; None if it is not finite.
    fn measurement_from(
        &self,
        observation: &ObjectObservation,
        tilt: [f32; 2],
        odometry_from_robot: Tf<OdometryFrame, RobotFrame>,
    ) -> Option<Measurement> {
        let height = self.viewpoint_height;
        let [x, y] = ground_from_map([observation.at.x, observation.at.y], tilt, height);
        let at = At::<RobotFrame>::new(x, y);
        let range = at.distance();
        let [xx, xy, yy] = observation.covariance;
        let along = match range {
            0.0 => Vector2::x(),
            range => Vector2::new(at.x, at.y) / range,
        };
        // A remaining tilt moves it along the line of sight by r²/H per radian (docs/methods.md 3.6).
        let tilt_std = self.config.tilt_std_deg.to_radians() * range * range / height;
        let airborne_std = if observation.airborne {
            self.config.airborne_range_share * range
        } else {
            0.0
        };
        let covariance = Matrix2::new(xx, xy, xy, yy)
            + along * along.transpose() * (tilt_std * tilt_std + airborne_std * airborne_std)
            + Matrix2::identity() * self.config.position_std * self.config.position_std;
        let rotation = rotation(odometry_from_robot.theta);
        let covariance = rotation * covariance * rotation.transpose();
        let finite = covariance.iter().all(|value| value.is_finite()) && range.is_finite();
        finite.then(|| Measurement {
            at: odometry_from_robot * at,
            in_robot_frame: at,
            covariance,
            score: observation.score.clamp(0.0, 1.0),
            team: observation.team,
        })
    }
}

/// Which positions are visible in an image?
struct VisibleArea {
    robot_from_odometry: Tf<RobotFrame, OdometryFrame>,
    robots: Vec<At<RobotFrame>>,
    radius: f32,
}

impl VisibleArea {
    /// Distance of a position, metres; None if a robot occludes it.
    fn visible_range(&self, at: At<OdometryFrame>) -> Option<f32> {
        let at = self.robot_from_odometry * at;
        let range = at.distance();
        let occluded = self.robots.iter().any(|robot| {
            let across = (robot.x * at.y - robot.y * at.x).abs() / range.max(f32::MIN_POSITIVE);
            let nearer = robot.x * at.x + robot.y * at.y > 0.0 && robot.distance() < range;
            nearer && across < self.radius
        });
        (!occluded).then_some(range)
    }
}

/// What association needs besides tracks and measurements.
struct AssociationContext<'a> {
    stamp: Stamp,
    config: &'a ObjectTrackConfig,
    view: &'a VisibleArea,
}

/// A track and a measurement within its gate, by index.
struct AssociationPair {
    cost: f32,
    track: usize,
    measurement: usize,
}

/// Assigns measurements to tracks, pairs with the smallest cost first; starts tracks for the others.
fn associate(
    tracks: &mut Vec<ObjectTrack>,
    measurements: &[Measurement],
    context: &AssociationContext,
    next_id: &mut u32,
) {
    let &AssociationContext {
        stamp,
        config,
        view,
    } = context;
    let mut pairs = Vec::new();
    for (t, track) in tracks.iter().enumerate() {
        for (m, measurement) in measurements.iter().enumerate() {
            let gating = track.gating(measurement, config);
            if gating.mahalanobis_squared < config.gate {
                pairs.push(AssociationPair {
                    cost: gating.cost,
                    track: t,
                    measurement: m,
                });
            }
        }
    }
    pairs.sort_by(|a, b| {
        let indices = (a.track, a.measurement).cmp(&(b.track, b.measurement));
        a.cost.total_cmp(&b.cost).then(indices)
    });
    let mut updated = vec![false; tracks.len()];
    let mut assigned = vec![false; measurements.len()];
    for AssociationPair {
        track, measurement, ..
    } in pairs
    {
        if !updated[track] && !assigned[measurement] {
            (updated[track], assigned[measurement]) = (true, true);
            tracks[track].update(stamp, &measurements[measurement], config);
        }
    }
    for (track, updated) in tracks.iter_mut().zip(updated) {
        if !updated && let Some(range) = view.visible_range(track.at()) {
            track.mark_missed(stamp, range, config);
        }
    }
    for (measurement, assigned) in measurements.iter().zip(assigned) {
        if !assigned {
            tracks.push(ObjectTrack::new(*next_id, stamp, measurement, config));
            *next_id = next_id.wrapping_add(1);
        }
    }
}

/// Of two tracks closer than `separation_min` metres the less probable one is removed.
fn remove_duplicates(tracks: &mut Vec<ObjectTrack>, separation_min: f32) {
    let mut kept: Vec<ObjectTrack> = Vec::with_capacity(tracks.len());
    tracks.sort_by(|a, b| {
        b.probability()
            .total_cmp(&a.probability())
            .then(a.id().cmp(&b.id()))
    });
    for track in tracks.drain(..) {
        if kept
            .iter()
            .all(|other| other.at().distance_to(track.at()) >= separation_min)
        {
            kept.push(track);
        }
    }
    kept.sort_by_key(ObjectTrack::id);
    *tracks = kept;
}

/// The most probable confirmed track, since there is one ball; of equal ones the one with the smaller variance.
fn most_probable<'a>(
    tracks: &'a [ObjectTrack],
    config: &ObjectTrackConfig,
) -> Option<&'a ObjectTrack> {
    tracks
        .iter()
        .filter(|track| track.is_confirmed(config))
        .max_by(|a, b| {
            a.probability()
                .total_cmp(&b.probability())
                .then(
                    b.position_variance(config)
                        .total_cmp(&a.position_variance(config)),
                )
                .then(b.id().cmp(&a.id()))
        })
}

/// From the odometry frame to the robot and the field.
struct OutputTransform {
    robot_from_odometry: Tf<RobotFrame, OdometryFrame>,
    pose: Option<(Pose, Matrix3<f32>)>,
}

impl OutputTransform {
    fn tracked_object(&self, track: &ObjectTrack, config: &ObjectTrackConfig) -> TrackedObject {
        let robot_rotation = rotation(self.robot_from_odometry.theta);
        let state_rotation = block_diagonal(robot_rotation);
        let at = self.robot_from_odometry * track.at();
        let velocity = robot_rotation * track.velocity();
        let covariance = state_rotation * track.covariance(config) * state_rotation.transpose();
        let on_field = self.pose.map(|(pose, pose_covariance)| {
            let field_rotation = rotation(pose.theta);
            let state_rotation = block_diagonal(field_rotation);
            let on_field = pose * at;
            let velocity = field_rotation * velocity;
            // Jacobian of position and velocity on the field with respect to the pose (x, y, θ).
            let mut by_pose = SMatrix::<f32, 4, 3>::zeros();
            (by_pose[(0, 0)], by_pose[(1, 1)]) = (1.0, 1.0);
            (by_pose[(0, 2)], by_pose[(1, 2)]) = (pose.y - on_field.y, on_field.x - pose.x);
            (by_pose[(2, 2)], by_pose[(3, 2)]) = (-velocity.y, velocity.x);
            FieldState {
                at: on_field,
                velocity: [velocity.x, velocity.y],
                covariance: state_rotation * covariance * state_rotation.transpose()
                    + by_pose * pose_covariance * by_pose.transpose(),
            }
        });
        TrackedObject {
            id: track.id(),
            at,
            velocity: [velocity.x, velocity.y],
            covariance,
            on_field,
            probability: track.probability(),
            last_seen: track.last_seen(),
            team: track.team(),
        }
    }
}

fn rotation(theta: f32) -> Matrix2<f32> {
    let (sin, cos) = math::sin_cos(theta);
    Matrix2::new(cos, -sin, sin, cos)
}

/// The same rotation of position and velocity.
fn block_diagonal(rotation: Matrix2<f32>) -> Matrix4<f32> {
    let mut state_rotation = Matrix4::zeros();
    state_rotation
        .fixed_view_mut::<2, 2>(0, 0)
        .copy_from(&rotation);
    state_rotation
        .fixed_view_mut::<2, 2>(2, 2)
        .copy_from(&rotation);
    state_rotation
}
