//! Which objects may a block of pixels see? Compares azimuths and slopes of all of them at once.

use super::blocks::OriginBounds;
use super::lanes::{LANES, Vector, splat};
use super::lattice::BlockView;
use super::row_transform::RowTransform;

/// An upright cylinder around an object, robot frame.
pub(super) struct Cylinder {
    pub(super) x: f32,
    pub(super) y: f32,
    pub(super) radius: f32,
    pub(super) bottom: f32,
    pub(super) top: f32,
}

/// The directions in which rays may meet an object.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reach {
    towards: [f32; 2],
    /// Cosine and sine of half its width in azimuth; `WIDE` for all azimuths.
    half_angle: [f32; 2],
    /// Lowest and highest slope.
    pub(super) slope: [f32; 2],
}

/// Compares below the cosine of any angle.
const WIDE: [f32; 2] = [0.0, 1e9];
const ALL_AZIMUTHS: [f32; 2] = [-1e9, 1.0];

/// How far the rays of the current image start from the axis, metres.
#[derive(Debug, Clone, Copy)]
pub(super) struct ReachMargins {
    across: f32,
    along: f32,
    height: [f32; 2],
    shift: f32,
}

impl ReachMargins {
    pub(super) fn new(origins: &OriginBounds, transform: &RowTransform) -> Self {
        // How far tilt lifts an origin.
        let lifted =
            transform.tilt_max * (origins.radius_max + transform.tilt_max * origins.height_max);
        ReachMargins {
            across: origins.axis_offset_max,
            along: origins.radius_max,
            height: [origins.height_min - lifted, origins.height_max + lifted],
            shift: transform.shift_max,
        }
    }

    /// Largest height of an origin.
    pub(super) fn height_max(&self) -> f32 {
        self.height[1]
    }

    /// Largest horizontal distance between an origin and the robot's.
    pub(super) fn origin_radius(&self) -> f32 {
        self.along + self.shift
    }
}

impl Reach {
    pub(super) fn new(cylinder: &Cylinder, margins: &ReachMargins) -> Self {
        let &Cylinder {
            x,
            y,
            radius,
            bottom,
            top,
        } = cylinder;
        let distance = x.hypot(y);
        let radius = radius + margins.shift;
        // Rays do not start exactly on the axis.
        let wide = radius + margins.across;
        let near = (distance - radius - margins.along).max(1e-3);
        let far = distance + radius + margins.along;
        // From the highest origin to the near bottom, from the lowest to the top.
        let (down, up) = (bottom - margins.height[1], top - margins.height[0]);
        let spare = 1e-3 / near;
        let low = if down < 0.0 { down / near } else { down / far } - spare;
        let high = if up < 0.0 { up / far } else { up / near } + spare;
        let sin = wide / distance.max(1e-6);
        Reach {
            towards: [x, y].map(|part| part / distance.max(1e-6)),
            half_angle: if sin < 0.99 {
                [(1.0 - sin * sin).sqrt(), sin]
            } else {
                WIDE
            },
            slope: [low, high],
        }
    }
}

/// The reaches of some objects, `LANES` at a time.
#[derive(Debug, Default)]
pub(super) struct Culling {
    groups: Vec<ReachLanes>,
}

#[derive(Debug, Clone, Copy)]
struct ReachLanes {
    towards: [Vector; 2],
    half_angle: [Vector; 2],
    slope: [Vector; 2],
}

impl Culling {
    pub(super) fn new(reaches: impl Iterator<Item = Reach>) -> Self {
        let reaches: Vec<Reach> = reaches.collect();
        let group = |reaches: &[Reach]| {
            // Those beyond the last one are met by no ray.
            let nothing = Reach {
                towards: [0.0; 2],
                half_angle: [1.0, 0.0],
                slope: [f32::INFINITY, f32::NEG_INFINITY],
            };
            let lanes = |of: &dyn Fn(&Reach) -> f32| {
                Vector::new(std::array::from_fn(|lane| {
                    of(reaches.get(lane).unwrap_or(&nothing))
                }))
            };
            ReachLanes {
                towards: [0, 1].map(|k| lanes(&|reach| reach.towards[k])),
                half_angle: [0, 1].map(|k| lanes(&|reach| reach.half_angle[k])),
                slope: [0, 1].map(|k| lanes(&|reach| reach.slope[k])),
            }
        };
        Culling {
            groups: reaches.chunks(LANES).map(group).collect(),
        }
    }

    /// Finds the objects that a block may see, in their order.
    pub(super) fn find(&self, view: &BlockView, found: &mut Vec<u32>) {
        found.clear();
        let [cos, sin] = view.half_angle.unwrap_or(ALL_AZIMUTHS);
        let [tx, ty] = view.towards.map(splat);
        let ([low, high], [cos, sin]) = (view.slope.map(splat), [cos, sin].map(splat));
        for (number, group) in self.groups.iter().enumerate() {
            let ReachLanes {
                towards,
                half_angle,
                slope,
            } = group;
            let dot = tx.mul_add(towards[0], ty * towards[1]);
            // The cosine of the sum of both half angles.
            let limit = cos.mul_add(half_angle[0], -(sin * half_angle[1]));
            let (above, below) = (high - slope[0], slope[1] - low);
            // Above 0 if azimuths and slopes overlap.
            let overlap = (dot - limit).fast_min(above).fast_min(below);
            let mut meets = overlap.simd_gt(splat(0.0)).to_bitmask();
            while meets != 0 {
                found.push((number * LANES) as u32 + meets.trailing_zeros());
                meets &= meets - 1;
            }
        }
    }
}
