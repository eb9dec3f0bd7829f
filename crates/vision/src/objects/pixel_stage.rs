//! The second stage: which candidates are balls, robots and people, judged by their pixels (docs/methods.md 4.9).
//!
//! Candidates come from grids that know no colour, and from the detectors of the ball's colour and of the carpet's end.

use std::f32::consts::TAU;

use localize::frames::At;
use localize::math;
use localize::robot::CameraConfig;
use localize::world::TeamColour;

use crate::colour::lookup_table::{ColourClass, ColourLookupTable};
use crate::config::ObjectDetectionConfig;
use crate::image::ImageView;
use crate::objects::ball::BallDetection;
use crate::objects::ball_candidates::{BallCandidate, BallGrid, PlaceTables, separation};
use crate::objects::ball_fit::fit_ball;
use crate::objects::bright_foot::BrightFootSearch;
use crate::objects::carpet_hull::CarpetHull;
use crate::objects::covariance::covariance_from_polar;
use crate::objects::obstacle_candidates::{ObstacleCandidate, ObstacleGrid, is_same};
use crate::objects::obstacle_edges::{measure_width, refine_foot};
use crate::objects::patch::obstacle_row_step;
use crate::objects::rejection::{ObjectRejection, RejectedObject};
use crate::objects::robots::{
    ObstacleKind, PERSON_RADIUS, PERSON_RADIUS_STD, RobotDetection, join_parts,
};
use crate::objects::view_angles::ViewAngles;
use crate::optics::ground_map::GroundMap;

/// A detection by colour or by the carpet's end is dropped if its pixels contradict: below this probability.
const CONTRADICTION: f32 = 0.1;
/// Nearer than this the robot itself takes the floor before an object, and the networks do not judge, metres.
const JUDGED_RANGE_MIN: f32 = 0.4;
/// A foot this much nearer (metres) than the carpet's end in its direction, more probable and at least so probable, is
/// that of the obstacle there.
const NEARER_FOOT: f32 = 0.25;
const FOOT_PROBABILITY_MIN: f32 = 0.9;
/// Least probability of a ball before its place is fitted. The networks judge best where a ball is in the middle.
const PROBABILITY_BEFORE_FIT: f32 = 0.3;
/// Detections nearer than this are one ball, ball radii.
const BALL_SEPARATION: f32 = 1.5;
/// Rows above the foot and columns (metres) in which a team marker is sought, and its fewest samples.
const MARKER_ROWS: usize = 14;
const MARKER_COLUMNS: [f32; 5] = [-0.14, -0.07, 0.0, 0.07, 0.14];
const MARKER_SAMPLES_MIN: usize = 6;

/// Tables of the second stage for one camera.
#[derive(Debug, Clone)]
pub(crate) struct PixelStage {
    angles: ViewAngles,
    balls: BallGrid,
    obstacles: ObstacleGrid,
    carpet_hull: CarpetHull,
}

/// Probability by the mean of two log odds.
fn mean_probability(a: f32, b: f32) -> f32 {
    let odds = |probability: f32| probability / (1.0 - probability).max(1e-6);
    let mean = (odds(a) * odds(b)).sqrt();
    mean / (1.0 + mean)
}

/// One image and what is known about its colours.
#[derive(Clone, Copy)]
pub(crate) struct PixelStageInput<'a> {
    pub(crate) image: &'a ImageView<'a>,
    pub(crate) map: &'a GroundMap,
    pub(crate) lookup_table: &'a ColourLookupTable,
    /// By which a ball is no carpet, where that is another one.
    pub(crate) chroma_table: Option<&'a ColourLookupTable>,
    pub(crate) config: &'a ObjectDetectionConfig,
}

impl PixelStage {
    pub(crate) fn new(
        map: &GroundMap,
        camera: &CameraConfig,
        mask: Option<&[bool]>,
        config: &ObjectDetectionConfig,
    ) -> Self {
        let angles = ViewAngles::new(map, camera.centre_px, config.viewpoint_height);
        let size = [map.width_px, map.height_px];
        let is_visible = |u: usize, v: usize| {
            camera.is_inside_mirror(u as f32, v as f32)
                && mask.is_none_or(|mask| mask[v * map.width_px + u])
        };
        PixelStage {
            balls: BallGrid::new(&angles, config, size, is_visible),
            obstacles: ObstacleGrid::new(&angles, config, size, is_visible),
            carpet_hull: CarpetHull::new(config.ray_count),
            angles,
        }
    }

