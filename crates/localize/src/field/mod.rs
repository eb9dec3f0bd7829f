//! The field: markings as centre lines, and goals, from a TOML file.

mod config;
pub(crate) mod goal_colours;
pub(crate) mod ray;
mod size;

use std::path::Path;

use crate::frames::{At, FieldFrame};
use crate::math;
use crate::toml_file;
use crate::toml_location::key_location;

pub use config::{Area, FieldConfig, FieldError, GoalColour, GoalConfig, MeasuredTo};
pub use size::{Axis, DrawnNumber, FieldSize};

/// A marking's centre line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Marking {
    /// A straight line from one end to the other.
    Line {
        /// One end.
        from: At<FieldFrame>,
        /// The other end.
        to: At<FieldFrame>,
    },
    /// A circle or an arc.
    Arc {
        /// Centre.
        centre: At<FieldFrame>,
        /// Radius of the line's centre, metres.
        radius: f32,
        /// Start angle, radians.
        start: f32,
        /// Length counter-clockwise, radians.
        sweep: f32,
    },
    /// A filled disc.
    Spot {
        /// Centre.
        centre: At<FieldFrame>,
        /// Radius of the painted disc, metres.
        radius: f32,
    },
}

/// A field with its markings as centre lines, whatever its file measures to.
///
/// ```
/// # fn main() -> Result<(), localize::field::FieldError> {
/// use std::path::Path;
///
/// let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/fields/msl_18x12.toml");
/// let field = localize::Field::load(&config)?;
/// // The file's 18 m end at the outer edges of the lines, which are 0.125 m wide.
/// assert_eq!((field.length, field.width), (17.875, 11.875));
/// assert_eq!(localize::Field::new(field.config.clone())?, field);
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Field {
    /// Content of the file.
    pub config: FieldConfig,
    /// Between the centres of the goal lines, metres.
    pub length: f32,
    /// Between the centres of the touch lines, metres.
    pub width: f32,
    /// Centre lines of all markings.
    pub markings: Vec<Marking>,
}

impl Field {
    /// Reads and checks a field file.
    pub fn load(path: &Path) -> Result<Self, FieldError> {
        let (config, text) = toml_file::read(path)?;
        Field::new(config).map_err(|source| FieldError::InFile {
            place: match &source {
                FieldError::InvalidSize { key, .. } => key_location(path, &text, key),
                _ => path.display().to_string(),
            },
            source: Box::new(source),
        })
    }

    /// Lays out the markings. Sizes that contradict each other are refused.
    pub fn new(config: FieldConfig) -> Result<Self, FieldError> {
        config.check()?;
        // Distance of a line's centre inside the file's reference.
        let inset = match config.measured_to {
            MeasuredTo::Centres => 0.0,
            MeasuredTo::OuterEdges => config.line_width / 2.0,
        };
        let half_length = config.length / 2.0 - inset;
        let half_width = config.width / 2.0 - inset;
        let mut markings = Vec::new();
        if config.boundary {
            markings.extend(rectangle(
                -half_length,
                -half_width,
                half_length,
                half_width,
            ));
        }
        if config.halfway_line {
            markings.push(line(0.0, -half_width, 0.0, half_width));
        }
        for side in [1.0, -1.0] {
            for area in [config.goal_area, config.penalty_area] {
                if area.depth > 0.0 && area.width > 0.0 {
                    let front = side * (config.length / 2.0 - area.depth + inset);
                    let half = area.width / 2.0 - inset;
                    let back = side * half_length;
                    markings.push(line(front, -half, front, half));
                    markings.push(line(front, half, back, half));
                    markings.push(line(front, -half, back, -half));
                }
            }
            if config.penalty_spot > 0.0 && config.spot_radius > 0.0 {
                let centre = At::new(side * (config.length / 2.0 - config.penalty_spot), 0.0);
                markings.push(Marking::Spot {
                    centre,
                    radius: config.spot_radius,
                });
            }
        }
        if config.centre_circle_radius > inset {
            let radius = config.centre_circle_radius - inset;
            markings.push(Marking::Arc {
                centre: At::new(0.0, 0.0),
                radius,
                start: 0.0,
                sweep: std::f32::consts::TAU,
            });
        }
        if config.spot_radius > 0.0 {
            markings.push(Marking::Spot {
                centre: At::new(0.0, 0.0),
                radius: config.spot_radius,
            });
        }
        if config.corner_arc_radius > inset {
            markings.extend(corner_arcs(&config, config.corner_arc_radius - inset));
        }
        markings.extend(
            config
                .extra_lines
                .iter()
                .map(|&[x0, y0, x1, y1]| line(x0, y0, x1, y1)),
        );
        markings.extend(
            config
                .extra_arcs
                .iter()
                .map(|&[x, y, radius, start_deg, sweep_deg]| Marking::Arc {
                    centre: At::new(x, y),
                    radius,
                    start: start_deg.to_radians(),
                    sweep: sweep_deg.to_radians(),
                }),
        );
        Ok(Field {
            length: 2.0 * half_length,
            width: 2.0 * half_width,
            markings,
            config,
        })
    }

