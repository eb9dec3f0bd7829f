//! Obstacle at the carpet's end of each ray; rods and cables are skipped.

use localize::math;

use crate::colour::lookup_table::ColourClass;
use crate::config::ObjectDetectionConfig;
use crate::objects::carpet_end::CarpetEnd;
use crate::objects::own_body::OwnBody;
use crate::objects::radial_scan::RadialScan;

/// Obstacle of one ray.
#[derive(Debug, Clone, Copy)]
pub(crate) struct RayObstacle {
    /// Range of its base, metres.
    pub(crate) range: f32,
    /// Median of its own and both neighbours' ranges, metres.
    pub(crate) smoothed_range: f32,
    /// The ray's direction, robot frame, unit length.
    pub(crate) direction: [f32; 2],
    /// True if it is dark or of a team's colour from the floor up.
    pub(crate) solid_base: bool,
    /// True if no carpet is visible before it: it starts next to the robot.
    pub(crate) touches_robot: bool,
    /// True if it is known not to be the robot's own body.
    pub(crate) beyond_own_body: bool,
    /// Number of cyan samples.
    pub(crate) cyan: u32,
    /// Number of magenta samples.
    pub(crate) magenta: u32,
    /// Sample of its base.
    pub(crate) base_sample: usize,
}

/// Samples of a base: its edge is mixed with the carpet.
pub(crate) const BASE_SAMPLES: usize = 5;

/// Largest range step between adjacent rays on one object, metres: a slanted side plus the sample spacing.
pub(crate) fn range_step_max(range: f32) -> f32 {
    0.15 + 0.1 * range
}

/// Obstacles of all rays; None if there is none within range.
pub(crate) fn find_ray_obstacles(
    rays: &RadialScan,
    carpet_ends: &[CarpetEnd],
    own_body: &OwnBody,
    config: &ObjectDetectionConfig,
) -> Vec<Option<RayObstacle>> {
    let mut obstacles: Vec<Option<RayObstacle>> = (0..rays.count())
        .map(|ray| {
            let end = rays.starts[ray + 1];
            find_obstacle_at_robot(rays, ray, own_body, config)
                .or_else(|| find_obstacle_beyond_carpet(rays, &carpet_ends[ray], end, config))
        })
        .collect();
    // In a loop of their own, so that loads from memory overlap: before, each would wait for decisions about its ray.
    for obstacle in obstacles.iter_mut().flatten() {
        let [x, y] = rays.samples[obstacle.base_sample].ground;
        let length = math::hypot(x, y);
        obstacle.direction = [x / length, y / length];
    }
    replace_thin_obstacles(&mut obstacles, config);
    smooth_ranges(&obstacles)
}

/// Obstacle at the carpet's end.
fn find_obstacle_beyond_carpet(
    rays: &RadialScan,
    carpet_end: &CarpetEnd,
    end: usize,
    config: &ObjectDetectionConfig,
) -> Option<RayObstacle> {
    if !(carpet_end.carpet_seen && carpet_end.range <= config.robot_range_max) {
        return None;
    }
    // A line and its blurred edges may precede the base.
    let before = carpet_end.first_beyond..skip_lines(rays, carpet_end.first_beyond, end, config);
    let solid = before.clone().find(|&first| {
        let base = &rays.classes[first..end.min(first + BASE_SAMPLES)];
        is_robot_colour(base[0])
            && 2 * base.iter().filter(|&&class| is_robot_colour(class)).count() >= base.len()
    });
    let first = solid.unwrap_or_else(|| {
        let mut samples = before.clone();
        let line = |sample: &usize| rays.classes[*sample] == ColourClass::WHITE;
        samples.find(|sample| !line(sample)).unwrap_or(before.end)
    });
    let base = &rays.classes[first..end.min(first + BASE_SAMPLES)];
    let whites = base
        .iter()
        .filter(|&&class| class == ColourClass::WHITE)
        .count();
    if base.is_empty() || 2 * whites > base.len() {
        return None;
    }
    // The base is in the middle of the samples that mix floor and obstacle.
    let floor = |class: &ColourClass| matches!(*class, ColourClass::CARPET | ColourClass::WHITE);
    let between = &rays.classes[carpet_end.first_beyond..first];
    let last = between.iter().rposition(floor);
    let last = last.map_or(carpet_end.first_beyond - 1, |last| {
        carpet_end.first_beyond + last
    });
    let range = (rays.ranges[last] + rays.ranges[first]) / 2.0;
    // Where the map ends, so does the carpet.
    if range.is_infinite() {
        return None;
    }
    Some(build_ray_obstacle(rays, first, end, range, solid.is_some()))
}

/// One past the last sample that may be a line, starting at `from`.
fn skip_lines(rays: &RadialScan, from: usize, end: usize, config: &ObjectDetectionConfig) -> usize {
    let mut gap = 0.0;
    let within = |sample: &usize| {
        gap += weighted_ground_step(rays, *sample);
        gap < config.carpet_gap_max
    };
    from + (from..end).take_while(within).count()
}

