//! Robot detection: groups of adjacent rays whose carpet ends at similar range, with their team marker.
//!
//! lima2001 section 3: the first obstacle in each direction; a robot's base is where its ray leaves the carpet.

use std::ops::Range;

use localize::frames::{At, RobotFrame, wrap_angle};
use localize::math;
use localize::world::TeamColour;

use crate::config::ObjectDetectionConfig;
use crate::objects::ball::BallDetection;
use crate::objects::carpet_end::CarpetEnd;
use crate::objects::covariance::covariance_from_polar;
use crate::objects::ground_contact::{GroundContact, GroundContactSearch};
use crate::objects::own_body::OwnBody;
use crate::objects::radial_scan::RadialScan;
use crate::objects::ray_obstacles::{
    BASE_SAMPLES, RayObstacle, find_ray_obstacles, range_step_max,
};

/// What stands on the field.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ObstacleKind {
    /// A robot.
    #[default]
    Robot,
    /// A person, or one leg.
    Person,
}

/// A robot or a person.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RobotDetection {
    /// Its centre, metres: `robot_radius` behind its nearest edge, of a person 0.15 m.
    pub at: At<RobotFrame>,
    /// Its nearest ground contact, metres.
    pub edge: At<RobotFrame>,
    /// Covariance of its centre: xx, xy, yy, m².
    pub covariance: [f32; 3],
    /// Visible width, metres.
    pub width: f32,
    /// Team colour, if a marker is visible.
    pub marker: Option<TeamColour>,
    /// Confidence: one third per cue (depth step to its neighbours, team marker, dark base), at least two thirds; of an
    /// obstacle found by its pixels, its probability.
    pub score: f32,
    /// Image position of its nearest edge: column, row, pixels.
    pub position_px: [f32; 2],
    /// Robot or person.
    pub kind: ObstacleKind,
}

/// Distance of a person's centre behind the nearest foot, metres, and its standard deviation: half a shoe from the side, the
/// heel of one who walks away, the toes of one who comes.
pub(crate) const PERSON_RADIUS: f32 = 0.15;
pub(crate) const PERSON_RADIUS_STD: f32 = 0.06;

/// Largest measured width of a ball, its radii: its edges are found in steps.
const WIDTH_OF_BALL_MAX: f32 = 3.0;

impl RobotDetection {
    /// True if this is a ball of the given radius (metres): no wider, and with its foot there.
    pub(crate) fn is_ball(&self, ball: &BallDetection, radius: f32) -> bool {
        ball.on_ground
            && ball.score >= self.score
            && self.width < WIDTH_OF_BALL_MAX * radius
            && self.edge.distance_to(ball.at) < 2.0 * radius
    }

    /// What was found as a robot is a person: its centre is nearer to its foot.
    pub(crate) fn become_person(&mut self) {
        let length = self.at.distance().max(f32::MIN_POSITIVE);
        let [x, y] = [self.at.x / length, self.at.y / length];
        let middle = self.edge.distance() + PERSON_RADIUS;
        self.at = At::new(middle * x, middle * y);
        let variance = PERSON_RADIUS_STD * PERSON_RADIUS_STD;
        let [xx, xy, yy] = &mut self.covariance;
        *xx += variance * x * x;
        *xy += variance * x * y;
        *yy += variance * y * y;
        self.kind = ObstacleKind::Person;
    }

    /// Takes in another part of the same robot or person, as good or worse: the centre is between theirs.
    fn absorb(&mut self, part: &RobotDetection) {
        let gap = self.at.distance_to(part.at);
        self.width = self.width.max(gap + 0.5 * (self.width + part.width));
        self.at = At::new(0.5 * (self.at.x + part.at.x), 0.5 * (self.at.y + part.at.y));
        self.marker = self.marker.or(part.marker);
    }

    /// True if the foot of another one is behind this robot, where the ground cannot be seen. People have legs.
    pub(crate) fn hides(&self, other: &RobotDetection) -> bool {
        let range = self.edge.distance();
        let aside = wrap_angle(self.at.bearing() - other.edge.bearing()).abs();
        self.kind == ObstacleKind::Robot
            && range < other.edge.distance()
            && aside < math::atan2(0.5 * self.width, range)
    }
}

