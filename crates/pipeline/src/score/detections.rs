//! How complete and how correct are detections? Line points, ball, robots and goal posts against ground truth.
//!
//! All are compared after correction by the tilt that matching estimated for the image.

use localize::field::marking_points;
use localize::frames::{At, FieldFrame, RobotFrame};
use localize::math;
use localize::tilt::ground_from_map;
use localize::{Field, Pose};
use serde::Serialize;
use sim::Sector;
use sim::world::OTHER_HALF_SIDE;
use vision::config::ObjectDetectionConfig;
use vision::objects::robots::RobotDetection;
use vision::{Detections, GroundMap, overlay};

use crate::score::visibility::{self, Body, BodyOutline};

/// What a true object is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GroundTruthKind {
    /// The ball.
    Ball,
    /// Another robot.
    Robot,
    /// A person. A robot that is detected there is an obstacle in its place: neither found nor false.
    Person,
}

/// An object whose true position is known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GroundTruthObject {
    /// What it is.
    pub kind: GroundTruthKind,
    /// Position on the field.
    pub at: At<FieldFrame>,
    /// Heading on the field, radians. With a heading the body is a square, as in the simulator; without, a circle.
    pub heading: Option<f32>,
    /// Number of pixels that show the object, if known.
    pub visible_px: Option<f32>,
}

/// Ground truth for the score of one image.
pub struct GroundTruthScene<'a> {
    /// True pose of the robot.
    pub pose: Pose,
    /// Its estimated tilt (a, b), radians.
    pub tilt: [f32; 2],
    /// Height of the mirror above the ground, metres.
    pub viewpoint_height: f32,
    /// The field with its markings.
    pub field: &'a Field,
    /// The ground map.
    pub map: &'a GroundMap,
    /// Covered sectors of the view.
    pub occluded_sectors: &'a [Sector],
    /// Ball, robots and people. None if they are unknown.
    pub objects: Option<&'a [GroundTruthObject]>,
}

/// Detection results as `--json` prints them.
#[derive(Debug, Clone, Default, Serialize)]
pub struct DetectionSummary {
    /// Line points within 5 m, and the share of them within max(5 cm, 2 pixels) of a marking.
    pub points: usize,
    /// See `points`.
    pub points_right: f64,
    /// Share of the points within 4 m that lie within 10 cm of a marking.
    pub points_near_right: f64,
    /// Share of the visible markings within 4 m that have a correct line point within 0.25 m.
    pub markings_sampled: f64,
    /// Images with the ball on the carpet within 6 m, more than half visible, and those in which it was detected.
    pub balls: usize,
    /// See `balls`.
    pub balls_found: usize,
    /// Images with a false ball.
    pub balls_false: usize,
    /// Robots within 4 m with more than half of their directions unoccluded, and those with a detection of their own
    /// that is right within three of its standard deviations.
    pub robots: usize,
    /// See `robots`.
    pub robots_found: usize,
    /// Share of the detected robots whose nearest visible edge is within 10 cm of the truth.
    pub robot_edges_right: f64,
    /// Detected robots within 4 m that are farther than three of their standard deviations from every robot.
    pub robots_false: usize,
    /// Detected goal posts, and those within 0.5 m of a true one.
    pub posts: usize,
    /// See `posts`.
    pub posts_right: usize,
}

/// One visible object (detected or missed) or one detection (correct or false).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScoredItem {
    /// Kind of the item.
    pub kind: ScoredKind,
    /// Distance from the robot, metres; of a false detection, the detected distance.
    pub range: f32,
    /// True if the detection is correct, or the object was detected.
    pub correct: bool,
}

/// Kinds of scored items.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum ScoredKind {
    /// A line point; correct within max(5 cm, 2 pixels) of a marking.
    Point,
    /// A 5 cm segment of a marking; detected if a correct point lies within 0.25 m.
    Marking,
    /// The ball, more than half visible.
    Ball,
    /// Another robot.
    Robot,
    /// A detected robot; correct if its nearest edge is within 10 cm.
    Edge,
    /// A false ball.
    FalseBall,
    /// A false robot.
    FalseRobot,
}

