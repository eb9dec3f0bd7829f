//! Are the images of two robots? Body, rods and rim stand still in the images of one, and lie elsewhere in those of another.

use rayon::prelude::*;

use crate::calibrate::edge_field::EdgeField;
use crate::calibrate::own_structure::{OwnStructure, distinct_places};
use crate::calibrate::two_groups::{Row, TwoGroups, best_groups};
use crate::image::Image;

/// Images that are compared; of more, evenly spaced ones.
const IMAGES_MAX: usize = 48;

/// Fewest places of a robot: a person's hands or a ball before the body seldom stay for three.
const PLACES_MIN: usize = 3;

/// Fewest cells that an image shows and that two robots are told by.
const CELLS_MIN: usize = 16;

/// Images whose groups by one half of the cells differ from those by the other half, at most.
const DISAGREEING_SHARE_MAX: f64 = 0.05;

/// Least distance of the groups, in standard deviations of their images. A uniform spread that is cut in the middle has
/// 3.5, a normal one 2.7.
const SEPARATION_MIN: f64 = 4.0;

/// Least typical displacement of a static edge between two robots, reduced pixels. Light alone moves edges by up to a
/// third of a pixel, and a mirror that moves by less hardly changes the map.
const APART_MIN: f64 = 0.5;

/// Images of two robots.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct TwoRobots {
    /// Indices of the images of the robot with more of them.
    pub(super) first: Vec<usize>,
    /// Those of the other one.
    pub(super) second: Vec<usize>,
    /// Typical displacement of the static edges, pixels of the image.
    pub(super) apart_px: f64,
}

/// The groups if the images are of two robots. Images of one size.
pub(super) fn find_two_robots(images: &[&Image]) -> Option<TwoRobots> {
    let step = images.len().div_ceil(IMAGES_MAX).max(1);
    let chosen: Vec<&&Image> = images.iter().step_by(step).collect();
    let fields: Vec<EdgeField> = chosen
        .par_iter()
        .map(|image| EdgeField::new(image))
        .collect();
    let reduction = fields.first()?.reduction;
    let places: Vec<&EdgeField> = distinct_places(&fields)
        .into_iter()
        .map(|index| &fields[index])
        .collect();
    if places.len() < 2 * PLACES_MIN {
        return None;
    }
    let structure = OwnStructure::find(&places);
    let rows: Vec<Row> = places
        .iter()
        .map(|field| structure.displacements(field))
        .filter(|row| shows_enough(row))
        .collect();
    drop(fields);
    if rows.len() < 2 * PLACES_MIN {
        return None;
    }
    let groups = decide(&rows, &structure)?;
    let sides: Vec<Option<f64>> = images
        .par_iter()
        .map(|image| {
            let row = structure.displacements(&EdgeField::new(image));
            shows_enough(&row).then(|| groups.score(&row))
        })
        .collect();
    let of_side = |is_positive: bool| -> Vec<usize> {
        let is_there = |&index: &usize| sides[index].is_some_and(|s| (s > 0.0) == is_positive);
        (0..images.len()).filter(is_there).collect()
    };
    let (mut first, mut second) = (of_side(false), of_side(true));
    if first.len() < second.len() {
        std::mem::swap(&mut first, &mut second);
    }
    Some(TwoRobots {
        first,
        second,
        apart_px: groups.typical_distance() * reduction as f64,
    })
}

fn shows_enough(row: &Row) -> bool {
    let seen = row.iter().flatten().count();
    seen >= CELLS_MIN && 3 * seen >= row.len()
}

/// Groups that both halves of the cells, taken like the squares of a chessboard, find by themselves, and that each tells
/// apart in the displacements of the other half.
fn decide(rows: &[Row], structure: &OwnStructure) -> Option<TwoGroups> {
    let is_white: Vec<bool> = structure
        .cells
        .iter()
        .map(|cell| (cell.index[0] + cell.index[1]).is_multiple_of(2))
        .collect();
    let half = |white: bool| -> Vec<Row> {
        let of_row = |row: &Row| -> Row {
            let cells = row.iter().zip(&is_white);
            cells
                .filter(|(_, is_white)| **is_white == white)
                .map(|(displacement, _)| *displacement)
                .collect()
        };
        rows.iter().map(of_row).collect()
    };
    let halves = [half(false), half(true)];
    let labels = [best_groups(&halves[0])?, best_groups(&halves[1])?];
    let equal = labels[0]
        .iter()
        .zip(&labels[1])
        .filter(|(a, b)| a == b)
        .count();
    let disagreeing = equal.min(rows.len() - equal);
    let is_separate = |half: &[Row], labels: &[bool]| separation(half, labels) >= SEPARATION_MIN;
    let labels_of_all = best_groups(rows)?;
    let members = labels_of_all.iter().filter(|&&label| label).count();
    let groups = TwoGroups::new(rows, &labels_of_all, None);
    let is_decided = disagreeing as f64 <= DISAGREEING_SHARE_MAX * rows.len() as f64
        && members.min(rows.len() - members) >= PLACES_MIN
        && is_separate(&halves[1], &labels[0])
        && is_separate(&halves[0], &labels[1])
        && groups.typical_distance() >= APART_MIN;
    is_decided.then_some(groups)
}

/// Distance of the groups' means in standard deviations of the images, each image scored by the others.
fn separation(rows: &[Row], labels: &[bool]) -> f64 {
    let scores: Vec<f64> = (0..rows.len())
        .map(|index| TwoGroups::new(rows, labels, Some(index)).score(&rows[index]))
        .collect();
    let mean = |of: bool| {
        let group: Vec<f64> = scores
            .iter()
            .zip(labels)
            .filter(|(_, label)| **label == of)
            .map(|(score, _)| *score)
            .collect();
        group.iter().sum::<f64>() / group.len() as f64
    };
    let means = [mean(false), mean(true)];
    let squares: f64 = scores
        .iter()
        .zip(labels)
        .map(|(score, &label)| (score - means[usize::from(label)]).powi(2))
        .sum();
    let deviation = (squares / (rows.len() - 2) as f64).sqrt();
    (means[1] - means[0]) / deviation.max(1e-9)
}
