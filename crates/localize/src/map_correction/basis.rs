//! In which directions can a ground map be wrong? Displacement fields of its errors, one per unknown (docs/methods.md 2.13).
//!
//! A field displaces the direction in which the viewpoint sees a ground point: the angle γ from straight down and the
//! bearing φ. Small rotations and shifts of optical parts are linear there, while on the ground they grow with the
//! square of the distance. Each field is a harmonic of φ times a table over γ.

use std::f32::consts::FRAC_PI_2;
use std::sync::Arc;

use super::mirror::{MirrorModel, PreparedMount};
use super::term::{BasisTerm, MIRROR_KINDS, NODES, TERMS_MAX};
use crate::math;

/// Smallest share by which a displaced ray keeps its depth; a ray closer to the horizon is cut off there.
const DEPTH_SHARE_MIN: f32 = 0.5;

/// Smallest sine of γ by which a tangential displacement is divided. Below it the robot's own body covers the ground.
const SIN_MIN: f32 = 0.05;

/// Displacement fields of a map's errors.
#[derive(Debug, Clone, PartialEq)]
pub struct MapBasis {
    /// At most [`TERMS_MAX`].
    terms: Vec<BasisTerm>,
    /// Of the viewpoint above the ground, metres.
    height: f32,
    /// Replaces the fields of mirror tilt, mirror offset and focal length, which then are derivatives only.
    mirror: Option<Arc<MirrorModel>>,
}

/// A displaced ground point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DisplacedPoint {
    /// Metres, robot frame.
    pub at: [f32; 2],
    /// Derivative of x and y by each unknown.
    pub derivatives: [[f32; 2]; TERMS_MAX],
    /// Standard deviation from not knowing which part of the mirror showed the point, metres.
    pub ambiguity: f32,
}

impl MapBasis {
    /// Terms beyond [`TERMS_MAX`] are dropped. `height`: of the viewpoint above the ground, metres.
    pub fn new(mut terms: Vec<BasisTerm>, height: f32) -> Self {
        terms.truncate(TERMS_MAX);
        MapBasis {
            terms,
            height,
            mirror: None,
        }
    }

    /// The same, with exact displacements by the mirror's mounting.
    pub fn with_mirror(self, mirror: MirrorModel) -> Self {
        MapBasis {
            mirror: Some(Arc::new(mirror)),
            ..self
        }
    }

    /// The unknowns in their order.
    pub fn terms(&self) -> &[BasisTerm] {
        &self.terms
    }

    /// Of the viewpoint above the ground, metres.
    pub fn height(&self) -> f32 {
        self.height
    }

    /// γ of a table's entry, radians.
    pub fn node_angle(node: usize) -> f32 {
        FRAC_PI_2 * node as f32 / (NODES - 1) as f32
    }

    /// γ of a point at `range` metres, as a node and the share of the next one.
    pub(super) fn node_at(&self, range: f32) -> (usize, f32) {
        let place = math::atan(range / self.height) * ((NODES - 1) as f32 / FRAC_PI_2);
        let node = (place as usize).min(NODES - 2);
        (node, place - node as f32)
    }

    /// Prepares displacements by `coefficients` times the fields.
    pub fn prepare(&self, coefficients: [f32; TERMS_MAX]) -> PreparedBasis<'_> {
        let value = |kind| {
            let place = self.terms.iter().position(|term| term.kind == kind);
            place.map_or(0.0, |k| coefficients[k])
        };
        let mounting = MIRROR_KINDS.map(value);
        // A mirror that is mounted as given displaces nothing: no point is traced.
        let moved = mounting.iter().any(|value| *value != 0.0);
        let mirror = self.mirror.as_deref().filter(|_| moved);
        let mount = mirror.map(|mirror| PreparedMirror {
            mirror,
            mount: mirror.prepare(mounting),
        });
        let mut smooth = coefficients;
        for (term, coefficient) in self.terms.iter().zip(&mut smooth) {
            if term.kind.is_of_mirror() {
                *coefficient = 0.0;
            }
        }
        PreparedBasis {
            basis: self,
            coefficients,
            smooth,
            mount,
        }
    }
}

/// A basis with coefficients, ready to displace many points.
#[derive(Debug, Clone, Copy)]
pub struct PreparedBasis<'a> {
    basis: &'a MapBasis,
    coefficients: [f32; TERMS_MAX],
    /// The same without those of the mirror's mounting.
    smooth: [f32; TERMS_MAX],
    /// None for a mirror that is mounted as given.
    mount: Option<PreparedMirror<'a>>,
}

/// A mirror at its mounting.
#[derive(Debug, Clone, Copy)]
struct PreparedMirror<'a> {
    mirror: &'a MirrorModel,
    mount: PreparedMount,
}