/// Statistics of detections over many images.
#[derive(Default)]
pub struct DetectionStatistics {
    summary: DetectionSummary,
    points_correct: usize,
    near_points: usize,
    near_points_correct: usize,
    marking_segments: usize,
    segments_sampled: usize,
    edges_correct: usize,
}

/// Length of the segments into which markings are divided, metres.
const SEGMENT_LENGTH: f32 = 0.05;
/// A segment is detected if a correct point is within this distance, metres. Scan spirals at 4 m are closer together.
const SEGMENT_RADIUS: f32 = 0.25;
/// Nearer markings are under the robot, metres.
const MIN_MARKING_RANGE: f32 = 0.4;
/// Farther markings are not scored, metres.
const MAX_MARKING_RANGE: f32 = 6.0;
/// Largest error of a correct ball detection: metres, plus a share of the distance.
const BALL_TOLERANCE: (f32, f32) = (0.15, 0.1);
/// Largest distance between a robot and its detection, centre to centre, metres: a robot's width. A detection that states
/// a larger error says nothing.
const ROBOT_TOLERANCE: f32 = 0.5;

impl DetectionStatistics {
    /// Scores one image.
    pub fn add_image(&mut self, detections: &Detections, scene: &GroundTruthScene<'_>) {
        self.add_image_with(detections, scene, &mut |_| {});
    }

    /// Scores one image, item by item.
    pub fn add_image_with(
        &mut self,
        detections: &Detections,
        scene: &GroundTruthScene<'_>,
        note: &mut impl FnMut(ScoredItem),
    ) {
        self.add_points(detections, scene, note);
        let upright = scene.compensate_objects(detections);
        self.add_ball(&upright, scene, note);
        self.add_robots(&upright, scene, note);
        let config = &scene.field.config;
        let ends = [-1.0f32, 1.0]
            .into_iter()
            .filter(|_| scene.field.has_goals());
        let posts = ends.flat_map(|end| {
            [-1.0f32, 1.0].map(|side| {
                At::new(
                    end * (scene.field.length / 2.0),
                    side * (config.goal.width / 2.0),
                )
            })
        });
        let posts: Vec<At<FieldFrame>> = posts.collect();
        for goal in detections
            .goals
            .iter()
            .filter(|goal| goal.kind == vision::objects::goals::GoalKind::Post)
        {
            let at = scene.pose * scene.compensate_tilt(goal.at);
            self.summary.posts += 1;
            let correct = posts.iter().any(|post| post.distance_to(at) <= 0.5);
            self.summary.posts_right += usize::from(correct);
        }
    }

    fn add_points(
        &mut self,
        detections: &Detections,
        scene: &GroundTruthScene<'_>,
        note: &mut impl FnMut(ScoredItem),
    ) {
        let markings = &scene.field.markings;
        let mut good = Vec::new();
        for point in &detections.line_points {
            let at = scene.compensate_tilt(point.point.at);
            let on_field = scene.pose * at;
            let off = markings
                .iter()
                .map(|marking| overlay::marking_distance(marking, on_field))
                .fold(f32::INFINITY, f32::min);
            // The standard deviation of an edge is half a pixel.
            let pixel = 2.0 * point.point.std_radial.max(point.point.std_tangential);
            let correct = off <= (2.0 * pixel).max(0.05);
            if correct {
                good.push(on_field);
            }
            note(ScoredItem {
                kind: ScoredKind::Point,
                range: at.distance(),
                correct,
            });
            if at.distance() <= 5.0 {
                self.summary.points += 1;
                self.points_correct += usize::from(correct);
            }
            if at.distance() <= 4.0 {
                self.near_points += 1;
                self.near_points_correct += usize::from(off <= 0.1);
            }
        }
        for at in marking_points(markings, SEGMENT_LENGTH) {
            let from_robot = scene.pose.inverse() * at;
            let range = from_robot.distance();
            if !(MIN_MARKING_RANGE..=MAX_MARKING_RANGE).contains(&range)
                || scene.is_occluded(from_robot)
            {
                continue;
            }
            let correct = good
                .iter()
                .any(|point| point.distance_to(at) <= SEGMENT_RADIUS);
            note(ScoredItem {
                kind: ScoredKind::Marking,
                range,
                correct,
            });
            if range <= 4.0 {
                self.marking_segments += 1;
                self.segments_sampled += usize::from(correct);
            }
        }
    }

