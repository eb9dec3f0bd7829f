//! Did the eyes see what is there, and is what they saw there? Line points, ball, robots and goal posts against truth.
//!
//! A frame's own lean bends its map; points are compared where they lie with the lean that matching estimated.

use localize::frames::{At, FieldFrame, RobotFrame};
use localize::tilt::ground_from_map;
use localize::{Field, Pose};
use serde::Serialize;
use sim::world::OTHER_HALF_SIDE;
use vision::config::ObjectConfig;
use vision::{Detections, GroundMap, overlay};

use crate::score::visibility::{self, Body, BodyOutline};

/// A thing whose place is known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GroundTruthObject {
    /// Ball, or else robot.
    pub is_ball: bool,
    /// On the field.
    pub at: At<FieldFrame>,
    /// Where it heads, radians on the field, where that is known: a square of the simulator's robots; else it is round.
    pub heading: Option<f32>,
    /// Pixels that show it, where that is known.
    pub visible_px: Option<f32>,
}

/// What a frame is scored by.
pub struct GroundTruthScene<'a> {
    /// Where the robot was.
    pub pose: Pose,
    /// Its lean (a, b) as estimated, radians.
    pub tilt: [f32; 2],
    /// Height of the mirror above the ground, metres.
    pub viewpoint_height: f32,
    /// Field, with its markings.
    pub field: &'a Field,
    /// What a pixel shows.
    pub map: &'a GroundMap,
    /// Sectors without sight: middle and whole width, radians, robot frame.
    pub occluded_sectors: &'a [(f32, f32)],
    /// Ball and robots; none where nobody knows what is there.
    pub objects: Option<&'a [GroundTruthObject]>,
}

/// What `--json` prints of the eyes.
#[derive(Debug, Clone, Default, Serialize)]
pub struct DetectionSummary {
    /// Line points within 5 m, and the share of them within max(5 cm, 2 pixels) of a marking.
    pub points: usize,
    /// See `points`.
    pub points_right: f64,
    /// Share of the points within 4 m that lie within 10 cm of a marking.
    pub points_near_right: f64,
    /// Share of the visible length of markings within 4 m that has a right line point within a quarter of a metre.
    pub markings_sampled: f64,
    /// Frames with the ball on the carpet within 6 m, more than half visible, and those in which it was found.
    pub balls: usize,
    /// See `balls`.
    pub balls_found: usize,
    /// Frames in which something else was taken for the ball.
    pub balls_false: usize,
    /// Robots within 4 m, nothing before them in more than half of their directions, and those that were found.
    pub robots: usize,
    /// See `robots`.
    pub robots_found: usize,
    /// Of those found, the share whose nearest visible edge is right to 10 cm.
    pub robot_edges_right: f64,
    /// Robots found within 4 m where there is none.
    pub robots_false: usize,
    /// Goal posts found, and those of them within half a metre of a true one.
    pub posts: usize,
    /// See `posts`.
    pub posts_right: usize,
}

/// One thing that could be seen or was believed to be, and whether that was right.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScoredItem {
    /// What.
    pub kind: ScoredKind,
    /// How far from the robot, metres; of what was taken for something, where that lies.
    pub range: f32,
    /// Right, or found.
    pub correct: bool,
}

/// What a note is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum ScoredKind {
    /// A line point; right within max(5 cm, 2 pixels) of a marking.
    Point,
    /// Five centimetres of marking; right with a right point within a quarter of a metre.
    Marking,
    /// The ball, more than half visible.
    Ball,
    /// Another robot.
    Robot,
    /// A robot that was found; right if its nearest edge is to 10 cm.
    Edge,
    /// Something else that was taken for the ball; never right.
    FalseBall,
    /// Something else that was taken for a robot; never right.
    FalseRobot,
}

/// Collects frames.
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

/// Markings are cut into pieces of this length, metres.
const SEGMENT_LENGTH: f32 = 0.05;
/// A piece is sampled if a right point lies this near, metres: between spirals of one another lies less at 4 m.
const SEGMENT_RADIUS: f32 = 0.25;
/// Markings nearer than this are under the robot, metres.
const MIN_MARKING_RANGE: f32 = 0.4;
/// Markings farther than this are not looked for, metres.
const MAX_MARKING_RANGE: f32 = 6.0;
/// A find this near to the true ball, metres and share of its distance, is a find.
const BALL_TOLERANCE: (f32, f32) = (0.15, 0.1);
/// A find whose middle is this near to a robot's is a find of it, metres: as wide as a robot.
const ROBOT_TOLERANCE: f32 = 0.5;

