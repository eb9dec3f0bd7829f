//! One size of a field: a key of its file, or a coordinate or radius that drawn markings share.

use super::{Field, FieldConfig};

/// Drawn coordinates that differ by less are one size, metres.
const SAME_COORDINATE: f32 = 0.02;
/// Most sizes of drawn markings, those of the longest lines: the search tries each.
const DRAWN_MAX: usize = 16;

/// A size with the markings that it moves.
#[derive(Debug, Clone, PartialEq)]
pub enum FieldSize {
    /// A key of the file, by its place among them.
    Key(usize),
    /// Distance between drawn markings at both sides of an axis: all ends and centres with one x or y, sign aside.
    Drawn {
        /// The coordinate.
        axis: Axis,
        /// The numbers of `extra_lines` and `extra_arcs` that are equal to it.
        numbers: Vec<DrawnNumber>,
    },
    /// Radius of drawn arcs, by their indices.
    DrawnRadius(Vec<usize>),
}

/// A coordinate of the field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Axis {
    /// Along the field.
    X,
    /// Across the field.
    Y,
}

/// A number of a drawn marking.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DrawnNumber {
    /// Row and column of `extra_lines`.
    Line(usize, usize),
    /// Row and column of `extra_arcs`.
    Arc(usize, usize),
}