    fn add_ball(
        &mut self,
        detections: &Detections,
        scene: &GroundTruthScene<'_>,
        note: &mut impl FnMut(ScoredItem),
    ) {
        let truth = scene.known_objects(GroundTruthKind::Ball).next();
        let at = truth.map(|ball| scene.pose.inverse() * ball.at);
        let hit = match (&detections.ball, at) {
            (Some(found), Some(at)) => {
                let (tolerance, share) = BALL_TOLERANCE;
                found.at.distance_to(at) <= tolerance + share * at.distance()
            }
            _ => false,
        };
        if let Some(found) = detections
            .ball
            .as_ref()
            .filter(|_| !hit && scene.objects.is_some())
        {
            self.summary.balls_false += 1;
            note(ScoredItem {
                kind: ScoredKind::FalseBall,
                range: found.at.distance(),
                correct: false,
            });
        }
        if let (Some(ball), Some(at)) = (truth, at)
            && scene.is_ball_mostly_visible(ball, at)
        {
            note(ScoredItem {
                kind: ScoredKind::Ball,
                range: at.distance(),
                correct: hit,
            });
            let near = at.distance() <= 6.0;
            self.summary.balls += usize::from(near);
            self.summary.balls_found += usize::from(near && hit);
        }
    }

    fn add_robots(
        &mut self,
        detections: &Detections,
        scene: &GroundTruthScene<'_>,
        note: &mut impl FnMut(ScoredItem),
    ) {
        if scene.objects.is_none() {
            return;
        }
        let bodies = scene.robot_bodies();
        let truths: Vec<At<RobotFrame>> = bodies.iter().map(|body| body.at).collect();
        let visibilities = visibility::body_visibilities(&bodies, scene.occluded_sectors);
        let assigned = assign_robots(&detections.robots, &truths);
        // An occluded robot counts neither as missed nor as false.
        let visible = truths
            .iter()
            .zip(visibilities)
            .zip(&assigned)
            .filter(|((_, visibility), _)| visibility.visible_fraction > 0.5);
        for ((truth, visibility), found) in visible {
            let near = truth.distance() <= 4.0;
            let found = found.map(|index| &detections.robots[index]);
            let mut note_robot = |kind, correct| {
                note(ScoredItem {
                    kind,
                    range: truth.distance(),
                    correct,
                });
            };
            note_robot(ScoredKind::Robot, found.is_some());
            self.summary.robots += usize::from(near);
            if let Some(found) = found {
                let correct = (found.edge.distance() - visibility.nearest_distance).abs() <= 0.1;
                note_robot(ScoredKind::Edge, correct);
                self.summary.robots_found += usize::from(near);
                self.edges_correct += usize::from(near && correct);
            }
        }
        let people = scene.known_objects(GroundTruthKind::Person);
        let people = people.map(|person| scene.pose.inverse() * person.at);
        let obstacles: Vec<At<RobotFrame>> = truths.iter().copied().chain(people).collect();
        // A second detection of one robot lies within its stated error, so it is no false robot.
        let false_robots = detections
            .robots
            .iter()
            .filter(|robot| !obstacles.iter().any(|truth| is_within_error(robot, *truth)));
        for false_robot in false_robots {
            let range = false_robot.edge.distance();
            self.summary.robots_false += usize::from(range <= 4.0);
            note(ScoredItem {
                kind: ScoredKind::FalseRobot,
                range,
                correct: false,
            });
        }
    }

