//! How many labelled objects are found? Detections of real photographs against outlines that people drew.
//!
//! A recording folder with object_labels.csv (stamp_s, class, range_m, polygon_px) is scored image by image, in pixels.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Result, bail};
use localize::{Stamp, math};
use serde::Serialize;
use vision::Detections;

use crate::csv_table::CsvRow;
use crate::recording::{parse_stamp, read_optional_table};

/// A detection beside an outline is correct up to this share of the image's width: 12 pixels of 480.
const TOLERANCE_SHARE: f32 = 0.025;
/// Distances at which balls and obstacles are scored, metres; labels without distance are always scored.
const BALL_RANGE: (f32, f32) = (0.5, 5.0);
const OBSTACLE_RANGE: (f32, f32) = (0.0, 4.0);
/// Upper ends of the distance classes in the report, metres.
const RANGE_CLASSES: [f32; 5] = [1.0, 2.0, 3.0, 4.0, 5.0];

/// What a label shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum LabelClass {
    Ball,
    Robot,
    Person,
    Other,
}

/// A labelled outline.
#[derive(Debug, Clone)]
struct ObjectLabel {
    class: LabelClass,
    /// Distance of its foot, metres; None if it is not known.
    range: Option<f32>,
    /// Column and row of its corners, pixels.
    outline: Vec<[f32; 2]>,
}

/// The labels of a recording, by image.
#[derive(Debug, Clone, Default)]
pub struct ObjectLabels {
    by_image: BTreeMap<Stamp, Vec<ObjectLabel>>,
}

impl ObjectLabels {
    /// Reads object_labels.csv of a folder. None if the folder has none.
    pub fn read(folder: &Path) -> Result<Option<Self>> {
        let columns = ["stamp_s", "class", "polygon_px"];
        let Some(table) = read_optional_table(folder, "object_labels.csv", &columns)? else {
            return Ok(None);
        };
        let mut labels = ObjectLabels::default();
        for row in table.rows() {
            let of_image = labels.by_image.entry(parse_stamp(row)?).or_default();
            of_image.push(read_label(row)?);
        }
        Ok(Some(labels))
    }
}

fn read_label(row: CsvRow<'_>) -> Result<ObjectLabel> {
    let class = match row.text("class")? {
        "ball" => LabelClass::Ball,
        "robot" => LabelClass::Robot,
        "person" => LabelClass::Person,
        _ => LabelClass::Other,
    };
    let range = row.optional_number("range_m")?.map(|number| number as f32);
    let text = row.text("polygon_px")?;
    let corner = |corner: &str| {
        let (u, v) = corner.split_once(':')?;
        let number = |text: &str| text.parse().ok().filter(|number: &f32| number.is_finite());
        Some([number(u)?, number(v)?])
    };
    let outline: Option<Vec<[f32; 2]>> = text.split_whitespace().map(corner).collect();
    match outline {
        Some(outline) if outline.len() >= 3 => Ok(ObjectLabel {
            class,
            range,
            outline,
        }),
        _ => bail!(
            "{}: invalid polygon_px: {text:?} (expected at least three corners as u:v)",
            row.location()
        ),
    }
}

/// Found and false objects of one kind.
#[derive(Debug, Clone, Default, Serialize)]
pub struct KindSummary {
    /// Labelled objects within the scored distance, and those that were found.
    pub labelled: usize,
    /// See `labelled`.
    pub found: usize,
    /// Detections within that distance at no label of the kind.
    pub false_finds: usize,
    /// Labelled and found objects by distance: up to 1, 2, 3, 4, 5 m, and beyond or unknown.
    pub by_range: [[usize; 2]; RANGE_CLASSES.len() + 1],
}

/// Results of a labelled recording, as `--json` prints them.
#[derive(Debug, Clone, Default, Serialize)]
pub struct LabelSummary {
    /// Scored images.
    pub images: usize,
    /// Balls from 0.5 to 5 m.
    pub balls: KindSummary,
    /// Robots to 4 m. False detections are counted with the people's, as `obstacles_false`.
    pub robots: KindSummary,
    /// People to 4 m.
    pub people: KindSummary,
    /// Robots or people detected where neither is labelled.
    pub obstacles_false: usize,
}

