//! Which lines and arcs pass through the elements? The longest first, each until it ends.

use rand::rngs::Xoshiro256PlusPlus;
use rand::{RngExt, SeedableRng};

use super::FieldMappingConfig;
use super::elements::Element;
use super::fit::{Circle, StraightLine, std_of_parts};
use super::junctions;
use super::shape::Shape;
use crate::math;

/// Most runs of elements that are too short for a line.
const REFUSED_MAX: usize = 40;
/// Most shapes of a field.
const SHAPES_MAX: usize = 80;
/// Seeds of lines and pairs for circles that are tried for each shape.
const LINE_SEEDS: usize = 400;
const CIRCLE_PAIRS: usize = 3000;
/// An arc must hold this much more than the best line: a circle fits a short line too.
const ARC_ADVANTAGE: f32 = 1.2;
/// Least cosine between the normals of shape and element.
const ALIGNMENT_MIN: f32 = 0.85;
/// Distance of the elements that a shape takes, in tolerances: the points' noise reaches farther than the fit.
const TAKEN: f32 = 3.5;
/// Standard deviation of a line's end along it, metres.
const END_STD: f32 = 0.05;

/// Standard deviation of an arc's centre or radius from which it is left out: it is too short to tell them, metres.
const ARC_STD_MAX: f32 = 1.0;

/// Finds the lines and arcs, longest first, and the number of arcs that are too uncertain.
pub(super) fn find(elements: &[Element], config: &FieldMappingConfig) -> (Vec<Shape>, usize) {
    let mut free: Vec<&Element> = elements.iter().collect();
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(1);
    let mut shapes = Vec::new();
    let mut refused = 0;
    while shapes.len() < SHAPES_MAX && free.len() > 2 {
        let line = best_line(&free, config, &mut rng);
        let arc = best_arc(&free, config, &mut rng);
        let line_size = line.as_ref().map_or(0, |(_, members)| members.len());
        let arc_size = arc.as_ref().map_or(0, |(_, members)| members.len());
        let is_arc = arc_size as f32 > ARC_ADVANTAGE * line_size as f32;
        let largest = match (&line, &arc) {
            (_, Some((_, members))) if is_arc => middle(members),
            (Some((_, members)), _) => middle(members),
            _ => None,
        };
        let found = match (line, arc) {
            (_, Some((circle, members))) if is_arc => arc_shape(circle, &members, config),
            (Some((line, members)), _) => line_shape(line, &members),
            _ => None,
        };
        let Some(shape) = found.filter(|shape| shape.length() >= config.length_min) else {
            // The largest run is a blob. What it covers is no line.
            let Some(blob) = largest.filter(|_| refused < REFUSED_MAX) else {
                break;
            };
            refused += 1;
            free.retain(|element| {
                math::hypot(element.at[0] - blob[0], element.at[1] - blob[1])
                    > config.length_min / 2.0
            });
            continue;
        };
        let taken = TAKEN * config.shape_tolerance;
        free.retain(|element| shape.distance(element.at) > taken);
        shapes.push(shape);
    }
    let found = shapes.len();
    shapes.retain(|shape| match shape {
        Shape::Line { .. } => true,
        Shape::Arc { std, .. } => std.iter().all(|std| *std <= ARC_STD_MAX),
    });
    let left_out = found - shapes.len();
    junctions::join_ends(&mut shapes);
    (shapes, left_out)
}

/// The mean of some elements.
fn middle(members: &[&Element]) -> Option<[f32; 2]> {
    let count = members.len() as f32;
    let sum = |k: usize| members.iter().map(|element| element.at[k]).sum::<f32>();
    (!members.is_empty()).then(|| [sum(0) / count, sum(1) / count])
}

/// Distance of the points that a shape explains, in tolerances.
const EXPLAINED: f32 = 2.0;