impl DetectionStatistics {
    /// Scores one frame.
    pub fn add_image(&mut self, seen: &Detections, scene: &GroundTruthScene<'_>) {
        self.add_image_with(seen, scene, &mut |_| {});
    }

    /// Scores one frame, thing by thing.
    pub fn add_image_with(
        &mut self,
        seen: &Detections,
        scene: &GroundTruthScene<'_>,
        note: &mut impl FnMut(ScoredItem),
    ) {
        self.add_points(seen, scene, note);
        self.add_ball(seen, scene, note);
        self.add_robots(seen, scene, note);
        let config = &scene.field.config;
        let posts = [-1.0f32, 1.0].into_iter().flat_map(|end| {
            [-1.0f32, 1.0].map(|side| {
                At::new(
                    end * (scene.field.length / 2.0),
                    side * (config.goal.width / 2.0),
                )
            })
        });
        let posts: Vec<At<FieldFrame>> = posts.collect();
        for goal in seen
            .goals
            .iter()
            .filter(|goal| goal.kind == vision::objects::goals::GoalKind::Post)
        {
            let at = scene.pose * scene.compensate_tilt(goal.at);
            self.summary.posts += 1;
            let right = posts.iter().any(|post| post.distance_to(at) <= 0.5);
            self.summary.posts_right += usize::from(right);
        }
    }

    fn add_points(
        &mut self,
        seen: &Detections,
        scene: &GroundTruthScene<'_>,
        note: &mut impl FnMut(ScoredItem),
    ) {
        let markings = &scene.field.markings;
        let mut good = Vec::new();
        for point in &seen.line_points {
            let at = scene.compensate_tilt(point.point.at);
            let on_field = scene.pose * at;
            let off = markings
                .iter()
                .map(|marking| overlay::marking_distance(marking, on_field))
                .fold(f32::INFINITY, f32::min);
            // Edges are placed to half a pixel, so a pixel is twice the standard deviation.
            let pixel = 2.0 * point.point.std_radial.max(point.point.std_tangential);
            let right = off <= (2.0 * pixel).max(0.05);
            if right {
                good.push(on_field);
            }
            note(ScoredItem {
                kind: ScoredKind::Point,
                range: at.distance(),
                correct: right,
            });
            if at.distance() <= 5.0 {
                self.summary.points += 1;
                self.points_correct += usize::from(right);
            }
            if at.distance() <= 4.0 {
                self.near_points += 1;
                self.near_points_correct += usize::from(off <= 0.1);
            }
        }
        for at in overlay::marking_points(markings, SEGMENT_LENGTH) {
            let from_robot = scene.pose.inverse() * at;
            let range = from_robot.distance();
            if !(MIN_MARKING_RANGE..=MAX_MARKING_RANGE).contains(&range)
                || scene.is_occluded(from_robot)
            {
                continue;
            }
            let right = good
                .iter()
                .any(|point| point.distance_to(at) <= SEGMENT_RADIUS);
            note(ScoredItem {
                kind: ScoredKind::Marking,
                range,
                correct: right,
            });
            if range <= 4.0 {
                self.marking_segments += 1;
                self.segments_sampled += usize::from(right);
            }
        }
    }

