//! What can be wrong about a ground map: the unknowns, each with its unit, its dependence on the bearing and its field
//! over the view angle (docs/methods.md 2.13).

use serde::{Deserialize, Serialize};

/// Largest number of unknowns of a basis.
pub const TERMS_MAX: usize = 12;

/// Entries of a table over γ: one per half a degree from 0 to 90.
pub const NODES: usize = 181;

/// Unknowns of a mirror's mounting in the order of `MirrorModel::prepare`.
pub(super) const MIRROR_KINDS: [TermKind; 5] = [
    TermKind::MirrorTiltX,
    TermKind::MirrorTiltY,
    TermKind::MirrorOffsetX,
    TermKind::MirrorOffsetY,
    TermKind::FocalLength,
];

/// Unit of an unknown.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unit {
    /// Angles.
    Radian,
    /// Lengths.
    Metre,
    /// Relative errors.
    Share,
}

/// What an unknown stands for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TermKind {
    /// Tilt of the mirror against the camera's axis towards the robot's x, radians.
    MirrorTiltX,
    /// The same towards y.
    MirrorTiltY,
    /// Offset of the mirror's axis from the camera's along the robot's x, metres.
    MirrorOffsetX,
    /// The same along y.
    MirrorOffsetY,
    /// Focal length, relative.
    FocalLength,
    /// Height of the viewpoint, metres.
    Height,
    /// Centre of the image along the robot's x, as a share of the largest image radius.
    CentreX,
    /// The same along y.
    CentreY,
    /// Relative error of the range about the nth node.
    Range(u8),
    /// Relative error of the range of far points, times the cosine of the bearing.
    FarRangeCosine,
    /// The same, times its sine.
    FarRangeSine,
    /// Ellipse: relative stretch along the robot's x against y.
    EllipseCosine,
    /// The same along the diagonal.
    EllipseSine,
}

impl TermKind {
    /// Name in logs and files.
    pub fn name(self) -> &'static str {
        match self {
            TermKind::MirrorTiltX => "mirror tilt x",
            TermKind::MirrorTiltY => "mirror tilt y",
            TermKind::MirrorOffsetX => "mirror offset x",
            TermKind::MirrorOffsetY => "mirror offset y",
            TermKind::FocalLength => "focal length",
            TermKind::Height => "height",
            TermKind::CentreX => "centre x",
            TermKind::CentreY => "centre y",
            TermKind::Range(0) => "range 1",
            TermKind::Range(1) => "range 2",
            TermKind::Range(2) => "range 3",
            TermKind::Range(_) => "range 4",
            TermKind::FarRangeCosine => "far range cos",
            TermKind::FarRangeSine => "far range sin",
            TermKind::EllipseCosine => "ellipse cos",
            TermKind::EllipseSine => "ellipse sin",
        }
    }

    /// All kinds.
    pub const ALL: [TermKind; 16] = [
        TermKind::MirrorTiltX,
        TermKind::MirrorTiltY,
        TermKind::MirrorOffsetX,
        TermKind::MirrorOffsetY,
        TermKind::FocalLength,
        TermKind::Height,
        TermKind::CentreX,
        TermKind::CentreY,
        TermKind::Range(0),
        TermKind::Range(1),
        TermKind::Range(2),
        TermKind::Range(3),
        TermKind::FarRangeCosine,
        TermKind::FarRangeSine,
        TermKind::EllipseCosine,
        TermKind::EllipseSine,
    ];

    /// Unit of its value.
    pub fn unit(self) -> Unit {
        match self {
            TermKind::MirrorTiltX | TermKind::MirrorTiltY => Unit::Radian,
            TermKind::MirrorOffsetX | TermKind::MirrorOffsetY | TermKind::Height => Unit::Metre,
            _ => Unit::Share,
        }
    }

    /// The kind of a name.
    pub fn from_name(name: &str) -> Option<Self> {
        TermKind::ALL.into_iter().find(|kind| kind.name() == name)
    }

    /// Is it an unknown of the mirror's mounting, which a [`MirrorModel`] knows exactly?
    pub(super) fn is_of_mirror(self) -> bool {
        MIRROR_KINDS.contains(&self)
    }
}

/// Dependence of a field on the bearing φ: factors of the radial and the tangential table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Harmonic {
    /// 1 and 0.
    Constant,
    /// cos φ and −sin φ.
    Cosine,
    /// sin φ and cos φ.
    Sine,
    /// cos 2φ and −sin 2φ.
    DoubleCosine,
    /// sin 2φ and cos 2φ.
    DoubleSine,
}

impl Harmonic {
    pub(super) fn factors(self, [cos, sin]: [f32; 2]) -> [f32; 2] {
        match self {
            Harmonic::Constant => [1.0, 0.0],
            Harmonic::Cosine => [cos, -sin],
            Harmonic::Sine => [sin, cos],
            Harmonic::DoubleCosine => [cos * cos - sin * sin, -2.0 * sin * cos],
            Harmonic::DoubleSine => [2.0 * sin * cos, cos * cos - sin * sin],
        }
    }

    /// Means of the squared factors over the bearing.
    pub(super) fn mean_squares(self) -> [f32; 2] {
        match self {
            Harmonic::Constant => [1.0, 0.0],
            _ => [0.5, 0.5],
        }
    }
}

/// One unknown with its field per unit.
#[derive(Debug, Clone, PartialEq)]
pub struct BasisTerm {
    /// What it stands for.
    pub kind: TermKind,
    /// Standard deviation before anything was seen, in the unit of `kind`.
    pub std: f32,
    /// Dependence on the bearing.
    pub harmonic: Harmonic,
    /// Change of γ per unit, radians, at [`MapBasis::node_angle`](super::MapBasis::node_angle).
    pub radial: [f32; NODES],
    /// Change of φ times sin γ per unit, radians.
    pub tangential: [f32; NODES],
}
