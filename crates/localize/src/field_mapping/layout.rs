//! How does a map become a field? Its longest direction is x, its middle the origin.

use super::FieldMappingConfig;
use super::map_motion::MapMotion;
use super::shape::Shape;
use crate::field::FieldConfig;
use crate::frames::At;
use crate::math;

/// Smallest extent of a field, metres.
const EXTENT_MIN: f32 = 1.0;

/// The field of the shapes, and the motion from the map to it.
pub(super) fn lay_out(shapes: &[Shape], config: &FieldMappingConfig) -> (FieldConfig, MapMotion) {
    let turned = upright(shapes);
    let [low, high] = extent(shapes, turned);
    let turned = if high[1] - low[1] > high[0] - low[0] {
        MapMotion::new(0.0, 0.0, -std::f32::consts::FRAC_PI_2) * turned
    } else {
        turned
    };
    let [low, high] = extent(shapes, turned);
    let middle = [0, 1].map(|k| 0.5 * (low[k] + high[k]));
    let field_from_map = MapMotion::new(-middle[0], -middle[1], 0.0) * turned;
    let size = [0, 1].map(|axis: usize| (high[axis] - low[axis]).max(EXTENT_MIN));
    let mut field = FieldConfig::without_markings(size, config.line_width, config.border);
    for shape in shapes {
        add_shape(&mut field, shape, field_from_map);
    }
    (field, field_from_map)
}

fn add_shape(field: &mut FieldConfig, shape: &Shape, field_from_map: MapMotion) {
    let moved = |[x, y]: [f32; 2]| field_from_map * At::new(x, y);
    match *shape {
        Shape::Line {
            from,
            to,
            std_across,
            std_along,
        } => {
            let (a, b) = (moved(from), moved(to));
            let length = math::hypot(b.x - a.x, b.y - a.y).max(1e-6);
            let (ux, uy) = ((b.x - a.x) / length, (b.y - a.y) / length);
            // The direction is uncertain too: the ends are known half as well as the middle.
            let across = 2.0 * std_across;
            let std_x = math::hypot(across * uy, std_along * ux);
            let std_y = math::hypot(across * ux, std_along * uy);
            field.extra_lines.push([a.x, a.y, b.x, b.y]);
            field.extra_lines_std.push([std_x, std_y, std_x, std_y]);
        }
        Shape::Arc {
            centre,
            radius,
            start,
            sweep,
            std,
        } => {
            let at = moved(centre);
            let start = crate::frames::wrap_angle(start + field_from_map.theta);
            let arc = [
                at.x,
                at.y,
                radius,
                start.to_degrees(),
                sweep.to_degrees().min(360.0),
            ];
            field.extra_arcs.push(arc);
            field.extra_arcs_std.push(std);
        }
    }
}

/// The rotation that makes most lines parallel to the axes.
fn upright(shapes: &[Shape]) -> MapMotion {
    let [mut cosine, mut sine] = [0.0_f32; 2];
    for shape in shapes {
        if let Shape::Line { from, to, .. } = shape {
            let angle = 4.0 * math::atan2(to[1] - from[1], to[0] - from[0]);
            let (sin, cos) = math::sin_cos(angle);
            cosine += shape.length() * cos;
            sine += shape.length() * sin;
        }
    }
    MapMotion::new(0.0, 0.0, -0.25 * math::atan2(sine, cosine))
}

/// The smallest and largest coordinates of the markings after a motion.
fn extent(shapes: &[Shape], motion: MapMotion) -> [[f32; 2]; 2] {
    let mut range = [[f32::MAX; 2], [f32::MIN; 2]];
    let mut add = |[x, y]: [f32; 2]| {
        let at = motion * At::new(x, y);
        for (k, value) in [at.x, at.y].into_iter().enumerate() {
            range[0][k] = range[0][k].min(value);
            range[1][k] = range[1][k].max(value);
        }
    };
    for shape in shapes {
        match *shape {
            Shape::Line { from, to, .. } => {
                add(from);
                add(to);
            }
            Shape::Arc {
                centre,
                radius,
                start,
                sweep,
                ..
            } => {
                for k in 0..=24 {
                    let (sin, cos) = math::sin_cos(start + sweep * k as f32 / 24.0);
                    add([centre[0] + radius * cos, centre[1] + radius * sin]);
                }
            }
        }
    }
    range
}