impl PreparedBasis<'_> {
    /// Displaces a ground point of the map (metres, robot frame).
    pub fn displace(&self, [x, y]: [f32; 2]) -> DisplacedPoint {
        let basis = self.basis;
        let range = math::hypot(x, y).max(1e-3);
        let direction = [x / range, y / range];
        let mut fields = [[0.0; 2]; TERMS_MAX];
        let mirrored = self
            .mount
            .and_then(|prepared| prepared.mirror.displace([x, y], &prepared.mount));
        let coefficients = match mirrored {
            Some(_) => &self.smooth,
            None => &self.coefficients,
        };
        let [turn, shift] = basis.sum_fields(range, direction, coefficients, &mut fields);
        let [bx, by] = mirrored.unwrap_or([x, y]);
        let base_range = math::hypot(bx, by).max(1e-3);
        let base_direction = [bx / base_range, by / base_range];
        let slope = displace_slope(base_range / basis.height, turn);
        let displaced_range = basis.height * slope;
        let (sin, cos) = math::sin_cos(shift);
        let outward = [
            cos * base_direction[0] - sin * base_direction[1],
            sin * base_direction[0] + cos * base_direction[1],
        ];
        let per_radian = basis.height * (1.0 + slope * slope);
        let mut derivatives = [[0.0; 2]; TERMS_MAX];
        for (derivative, [radial, tangential]) in derivatives.iter_mut().zip(fields) {
            let (radial, tangential) = (per_radian * radial, displaced_range * tangential);
            *derivative = [
                radial * outward[0] - tangential * outward[1],
                radial * outward[1] + tangential * outward[0],
            ];
        }
        let at = outward.map(|part| part * displaced_range);
        // Nobody knows which ring of the mirror showed a point that both show.
        let ambiguous = self
            .mount
            .is_some_and(|prepared| range < prepared.mirror.ambiguous_range());

        DisplacedPoint {
            at,
            derivatives,
            ambiguity: if ambiguous {
                math::hypot(at[0] - x, at[1] - y)
            } else {
                0.0
            },
        }
    }
}

impl MapBasis {
    /// Changes of γ and φ at a point, and those per unit of each unknown.
    fn sum_fields(
        &self,
        range: f32,
        direction: [f32; 2],
        coefficients: &[f32; TERMS_MAX],
        fields: &mut [[f32; 2]; TERMS_MAX],
    ) -> [f32; 2] {
        let (node, share) = self.node_at(range);
        let slope = range / self.height;
        let sine = (slope / (1.0 + slope * slope).sqrt()).max(SIN_MIN);
        let mut sums = [0.0; 2];
        for ((term, field), coefficient) in self.terms.iter().zip(fields).zip(coefficients) {
            let between =
                |table: &[f32; NODES]| table[node] + share * (table[node + 1] - table[node]);
            let [radial, tangential] = term.harmonic.factors(direction);
            *field = [
                radial * between(&term.radial),
                tangential * between(&term.tangential) / sine,
            ];
            sums[0] += coefficient * field[0];
            sums[1] += coefficient * field[1];
        }
        sums
    }
}

/// tan(γ + turn) from tan γ.
fn displace_slope(slope: f32, turn: f32) -> f32 {
    let tangent = turn * (1.0 + turn * turn / 3.0);
    (slope + tangent).max(0.0) / (1.0 - slope * tangent).max(DEPTH_SHARE_MIN)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::map_correction::smooth::{height_term, smooth_terms};
    use crate::map_correction::term::TermKind;

    fn basis() -> MapBasis {
        let mut terms = smooth_terms(0.01);
        terms.push(height_term(0.01, 0.8));
        MapBasis::new(terms, 0.8)
    }

    #[test]
    fn a_higher_viewpoint_stretches_all_ranges_alike() {
        let basis = basis();
        let place = basis
            .terms()
            .iter()
            .position(|term| term.kind == TermKind::Height);
        let mut coefficients = [0.0; TERMS_MAX];
        coefficients[place.expect("a height")] = 0.004;
        for point in [[1.0, 0.5], [-3.0, 2.0], [0.2, -5.0]] {
            let at = basis.prepare(coefficients).displace(point).at;
            for axis in 0..2 {
                let expected = point[axis] * 0.804 / 0.8;
                assert!((at[axis] - expected).abs() < 1e-3, "{point:?}: {at:?}");
            }
        }
    }

    #[test]
    fn derivatives_equal_differences() {
        let basis = basis();
        let mut coefficients = [0.0; TERMS_MAX];
        for (k, value) in coefficients.iter_mut().enumerate() {
            *value = 0.002 * ((k % 3) as f32 - 1.0);
        }
        for point in [[1.0, 0.5], [-3.0, 2.0], [0.2, -5.0]] {
            let here = basis.prepare(coefficients).displace(point);
            for k in 0..basis.terms().len() {
                let mut moved = coefficients;
                moved[k] += 1e-3;
                let there = basis.prepare(moved).displace(point);
                for axis in 0..2 {
                    let difference = (there.at[axis] - here.at[axis]) / 1e-3;
                    let scale = 1.0 + math::hypot(point[0], point[1]).powi(2);
                    assert!(
                        (difference - here.derivatives[k][axis]).abs() < 0.03 * scale,
                        "{point:?} {k}: {difference} {}",
                        here.derivatives[k][axis]
                    );
                }
            }
        }
    }

    #[test]
    fn every_plausible_point_stays_finite() {
        let basis = basis();
        let coefficients = [0.05; TERMS_MAX];
        for point in [[0.0, 0.0], [100.0, -100.0], [1e-5, 0.0]] {
            let at = basis.prepare(coefficients).displace(point).at;
            assert!(at.iter().all(|value| value.is_finite()), "{at:?}");
        }
    }
}