    /// All balls on the ground, best first.
    ///
    /// `carpet_end`: range of the carpet's boundary along each ray, metres. `obstacles`: robots and people.
    pub(crate) fn detect_balls(
        &self,
        input: PixelStageInput<'_>,
        carpet_end: &[f32],
        obstacles: &[RobotDetection],
    ) -> Vec<BallDetection> {
        let reach = self.ball_reach(carpet_end, obstacles);
        let tables = PlaceTables {
            floor: input.lookup_table,
            ball: input.chroma_table.unwrap_or(input.lookup_table),
        };
        let candidates = self
            .balls
            .find_candidates(input.image, tables, carpet_end, &reach);
        let candidates = self
            .balls
            .judge(input.image, candidates, PROBABILITY_BEFORE_FIT);
        let mut balls: Vec<(BallCandidate, BallDetection)> = Vec::new();
        for candidate in candidates {
            let Some((fitted, ball)) = self.ball_detection(input, &candidate) else {
                continue;
            };
            let beside = |(other, _): &(BallCandidate, BallDetection)| {
                separation(&fitted, other) < BALL_SEPARATION
            };
            if !balls.iter().any(beside) {
                balls.push((fitted, ball));
            }
        }
        let mut balls: Vec<BallDetection> = balls.into_iter().map(|(_, ball)| ball).collect();
        balls.sort_by(|a, b| b.score.total_cmp(&a.score));
        balls
    }

    /// Range to which a ball may lie along each ray, metres: to the end of the carpet, and also beyond what ends the view
    /// of it, but for obstacles, which hide balls.
    fn ball_reach(&self, carpet_end: &[f32], obstacles: &[RobotDetection]) -> Vec<f32> {
        let mut reach = self.carpet_hull.ranges(carpet_end);
        let count = carpet_end.len() as i32;
        for obstacle in obstacles {
            let azimuth = self.obstacles.azimuth_of(obstacle.position_px);
            let half = math::atan2(0.5 * obstacle.width, obstacle.edge.distance());
            let [first, last] =
                [azimuth - half, azimuth + half].map(|azimuth| azimuth / TAU * count as f32);
            for ray in first.floor() as i32..=last.ceil() as i32 {
                let ray = ray.rem_euclid(count) as usize;
                reach[ray] = carpet_end[ray];
            }
        }
        reach
    }

    /// The ball that its colour gave, if its pixels do not contradict. One in the air or at the robot's feet looks unlike
    /// those that the network knows and is not judged.
    pub(crate) fn judge_ball_by_colour(
        &self,
        input: PixelStageInput<'_>,
        ball: BallDetection,
        rejected: &mut Vec<RejectedObject>,
    ) -> Option<BallDetection> {
        if !ball.on_ground || ball.at.distance() < JUDGED_RANGE_MIN {
            return Some(ball);
        }
        let mut candidate = self
            .balls
            .candidate_at(ball.at.distance(), ball.position_px);
        candidate.probability = self.balls.probability(input.image, &candidate);
        let fitted = (candidate.probability >= PROBABILITY_BEFORE_FIT)
            .then(|| self.ball_detection(input, &candidate))
            .flatten();
        if fitted.is_none() {
            rejected.push(RejectedObject {
                position_px: ball.position_px,
                reason: ObjectRejection::NotABall,
                probability: candidate.probability,
            });
        }
        fitted.map(|(_, ball)| ball)
    }

    fn ball_detection(
        &self,
        input: PixelStageInput<'_>,
        candidate: &BallCandidate,
    ) -> Option<(BallCandidate, BallDetection)> {
        let config = input.config;
        let fit = fit_ball(input.image, &self.angles, candidate);
        let mut fitted = self.balls.displaced(candidate, fit.away, fit.aside);
        fitted.probability = self.balls.probability(input.image, &fitted);
        // Beside lines, robots and the mirror's rim the disc slides off a ball, but remains near it: both looks count.
        let unfitted = BallCandidate {
            probability: mean_probability(candidate.probability, fitted.probability),
            ..*candidate
        };
        let slid_off = fitted.probability < config.ball_probability_min
            && unfitted.probability >= config.ball_probability_min;
        let candidate = if slid_off { &unfitted } else { &fitted };
        if candidate.probability < config.ball_probability_min {
            return None;
        }
        let (view_angle, azimuth) = (candidate.view_angle, candidate.azimuth);
        let centre_height = config.viewpoint_height - config.ball_radius;
        let range = centre_height * math::tan(view_angle);
        if !(range > 0.0 && range <= config.ball_range_max) {
            return None;
        }
        let position_px = self.angles.position_px(view_angle, azimuth);
        let contact_px = self
            .angles
            .position_px(self.angles.ground_angle(range), azimuth);
        let [ex, ey] = ground_direction(input.map, contact_px)?;
        // Ground that half a ball covers along the view.
        let footprint =
            config.viewpoint_height / math::cos(view_angle).powi(2) * candidate.ball.half_height;
        let (along, across) = (0.02 + 0.15 * footprint, 0.01 + 0.02 * range);
        let row_px = self
            .angles
            .radius_px(view_angle + candidate.ball.half_height, azimuth)
            - self
                .angles
                .radius_px(view_angle - candidate.ball.half_height, azimuth);
        let width_px = 2.0 * candidate.ball.half_width * self.angles.radius_px(view_angle, azimuth);
        let quarter = std::f32::consts::FRAC_PI_4;
        let pixels = quarter * row_px * width_px;
        let ball = BallDetection {
            at: At::new(range * ex, range * ey),
            covariance: covariance_from_polar([ex, ey], along, across),
            on_ground: true,
            score: candidate.probability,
            position_px,
            pixels: pixels.max(1.0) as usize,
            distance: None,
        };
        Some((*candidate, ball))
    }