/// Share of a robot's width below which two detections are one. Centres of two robots are a width apart; each is found with an error.
const ROBOT_SEPARATION: f32 = 0.8;
/// Distance below which a person and another detection are one, metres: two legs.
const PERSON_SEPARATION: f32 = 0.3;

/// Makes one of detections whose centres are nearer to each other than robots or people can stand: halves of one robot, legs of
/// one person.
/// `width`: of a robot, metres.
pub(crate) fn join_parts(mut parts: Vec<RobotDetection>, width: f32) -> Vec<RobotDetection> {
    parts.sort_by(|a, b| b.score.total_cmp(&a.score));
    let mut joined: Vec<RobotDetection> = Vec::with_capacity(parts.len());
    for part in parts {
        let is_whole = |other: &&mut RobotDetection| {
            let kinds = [other.kind, part.kind];
            let separation = match kinds.contains(&ObstacleKind::Person) {
                true => PERSON_SEPARATION,
                false => ROBOT_SEPARATION * width,
            };
            other.at.distance_to(part.at) < separation
        };
        match joined.iter_mut().find(is_whole) {
            Some(whole) => whole.absorb(&part),
            None => joined.push(part),
        }
    }
    joined
}

/// Least depth of a dip between two nearer robots, metres.
const DIP_MIN: f32 = 0.1;

/// Groups the rays' obstacles into robots.
pub(crate) fn detect_robots(
    rays: &RadialScan,
    carpet_ends: &[CarpetEnd],
    own_body: &OwnBody,
    contact_search: &GroundContactSearch<'_>,
    config: &ObjectDetectionConfig,
) -> Vec<RobotDetection> {
    let obstacles = find_ray_obstacles(rays, carpet_ends, own_body, config);
    let count = obstacles.len();
    let joined = |a: usize, b: usize| match (obstacles[a], obstacles[b]) {
        (Some(a), Some(b)) => {
            (a.smoothed_range - b.smoothed_range).abs()
                < range_step_max(a.smoothed_range.min(b.smoothed_range))
        }
        _ => false,
    };
    // Start at a gap, so that no group is split at azimuth 0.
    let Some(first) = (0..count).find(|&ray| !joined((ray + count - 1) % count, ray)) else {
        return Vec::new();
    };
    let mut found = Vec::new();
    let mut group = RayGroup::default();
    let widths = [robot_diagonal(config), std::f32::consts::TAU / count as f32];
    for step in 0..=count {
        let ray = (first + step) % count;
        let follows = (group.rays.last()).is_some_and(|&last| joined(last, ray)) && step < count;
        if !follows {
            group.split(0..group.rays.len(), widths, config, &mut |rays_of_one| {
                found.extend(build_robot(
                    rays,
                    carpet_ends,
                    contact_search,
                    &obstacles,
                    rays_of_one,
                    config,
                ));
            });
            group.clear();
        }
        if let Some(obstacle) = &obstacles[ray] {
            group.push(ray, obstacle);
        }
    }
    found
}

/// Adjacent rays whose obstacles may be one robot.
#[derive(Default)]
struct RayGroup {
    rays: Vec<usize>,
    /// Smoothed range of each of them, metres.
    ranges: Vec<f32>,
    /// Whether the base of each is dark.
    solid: Vec<bool>,
}

impl RayGroup {
    fn push(&mut self, ray: usize, obstacle: &RayObstacle) {
        self.rays.push(ray);
        self.ranges.push(obstacle.smoothed_range);
        self.solid.push(obstacle.solid_base);
    }

    fn clear(&mut self) {
        self.rays.clear();
        self.ranges.clear();
        self.solid.clear();
    }

    /// Splits the rays of `part` at a dip between nearer ones, at a depth step, or where the base changes, until none of the
    /// parts is wider than `width` (metres, at its nearest ray; `ray_angle` apart).
    fn split(
        &self,
        part: Range<usize>,
        [width, ray_angle]: [f32; 2],
        config: &ObjectDetectionConfig,
        found: &mut impl FnMut(&[usize]),
    ) {
        let ranges = &self.ranges[part.clone()];
        let nearest = ranges.iter().copied().fold(f32::INFINITY, f32::min);
        let cut = match ranges.len() as f32 * ray_angle * nearest > width {
            true => self.cut(part.clone(), config),
            false => None,
        };
        let Some(cut) = cut else {
            found(&self.rays[part]);
            return;
        };
        self.split(part.start..cut.start, [width, ray_angle], config, found);
        self.split(cut.end..part.end, [width, ray_angle], config, found);
    }

