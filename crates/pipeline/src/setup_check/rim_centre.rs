//! Is the mirror's rim in the images where the set-up says? A camera that was pushed shows it elsewhere.
//!
//! Near the robot a shift of the mirror's centre moves all ground alike, which line points cannot tell from another position of the
//! robot. The rim moves with the mirror's image, too, and no pose explains that.

use localize::Field;
use localize::math;
use localize::setup_check::{Explanation, FieldTables, refine};

use super::assess::{Improvement, Trial};
use super::change::Change;
use super::origin_offset::compare_with_offsets;
use super::variant::SetupVariant;

/// A smaller distance of the rim's centre from the configured one is no mistake, as a share of its radius: a mirror that is mounted
/// aslant shows its rim beside its axis.
const OFFSET_MIN: f32 = 0.015;
impl Trial<'_> {
    /// The centre of the mirror that its rim shows, unless the line points contradict it.
    pub(super) fn search_centre_by_rim(
        &self,
        variant: &SetupVariant,
        now: &Explanation,
    ) -> Option<Improvement> {
        let (camera, _) = self.setup.camera.as_ref()?;
        let camera = variant.camera(camera);
        let radius = camera.outer_radius_px?;
        let rim = self.rim?;
        let [du, dv] = [0, 1].map(|axis| rim.centre_px[axis] - camera.centre_px[axis]);
        if !self.has_pixels() || math::hypot(du, dv) < OFFSET_MIN * radius {
            return None;
        }
        let [u, v] = variant.centre_shift;
        let change = Change::Centre([u + du, v + dv]);
        let after = change.apply(variant);
        let field = Field::new(variant.field.clone()).ok()?;
        let keyframes = after.apply(self.setup, self.measured);
        let explanation = refine(&mut FieldTables::new(&field, &self.config), &keyframes, now);
        let comparison = compare_with_offsets(now, &explanation);
        (!comparison.is_worse()).then_some(Improvement {
            change,
            after,
            explanation,
            comparison,
            by_steps: false,
        })
    }
}
