//! What stands and rolls around the robot? Ball and robots with their motion, from each frame's sights and the pose.
//!
//! Objects are followed in the odometry's frame, which neither jumps when the pose is corrected nor ends when it is
//! lost: what the robot needs to drive to the ball does not depend on where on the field both are. The field's
//! coordinates come with the pose and carry its uncertainty. Stamps are arguments; the same sights give the same bits.

mod config;
mod odometry_buffer;
#[cfg(test)]
mod tests;
mod track;

use nalgebra::{Matrix2, Matrix4, SMatrix, Vector2, Vector4};

pub use config::{ObjectConfig, WorldConfig};
use odometry_buffer::OdometryBuffer;
use track::Track;

use crate::estimate::Estimate;
use crate::frames::{At, FieldFrame, Pose, RobotFrame, Tf};
use crate::sample::Odometry;
use crate::stamp::Stamp;
use crate::tilt::ground_from_map;

/// The frame in which odometry adds up: fixed to the ground but for its slow drift.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OdometryFrame {}

/// The colour that a robot wears.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TeamColour {
    /// Cyan.
    Cyan,
    /// Magenta.
    Magenta,
}

/// One object as a frame shows it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ObjectObservation {
    /// Where it stands, metres.
    pub at: At<RobotFrame>,
    /// Covariance: xx, xy, yy, m².
    pub covariance: [f32; 3],
    /// How sure it is one, 0 to 1.
    pub score: f32,
    /// True if it is above the ground: then it only seems to be that far away.
    pub airborne: bool,
    /// Its team's colour, where one is seen.
    pub team: Option<TeamColour>,
}

/// The objects of a frame.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct WorldObservation {
    /// The ball, if one is seen.
    pub ball: Option<ObjectObservation>,
    /// Robots.
    pub robots: Vec<ObjectObservation>,
}

/// An object that is being followed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackedObject {
    /// Stays with it for as long as it is followed.
    pub id: u32,
    /// Where it is seen from the robot, metres.
    pub at: At<RobotFrame>,
    /// Its velocity over the ground in the robot's axes, m/s.
    pub velocity: [f32; 2],
    /// Covariance of position and velocity, robot frame: m², m²/s, m²/s².
    pub covariance: Matrix4<f32>,
    /// The same on the field; none while the robot is lost.
    pub on_field: Option<FieldState>,
    /// How probable it is that there is such a thing, 0 to 1.
    pub probability: f32,
    /// When it was last seen.
    pub last_seen: Stamp,
    /// Its team's colour, where one was seen.
    pub team: Option<TeamColour>,
}

/// An object in field coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FieldState {
    /// Where it is, metres.
    pub at: At<FieldFrame>,
    /// Its velocity, m/s.
    pub velocity: [f32; 2],
    /// Covariance of position and velocity, the pose's part in it: m², m²/s, m²/s².
    pub covariance: Matrix4<f32>,
}

/// What is around the robot at a moment.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct WorldView {
    /// The ball.
    pub ball: Option<TrackedObject>,
    /// Robots, the longest followed first.
    pub robots: Vec<TrackedObject>,
}

/// Follows what is seen from frame to frame.
#[derive(Debug, Clone)]
pub struct WorldModel {
    config: WorldConfig,
    /// Of the viewpoint above the ground, metres: a lean moves far objects by their distance squared over it.
    viewpoint_height: f32,
    motion: OdometryBuffer,
    balls: Vec<Track>,
    robots: Vec<Track>,
    next_id: u32,
    last: Option<(Stamp, Option<Pose>)>,
}

impl WorldModel {
    /// Knows of nothing yet; `viewpoint_height`: the mirror's above the ground, metres.
    pub fn new(config: WorldConfig, viewpoint_height: f32) -> Self {
        WorldModel {
            config,
            viewpoint_height,
            motion: OdometryBuffer::default(),
            balls: Vec::new(),
            robots: Vec::new(),
            next_id: 0,
            last: None,
        }
    }