    /// The rays between two robots, empty where they touch; None if nothing divides the part.
    fn cut(&self, part: Range<usize>, config: &ObjectDetectionConfig) -> Option<Range<usize>> {
        let ranges = &self.ranges[part.clone()];
        let dip = deepest_dip(ranges).filter(|(depth, _)| *depth > DIP_MIN);
        if let Some((_, index)) = dip {
            let ray = part.start + index;
            return Some(ray..ray + 1);
        }
        // A depth step of half a robot separates two robots.
        let steps = ranges.array_windows().map(|[a, b]| (b - a).abs());
        let largest = last_largest(steps).filter(|(step, _)| *step > config.robot_radius);
        // Or a change of the base: a dark base next to a wall or the carpet's boundary.
        let solid = &self.solid[part.clone()];
        let changed = || solid.array_windows().position(|[a, b]| a != b);
        let before = largest.map(|(_, index)| index).or_else(changed)?;
        let ray = part.start + before + 1;
        Some(ray..ray)
    }
}

/// Depth and index of the deepest dip between nearer rays on both sides.
fn deepest_dip(ranges: &[f32]) -> Option<(f32, usize)> {
    // Nearest range from each ray on.
    let mut after = ranges.to_vec();
    for index in (1..after.len()).rev() {
        after[index - 1] = after[index - 1].min(after[index]);
    }
    let mut before = f32::INFINITY;
    let dips = ranges
        .array_windows()
        .zip(&after[2.min(after.len())..])
        .map(|([left, range, _], after)| {
            before = before.min(*left);
            range - before.max(*after)
        });
    last_largest(dips).map(|(depth, index)| (depth, index + 1))
}

/// The largest value, the last of equal ones, with its index.
fn last_largest(values: impl Iterator<Item = f32>) -> Option<(f32, usize)> {
    values
        .zip(0..)
        .reduce(|best, other| match other.0 >= best.0 {
            true => other,
            false => best,
        })
}

/// Largest width of a robot, metres: the diagonal of the league's square robot is √2 times its side.
fn robot_diagonal(config: &ObjectDetectionConfig) -> f32 {
    2.0 * config.robot_radius * std::f32::consts::SQRT_2
}

