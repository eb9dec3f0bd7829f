//! Which mirror makes the lines straight? Its range by image radius, but for the scale, from line points alone: no field, no poses.
//!
//! Most points of an image lie on a few straight lines of the floor, whatever the field's sizes are. For each shape of a family
//! the longest lines are taken out of each image one after the other. The best shapes are fitted: axis and spline of the range
//! move so that the points of each line deviate least from it, relative to their range.

use localize::math;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use crate::calibrate::joint_fit::MapModel;
use crate::calibrate::line_pixels::SearchImage;
use crate::calibrate::radial_family::shapes;
use crate::calibrate::radial_model::{KnownSizes, PixelPoint, RadialModel};

/// Reach of a line per round, as a share of the range: from a member of the family to the accuracy of paint.
const REACHES: [f64; 9] = [0.05, 0.04, 0.03, 0.025, 0.02, 0.02, 0.015, 0.015, 0.012];

/// Steps of the fit for each set of lines.
const STEPS: usize = 6;

/// Shapes that are fitted.
const FITTED: usize = 5;

/// Fewest points of a line.
const LINE_POINTS_MIN: usize = 10;

/// Most lines of an image: more is clutter.
const LINES_MAX: usize = 8;

/// Points between which lines are tried.
const TRIED_POINTS: usize = 40;

/// Two points nearer than this share of their range do not give a line's direction.
const BASE_MIN: f64 = 0.2;

/// Points on one straight line of the floor.
type Line = Vec<PixelPoint>;

/// A point on the ground with its standard deviation.
struct GroundPoint {
    at: [f64; 2],
    std: f64,
}

/// The mirror of the family by which most points lie on straight lines; its scale is a guess. None if no shape can be fitted.
pub(super) fn find_straight_mirror(
    images: &[SearchImage],
    sizes: KnownSizes,
) -> Option<RadialModel> {
    let count = |model: &RadialModel, reach: f64| -> usize {
        lines_of(model, images, reach).iter().map(Vec::len).sum()
    };
    let mut ranked: Vec<(usize, RadialModel)> = shapes()
        .collect::<Vec<_>>()
        .into_par_iter()
        .map(|function| {
            let model = RadialModel::new(function, sizes);
            (count(&model, REACHES[0]), model)
        })
        .collect();
    ranked.sort_by_key(|&(straight, _)| std::cmp::Reverse(straight));
    ranked.truncate(FITTED);
    let fitted: Vec<(usize, RadialModel)> = ranked
        .into_par_iter()
        .filter_map(|(_, mut model)| {
            for reach in REACHES {
                let lines = lines_of(&model, images, reach);
                for _ in 0..STEPS {
                    step(&mut model, &lines, reach)?;
                }
            }
            Some((count(&model, REACHES[REACHES.len() - 1]), model))
        })
        .collect();
    let best = fitted.into_iter().max_by_key(|&(straight, _)| straight)?;
    Some(best.1)
}

fn lines_of(model: &RadialModel, images: &[SearchImage], reach: f64) -> Vec<Line> {
    images
        .iter()
        .flat_map(|image| image_lines(model, &image.points, reach))
        .collect()
}

/// The lines of one image, those with most points first.
fn image_lines(model: &RadialModel, points: &[PixelPoint], reach: f64) -> Vec<Line> {
    let mut left: Vec<(PixelPoint, GroundPoint)> = points
        .iter()
        .filter_map(|point| Some((*point, ground_point(model, point, reach)?)))
        .collect();
    let mut lines = Vec::new();
    while lines.len() < LINES_MAX {
        let Some(line) = longest_line(&left) else {
            break;
        };
        let is_on = |(_, ground): &(PixelPoint, GroundPoint)| distance(line, ground) < ground.std;
        let (on, off): (Vec<_>, Vec<_>) = left.into_iter().partition(is_on);
        if on.len() < LINE_POINTS_MIN {
            break;
        }
        lines.push(on.into_iter().map(|(point, _)| point).collect());
        left = off;
    }
    lines
}

/// The line through two points that is nearest to most others: a point of it and its normal.
fn longest_line(points: &[(PixelPoint, GroundPoint)]) -> Option<[[f64; 2]; 2]> {
    let tried: Vec<[f64; 2]> = points
        .iter()
        .step_by(points.len().div_ceil(TRIED_POINTS).max(1))
        .map(|(_, ground)| ground.at)
        .collect();
    let pairs = tried.iter().enumerate().flat_map(|(i, from)| {
        let later = &tried[i + 1..];
        later.iter().filter_map(|to| line_through(*from, *to))
    });
    let scored = pairs.map(|line| {
        let near = points.iter().map(|(_, ground)| {
            let share = distance(line, ground) / ground.std;
            (1.0 - share * share).max(0.0)
        });
        (near.sum::<f64>(), line)
    });
    let best = scored.max_by(|a, b| a.0.total_cmp(&b.0))?;
    Some(best.1)
}

fn line_through(from: [f64; 2], to: [f64; 2]) -> Option<[[f64; 2]; 2]> {
    let [x, y] = [to[0] - from[0], to[1] - from[1]];
    let length = math::hypot(x, y);
    let range = f64::min(math::hypot(from[0], from[1]), math::hypot(to[0], to[1]));
    (length > BASE_MIN * range).then(|| [from, [-y / length, x / length]])
}

fn distance([at, normal]: [[f64; 2]; 2], ground: &GroundPoint) -> f64 {
    ((ground.at[0] - at[0]) * normal[0] + (ground.at[1] - at[1]) * normal[1]).abs()
}