    /// Takes a motion of the robot; in the order of stamps.
    pub fn add_odometry(&mut self, odometry: &Odometry) {
        self.motion.add(odometry);
    }

    /// What is around at a frame: `sight` is none if the frame showed nothing at all, which is no sign of absence.
    pub fn update(
        &mut self,
        stamp: Stamp,
        sight: Option<&WorldObservation>,
        estimate: &Estimate,
    ) -> WorldView {
        let pose = estimate.pose;
        let Some(odometry_from_robot) = self.predict(stamp, pose, estimate.odometry_scales) else {
            // From the past: nothing is known of then that is not known better now.
            return WorldView::default();
        };
        if let Some(sight) = sight {
            self.update_tracks(stamp, sight, estimate.tilt, odometry_from_robot);
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
            ball: most_probable(&self.balls, &config.ball).map(|track| view.tracked_object(track)),
            robots: self
                .robots
                .iter()
                .filter(|track| track.is_confirmed(&config.robots))
                .map(|track| view.tracked_object(track))
                .collect(),
        }
    }

    /// Carries everything on to a frame; none if the frame is older than what is known.
    fn predict(
        &mut self,
        stamp: Stamp,
        pose: Option<Pose>,
        scales: [f32; 2],
    ) -> Option<Tf<OdometryFrame, RobotFrame>> {
        let gap = match self.last {
            Some((last, _)) => last.seconds_until(stamp) as f32,
            None => 0.0,
        };
        if gap < -self.config.gap_max || gap > self.config.gap_max {
            // Another time: a clock was set, or nobody looked for long.
            self.balls.clear();
            self.robots.clear();
            self.last = None;
        } else if gap < 0.0 {
            return None;
        }
        let before = self.motion.pose_at_image();
        let poses = match (self.last, pose) {
            (Some((_, Some(last))), Some(pose)) => Some(last.inverse() * pose),
            _ => None,
        };
        let moved = self.motion.advance_to(stamp, poses, scales);
        self.last = Some((stamp, pose));
        let config = &self.config;
        // Without wheels or poses the robot may have driven anywhere.
        let unknown = if moved {
            0.0
        } else {
            config.own_speed_max * gap
        };
        let step: Tf<RobotFrame, RobotFrame> = before.inverse() * self.motion.pose_at_image();
        let at = self.motion.pose_at_image().origin();
        for (tracks, object) in [
            (&mut self.balls, &config.ball),
            (&mut self.robots, &config.robots),
        ] {
            for track in tracks {
                track.predict(gap, object);
                let slip = config.odometry_std * (step.origin().distance());
                let turn = config.odometry_std * step.theta * track.at().distance_to(at);
                track.add_position_noise(unknown * unknown + slip * slip + turn * turn);
            }
        }
        Some(self.motion.pose_at_image())
    }