impl LabelSummary {
    /// Scores one image of a width in pixels.
    pub fn add_image(
        &mut self,
        labels: &ObjectLabels,
        stamp: Stamp,
        width_px: usize,
        detections: &Detections,
    ) {
        let none = Vec::new();
        let labels = labels.by_image.get(&stamp).unwrap_or(&none);
        let tolerance = TOLERANCE_SHARE * width_px as f32;
        let balls: Vec<([f32; 2], f32)> = detections
            .ball
            .iter()
            .chain(&detections.other_balls)
            .map(|ball| (ball.position_px, ball.at.distance()))
            .collect();
        let obstacles: Vec<([f32; 2], f32)> = detections
            .robots
            .iter()
            .map(|robot| (robot.position_px, robot.edge.distance()))
            .collect();
        let is_ball = |class| class == LabelClass::Ball;
        let is_obstacle = |class| matches!(class, LabelClass::Robot | LabelClass::Person);
        self.images += 1;
        self.balls
            .add_labels(labels, &balls, LabelClass::Ball, BALL_RANGE, tolerance);
        self.robots.add_labels(
            labels,
            &obstacles,
            LabelClass::Robot,
            OBSTACLE_RANGE,
            tolerance,
        );
        self.people.add_labels(
            labels,
            &obstacles,
            LabelClass::Person,
            OBSTACLE_RANGE,
            tolerance,
        );
        self.balls.false_finds += false_finds(labels, &balls, is_ball, BALL_RANGE, tolerance);
        self.obstacles_false +=
            false_finds(labels, &obstacles, is_obstacle, OBSTACLE_RANGE, tolerance);
    }

    /// Prints the results as text.
    pub fn print(&self) {
        let images = self.images.max(1) as f64;
        let obstacles = self.robots.labelled + self.people.labelled;
        println!(
            "labelled balls ({} to {} m): {} of {} found; {:.2} false a picture",
            BALL_RANGE.0,
            BALL_RANGE.1,
            self.balls.found,
            self.balls.labelled,
            self.balls.false_finds as f64 / images
        );
        println!(
            "labelled robots and people (to {} m): {} of {} found; {:.2} false a picture",
            OBSTACLE_RANGE.1,
            self.robots.found + self.people.found,
            obstacles,
            self.obstacles_false as f64 / images
        );
        for (name, kind) in [
            ("balls", &self.balls),
            ("robots", &self.robots),
            ("people", &self.people),
        ] {
            let classes = kind.by_range.iter().enumerate();
            let parts: Vec<String> = classes
                .filter(|(_, [labelled, _])| *labelled > 0)
                .map(
                    |(class, [labelled, found])| match RANGE_CLASSES.get(class) {
                        Some(end) => format!("to {end} m {found} of {labelled}"),
                        None => format!("farther or unknown {found} of {labelled}"),
                    },
                )
                .collect();
            println!("  {name}: {}", parts.join(", "));
        }
    }
}

impl KindSummary {
    fn add_labels(
        &mut self,
        labels: &[ObjectLabel],
        detections: &[([f32; 2], f32)],
        class: LabelClass,
        (nearest, farthest): (f32, f32),
        tolerance: f32,
    ) {
        for label in labels.iter().filter(|label| label.class == class) {
            let found = detections
                .iter()
                .any(|(position, _)| distance_to_outline(*position, &label.outline) <= tolerance);
            let row = match label.range {
                Some(range) => RANGE_CLASSES.iter().position(|&end| range <= end),
                None => None,
            };
            let row = &mut self.by_range[row.unwrap_or(RANGE_CLASSES.len())];
            row[0] += 1;
            row[1] += usize::from(found);
            if label
                .range
                .is_none_or(|range| (nearest..=farthest).contains(&range))
            {
                self.labelled += 1;
                self.found += usize::from(found);
            }
        }
    }
}