/// Ground that a sample covers along its ray, metres; white counts a quarter, since a line may point at the robot.
fn weighted_ground_step(rays: &RadialScan, sample: usize) -> f32 {
    let step = rays.ranges[sample] - rays.ranges[sample - 1];
    if rays.classes[sample] == ColourClass::WHITE {
        0.25 * step
    } else {
        step
    }
}

/// Obstacle that hides the carpet from the robot on, farther than an ignored gap; where the own body is known, from its
/// end on.
fn find_obstacle_at_robot(
    rays: &RadialScan,
    ray: usize,
    own_body: &OwnBody,
    config: &ObjectDetectionConfig,
) -> Option<RayObstacle> {
    let end = rays.starts[ray + 1];
    let own_end = own_body.end(ray);
    let start = own_end.unwrap_or(rays.starts[ray]);
    let hidden = rays.hidden_end(ray, start);
    if hidden == start {
        return None;
    }
    // A line that begins at the body hides nothing, however wide it blooms.
    let is_white = |class: &&ColourClass| **class == ColourClass::WHITE;
    let whites = rays.classes[start..hidden].iter().filter(is_white).count();
    if own_end.is_some() && 2 * whites > hidden - start {
        return None;
    }
    let nearest = rays.ranges[start];
    let gap: f32 = (start + 1..hidden)
        .map(|sample| weighted_ground_step(rays, sample))
        .sum();
    let hides = gap > config.carpet_gap_max + config.carpet_gap_per_range * nearest;
    hides.then(|| RayObstacle {
        touches_robot: true,
        beyond_own_body: own_end.is_some(),
        ..build_ray_obstacle(rays, start, end, nearest, true)
    })
}

/// An obstacle without its direction.
fn build_ray_obstacle(
    rays: &RadialScan,
    first: usize,
    end: usize,
    range: f32,
    solid: bool,
) -> RayObstacle {
    let count_class = |wanted: ColourClass| {
        let same = rays.classes[first..end].iter().filter(|&&c| c == wanted);
        same.count() as u32
    };
    RayObstacle {
        range,
        smoothed_range: range,
        direction: [0.0; 2],
        solid_base: solid,
        touches_robot: false,
        beyond_own_body: false,
        cyan: count_class(ColourClass::CYAN),
        magenta: count_class(ColourClass::MAGENTA),
        base_sample: first,
    }
}

fn is_robot_colour(class: ColourClass) -> bool {
    matches!(
        class,
        ColourClass::BLACK | ColourClass::CYAN | ColourClass::MAGENTA
    )
}

/// Replaces obstacles that are nearer than both neighbours and narrower than a robot (rods, cables) by the nearer
/// neighbour.
///
/// The mirror's own rods appear in fixed directions.
fn replace_thin_obstacles(obstacles: &mut [Option<RayObstacle>], config: &ObjectDetectionConfig) {
    let count = obstacles.len();
    let ray_angle = std::f32::consts::TAU / count as f32;
    for first in 0..count {
        let range = |obstacles: &[Option<RayObstacle>], ray: usize| {
            obstacles[ray % count].map_or(f32::INFINITY, |obstacle| obstacle.range)
        };
        let own = range(obstacles, first);
        let before = range(obstacles, first + count - 1);
        if !own.is_finite() || before - own <= range_step_max(own) {
            continue;
        }
        let widest = (config.robot_width_min / (ray_angle * own)) as usize;
        let farther = |ray: &usize| range(obstacles, *ray) - own > range_step_max(own);
        let Some(after) = (first + 1..=first + widest).find(farther) else {
            continue;
        };
        let neighbours = if before <= range(obstacles, after) {
            obstacles[(first + count - 1) % count]
        } else {
            obstacles[after % count]
        };
        for ray in first..after {
            // The replacement is in the ray's own direction.
            let towards = obstacles[ray % count].map(|obstacle| obstacle.direction);
            obstacles[ray % count] = neighbours.map(|neighbours| RayObstacle {
                direction: towards.unwrap_or(neighbours.direction),
                ..neighbours
            });
        }
    }
}

/// Smooths ranges and bases over three adjacent rays: a robot covers several, noise only one.
fn smooth_ranges(obstacles: &[Option<RayObstacle>]) -> Vec<Option<RayObstacle>> {
    let count = obstacles.len();
    let median = |ray: usize| {
        let own = obstacles[ray]?;
        let neighbours = [ray + count - 1, ray + 1].map(|ray| obstacles[ray % count]);
        let [before, after] = neighbours.map(|other| other.map_or(own.range, |other| other.range));
        let solid = |other: Option<RayObstacle>| {
            let near = other.filter(|o| (o.range - own.range).abs() < range_step_max(own.range));
            near.map_or(own.solid_base, |other| other.solid_base)
        };
        let [one, other] = neighbours.map(solid);
        Some(RayObstacle {
            smoothed_range: own.range.clamp(before.min(after), before.max(after)),
            solid_base: if one == other { one } else { own.solid_base },
            ..own
        })
    };
    (0..count).map(median).collect()
}