/// Share of the points on the shapes, and their root mean square distance, metres.
pub(super) fn explained(
    shapes: &[Shape],
    elements: &[Element],
    config: &FieldMappingConfig,
) -> (f32, f32) {
    let [mut all, mut on, mut squares] = [0.0_f32; 3];
    for element in elements {
        all += element.weight;
        let nearest = shapes
            .iter()
            .map(|shape| shape.distance(element.at))
            .fold(f32::MAX, f32::min);
        if nearest <= EXPLAINED * config.shape_tolerance {
            on += element.weight;
            squares += element.weight * nearest * nearest;
        }
    }
    (on / all.max(1.0), (squares / on.max(1.0)).sqrt())
}

/// The straight line with most elements, and these.
fn best_line<'a>(
    free: &[&'a Element],
    config: &FieldMappingConfig,
    rng: &mut Xoshiro256PlusPlus,
) -> Option<(StraightLine, Vec<&'a Element>)> {
    let mut best: Option<(StraightLine, Vec<&Element>)> = None;
    for _ in 0..LINE_SEEDS.min(4 * free.len()) {
        let seed = free[rng.random_range(0..free.len())];
        let line = StraightLine {
            through: seed.at,
            direction: [seed.normal[1], -seed.normal[0]],
        };
        let members = line_members(&line, free, config);
        if best
            .as_ref()
            .is_none_or(|(_, most)| members.len() > most.len())
        {
            best = Some((line, members));
        }
    }
    let (mut line, mut members) = best?;
    for _ in 0..4 {
        let fitted = StraightLine::fit(members.iter().copied())?;
        // The run about the middle of the members goes on.
        let found = line_members(&fitted, free, config);
        if found.is_empty() {
            break;
        }
        (line, members) = (fitted, found);
    }
    (members.len() > 1).then_some((line, members))
}

/// The elements on a line without a gap, about the place through which it is defined.
fn line_members<'a>(
    line: &StraightLine,
    free: &[&'a Element],
    config: &FieldMappingConfig,
) -> Vec<&'a Element> {
    let aligned = |element: &&&Element| {
        let [nx, ny] = element.normal;
        line.across(element.at).abs() <= config.shape_tolerance
            && (ny * line.direction[0] - nx * line.direction[1]).abs() >= ALIGNMENT_MIN
    };
    let mut near: Vec<(f32, &Element)> = free
        .iter()
        .filter(aligned)
        .map(|&element| (line.along(element.at), element))
        .collect();
    near.sort_by(|a, b| a.0.total_cmp(&b.0));
    longest_run(&near, config.gap_max)
}

/// The run with most elements between gaps.
fn longest_run<'a>(sorted: &[(f32, &'a Element)], gap_max: f32) -> Vec<&'a Element> {
    let runs = sorted.chunk_by(|a, b| b.0 - a.0 <= gap_max);
    let longest = runs.max_by_key(|run| run.len()).unwrap_or_default();
    longest.iter().map(|(_, element)| *element).collect()
}

fn line_shape(line: StraightLine, members: &[&Element]) -> Option<Shape> {
    let along = || members.iter().map(|element| line.along(element.at));
    let (low, high) = (along().reduce(f32::min)?, along().reduce(f32::max)?);
    Some(Shape::Line {
        from: line.at(low),
        to: line.at(high),
        // The parts of a drive share the bends of the map: their mean is known no better than one of them.
        std_across: std_of_parts(members, |at| line.across(at)).0,
        std_along: END_STD,
    })
}