/// Detections within a distance at no label of their kind.
fn false_finds(
    labels: &[ObjectLabel],
    detections: &[([f32; 2], f32)],
    is_kind: impl Fn(LabelClass) -> bool,
    (nearest, farthest): (f32, f32),
    tolerance: f32,
) -> usize {
    let is_false = |&&(position, range): &&([f32; 2], f32)| {
        (nearest..=farthest).contains(&range)
            && !labels.iter().any(|label| {
                is_kind(label.class) && distance_to_outline(position, &label.outline) <= tolerance
            })
    };
    detections.iter().filter(is_false).count()
}

/// Distance of a position from an outline, pixels; 0 inside.
fn distance_to_outline([u, v]: [f32; 2], outline: &[[f32; 2]]) -> f32 {
    let mut inside = false;
    let mut nearest = f32::INFINITY;
    for (index, &[au, av]) in outline.iter().enumerate() {
        let [bu, bv] = outline[(index + 1) % outline.len()];
        let (du, dv) = (bu - au, bv - av);
        if (av > v) != (bv > v) && u < du * (v - av) / dv + au {
            inside = !inside;
        }
        let length2 = (du * du + dv * dv).max(1e-9);
        let part = (((u - au) * du + (v - av) * dv) / length2).clamp(0.0, 1.0);
        nearest = nearest.min(math::hypot(u - au - part * du, v - av - part * dv));
    }
    if inside { 0.0 } else { nearest }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SQUARE: [[f32; 2]; 4] = [[10.0, 10.0], [20.0, 10.0], [20.0, 20.0], [10.0, 20.0]];

    #[test]
    fn distance_to_an_outline_is_zero_inside_and_measured_to_its_edge_outside() {
        assert_eq!(distance_to_outline([15.0, 15.0], &SQUARE), 0.0);
        assert!((distance_to_outline([24.0, 15.0], &SQUARE) - 4.0).abs() < 1e-5);
        assert!((distance_to_outline([23.0, 24.0], &SQUARE) - 5.0).abs() < 1e-5);
    }

    #[test]
    fn label_that_is_no_number_is_refused_with_its_line() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("object_labels.csv");
        assert!(ObjectLabels::read(folder.path()).expect("absent").is_none());
        let refused = |row: &str| {
            let text = format!("stamp_s,class,range_m,polygon_px\n{row}\n");
            std::fs::write(&path, text).expect("written");
            let error = ObjectLabels::read(folder.path()).expect_err("refused");
            error.to_string()
        };
        let message = refused("0.1,ball,far,1:1 2:1 2:2");
        assert!(
            message.contains("line 2: range_m = \"far\" is not a number"),
            "{message}"
        );
        let message = refused("0.1,ball,,1:1 2:nan 2:2");
        assert!(message.contains("line 2: invalid polygon_px"), "{message}");
        let message = refused("1e30,ball,,1:1 2:1 2:2");
        assert!(message.contains("line 2: stamp_s = "), "{message}");
        std::fs::remove_file(&path).expect("removed");
        std::os::unix::fs::symlink("nowhere.csv", &path).expect("a link");
        let message = ObjectLabels::read(folder.path()).expect_err("refused");
        assert!(
            format!("{message:#}").contains("No such file"),
            "{message:#}"
        );
    }

    #[test]
    fn a_detection_far_from_every_label_of_its_kind_is_false() {
        let label = ObjectLabel {
            class: LabelClass::Robot,
            range: Some(2.0),
            outline: SQUARE.to_vec(),
        };
        let detections = [
            ([15.0, 15.0], 2.0),
            ([60.0, 60.0], 2.0),
            ([60.0, 60.0], 9.0),
        ];
        let is_ball = |class| class == LabelClass::Ball;
        let is_robot = |class| class == LabelClass::Robot;
        let labels = [label];
        let limits = (0.0, 4.0);
        assert_eq!(false_finds(&labels, &detections, is_robot, limits, 12.0), 1);
        assert_eq!(false_finds(&labels, &detections, is_ball, limits, 12.0), 2);
        let mut robots = KindSummary::default();
        robots.add_labels(&labels, &detections, LabelClass::Robot, limits, 12.0);
        assert_eq!((robots.labelled, robots.found), (1, 1));
    }
}