    /// Standard deviation of the markings' positions, metres: root mean square over those of a measured field. 0 if the file
    /// states none.
    pub fn marking_std(&self) -> f32 {
        let lines = self.config.extra_lines_std.as_flattened();
        let arcs = self.config.extra_arcs_std.as_flattened();
        let count = lines.len() + arcs.len();
        let squares: f32 = lines.iter().chain(arcs).map(|std| std * std).sum();
        (squares / count.max(1) as f32).sqrt()
    }

    /// True if there are goals.
    pub fn has_goals(&self) -> bool {
        self.config.goal.width > 0.0
    }

    /// Half the carpet's extent along x and y, metres.
    pub fn carpet_half_extent(&self) -> (f32, f32) {
        (
            self.config.length / 2.0 + self.config.border,
            self.config.width / 2.0 + self.config.border,
        )
    }
}

fn line(x0: f32, y0: f32, x1: f32, y1: f32) -> Marking {
    Marking::Line {
        from: At::new(x0, y0),
        to: At::new(x1, y1),
    }
}

fn rectangle(x0: f32, y0: f32, x1: f32, y1: f32) -> [Marking; 4] {
    [
        line(x0, y0, x1, y0),
        line(x1, y0, x1, y1),
        line(x1, y1, x0, y1),
        line(x0, y1, x0, y0),
    ]
}

/// Quarter circles about the corners of the file's reference rectangle.
fn corner_arcs(config: &FieldConfig, radius: f32) -> [Marking; 4] {
    use std::f32::consts::{FRAC_PI_2, PI};
    let (x, y) = (config.length / 2.0, config.width / 2.0);
    [
        (x, y, PI),
        (-x, y, -FRAC_PI_2),
        (-x, -y, 0.0),
        (x, -y, FRAC_PI_2),
    ]
    .map(|(x, y, start)| Marking::Arc {
        centre: At::new(x, y),
        radius,
        start,
        sweep: FRAC_PI_2,
    })
}