/// A key and where its value stands.
type Key = (&'static str, fn(&mut FieldConfig) -> &mut f32);

const KEYS: [Key; 9] = [
    ("length", |field| &mut field.length),
    ("width", |field| &mut field.width),
    ("centre_circle_radius", |field| {
        &mut field.centre_circle_radius
    }),
    ("penalty_area.width", |field| &mut field.penalty_area.width),
    ("penalty_area.depth", |field| &mut field.penalty_area.depth),
    ("goal_area.width", |field| &mut field.goal_area.width),
    ("goal_area.depth", |field| &mut field.goal_area.depth),
    ("corner_arc_radius", |field| &mut field.corner_arc_radius),
    ("penalty_spot", |field| &mut field.penalty_spot),
];
const LENGTH: FieldSize = FieldSize::Key(0);
const WIDTH: FieldSize = FieldSize::Key(1);

impl DrawnNumber {
    fn of(self, field: &mut FieldConfig) -> &mut f32 {
        match self {
            DrawnNumber::Line(row, column) => &mut field.extra_lines[row][column],
            DrawnNumber::Arc(row, column) => &mut field.extra_arcs[row][column],
        }
    }

    fn value(self, field: &FieldConfig) -> f32 {
        match self {
            DrawnNumber::Line(row, column) => field.extra_lines[row][column],
            DrawnNumber::Arc(row, column) => field.extra_arcs[row][column],
        }
    }
}

impl FieldSize {
    /// All sizes of a field that move a marking.
    pub fn all(field: &FieldConfig) -> Vec<FieldSize> {
        let Ok(laid_out) = Field::new(field.clone()) else {
            return Vec::new();
        };
        let moves = |size: &FieldSize| {
            let before = size.get(field);
            let changed = size.with(field, 0.99 * before);
            before > 0.0
                && Field::new(changed).is_ok_and(|other| other.markings != laid_out.markings)
        };
        let keys = (0..KEYS.len()).map(FieldSize::Key).filter(moves);
        keys.chain(drawn(field)).collect()
    }

    /// The size between the field's ends (`Axis::X`) or sides: of its boundary, or of the outermost drawn markings.
    pub fn between_ends(field: &FieldConfig, axis: Axis) -> Option<FieldSize> {
        let key = match axis {
            Axis::X => LENGTH,
            Axis::Y => WIDTH,
        };
        let all = FieldSize::all(field);
        let outermost = all
            .iter()
            .filter(|size| matches!(size, FieldSize::Drawn { axis: own, .. } if *own == axis))
            .max_by(|a, b| a.get(field).total_cmp(&b.get(field)));
        all.iter().find(|size| **size == key).or(outermost).cloned()
    }

    /// Its value, metres.
    pub fn get(&self, field: &FieldConfig) -> f32 {
        match self {
            FieldSize::Key(index) => *KEYS[*index].1(&mut field.clone()),
            FieldSize::Drawn { numbers, .. } => 2.0 * numbers[0].value(field).abs(),
            FieldSize::DrawnRadius(rows) => field.extra_arcs[rows[0]][2],
        }
    }

    /// The field with another value, metres.
    pub fn with(&self, field: &FieldConfig, value: f32) -> FieldConfig {
        let mut changed = field.clone();
        match self {
            FieldSize::Key(index) => *KEYS[*index].1(&mut changed) = value,
            FieldSize::Drawn { axis, numbers } => {
                for number in numbers {
                    let number = number.of(&mut changed);
                    *number = (0.5 * value).copysign(*number);
                }
                // The carpet reaches as far as the markings.
                let extent = match axis {
                    Axis::X => &mut changed.length,
                    Axis::Y => &mut changed.width,
                };
                *extent = extent.max(value);
            }
            FieldSize::DrawnRadius(rows) => {
                for row in rows {
                    changed.extra_arcs[*row][2] = value;
                }
            }
        }
        changed
    }

    /// The edit from one field's size to another's.
    pub fn text(&self, from: &FieldConfig, to: &FieldConfig) -> String {
        let (old, new) = (self.get(from), self.get(to));
        match self {
            FieldSize::Key(index) => format!("{} = {new:.2} (now {old:.2})", KEYS[*index].0),
            FieldSize::Drawn { axis, numbers } => {
                let name = match axis {
                    Axis::X => "x",
                    Axis::Y => "y",
                };
                let both = numbers
                    .iter()
                    .any(|number| number.value(from) * numbers[0].value(from) < 0.0);
                let sign = match (both, numbers[0].value(from) < 0.0) {
                    (true, _) => "±",
                    (false, true) => "-",
                    (false, false) => "",
                };
                let has = |wanted: fn(&DrawnNumber) -> bool| numbers.iter().any(wanted);
                let keys = match (
                    has(|number| matches!(number, DrawnNumber::Line(..))),
                    has(|number| matches!(number, DrawnNumber::Arc(..))),
                ) {
                    (true, true) => "extra_lines and extra_arcs",
                    (true, false) => "extra_lines",
                    _ => "extra_arcs",
                };
                format!(
                    "{keys}: {name} = {sign}{:.2} (now {sign}{:.2})",
                    0.5 * new,
                    0.5 * old
                )
            }
            FieldSize::DrawnRadius(_) => {
                format!("extra_arcs: radius = {new:.2} (now {old:.2})")
            }
        }
    }
}

/// The sizes of drawn markings: radii, which displaced centres could stand for, then coordinates. Those of the longest markings
/// first.
fn drawn(field: &FieldConfig) -> Vec<FieldSize> {
    let sorted = |mut groups: Vec<(f32, FieldSize)>| {
        groups.sort_by(|a, b| b.0.total_cmp(&a.0));
        groups.into_iter().map(|(_, size)| size)
    };
    let radii = sorted(drawn_radii(field));
    radii
        .chain(sorted(drawn_coordinates(field)))
        .take(DRAWN_MAX)
        .collect()
}

fn arc_length(&[_, _, radius, _, sweep]: &[f32; 5]) -> f32 {
    radius * sweep.to_radians().abs()
}

/// The radii of drawn arcs, each with the length of its arcs.
fn drawn_radii(field: &FieldConfig) -> Vec<(f32, FieldSize)> {
    let mut groups: Vec<(f32, FieldSize)> = Vec::new();
    for (row, arc) in field.extra_arcs.iter().enumerate() {
        let radius = arc[2];
        let group = groups.iter_mut().find_map(|(sum, size)| match size {
            FieldSize::DrawnRadius(rows) => {
                let same = (field.extra_arcs[rows[0]][2] - radius).abs() < SAME_COORDINATE;
                same.then_some((sum, rows))
            }
            FieldSize::Key(_) | FieldSize::Drawn { .. } => None,
        });
        match group {
            Some((sum, rows)) => {
                *sum += arc_length(arc);
                rows.push(row);
            }
            None => groups.push((arc_length(arc), FieldSize::DrawnRadius(vec![row]))),
        }
    }
    groups
}

/// The coordinates of drawn markings, each with the length of the markings there.
fn drawn_coordinates(field: &FieldConfig) -> Vec<(f32, FieldSize)> {
    let mut groups: Vec<(f32, FieldSize)> = Vec::new();
    let mut add = |axis: Axis, number: DrawnNumber, length: f32| {
        let value = number.value(field).abs();
        if value < SAME_COORDINATE {
            return;
        }
        let group = groups.iter_mut().find_map(|(sum, size)| match size {
            FieldSize::Drawn { axis: own, numbers } if *own == axis => {
                let same = (numbers[0].value(field).abs() - value).abs() < SAME_COORDINATE;
                same.then_some((sum, numbers))
            }
            _ => None,
        });
        match group {
            Some((sum, numbers)) => {
                *sum += length;
                numbers.push(number);
            }
            None => {
                let numbers = vec![number];
                groups.push((length, FieldSize::Drawn { axis, numbers }));
            }
        }
    };
    for (row, [x0, y0, x1, y1]) in field.extra_lines.iter().enumerate() {
        // A line along an axis lies at a coordinate with its whole length; where it ends there, it says less.
        let (along_x, along_y) = ((x1 - x0).abs(), (y1 - y0).abs());
        for column in [0, 2] {
            add(Axis::X, DrawnNumber::Line(row, column), along_y);
            add(Axis::Y, DrawnNumber::Line(row, column + 1), along_x);
        }
    }
    for (row, arc) in field.extra_arcs.iter().enumerate() {
        add(Axis::X, DrawnNumber::Arc(row, 0), arc_length(arc));
        add(Axis::Y, DrawnNumber::Arc(row, 1), arc_length(arc));
    }
    groups
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A gym: boundary of 11 x 8 m, a circle, and a line to one side.
    fn drawn_field() -> FieldConfig {
        FieldConfig {
            extra_lines: vec![
                [-5.5, 4.0, 5.5, 4.0],
                [-5.5, -4.0, 5.5, -4.0],
                [-5.5, -4.0, -5.5, 4.0],
                [5.5, -4.0, 5.5, 4.0],
                [2.0, -4.0, 2.0, 1.0],
            ],
            extra_arcs: vec![[2.0, 1.0, 1.5, 0.0, 360.0]],
            ..FieldConfig::without_markings([11.0, 8.0], 0.05, 1.0)
        }
    }

    #[test]
    fn drawn_lines_with_their_ends_and_arcs_move_together() {
        let field = drawn_field();
        let all = FieldSize::all(&field);
        // x = 5.5 and 2, y = 4 and 1, and a radius.
        assert_eq!(all.len(), 5, "{all:?}");
        let width = FieldSize::between_ends(&field, Axis::Y).expect("a width");
        assert_eq!(width.get(&field), 8.0);
        let narrow = width.with(&field, 7.0);
        assert_eq!(narrow.extra_lines[1], [-5.5, -3.5, 5.5, -3.5]);
        assert_eq!(narrow.extra_lines[4], [2.0, -3.5, 2.0, 1.0]);
        assert_eq!(
            width.text(&field, &narrow),
            "extra_lines: y = ±3.50 (now ±4.00)"
        );
        let x = all.iter().find(|size| size.get(&field) == 4.0);
        let x = x.expect("the size of x = 2");
        let moved = x.with(&field, 5.0);
        assert_eq!(moved.extra_lines[4], [2.5, -4.0, 2.5, 1.0]);
        assert_eq!(moved.extra_arcs[0][0], 2.5);
        assert_eq!(
            x.text(&field, &moved),
            "extra_lines and extra_arcs: x = 2.50 (now 2.00)"
        );
    }

    #[test]
    fn sizes_of_a_league_field_are_keys() {
        let text = include_str!("../../../../config/fields/msl_12x8.toml");
        let field: FieldConfig = toml::from_str(text).expect("a field");
        let all = FieldSize::all(&field);
        assert!(all.iter().all(|size| matches!(size, FieldSize::Key(_))));
        assert_eq!(FieldSize::between_ends(&field, Axis::X), Some(LENGTH));
        assert!(all.len() >= 8, "{all:?}");
    }
}