    fn update_tracks(
        &mut self,
        stamp: Stamp,
        sight: &WorldObservation,
        lean: [f32; 2],
        odometry_from_robot: Tf<OdometryFrame, RobotFrame>,
    ) {
        let place = |sighting: &ObjectObservation| {
            self.measurement_from(sighting, lean, odometry_from_robot)
        };
        let balls: Vec<Measurement> = sight.ball.iter().filter_map(place).collect();
        let robots: Vec<Measurement> = sight.robots.iter().filter_map(place).collect();
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
            associate(tracks, measurements, &view, (stamp, config), &mut next_id);
            remove_duplicates(tracks, config.separation_min);
        }
        self.next_id = next_id;
    }

    /// A sighting in the odometry's frame; none if it is no number.
    fn measurement_from(
        &self,
        sighting: &ObjectObservation,
        tilt: [f32; 2],
        odometry_from_robot: Tf<OdometryFrame, RobotFrame>,
    ) -> Option<Measurement> {
        let height = self.viewpoint_height;
        let [x, y] = ground_from_map([sighting.at.x, sighting.at.y], tilt, height);
        let at = At::<RobotFrame>::new(x, y);
        let range = at.distance();
        let [xx, xy, yy] = sighting.covariance;
        let along = match range {
            0.0 => Vector2::x(),
            range => Vector2::new(at.x, at.y) / range,
        };
        // The lean that remains moves it along the line of sight by (r² + H²)/H for each radian.
        let lean =
            self.config.tilt_std_deg.to_radians() * (range * range + height * height) / height;
        let lift = if sighting.airborne {
            self.config.airborne_range_share * range
        } else {
            0.0
        };
        let covariance = Matrix2::new(xx, xy, xy, yy)
            + along * along.transpose() * (lean * lean + lift * lift)
            + Matrix2::identity() * self.config.position_std * self.config.position_std;
        let turn = rotation(odometry_from_robot.theta);
        let covariance = turn * covariance * turn.transpose();
        let whole = covariance.iter().all(|value| value.is_finite()) && range.is_finite();
        whole.then(|| Measurement {
            at: odometry_from_robot * at,
            in_robot_frame: at,
            covariance,
            score: sighting.score.clamp(0.0, 1.0),
            team: sighting.team,
        })
    }
}

/// A sighting in the odometry's frame.
#[derive(Debug, Clone, Copy)]
struct Measurement {
    at: At<OdometryFrame>,
    in_robot_frame: At<RobotFrame>,
    covariance: Matrix2<f32>,
    score: f32,
    team: Option<TeamColour>,
}

/// Which places does a frame show?
struct VisibleArea {
    robot_from_odometry: Tf<RobotFrame, OdometryFrame>,
    robots: Vec<At<RobotFrame>>,
    radius: f32,
}

impl VisibleArea {
    /// False if a robot stands before the place, or it is too far to be seen reliably.
    fn is_visible(&self, at: At<OdometryFrame>, reach: f32) -> bool {
        let at = self.robot_from_odometry * at;
        let range = at.distance();
        let hidden = self.robots.iter().any(|robot| {
            let across = (robot.x * at.y - robot.y * at.x).abs() / range.max(f32::MIN_POSITIVE);
            let before = robot.x * at.x + robot.y * at.y > 0.0 && robot.distance() < range;
            before && across < self.radius
        });
        !hidden && range < reach
    }
}

/// Gives each track its measurement, nearest pairs first; starts tracks where none is.
fn associate(
    tracks: &mut Vec<Track>,
    measurements: &[Measurement],
    view: &VisibleArea,
    (stamp, config): (Stamp, &ObjectConfig),
    next_id: &mut u32,
) {
    let mut pairs = Vec::new();
    for (t, track) in tracks.iter().enumerate() {
        for (m, measurement) in measurements.iter().enumerate() {
            let (distance, spread) = track.mahalanobis_squared(measurement);
            if distance < config.gate {
                // The likelier track, not merely the vaguer one.
                pairs.push((distance + spread, t, m));
            }
        }
    }
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    let (mut served, mut taken) = (vec![false; tracks.len()], vec![false; measurements.len()]);
    for (_, t, m) in pairs {
        if !served[t] && !taken[m] {
            (served[t], taken[m]) = (true, true);
            tracks[t].update(stamp, &measurements[m], config);
        }
    }
    for (track, served) in tracks.iter_mut().zip(served) {
        if !served && view.is_visible(track.at(), config.range_max) {
            track.mark_missed(config);
        }
    }
    for (measurement, taken) in measurements.iter().zip(taken) {
        if !taken {
            tracks.push(Track::new(*next_id, stamp, measurement, config));
            *next_id = next_id.wrapping_add(1);
        }
    }
}

