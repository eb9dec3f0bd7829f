//! Where do a keyframe's points lie on what the other keyframes saw? Points to pieces of line, robustly.

use nalgebra::{Matrix3, Vector3};

use super::FieldMappingConfig;
use super::keyframes::Keyframe;
use super::point_map::{KnownFrom, PieceLookup, PointMap};
use super::pose_graph::{OdometryCorrection, PointEquations, PoseGraph};
use crate::frames::{At, FieldFrame, Pose};
use crate::math;

/// Keyframes after which those placed so far are relaxed.
const RELAX_PERIOD: usize = 40;
/// Steps of a match, and of each sweep.
const MATCH_STEPS: usize = 6;
const SWEEP_STEPS: usize = 2;
/// Points of a keyframe on places that others saw for it to count as a revisit.
const REVISIT_POINTS: usize = 30;
/// Weight of a point: those of one keyframe repeat errors.
const POINT_WEIGHT: f64 = 0.1;

/// Places the keyframes one after the other: by the wheels, then by the points of those before. The first is the origin.
pub(super) fn place_in_order(
    keyframes: &mut [Keyframe],
    wheel_noise: f32,
    config: &FieldMappingConfig,
) -> OdometryCorrection {
    let mut correction = OdometryCorrection::default();
    let mut map = PointMap::new(config.cell);
    for index in 0..keyframes.len() {
        if let Some(previous) = index.checked_sub(1).and_then(|k| keyframes.get(k)) {
            let predicted = previous.pose * correction.apply(keyframes[index].motion);
            let keyframe = &mut keyframes[index];
            keyframe.pose = predicted;
            match_pose(keyframe, map.lookup(index), config);
        }
        map.add(index, map_points(&keyframes[index]));
        if (index + 1).is_multiple_of(RELAX_PERIOD) {
            let placed = &mut keyframes[..=index];
            for _ in 0..2 {
                relax(
                    placed,
                    &mut correction,
                    config.reach_first,
                    wheel_noise,
                    config,
                );
            }
            map = map_of(placed, config);
        }
    }
    correction
}

/// Moves all keyframes and the wheels' correction until points and wheels agree. Returns the number of revisits.
pub(super) fn relax(
    keyframes: &mut [Keyframe],
    correction: &mut OdometryCorrection,
    reach: f32,
    wheel_noise: f32,
    config: &FieldMappingConfig,
) -> usize {
    let mut revisits = 0;
    for _ in 0..SWEEP_STEPS {
        let map = map_of(keyframes, config);
        revisits = 0;
        let mut equations = Vec::with_capacity(keyframes.len());
        for (index, keyframe) in keyframes.iter().enumerate() {
            let (equation, seen) = point_equations(keyframe, &mut map.lookup(index), reach);
            revisits += usize::from(seen >= REVISIT_POINTS);
            equations.push(equation);
        }
        PoseGraph::new(keyframes, correction, config, wheel_noise).step(&equations);
    }
    revisits
}

/// Points of a keyframe on the map, with their weights.
pub(super) fn map_points(keyframe: &Keyframe) -> impl Iterator<Item = (At<FieldFrame>, f32)> {
    let (sin, cos) = math::sin_cos(keyframe.pose.theta);
    let pose = keyframe.pose;
    keyframe.points.iter().map(move |point| {
        let at = At::new(
            pose.x + cos * point.at.x - sin * point.at.y,
            pose.y + sin * point.at.x + cos * point.at.y,
        );
        (at, point.weight)
    })
}

fn map_of(keyframes: &[Keyframe], config: &FieldMappingConfig) -> PointMap {
    let mut map = PointMap::new(config.cell);
    for (index, keyframe) in keyframes.iter().enumerate() {
        map.add(index, map_points(keyframe));
    }
    map
}

/// Matches one keyframe to a map, from the pose by the wheels.
fn match_pose(keyframe: &mut Keyframe, mut pieces: PieceLookup<'_>, config: &FieldMappingConfig) {
    let predicted = keyframe.pose;
    let distance = keyframe.motion.origin().distance();
    let std = [
        config.odometry_noise * distance + 0.01,
        config.odometry_noise * distance + 0.01,
        config.odometry_noise * keyframe.motion.theta.abs() + 0.02 * distance + 0.005,
    ];
    let information = std.map(|std| 1.0 / f64::from(std * std));
    let mut reach = config.reach_first;
    for _ in 0..MATCH_STEPS {
        let (equation, _) = point_equations(keyframe, &mut pieces, reach);
        let off = keyframe.pose.difference(predicted).map(f64::from);
        let prior = Matrix3::from_diagonal(&Vector3::from(information));
        let normal = equation.normal + prior;
        let Some(cholesky) = normal.cholesky() else {
            return;
        };
        let step = -cholesky.solve(&(equation.gradient + prior * off));
        let pose = keyframe.pose;
        keyframe.pose = Pose::new(
            pose.x + step[0] as f32,
            pose.y + step[1] as f32,
            pose.theta + step[2] as f32,
        );
        reach = (0.7 * reach).max(config.reach_last);
    }
}

/// Normal equations of a keyframe's points, and the number of points on places that others than its neighbours saw.
fn point_equations(
    keyframe: &Keyframe,
    pieces: &mut PieceLookup<'_>,
    reach: f32,
) -> (PointEquations, usize) {
    let mut sums = PointEquations::default();
    let mut seen = 0;
    for (point, (at, _)) in keyframe.points.iter().zip(map_points(keyframe)) {
        let Some(known) = pieces.nearest(at, reach) else {
            continue;
        };
        seen += usize::from(known.known_from != KnownFrom::Neighbours);
        let piece = known.piece;
        let [nx, ny] = piece.normal;
        let residual = nx * (at.x - piece.mean.x) + ny * (at.y - piece.mean.y);
        let scale = 0.5 * reach;
        let kernel = scale * scale / (scale * scale + residual * residual);
        let weight = POINT_WEIGHT * f64::from(kernel * kernel / (point.variance + piece.across));
        let turn = ny * (at.x - keyframe.pose.x) - nx * (at.y - keyframe.pose.y);
        let row = Vector3::new(f64::from(nx), f64::from(ny), f64::from(turn));
        sums.normal += weight * row * row.transpose();
        sums.gradient += weight * f64::from(residual) * row;
    }
    (sums, seen)
}
