//! Do the poses turn about the point that the wheels turn about? Another centre of the mirror, or an offset of the map's origin.
//!
//! Near the robot a shift of the mirror's centre moves all ground alike. Line points cannot tell that from another position of
//! the robot, but the wheels can, in turns (docs/methods.md 16.2).

use localize::Field;
use localize::frames::Tf;
use localize::math;
use localize::setup_check::{Comparison, Explanation, FieldTables, compare, refine};
use nalgebra::{Matrix2, Matrix3, Vector2};

use super::assess::{Improvement, Trial};
use super::change::Change;
use super::variant::SetupVariant;

/// Standard deviations that an offset must have to be named.
const OFFSET_SIGMAS: f32 = 3.0;
/// Shift that shows by how much a pixel moves the origin, pixels.
const PROBE_PX: f32 = 3.0;
/// Passes of the search for a centre without an offset.
const PASSES: usize = 3;
/// Farthest shift of the centre that is tried, pixels.
const REACH_PX: f32 = 60.0;

/// An offset of the poses' origin from the point that the wheels turn about.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct OriginOffset {
    /// In the robot frame, metres.
    pub(super) at: Vector2<f32>,
    /// Square of its standard deviations: twice the log likelihood that it gains over none.
    squared_sigmas: f32,
    /// Standard deviation of each coordinate, that of the wheels' centre included, metres.
    pub(super) std: f32,
}

impl OriginOffset {
    /// Offset by the steps of an explanation. None for too few steps.
    pub(super) fn measure(explanation: &Explanation) -> Option<Self> {
        let offset = explanation.wheels_fit()?.origin;
        Some(OriginOffset {
            at: offset.at,
            squared_sigmas: offset.at.norm_squared() / offset.variance,
            std: offset.variance.sqrt(),
        })
    }

    /// Offset by the steps of an explanation, if it is one beyond doubt.
    pub(super) fn find(explanation: &Explanation) -> Option<Self> {
        OriginOffset::measure(explanation).filter(OriginOffset::is_certain)
    }

    fn is_certain(&self) -> bool {
        self.squared_sigmas > OFFSET_SIGMAS.powi(2)
    }

    /// Covariance of poses by headings of all directions.
    pub(super) fn pose_covariance(&self) -> Matrix3<f32> {
        let variance = 0.5 * self.at.norm_squared();
        Matrix3::from_diagonal(&[variance, variance, 0.0].into())
    }
}

impl Trial<'_> {
    /// The centre with which poses and wheels turn about one point. The gain is that of line points and wheels together.
    ///
    /// None for a calibrated map, whose origin may be off as well as the image.
    pub(super) fn search_centre_by_wheels(
        &self,
        variant: &SetupVariant,
        now: &Explanation,
    ) -> Option<Improvement> {
        let offset =
            OriginOffset::find(now).filter(|_| self.has_pixels() && !self.setup.is_calibrated())?;
        let field = Field::new(variant.field.clone()).ok()?;
        let mut tables = FieldTables::new(&field, &self.config);
        let mut explain_at = |shift: Vector2<f32>, start: &Explanation| {
            let change = Change::Centre(shift.into());
            let after = change.apply(variant);
            let keyframes = after.apply(self.setup, self.measured);
            let explanation = refine(&mut tables, &keyframes, start);
            (change, after, explanation)
        };
        let mut shift = Vector2::from(variant.centre_shift);
        let mut remaining = offset;
        let mut best = None;
        for _ in 0..PASSES {
            let start = best.as_ref().map_or(now, |(_, _, explanation)| explanation);
            let mut probe = |step: Vector2<f32>| {
                let (_, _, explanation) = explain_at(shift + step, start);
                let moved = OriginOffset::measure(&explanation)?;
                Some((moved.at - remaining.at) / PROBE_PX)
            };
            let columns = [
                probe(Vector2::new(PROBE_PX, 0.0))?,
                probe(Vector2::new(0.0, PROBE_PX))?,
            ];
            shift -= Matrix2::from_columns(&columns).try_inverse()? * remaining.at;
            let moved = without_offset(start, remaining.at);
            let [u, v] = (shift - Vector2::from(variant.centre_shift)).into();
            if !(math::hypot(u, v) <= REACH_PX) {
                return None;
            }
            let next = explain_at(shift, &moved);
            remaining = OriginOffset::measure(&next.2)?;
            best = Some(next);
        }
        let (change, after, explanation) = best.filter(|_| !remaining.is_certain())?;
        Some(Improvement {
            change,
            after,
            comparison: compare_with_offsets(now, &explanation),
            by_steps: false,
            explanation,
        })
    }
}

/// The poses of the point that the wheels turn about: another centre moves them there by more than a search near them reaches.
fn without_offset(explanation: &Explanation, offset: Vector2<f32>) -> Explanation {
    let back = Tf::new(-offset.x, -offset.y, 0.0);
    let mut moved = explanation.clone();
    for fit in &mut moved.keyframes {
        fit.pose = fit.pose.map(|pose| pose * back);
    }
    moved
}

/// As [`compare`], with the gain of the wheels' steps in turns, which single keyframes are too uncertain for.
pub(super) fn compare_with_offsets(now: &Explanation, other: &Explanation) -> Comparison {
    let cost = |explanation| {
        OriginOffset::measure(explanation).map_or(0.0, |offset| 0.5 * offset.squared_sigmas)
    };
    let mut comparison = compare(now, other);
    comparison.gain += cost(now) - cost(other);
    comparison
}