/// Two things cannot stand in one place: the more doubtful track of such a pair is given up.
fn remove_duplicates(tracks: &mut Vec<Track>, apart_min: f32) {
    let mut kept: Vec<Track> = Vec::with_capacity(tracks.len());
    tracks.sort_by(|a, b| {
        b.probability()
            .total_cmp(&a.probability())
            .then(a.id().cmp(&b.id()))
    });
    for track in tracks.drain(..) {
        if kept
            .iter()
            .all(|other| other.at().distance_to(track.at()) >= apart_min)
        {
            kept.push(track);
        }
    }
    kept.sort_by_key(Track::id);
    *tracks = kept;
}

/// There is one ball: the most probable of what looks like one; of equals the one that is known better.
fn most_probable<'a>(tracks: &'a [Track], config: &ObjectConfig) -> Option<&'a Track> {
    tracks
        .iter()
        .filter(|track| track.is_confirmed(config))
        .max_by(|a, b| {
            a.probability()
                .total_cmp(&b.probability())
                .then(b.position_variance().total_cmp(&a.position_variance()))
                .then(b.id().cmp(&a.id()))
        })
}

/// From where are the objects told?
struct OutputTransform {
    robot_from_odometry: Tf<RobotFrame, OdometryFrame>,
    pose: Option<(Pose, nalgebra::Matrix3<f32>)>,
}

impl OutputTransform {
    fn tracked_object(&self, track: &Track) -> TrackedObject {
        let turn = rotation(self.robot_from_odometry.theta);
        let both = block_diagonal(turn);
        let at = self.robot_from_odometry * track.at();
        let velocity = turn * track.velocity();
        let covariance = both * track.covariance() * both.transpose();
        let on_field = self.pose.map(|(pose, pose_covariance)| {
            let turn = rotation(pose.theta);
            let both = block_diagonal(turn);
            let on_field = pose * at;
            let speed = turn * velocity;
            // How position and velocity on the field change with the pose (x, y, θ).
            let mut by_pose = SMatrix::<f32, 4, 3>::zeros();
            (by_pose[(0, 0)], by_pose[(1, 1)]) = (1.0, 1.0);
            (by_pose[(0, 2)], by_pose[(1, 2)]) = (pose.y - on_field.y, on_field.x - pose.x);
            (by_pose[(2, 2)], by_pose[(3, 2)]) = (-speed.y, speed.x);
            FieldState {
                at: on_field,
                velocity: [speed.x, speed.y],
                covariance: both * covariance * both.transpose()
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

impl FieldState {
    /// Where it will be after `seconds` if nobody touches it, and how sure that is: position and covariance xx, xy, yy.
    ///
    /// `deceleration`: of a rolling ball, m/s²; 0 for what drives.
    pub fn predict(&self, seconds: f32, deceleration: f32) -> (At<FieldFrame>, [f32; 3]) {
        let velocity = Vector2::new(self.velocity[0], self.velocity[1]);
        let way = track::rolling_displacement(velocity, seconds, deceleration);
        let p = &self.covariance;
        let spread = |i: usize, j: usize| {
            p[(i, j)]
                + seconds * (p[(i, j + 2)] + p[(i + 2, j)])
                + seconds * seconds * p[(i + 2, j + 2)]
        };
        (
            At::new(self.at.x + way.x, self.at.y + way.y),
            [spread(0, 0), spread(0, 1), spread(1, 1)],
        )
    }
}

fn rotation(theta: f32) -> Matrix2<f32> {
    let (sin, cos) = theta.sin_cos();
    Matrix2::new(cos, -sin, sin, cos)
}

/// The same turn of position and velocity.
fn block_diagonal(turn: Matrix2<f32>) -> Matrix4<f32> {
    let mut both = Matrix4::zeros();
    both.fixed_view_mut::<2, 2>(0, 0).copy_from(&turn);
    both.fixed_view_mut::<2, 2>(2, 2).copy_from(&turn);
    both
}

/// Position and velocity in one.
type TrackState = Vector4<f32>;