/// None at the horizon.
fn ground_point(model: &RadialModel, point: &PixelPoint, reach: f64) -> Option<GroundPoint> {
    let at = model.ground(point, [0.0; 2]);
    let variance = model.variance(point);
    let range = math::hypot(at[0], at[1]);
    let std = (variance + (reach * range) * (reach * range)).sqrt();
    (at[0].is_finite() && at[1].is_finite() && std.is_finite()).then_some(GroundPoint { at, std })
}

/// One Gauss-Newton step of axis and spline; each line is refitted to its points meanwhile. The tilt is not told by straight
/// lines: a tilted plane is another view of the same lines. None if the normal equations cannot be solved.
fn step(model: &mut RadialModel, lines: &[Line], reach: f64) -> Option<()> {
    let count = model.parameter_count();
    let mut normal = DMatrix::<f64>::zeros(count, count);
    let mut gradient = DVector::<f64>::zeros(count);
    for line in lines {
        add_line(model, line, reach, &mut normal, &mut gradient);
    }
    for term in model.prior_terms() {
        let parameters = model.parameters();
        let value: f64 = term.row.iter().map(|&(i, di)| di * parameters[i]).sum();
        for &(i, di) in &term.row {
            gradient[i] += term.weight * (value - term.target) * di;
            for &(j, dj) in &term.row {
                normal[(i, j)] += term.weight * di * dj;
            }
        }
    }
    for i in RadialModel::TILT {
        normal[(i, i)] += 1e12;
    }
    let change = -normal.cholesky()?.solve(&gradient);
    for (value, change) in model.parameters_mut().iter_mut().zip(change.iter()) {
        *value += change;
    }
    Some(())
}

/// Adds the normal equations of a line's points, in units of their standard deviations.
///
/// The line's own direction and offset are eliminated: what they could take of the residuals is projected out.
fn add_line(
    model: &RadialModel,
    line: &Line,
    reach: f64,
    normal: &mut DMatrix<f64>,
    gradient: &mut DVector<f64>,
) {
    let count = model.parameter_count();
    let grounds: Vec<(&PixelPoint, GroundPoint)> = line
        .iter()
        .filter_map(|point| Some((point, ground_point(model, point, reach)?)))
        .collect();
    let Some([centre, across]) = fitted_line(&grounds) else {
        return;
    };
    let along = [across[1], -across[0]];
    let mut rows = DMatrix::<f64>::zeros(grounds.len(), count);
    let mut residuals = DVector::<f64>::zeros(grounds.len());
    let mut own = [
        DVector::<f64>::zeros(grounds.len()),
        DVector::<f64>::zeros(grounds.len()),
    ];
    let mut by_map: Vec<(usize, [f64; 2])> = Vec::new();
    for (k, (point, ground)) in grounds.iter().enumerate() {
        by_map.clear();
        model.linearize(point, [0.0; 2], &mut by_map);
        let offset = [ground.at[0] - centre[0], ground.at[1] - centre[1]];
        let of = |axis: [f64; 2], vector: [f64; 2]| axis[0] * vector[0] + axis[1] * vector[1];
        let residual = of(across, offset) / ground.std;
        // Geman and McClure's weight, as its root.
        let weight = 1.0 / (1.0 + residual * residual);
        residuals[k] = weight * residual;
        let squared_range = of(ground.at, ground.at);
        for &(i, moved) in &by_map {
            // The standard deviation grows with the range: no shape gains by shrinking the ground.
            let change =
                of(across, moved) / ground.std - residual * of(ground.at, moved) / squared_range;
            rows[(k, i)] = weight * change;
        }
        own[0][k] = weight / ground.std;
        own[1][k] = weight * of(along, offset) / ground.std;
    }
    for i in 0..2 {
        let [first, second] = &mut own;
        if i == 1 {
            let shared = first.dot(second);
            *second -= &*first * shared;
        }
        let vector = &mut own[i];
        let length = vector.norm();
        if length < 1e-9 {
            return;
        }
        *vector /= length;
        let taken = rows.tr_mul(vector);
        rows -= &*vector * taken.transpose();
        let taken = residuals.dot(vector);
        residuals -= &*vector * taken;
    }
    *gradient += rows.tr_mul(&residuals);
    *normal += rows.tr_mul(&rows);
}

/// The line that fits best: its centre and normal.
fn fitted_line(points: &[(&PixelPoint, GroundPoint)]) -> Option<[[f64; 2]; 2]> {
    let (mut weights, mut sums) = (0.0, [0.0; 2]);
    for (_, ground) in points {
        let weight = 1.0 / (ground.std * ground.std);
        weights += weight;
        sums[0] += weight * ground.at[0];
        sums[1] += weight * ground.at[1];
    }
    if points.len() < LINE_POINTS_MIN / 2 {
        return None;
    }
    let centre = sums.map(|sum| sum / weights);
    let [mut xx, mut xy, mut yy] = [0.0; 3];
    for (_, ground) in points {
        let weight = 1.0 / (ground.std * ground.std);
        let [x, y] = [ground.at[0] - centre[0], ground.at[1] - centre[1]];
        xx += weight * x * x;
        xy += weight * x * y;
        yy += weight * y * y;
    }
    let (sin, cos) = math::sin_cos(0.5 * math::atan2(2.0 * xy, xx - yy));
    Some([centre, [-sin, cos]])
}