    /// True if the last image showed another view than those before.
    pub(crate) fn is_new_view(&self) -> bool {
        self.obstacles.is_new_view()
    }

    /// Robots and people. `by_carpet`: obstacles at the carpet's end. `carpet_end`: range of that along each ray, metres.
    /// `is_hidden`: see [`ObstacleGrid::find_candidates`].
    pub(crate) fn detect_obstacles(
        &mut self,
        input: PixelStageInput<'_>,
        by_carpet: Vec<RobotDetection>,
        carpet_end: &[f32],
        is_hidden: impl Fn(f32, f32) -> bool,
        rejected: &mut Vec<RejectedObject>,
    ) -> Vec<RobotDetection> {
        let PixelStageInput { image, config, .. } = input;
        let carpet = self.carpet_hull.ranges(carpet_end);
        let candidates =
            self.obstacles
                .find_candidates(image, input.lookup_table, &carpet, is_hidden);
        let candidates = self
            .obstacles
            .judge(image, candidates, config.obstacle_probability_min);
        let mut known: Vec<ObstacleCandidate> = Vec::new();
        let mut obstacles = Vec::new();
        for mut robot in by_carpet {
            let azimuth = self.obstacles.azimuth_of(robot.position_px);
            let candidate = self
                .obstacles
                .judge_at(image, robot.edge.distance(), azimuth);
            // A dark body that stray light tints like the carpet ends it too late. Its foot is a step that networks know.
            let nearer = candidates.iter().find(|other| {
                is_same(&candidate, other)
                    && other.range < candidate.range - NEARER_FOOT
                    && other.probability() > candidate.probability().max(FOOT_PROBABILITY_MIN)
            });
            if let Some(nearer) = nearer
                && let Some(foot) = self.obstacle_detection(input, nearer)
            {
                known.push(*nearer);
                obstacles.push(RobotDetection {
                    marker: robot.marker.or(foot.marker),
                    ..foot
                });
                continue;
            }
            let beside = candidates.iter().any(|other| is_same(&candidate, other));
            let judged = robot.edge.distance() >= JUDGED_RANGE_MIN;
            let reason = if self.obstacles.is_own_part(&candidate) {
                Some(ObjectRejection::OwnBody)
            } else if judged && !beside && candidate.probability() < CONTRADICTION {
                Some(ObjectRejection::NotAnObstacle)
            } else {
                None
            };
            if let Some(reason) = reason {
                rejected.push(RejectedObject {
                    position_px: robot.position_px,
                    reason,
                    probability: candidate.probability(),
                });
                continue;
            }
            if robot.marker.is_none() && candidate.person > candidate.robot.max(0.5) {
                robot.become_person();
            }
            known.push(candidate);
            obstacles.push(robot);
        }
        // What ends the carpet has a measured width.
        let measured = obstacles.len();
        for candidate in candidates {
            if known.iter().any(|other| is_same(&candidate, other)) {
                continue;
            }
            let detection = self.obstacle_detection(input, &candidate);
            if let Some(obstacle) = detection
                && !obstacles[..measured]
                    .iter()
                    .any(|nearer| nearer.hides(&obstacle))
            {
                known.push(candidate);
                obstacles.push(obstacle);
            }
        }
        join_parts(obstacles, 2.0 * config.robot_radius)
    }

