//! Which lines are on a field? White paint and pieces of cables, and which area they may touch.

use std::f32::consts::PI;

use localize::field::{Field, Marking};
use localize::frames::At;

/// A line of paint, or a piece of a cable.
#[derive(Debug, Clone, Copy)]
pub(super) struct Stroke {
    pub(super) shape: Shape,
    /// Half its width; for a disc its radius, metres.
    pub(super) half: f32,
    pub(super) is_cable: bool,
}

#[derive(Debug, Clone, Copy)]
pub(super) enum Shape {
    /// Middle, unit vector along it, half its length.
    Line {
        middle: [f32; 2],
        along: [f32; 2],
        half_length: f32,
    },
    /// Centre, radius, and the unit vectors to its ends if it is no full circle, and whether it is shorter than half of one.
    Arc {
        centre: [f32; 2],
        radius: f32,
        ends: Option<([[f32; 2]; 2], bool)>,
    },
    Disc {
        centre: [f32; 2],
    },
}

/// A box on the field: centre, unit vector along its first side, half its sides, metres.
#[derive(Debug, Clone, Copy)]
pub(super) struct Area {
    pub(super) centre: [f32; 2],
    pub(super) axis: [f32; 2],
    pub(super) half: [f32; 2],
}

impl Stroke {
    pub(super) fn new(marking: &Marking, half: f32, is_cable: bool) -> Self {
        let (shape, half) = match *marking {
            Marking::Line { from, to } => {
                let (dx, dy) = (to.x - from.x, to.y - from.y);
                let length = dx.hypot(dy);
                let per = 1.0 / length.max(1e-6);
                let line = Shape::Line {
                    middle: [(from.x + to.x) / 2.0, (from.y + to.y) / 2.0],
                    along: if length > 1e-6 {
                        [dx * per, dy * per]
                    } else {
                        [1.0, 0.0]
                    },
                    // Corners are full: each line extends by half a line width beyond its end point.
                    half_length: length / 2.0 + half,
                };
                (line, half)
            }
            Marking::Arc {
                centre,
                radius,
                start,
                sweep,
            } => {
                let unit = |angle: f32| [angle.cos(), angle.sin()];
                let ends = (sweep < 2.0 * PI - 1e-4)
                    .then(|| ([unit(start), unit(start + sweep)], sweep <= PI));
                let centre = [centre.x, centre.y];
                (
                    Shape::Arc {
                        centre,
                        radius,
                        ends,
                    },
                    half,
                )
            }
            Marking::Spot { centre, radius } => (
                Shape::Disc {
                    centre: [centre.x, centre.y],
                },
                radius,
            ),
        };
        Stroke {
            shape,
            half,
            is_cable,
        }
    }

    /// Corners of a box around the stroke.
    pub(super) fn bounds(&self) -> [[f32; 2]; 2] {
        let around = |centre: [f32; 2], reach: [f32; 2]| {
            [
                [0, 1].map(|k| centre[k] - reach[k]),
                [0, 1].map(|k| centre[k] + reach[k]),
            ]
        };
        match self.shape {
            Shape::Line {
                middle,
                along,
                half_length,
            } => {
                let reach = along.map(|part| part.abs() * half_length + self.half);
                around(middle, reach)
            }
            Shape::Arc { centre, radius, .. } => around(centre, [radius + self.half; 2]),
            Shape::Disc { centre } => around(centre, [self.half; 2]),
        }
    }

    /// The box of a line.
    pub(super) fn area(&self) -> Option<Area> {
        let Shape::Line {
            middle,
            along,
            half_length,
        } = self.shape
        else {
            return None;
        };
        Some(Area {
            centre: middle,
            axis: along,
            half: [half_length, self.half],
        })
    }
}

/// The painted markings: walls replace the boundary lines, except at the goals' mouths.
pub(super) fn painted_markings(field: &Field) -> Vec<Marking> {
    if !field.config.walls {
        return field.markings.clone();
    }
    let (half_x, half_y) = (field.length / 2.0, field.width / 2.0);
    let mouth = field.config.goal.width / 2.0;
    let is_wall = |a: f32, b: f32, half: f32| a == b && a.abs() == half;
    let paint = |marking: &Marking| match *marking {
        Marking::Line { from, to } if is_wall(from.y, to.y, half_y) => None,
        Marking::Line { from, to } if is_wall(from.x, to.x, half_x) => Some(Marking::Line {
            from: At::new(from.x, -mouth),
            to: At::new(to.x, mouth),
        }),
        other => Some(other),
    };
    field.markings.iter().filter_map(paint).collect()
}