    /// Results of all images. None if no image was added.
    pub fn summary(self) -> Option<DetectionSummary> {
        let share = |part: usize, all: usize| part as f64 / all.max(1) as f64;
        (self.marking_segments > 0).then(|| DetectionSummary {
            points_right: share(self.points_correct, self.summary.points),
            points_near_right: share(self.near_points_correct, self.near_points),
            markings_sampled: share(self.segments_sampled, self.marking_segments),
            robot_edges_right: share(self.edges_correct, self.summary.robots_found),
            ..self.summary
        })
    }
}

/// The detection of each robot: one detection counts for one robot, nearest pairs first.
fn assign_robots(detections: &[RobotDetection], truths: &[At<RobotFrame>]) -> Vec<Option<usize>> {
    let mut pairs: Vec<(f32, usize, usize)> = Vec::new();
    for (k, robot) in detections.iter().enumerate() {
        for (i, truth) in truths.iter().enumerate() {
            if is_within_error(robot, *truth) {
                pairs.push((robot.at.distance_to(*truth), k, i));
            }
        }
    }
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut assigned = vec![None; truths.len()];
    let mut used = vec![false; detections.len()];
    for (_, k, i) in pairs {
        if assigned[i].is_none() && !used[k] {
            assigned[i] = Some(k);
            used[k] = true;
        }
    }
    assigned
}

/// Is the robot within three standard deviations of its detection, and within its own width?
fn is_within_error(detection: &RobotDetection, truth: At<RobotFrame>) -> bool {
    let distance = detection.at.distance_to(truth);
    if distance > ROBOT_TOLERANCE {
        return false;
    }
    let (dx, dy) = (truth.x - detection.at.x, truth.y - detection.at.y);
    let [xx, xy, yy] = detection.covariance;
    // Variance along the direction of the error, times the squared distance.
    let scaled_variance = dx * dx * xx + 2.0 * dx * dy * xy + dy * dy * yy;
    distance.powi(4) <= 9.0 * scaled_variance
}

impl DetectionSummary {
    /// Prints the results as text.
    pub fn print(&self) {
        println!(
            "line points: {:.1} % of {} right (5 m); {:.1} % within 10 cm (4 m); {:.0} % of the markings sampled (4 m)",
            100.0 * self.points_right,
            self.points,
            100.0 * self.points_near_right,
            100.0 * self.markings_sampled
        );
        if self.balls + self.balls_false > 0 {
            println!(
                "ball in view within 6 m: found in {} of {}; {} false",
                self.balls_found, self.balls, self.balls_false
            );
        }
        if self.robots + self.robots_false > 0 {
            println!(
                "robots within 4 m: {} of {} found, nearest edge right to 10 cm in {:.0} %; {} false",
                self.robots_found,
                self.robots,
                100.0 * self.robot_edges_right,
                self.robots_false
            );
        }
        if self.posts > 0 {
            println!(
                "goal posts: {} of {} detections are correct",
                self.posts_right, self.posts
            );
        }
    }
}