    fn obstacle_detection(
        &self,
        input: PixelStageInput<'_>,
        candidate: &ObstacleCandidate,
    ) -> Option<RobotDetection> {
        let config = input.config;
        // Near the horizon a fraction of a row is metres.
        let refined = refine_foot(input.image, &self.angles, candidate);
        let range = match refined > 0.0 && refined <= config.robot_range_max {
            true => refined,
            false => candidate.range,
        };
        let foot = ObstacleCandidate {
            range,
            ..*candidate
        };
        let marker = self.team_marker(input, &foot);
        let (kind, radius) = match marker.is_none() && candidate.person > candidate.robot {
            true => (ObstacleKind::Person, PERSON_RADIUS),
            false => (ObstacleKind::Robot, config.robot_radius),
        };
        let shoe = (kind == ObstacleKind::Person)
            .then(|| self.bright_foot(input, &foot))
            .flatten();
        let range = shoe.unwrap_or(range);
        let foot = ObstacleCandidate { range, ..foot };
        let position_px = self.obstacles.foot_px(&foot);
        let [ex, ey] = self.direction(input.map, &foot)?;
        let middle = range + radius;
        let row = self.angles.ground_angle(range) + obstacle_row_step(range, self.angles.height);
        let along = 0.05 + 0.3 * (self.angles.ground_range(row) - range).min(range);
        let along = match kind {
            ObstacleKind::Person => math::hypot(along, PERSON_RADIUS_STD),
            ObstacleKind::Robot => along,
        };
        let across = 0.08 + 0.02 * range;
        Some(RobotDetection {
            at: At::new(middle * ex, middle * ey),
            edge: At::new(range * ex, range * ey),
            covariance: covariance_from_polar([ex, ey], along, across),
            width: measure_width(input.image, &self.angles, &foot),
            marker,
            score: candidate.probability(),
            position_px,
            kind,
        })
    }

    /// Where a bright shoe before a foot begins, metres.
    fn bright_foot(&self, input: PixelStageInput<'_>, foot: &ObstacleCandidate) -> Option<f32> {
        let search = BrightFootSearch {
            image: input.image,
            lookup_table: input.lookup_table,
            angles: &self.angles,
        };
        search.nearer_foot(foot)
    }

    /// Unit vector to an obstacle's foot, robot frame: where the map shows no ground so far away, that of the last ground
    /// before it.
    fn direction(&self, map: &GroundMap, foot: &ObstacleCandidate) -> Option<[f32; 2]> {
        let step = obstacle_row_step(foot.range, self.angles.height);
        let last = self.angles.ground_angle(foot.range);
        let rows = (0..).map(|row| last - row as f32 * step);
        let mut before = rows.take_while(|&view_angle| view_angle > 0.0);
        before.find_map(|view_angle| {
            ground_direction(map, self.angles.position_px(view_angle, foot.azimuth))
        })
    }

    /// Team colour above an obstacle's foot.
    fn team_marker(
        &self,
        input: PixelStageInput<'_>,
        foot: &ObstacleCandidate,
    ) -> Option<TeamColour> {
        let (mut cyan, mut magenta) = (0, 0);
        let view_angle = self.angles.ground_angle(foot.range);
        let step = obstacle_row_step(foot.range, self.angles.height);
        for row in 1..=MARKER_ROWS {
            for aside in MARKER_COLUMNS {
                let azimuth = foot.azimuth + math::atan2(aside, foot.range);
                let [u, v] = self
                    .angles
                    .position_px(view_angle + row as f32 * step, azimuth)
                    .map(|at| at.round());
                let size = [input.image.width_px as f32, input.image.height_px as f32];
                if !(u >= 0.0 && v >= 0.0 && u < size[0] && v < size[1]) {
                    continue;
                }
                let native = input.image.native_channels(u as usize, v as usize);
                match input.lookup_table.class(native) {
                    ColourClass::CYAN => cyan += 1,
                    ColourClass::MAGENTA => magenta += 1,
                    _ => {}
                }
            }
        }
        match (cyan, magenta) {
            (c, m) if c.max(m) < MARKER_SAMPLES_MIN => None,
            (c, m) if c > 2 * m => Some(TeamColour::Cyan),
            (c, m) if m > 2 * c => Some(TeamColour::Magenta),
            _ => None,
        }
    }
}

/// Unit vector of the ground at an image position, robot frame. None if the map shows no ground there.
fn ground_direction(map: &GroundMap, [u, v]: [f32; 2]) -> Option<[f32; 2]> {
    let (u, v) = (u.round(), v.round());
    if !(u >= 0.0 && v >= 0.0) {
        return None;
    }
    let ground = map.at(u as usize, v as usize)?;
    let range = ground.distance();
    (range > 0.0).then(|| [ground.x / range, ground.y / range])
}