fn build_robot(
    rays: &RadialScan,
    carpet_ends: &[CarpetEnd],
    contact_search: &GroundContactSearch<'_>,
    obstacles: &[Option<RayObstacle>],
    group: &[usize],
    config: &ObjectDetectionConfig,
) -> Option<RobotDetection> {
    let members: Vec<RayObstacle> = group.iter().filter_map(|&ray| obstacles[ray]).collect();
    let nearest = *members.iter().min_by(|a, b| a.range.total_cmp(&b.range))?;
    let ray_angle = std::f32::consts::TAU / obstacles.len() as f32;
    let width = members.len() as f32 * ray_angle * nearest.range;
    if width < config.robot_width_min || width > config.robot_width_max {
        return None;
    }
    let stands_out = [group[0] + obstacles.len() - 2, group[group.len() - 1] + 2].map(|ray| {
        let ray = ray % obstacles.len();
        let end = obstacles[ray].map_or(carpet_ends[ray].range, |obstacle| obstacle.range);
        end - nearest.range >= config.robot_depth_step_min
    });
    let stands_out = stands_out == [true; 2];
    let solid = members
        .iter()
        .filter(|obstacle| obstacle.solid_base)
        .count() as f32
        / members.len() as f32;
    let [mut x, mut y] = [0.0, 0.0];
    for member in &members {
        x += member.direction[0];
        y += member.direction[1];
    }
    let length = math::hypot(x, y);
    let [x, y] = [x / length, y / length];
    let (cyan, magenta) = members.iter().fold((0, 0), |(c, m), obstacle| {
        (c + obstacle.cyan, m + obstacle.magenta)
    });
    let marker = match (cyan, magenta) {
        (c, m) if c.max(m) < 3 => None,
        (c, m) if c > 2 * m => Some(TeamColour::Cyan),
        (c, m) if m > 2 * c => Some(TeamColour::Magenta),
        _ => None,
    };
    // Dark floor behind the carpet, coloured objects and clutter show one cue each; a robot shows at least two.
    let cues = [stands_out, marker.is_some(), solid >= 0.5];
    let cues = cues.iter().filter(|&&cue| cue).count();
    // The own body passes two cues as well until it is known. So near, a marker is large, but noise is not.
    let most = |is: fn(&RayObstacle) -> bool| {
        2 * members.iter().filter(|obstacle| is(obstacle)).count() > members.len()
    };
    let touching = most(|obstacle| obstacle.touches_robot);
    let own = !most(|obstacle| obstacle.beyond_own_body);
    let plain = marker.is_none() || (cyan.max(magenta) as usize) < BASE_SAMPLES * members.len();
    // Nor is the end of the carpet beside the robot an obstacle: it is wider.
    if cues < 2 || touching && (own && plain || !own && width > robot_diagonal(config)) {
        return None;
    }
    let sample = rays.samples[nearest.base_sample];
    let base_px = [f32::from(sample.u), f32::from(sample.v)];
    let contact = contact_search.find_nearest(base_px, ray_angle);
    let contact = contact
        .filter(|_| !nearest.touches_robot)
        .unwrap_or(GroundContact {
            range: nearest.range,
            position_px: base_px,
        });
    let middle = contact.range + config.robot_radius;
    // Along the ray: sample spacing and unknown radius. Across: ray spacing and unknown width.
    let next = rays.samples[(nearest.base_sample + 1).min(rays.samples.len() - 1)].range;
    let step = (next - nearest.range).abs().min(1.0);
    let (along, across) = (step + 0.05, ray_angle * middle + 0.05);
    Some(RobotDetection {
        at: At::new(middle * x, middle * y),
        edge: At::new(contact.range * x, contact.range * y),
        covariance: covariance_from_polar([x, y], along, across),
        width,
        marker,
        score: cues as f32 / 3.0,
        position_px: contact.position_px,
        kind: ObstacleKind::Robot,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn robot_at(x: f32, y: f32, score: f32) -> RobotDetection {
        RobotDetection {
            at: At::new(x, y),
            edge: At::new(x, y - 0.25),
            covariance: [0.0025, 0.0, 0.0036],
            width: 0.3,
            marker: None,
            score,
            position_px: [0.0; 2],
            kind: ObstacleKind::Robot,
        }
    }

    #[test]
    fn halves_of_a_robot_are_one_and_touching_robots_are_two() {
        let halves = [robot_at(-0.15, 2.0, 0.9), robot_at(0.15, 2.0, 1.0)];
        let beside = robot_at(0.5, 2.0, 0.8);
        let found = join_parts(vec![halves[0], beside, halves[1]], 0.5);
        let places: Vec<[f32; 2]> = found.iter().map(|robot| [robot.at.x, robot.at.y]).collect();
        assert_eq!(places, [[0.0, 2.0], [0.5, 2.0]]);
        assert!((found[0].width - 0.6).abs() < 1e-6, "{}", found[0].width);
        assert_eq!(found[0].score, 1.0);
        let person = RobotDetection {
            kind: ObstacleKind::Person,
            ..halves[0]
        };
        assert_eq!(join_parts(vec![person, halves[1]], 0.5).len(), 2);
    }

    #[test]
    fn centre_of_a_person_is_a_persons_radius_behind_its_foot() {
        let mut found = robot_at(0.0, 1.75, 0.9);
        found.become_person();
        assert_eq!(found.kind, ObstacleKind::Person);
        assert!((found.at.y - 1.5 - PERSON_RADIUS).abs() < 1e-5 && found.at.x.abs() < 1e-6);
        let [across, mixed, along] = found.covariance;
        assert!((across - 0.0025).abs() < 1e-6 && mixed.abs() < 1e-6);
        assert!((along - 0.0036 - PERSON_RADIUS_STD * PERSON_RADIUS_STD).abs() < 1e-6);
    }
}