/// Points along all markings' centre lines (a spot's centre), `step` metres apart.
pub fn marking_points(markings: &[Marking], step: f32) -> Vec<At<FieldFrame>> {
    let mut points = Vec::new();
    for marking in markings {
        match *marking {
            Marking::Line { from, to } => {
                let count = (from.distance_to(to) / step).ceil().max(1.0) as usize;
                points.extend((0..=count).map(|index| {
                    let part = index as f32 / count as f32;
                    At::new(
                        from.x + part * (to.x - from.x),
                        from.y + part * (to.y - from.y),
                    )
                }));
            }
            Marking::Arc {
                centre,
                radius,
                start,
                sweep,
            } => {
                let count = (radius * sweep / step).ceil().max(1.0) as usize;
                points.extend((0..=count).map(|index| {
                    let (sin, cos) = math::sin_cos(start + sweep * index as f32 / count as f32);
                    At::new(centre.x + radius * cos, centre.y + radius * sin)
                }));
            }
            Marking::Spot { centre, .. } => points.push(centre),
        }
    }
    points
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub(crate) fn league_18x12(measured_to: &str) -> Field {
        let text = format!(
            r#"length = 18.0
            width = 12.0
            measured_to = "{measured_to}"
            line_width = 0.125
            border = 1.0
            centre_circle_radius = 2.0
            corner_arc_radius = 0.75
            spot_radius = 0.075
            penalty_spot = 3.0
            goal_area = {{ depth = 0.75, width = 3.5 }}
            penalty_area = {{ depth = 2.25, width = 6.5 }}
            goal = {{ width = 2.0, height = 1.0, depth = 0.6, post = 0.125, colours = ["white", "white"] }}"#
        );
        Field::new(toml::from_str(&text).expect("a field")).expect("a field")
    }

    #[test]
    fn refused_size_is_named_with_its_line_and_markings_are_limited() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("field.toml");
        let refused = |text: &str| {
            std::fs::write(&path, text).expect("written");
            Field::load(&path).expect_err("refused").to_string()
        };
        let sizes = "length = 18.0\nwidth = 12.0\nline_width = 0.125\nborder = 1.0\n";
        let message = refused(&sizes.replace("12.0", "-12.0"));
        assert!(
            message.contains("field.toml: line 2: width = -12"),
            "{message}"
        );
        let message = refused(&format!(
            "{sizes}goal_area = {{ depth = 0.5, width = 30.0 }}\n"
        ));
        assert!(
            message.contains("line 5: goal_area.width = 30"),
            "{message}"
        );
        let message = refused(&format!(
            "{sizes}extra_lines = [[1.0, 0.0, 2.0, 0.0, 3.0]]\n"
        ));
        assert!(
            message.contains("line 5") && message.contains("4 numbers are wanted, not 5"),
            "{message}"
        );
        let lines = "[1.0, 0.0, 2.0, 0.0],".repeat(501);
        let message = refused(&format!("{sizes}extra_lines = [{lines}]\n"));
        assert!(message.contains("line 5: extra_lines = 501"), "{message}");
    }

    fn has_line(field: &Field, x0: f32, y0: f32, x1: f32, y1: f32) -> bool {
        let near = |p: At<FieldFrame>, x: f32, y: f32| p.distance_to(At::new(x, y)) < 1e-5;
        field.markings.iter().any(|marking| match *marking {
            Marking::Line { from, to } => {
                near(from, x0, y0) && near(to, x1, y1) || near(to, x0, y0) && near(from, x1, y1)
            }
            _ => false,
        })
    }

    #[test]
    fn outer_edge_sizes_put_line_centres_half_a_line_width_inside() {
        let field = league_18x12("outer_edges");
        assert_eq!((field.length, field.width), (17.875, 11.875));
        assert!(has_line(&field, 8.9375, -5.9375, 8.9375, 5.9375));
        assert!(has_line(
            &field,
            9.0 - 2.25 + 0.0625,
            -3.1875,
            9.0 - 2.25 + 0.0625,
            3.1875
        ));
        assert!(has_line(&field, 0.0, -5.9375, 0.0, 5.9375));
    }

    #[test]
    fn centre_sizes_are_used_unchanged() {
        let field = league_18x12("centres");
        assert_eq!((field.length, field.width), (18.0, 12.0));
        assert!(has_line(&field, 6.75, -3.25, 6.75, 3.25));
    }

    #[test]
    fn every_corner_arc_curves_inside_the_field() {
        for marking in league_18x12("centres").markings {
            let Marking::Arc {
                centre,
                radius,
                start,
                sweep,
            } = marking
            else {
                continue;
            };
            let middle = start + sweep / 2.0;
            let (x, y) = (
                centre.x + radius * middle.cos(),
                centre.y + radius * middle.sin(),
            );
            assert!(x.abs() < 9.0 && y.abs() < 6.0, "arc about {centre:?}");
        }
    }

    #[test]
    fn a_negative_size_is_refused_by_name() {
        let mut config = league_18x12("centres").config;
        config.penalty_area.width = -1.0;
        let message = Field::new(config).expect_err("negative").to_string();
        assert!(message.contains("penalty_area.width = -1"), "{message}");
    }

    #[test]
    fn goal_area_must_fit_in_the_penalty_area() {
        let mut config = league_18x12("centres").config;
        config.goal_area.depth = config.penalty_area.depth + 0.1;
        let message = Field::new(config.clone()).expect_err("deeper").to_string();
        assert!(message.starts_with("goal_area.depth"), "{message}");
        config.penalty_area = Area::default();
        assert!(Field::new(config).is_ok());
    }

    #[test]
    fn every_shipped_field_loads() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/fields");
        let mut names: Vec<_> = std::fs::read_dir(&folder)
            .expect("config/fields")
            .map(|entry| entry.expect("an entry").path())
            .collect();
        names.sort();
        names.retain(|path| path.extension().is_some_and(|kind| kind == "toml"));
        assert_eq!(names.len(), 5);
        for path in names {
            let field = Field::load(&path).unwrap_or_else(|error| panic!("{error}"));
            assert!(field.markings.len() > 8, "{}", path.display());
        }
    }

    #[test]
    fn msl_2001_field_has_its_model_lines_and_coloured_goals() {
        // lima2001 4.3: six lines along the field, five across (both goal areas' fronts, goal lines, halfway line).
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/fields");
        let field = Field::load(&folder.join("msl_2001.toml")).expect("a field");
        assert_eq!(
            field.config.goal.colours,
            [GoalColour::Blue, GoalColour::Yellow]
        );
        let mut across: Vec<i32> = Vec::new();
        let mut along: Vec<i32> = Vec::new();
        for marking in &field.markings {
            if let Marking::Line { from, to } = marking {
                let millimetres = |value: f32| (value * 1000.0).round() as i32;
                if from.x == to.x {
                    across.push(millimetres(from.x));
                } else {
                    along.push(millimetres(from.y));
                }
            }
        }
        across.sort_unstable();
        across.dedup();
        along.sort_unstable();
        along.dedup();
        assert_eq!((across.len(), along.len()), (5, 6));
    }
}