    fn add_ball(
        &mut self,
        seen: &Detections,
        scene: &GroundTruthScene<'_>,
        note: &mut impl FnMut(ScoredItem),
    ) {
        let truth = scene.known_objects().iter().find(|object| object.is_ball);
        let at = truth.map(|ball| scene.pose.inverse() * ball.at);
        let hit = match (&seen.ball, at) {
            (Some(found), Some(at)) => {
                let (tolerance, share) = BALL_TOLERANCE;
                found.at.distance_to(at) <= tolerance + share * at.distance()
            }
            _ => false,
        };
        if let Some(found) = seen
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
        seen: &Detections,
        scene: &GroundTruthScene<'_>,
        note: &mut impl FnMut(ScoredItem),
    ) {
        if scene.objects.is_none() {
            return;
        }
        let bodies = scene.robot_bodies();
        let truths: Vec<At<RobotFrame>> = bodies.iter().map(|body| body.at).collect();
        let sights = visibility::body_visibilities(&bodies, scene.occluded_sectors);
        // What stands behind others is no miss, and no false find either.
        let visible = truths
            .iter()
            .zip(sights)
            .filter(|(_, sight)| sight.visible_fraction > 0.5);
        for (truth, sight) in visible {
            let near = truth.distance() <= 4.0;
            let found = seen
                .robots
                .iter()
                .min_by(|a, b| {
                    a.at.distance_to(*truth)
                        .total_cmp(&b.at.distance_to(*truth))
                })
                .filter(|robot| robot.at.distance_to(*truth) <= ROBOT_TOLERANCE);
            let mut noted = |kind, right| {
                note(ScoredItem {
                    kind,
                    range: truth.distance(),
                    correct: right,
                });
            };
            noted(ScoredKind::Robot, found.is_some());
            self.summary.robots += usize::from(near);
            if let Some(found) = found {
                let right = (found.edge.distance() - sight.nearest_distance).abs() <= 0.1;
                noted(ScoredKind::Edge, right);
                self.summary.robots_found += usize::from(near);
                self.edges_correct += usize::from(near && right);
            }
        }
        let strangers = seen.robots.iter().filter(|robot| {
            truths
                .iter()
                .all(|truth| truth.distance_to(robot.at) > 2.0 * ROBOT_TOLERANCE)
        });
        for stranger in strangers {
            let range = stranger.edge.distance();
            self.summary.robots_false += usize::from(range <= 4.0);
            note(ScoredItem {
                kind: ScoredKind::FalseRobot,
                range,
                correct: false,
            });
        }
    }

    /// All frames in numbers; none if no frame was added.
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

impl DetectionSummary {
    /// In a few lines for people.
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
                "goal posts: {} of {} found are some",
                self.posts_right, self.posts
            );
        }
    }
}

impl GroundTruthScene<'_> {
    fn known_objects(&self) -> &[GroundTruthObject] {
        self.objects.unwrap_or_default()
    }

    /// Where a point of the upright map lies on the ground (docs/methods.md 3.3).
    fn compensate_tilt(&self, at: At<RobotFrame>) -> At<RobotFrame> {
        let [x, y] = ground_from_map([at.x, at.y], self.tilt, self.viewpoint_height);
        At::new(x, y)
    }

    /// The other robots.
    fn robot_bodies(&self) -> Vec<Body> {
        let robots = self.known_objects().iter().filter(|object| !object.is_ball);
        let body = |robot: &GroundTruthObject| Body {
            at: self.pose.inverse() * robot.at,
            outline: match robot.heading {
                Some(heading) => BodyOutline::Square(OTHER_HALF_SIDE, heading - self.pose.theta),
                None => BodyOutline::Circle(ObjectConfig::default().robot_radius),
            },
        };
        robots.map(body).collect()
    }

    /// Does a robot stand before this place, or is it covered?
    fn is_occluded(&self, at: At<RobotFrame>) -> bool {
        let range = at.distance();
        let covered = visibility::is_in_sectors(at.y.atan2(at.x), self.occluded_sectors);
        covered
            || self
                .known_objects()
                .iter()
                .filter(|object| !object.is_ball)
                .any(|robot| {
                    let robot = self.pose.inverse() * robot.at;
                    let along = (robot.x * at.x + robot.y * at.y) / range;
                    let across = (robot.x * at.y - robot.y * at.x).abs() / range;
                    along > 0.0 && along < range + 0.3 && across < 0.3
                })
    }

    /// Is more than half of the ball visible, on the carpet? Where nobody counted its pixels, directions are counted.
    fn is_ball_mostly_visible(&self, ball: &GroundTruthObject, at: At<RobotFrame>) -> bool {
        let (half_length, half_width) = self.field.carpet_half_extent();
        if ball.at.x.abs() > half_length || ball.at.y.abs() > half_width {
            return false;
        }
        let Some(visible) = ball.visible_px else {
            let mut bodies = self.robot_bodies();
            bodies.push(Body {
                at,
                outline: BodyOutline::Circle(ObjectConfig::default().ball_radius),
            });
            let sights = visibility::body_visibilities(&bodies, self.occluded_sectors);
            return sights
                .last()
                .is_some_and(|ball| ball.visible_fraction > 0.5);
        };
        vision::objects::ball::expected_ball_pixels_at(
            self.map,
            &ObjectConfig {
                viewpoint_height: self.viewpoint_height,
                ..ObjectConfig::default()
            },
            at,
        )
        .is_some_and(|whole| visible > 0.5 * whole)
    }
}