impl GroundTruthScene<'_> {
    fn known_objects(&self, kind: GroundTruthKind) -> impl Iterator<Item = &GroundTruthObject> {
        let all = self.objects.unwrap_or_default().iter();
        all.filter(move |object| object.kind == kind)
    }

    /// Converts a point of the upright ground map to its position on the ground (docs/methods.md 3.3).
    fn compensate_tilt(&self, at: At<RobotFrame>) -> At<RobotFrame> {
        let [x, y] = ground_from_map([at.x, at.y], self.tilt, self.viewpoint_height);
        At::new(x, y)
    }

    /// Ball and robots on the ground of the tilted robot.
    fn compensate_objects(&self, detections: &Detections) -> Detections {
        let mut upright = Detections {
            ball: detections.ball,
            robots: detections.robots.clone(),
            ..Detections::default()
        };
        if let Some(ball) = &mut upright.ball {
            ball.at = self.compensate_tilt(ball.at);
        }
        for robot in &mut upright.robots {
            // Only the edge is seen on the ground; the centre keeps its distance from it.
            let edge = self.compensate_tilt(robot.edge);
            let behind = [robot.at.x - robot.edge.x, robot.at.y - robot.edge.y];
            robot.at = At::new(edge.x + behind[0], edge.y + behind[1]);
            robot.edge = edge;
        }
        upright
    }

    /// Bodies of the other robots, robot frame.
    fn robot_bodies(&self) -> Vec<Body> {
        let robots = self.known_objects(GroundTruthKind::Robot);
        let body = |robot: &GroundTruthObject| Body {
            at: self.pose.inverse() * robot.at,
            outline: match robot.heading {
                Some(heading) => BodyOutline::Square(OTHER_HALF_SIDE, heading - self.pose.theta),
                None => BodyOutline::Circle(ObjectDetectionConfig::default().robot_radius),
            },
        };
        robots.map(body).collect()
    }

    /// True if a robot or a covered sector occludes this point.
    fn is_occluded(&self, at: At<RobotFrame>) -> bool {
        let range = at.distance();
        let direction = math::atan2(at.y, at.x);
        let covered = self
            .occluded_sectors
            .iter()
            .any(|sector| sector.contains(direction));
        covered
            || self.known_objects(GroundTruthKind::Robot).any(|robot| {
                let robot = self.pose.inverse() * robot.at;
                let along = (robot.x * at.x + robot.y * at.y) / range;
                let across = (robot.x * at.y - robot.y * at.x).abs() / range;
                along > 0.0 && along < range + 0.3 && across < 0.3
            })
    }

    /// True if the ball is on the carpet and more than half visible. Counts directions if its pixels are unknown.
    fn is_ball_mostly_visible(&self, ball: &GroundTruthObject, at: At<RobotFrame>) -> bool {
        let (half_length, half_width) = self.field.carpet_half_extent();
        if ball.at.x.abs() > half_length || ball.at.y.abs() > half_width {
            return false;
        }
        let Some(visible) = ball.visible_px else {
            let mut bodies = self.robot_bodies();
            bodies.push(Body {
                at,
                outline: BodyOutline::Circle(ObjectDetectionConfig::default().ball_radius),
            });
            let visibilities = visibility::body_visibilities(&bodies, self.occluded_sectors);
            return visibilities
                .last()
                .is_some_and(|ball| ball.visible_fraction > 0.5);
        };
        vision::objects::ball::expected_ball_pixels_at(
            self.map,
            &ObjectDetectionConfig {
                viewpoint_height: self.viewpoint_height,
                ..ObjectDetectionConfig::default()
            },
            at,
        )
        .is_some_and(|whole| visible > 0.5 * whole)
    }
}

#[cfg(test)]
mod tests {
    use vision::objects::robots::ObstacleKind;

    use super::*;

    fn robot(x: f32, std: f32) -> RobotDetection {
        RobotDetection {
            at: At::new(x, 0.0),
            edge: At::new(x - 0.25, 0.0),
            covariance: [std * std, 0.0, std * std],
            width: 0.5,
            marker: None,
            score: 1.0,
            position_px: [0.0, 0.0],
            kind: ObstacleKind::Robot,
        }
    }

    #[test]
    fn one_detection_counts_for_one_robot() {
        let truths = [At::new(2.0, 0.0), At::new(2.3, 0.0)];
        let one = assign_robots(&[robot(2.2, 0.1)], &truths);
        assert_eq!(one, [None, Some(0)]);
        let two = assign_robots(&[robot(2.2, 0.1), robot(2.1, 0.1)], &truths);
        assert_eq!(two, [Some(1), Some(0)]);
    }

    #[test]
    fn detection_beyond_its_stated_error_is_of_no_robot() {
        let truth = At::new(2.0, 0.0);
        assert!(is_within_error(&robot(2.25, 0.1), truth));
        assert!(!is_within_error(&robot(2.25, 0.05), truth));
        // A large stated error does not make a detection half a metre off right.
        assert!(!is_within_error(&robot(2.6, 5.0), truth));
    }
}
