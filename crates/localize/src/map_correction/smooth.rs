//! Which fields describe the errors of a map whose optics are unknown? Low-order smooth ones.

use super::basis::MapBasis;
use super::term::{BasisTerm, Harmonic, NODES, TermKind};
use crate::math;

/// Ranges at which the relative error of the range is a node, in heights of the viewpoint.
const RANGE_NODES: [f32; 4] = [1.0, 2.5, 5.0, 9.0];

/// Range beyond which a point is far, in heights of the viewpoint.
const FAR: f32 = 4.0;

/// Terms of a map without known optics: relative errors of the range at four ranges, of far ranges over the bearing, and
/// an elliptic image. `std`: standard deviation of each, as a share of the range.
pub fn smooth_terms(std: f32) -> Vec<BasisTerm> {
    let mut terms: Vec<BasisTerm> = (0..RANGE_NODES.len())
        .map(|node| {
            let kind = TermKind::Range(node as u8);
            term(kind, std, Harmonic::Constant, |slope| {
                [relative(slope) * range_weight(slope, node), 0.0]
            })
        })
        .collect();
    for (kind, harmonic) in [
        (TermKind::FarRangeCosine, Harmonic::Cosine),
        (TermKind::FarRangeSine, Harmonic::Sine),
    ] {
        terms.push(term(kind, std, harmonic, |slope| {
            [relative(slope) * slope / (slope + FAR), 0.0]
        }));
    }
    for (kind, harmonic) in [
        (TermKind::EllipseCosine, Harmonic::DoubleCosine),
        (TermKind::EllipseSine, Harmonic::DoubleSine),
    ] {
        terms.push(term(kind, 0.5 * std, harmonic, |slope| {
            [relative(slope), slope / (1.0 + slope * slope).sqrt()]
        }));
    }
    terms
}

/// Term of the viewpoint's height. `std`: metres.
pub fn height_term(std: f32, height: f32) -> BasisTerm {
    term(TermKind::Height, std, Harmonic::Constant, |slope| {
        [relative(slope) / height, 0.0]
    })
}

/// A term whose fields (radial, tangential) depend on tan γ.
fn term(
    kind: TermKind,
    std: f32,
    harmonic: Harmonic,
    fields: impl Fn(f32) -> [f32; 2],
) -> BasisTerm {
    let mut term = BasisTerm {
        kind,
        std,
        harmonic,
        radial: [0.0; NODES],
        tangential: [0.0; NODES],
    };
    for node in 0..NODES {
        // The last entry is the horizon; its neighbour stands for it.
        let slope = math::tan(MapBasis::node_angle(node.min(NODES - 2)));
        [term.radial[node], term.tangential[node]] = fields(slope);
    }
    term
}

/// Change of γ by a relative error of the range: sin γ cos γ.
fn relative(slope: f32) -> f32 {
    slope / (1.0 + slope * slope)
}

/// Weight of a node of the range: linear in the logarithm of the range between the nodes, constant beyond them.
fn range_weight(slope: f32, node: usize) -> f32 {
    let place = math::ln(slope.max(1e-3));
    let at = |node: usize| math::ln(RANGE_NODES[node]);
    let rising = match node {
        0 => 1.0,
        _ => ((place - at(node - 1)) / (at(node) - at(node - 1))).clamp(0.0, 1.0),
    };
    let falling = match node + 1 {
        next if next < RANGE_NODES.len() => {
            ((at(next) - place) / (at(next) - at(node))).clamp(0.0, 1.0)
        }
        _ => 1.0,
    };
    rising.min(falling)
}