/// The circle with most elements, and these.
fn best_arc<'a>(
    free: &[&'a Element],
    config: &FieldMappingConfig,
    rng: &mut Xoshiro256PlusPlus,
) -> Option<(Circle, Vec<&'a Element>)> {
    let mut best: Option<(Circle, Vec<&Element>)> = None;
    for _ in 0..CIRCLE_PAIRS {
        let a = free[rng.random_range(0..free.len())];
        let b = free[rng.random_range(0..free.len())];
        let apart = math::hypot(a.at[0] - b.at[0], a.at[1] - b.at[1]);
        if !(0.2..=2.0 * config.radius_max).contains(&apart) {
            continue;
        }
        let Some(circle) = Circle::through(a, b) else {
            continue;
        };
        if !(config.radius_min..=config.radius_max).contains(&circle.radius) {
            continue;
        }
        let members = arc_members(&circle, free, config);
        if best
            .as_ref()
            .is_none_or(|(_, most)| members.len() > most.len())
        {
            best = Some((circle, members));
        }
    }
    let (mut circle, mut members) = best?;
    for _ in 0..3 {
        if members.len() < 4 {
            return None;
        }
        let (fitted, _) = circle.fit(&members)?;
        if !(config.radius_min..=config.radius_max).contains(&fitted.radius) {
            return None;
        }
        let found = arc_members(&fitted, free, config);
        if found.len() < members.len() / 2 {
            break;
        }
        (circle, members) = (fitted, found);
    }
    Some((circle, members))
}

/// The elements on a circle in one run without a gap.
fn arc_members<'a>(
    circle: &Circle,
    free: &[&'a Element],
    config: &FieldMappingConfig,
) -> Vec<&'a Element> {
    let on_circle = |element: &&&Element| {
        let (dx, dy) = (
            element.at[0] - circle.centre[0],
            element.at[1] - circle.centre[1],
        );
        let distance = math::hypot(dx, dy).max(1e-3);
        let [nx, ny] = element.normal;
        (distance - circle.radius).abs() <= config.shape_tolerance
            && ((nx * dx + ny * dy) / distance).abs() >= ALIGNMENT_MIN
    };
    let mut near: Vec<(f32, &Element)> = free
        .iter()
        .filter(on_circle)
        .map(|&element| (circle.angle(element.at), element))
        .collect();
    near.sort_by(|a, b| a.0.total_cmp(&b.0));
    let gap = config.gap_max / circle.radius;
    let turns = unrolled(near, gap);
    longest_run(&turns, gap)
}

/// The angles from the end of the largest gap on, so that no run is cut at ±180°.
fn unrolled(mut sorted: Vec<(f32, &Element)>, gap: f32) -> Vec<(f32, &Element)> {
    let Some(cut) = sorted
        .windows(2)
        .position(|pair| pair[1].0 - pair[0].0 > gap)
    else {
        return sorted;
    };
    sorted.rotate_left(cut + 1);
    let first = sorted.first().map_or(0.0, |(angle, _)| *angle);
    for (angle, _) in &mut sorted {
        *angle = first + (*angle - first).rem_euclid(std::f32::consts::TAU);
    }
    sorted
}

fn arc_shape(circle: Circle, members: &[&Element], config: &FieldMappingConfig) -> Option<Shape> {
    let (circle, inverse) = circle.fit(members)?;
    let mut angles: Vec<(f32, &Element)> = members
        .iter()
        .map(|&element| (circle.angle(element.at), element))
        .collect();
    angles.sort_by(|a, b| a.0.total_cmp(&b.0));
    let gap = config.gap_max / circle.radius;
    let (first, last) = (angles.first()?.0, angles.last()?.0);
    let wraps = angles.windows(2).all(|pair| pair[1].0 - pair[0].0 <= gap)
        && std::f32::consts::TAU - (last - first) <= gap;
    let (start, sweep) = if wraps {
        (0.0, std::f32::consts::TAU)
    } else {
        let turned = unrolled(angles, gap);
        let (first, last) = (turned.first()?.0, turned.last()?.0);
        (crate::frames::wrap_angle(first), last - first)
    };
    let (std, parts) = std_of_parts(members, |at| circle.across(at));
    let mean_std = f64::from(std / parts.sqrt());
    Some(Shape::Arc {
        centre: circle.centre,
        radius: circle.radius,
        start,
        sweep,
        std: std::array::from_fn(|k| (mean_std * inverse[(k, k)].max(0.0).sqrt()) as f32),
    })
}
