//! Are the images of two robots? Body, rods and rim stand still in the images of one, and lie elsewhere in those of another.

use rayon::prelude::*;

use crate::calibrate::CalibrationError;
use crate::calibrate::edge_field::EdgeField;
use crate::calibrate::lines::NamedImage;
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
struct TwoRobots {
    /// Indices of the images of the robot with more of them.
    first: Vec<usize>,
    /// Those of the other one.
    second: Vec<usize>,
    /// Typical displacement of the static edges, pixels of the image.
    apart_px: f64,
}

/// Refuses images of two robots, whose mirrors may be so alike that one map explains both.
pub(super) fn ensure_one_robot(images: &[NamedImage]) -> Result<(), CalibrationError> {
    let pictures: Vec<&Image> = images.iter().map(|image| &image.image).collect();
    let Some(robots) = find_two_robots(&pictures) else {
        return Ok(());
    };
    let names = |indices: &[usize]| -> Vec<String> {
        indices.iter().map(|&i| images[i].name.clone()).collect()
    };
    Err(CalibrationError::TwoCameras {
        sign: format!(
            "the robot's body, its rods and the mirror's rim lie {:.1} pixels apart in two groups of images",
            robots.apart_px
        ),
        first: names(&robots.first),
        second: names(&robots.second),
    })
}

/// The groups if the images are of two robots. Images of one size.
fn find_two_robots(images: &[&Image]) -> Option<TwoRobots> {
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
        .filter(shows_enough)
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
/// apart in the displacements of the other half. The few images on which the halves differ belong to neither group there.
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
    let equal = |index: &usize| labels[0][*index] == labels[1][*index];
    let (equal, opposite): (Vec<usize>, Vec<usize>) = (0..rows.len()).partition(equal);
    // Which group is called the first is chance.
    let (decided, undecided) = if equal.len() >= opposite.len() {
        (equal, opposite)
    } else {
        (opposite, equal)
    };
    let is_separate = |half: &[Row], labels: &[bool]| {
        let rows: Vec<Row> = decided.iter().map(|&index| half[index].clone()).collect();
        let labels: Vec<bool> = decided.iter().map(|&index| labels[index]).collect();
        separation(&rows, &labels) >= SEPARATION_MIN
    };
    let labels_of_all = best_groups(rows)?;
    let members = labels_of_all.iter().filter(|&&label| label).count();
    let groups = TwoGroups::new(rows, &labels_of_all, None);
    let is_decided = undecided.len() as f64 <= DISAGREEING_SHARE_MAX * rows.len() as f64
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

#[cfg(test)]
mod tests {
    use localize::math::{cos, exp, sin};

    use super::*;

    const SIDE: usize = 360;

    /// Numbers from 0 to 1 that look random (a linear congruential generator).
    struct Numbers(u64);

    impl Numbers {
        fn next(&mut self) -> f32 {
            self.0 = self
                .0
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            (self.0 >> 40) as f32 / (1 << 24) as f32
        }
    }

    /// Distance to a line of this direction through a point, pixels.
    fn distance([x, y]: [f32; 2], through: [f32; 2], direction: f32) -> f32 {
        ((y - through[1]) * cos(direction) - (x - through[0]) * sin(direction)).abs()
    }

    fn profile(distance: f32, width: f32) -> f32 {
        exp(-0.5 * (distance / width) * (distance / width))
    }

    /// A carpet with lines of its own, and a robot: a square body with three rods, moved by `shift` pixels.
    fn picture(place: u64, shift: [f32; 2], light: f32) -> Image {
        let mut numbers = Numbers(place.wrapping_mul(7919) + 1);
        let side = SIDE as f32;
        let lines: Vec<([f32; 2], f32)> = (0..6)
            .map(|_| {
                (
                    [side * numbers.next(), side * numbers.next()],
                    3.1 * numbers.next(),
                )
            })
            .collect();
        let centre = shift.map(|offset| 0.5 * side + offset);
        let mut rgb = Vec::new();
        for (v, u) in (0..SIDE).flat_map(|v| (0..SIDE).map(move |u| (v, u))) {
            let at = [u as f32, v as f32];
            let line = lines
                .iter()
                .map(|&(through, direction)| profile(distance(at, through, direction), 2.5));
            let mut level = 90.0 + 110.0 * line.fold(0.0, f32::max);
            let [x, y] = [at[0] - centre[0], at[1] - centre[1]];
            let rods = [[y.abs(), x], [y.abs(), -x], [x.abs(), -y]];
            for [across, along] in rods {
                level *= if along > 0.0 {
                    1.0 - 0.8 * profile(across, 3.0)
                } else {
                    1.0
                };
            }
            let outside = x.abs().max(y.abs()) - 30.0;
            level *= 0.2 + 0.8 / (1.0 + exp(-outside / 2.0));
            let noise = 6.0 * (numbers.next() - 0.5);
            rgb.extend([(light * level + noise).clamp(0.0, 255.0) as u8; 3]);
        }
        Image {
            width_px: SIDE,
            height_px: SIDE,
            rgb,
        }
    }

    fn find(images: &[Image]) -> Option<TwoRobots> {
        find_two_robots(&images.iter().collect::<Vec<_>>())
    }

    #[test]
    fn robots_whose_bodies_lie_two_pixels_apart_are_told_apart() {
        let images: Vec<Image> = (0..12)
            .map(|i| picture(i, if i % 3 == 2 { [1.5, 1.5] } else { [0.0; 2] }, 1.0))
            .collect();
        let robots = find(&images).expect("two robots");
        assert_eq!(robots.second, [2, 5, 8, 11]);
        assert_eq!(robots.first.len(), 8);
        assert!((0.8..2.5).contains(&robots.apart_px), "{robots:?}");
    }

    #[test]
    fn one_robot_in_two_lights_is_one() {
        let images: Vec<Image> = (0..12)
            .map(|i| picture(i, [0.0; 2], if i < 6 { 0.5 } else { 1.6 }))
            .collect();
        assert_eq!(find(&images), None);
    }

    #[test]
    fn places_where_a_robot_stood_for_long_are_no_robots() {
        let images: Vec<Image> = (0..16).map(|i| picture(i / 8, [0.0; 2], 1.0)).collect();
        assert_eq!(find(&images), None);
    }

    #[test]
    fn one_foreign_image_does_not_show_a_robot() {
        let images: Vec<Image> = (0..10)
            .map(|i| picture(i, if i == 4 { [1.5, 1.5] } else { [0.0; 2] }, 1.0))
            .collect();
        assert_eq!(find(&images), None);
    }
}
