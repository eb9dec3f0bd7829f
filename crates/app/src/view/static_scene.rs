//! The constant part of a source: field, camera and ground map, with the tables that drawing needs.

use std::sync::Arc;

use localize::LocalizeConfig;
use localize::field::Field;
use localize::field::marking_points;
use localize::frames::{At, Pose, RobotFrame};
use localize::map_correction::{MapBasis, MapCorrectionEstimate, PreparedBasis, TERMS_MAX};
use localize::matching::distance_field::{DistanceField, DistanceFieldConfig};
use localize::robot::CameraConfig;
use localize::robot::RobotConfig;
use localize::tilt::map_from_ground;
use vision::GroundMap;
use vision::colour::colour_table::ColourTable;

use super::inverse_ground_map::InverseGroundMap;
use pipeline::setup::Setup;

/// Displacement of points 3 m away from which a map counts as corrected, metres. Rounding moves points by micrometres.
const DISPLACEMENT_MIN: f32 = 1e-4;
/// Steps that find the given map's point of a corrected one.
const INVERSION_STEPS: usize = 4;

/// Spacing of the points along a projected marking, metres: small enough to show the mirror's distortion.
const MARKING_POINT_SPACING: f32 = 0.1;
/// Neighbouring points farther apart than this many spacings belong to different markings.
const GAP_STEPS: f32 = 1.5;

/// Field, camera and ground map.
pub(crate) struct StaticScene {
    /// Robot configuration.
    pub(crate) robot: RobotConfig,
    /// The field.
    pub(crate) field: Field,
    /// Camera with its ground map and the inverse map.
    pub(crate) camera: Option<CameraModel>,
    /// The robot's colour table.
    pub(crate) colour_table: Option<ColourTable>,
    /// One entry per pixel; false where the robot sees itself.
    pub(crate) mask: Option<Arc<Vec<bool>>>,
    /// Distance to the nearest marking, for every point of the field.
    pub(crate) distances: DistanceField,
    /// Points along the markings, marking after marking.
    marking_points: Vec<At<localize::FieldFrame>>,
}

/// Camera with the maps between image and ground.
pub(crate) struct CameraModel {
    /// Camera configuration.
    pub(crate) config: CameraConfig,
    /// Pixel to ground.
    pub(crate) map: Arc<GroundMap>,
    /// Ground to pixel.
    pub(crate) inverse: InverseGroundMap,
    /// Height of the viewpoint, metres.
    pub(crate) viewpoint_height: f32,
    /// Possible errors of the map. None if they cannot be traced: it is drawn as given then.
    basis: Option<MapBasis>,
}

/// How a robot stands when its image is taken, and what it learned about its map.
#[derive(Clone, Copy)]
pub(crate) struct View<'a> {
    /// On the field.
    pub(crate) pose: Pose,
    /// Tilt (a, b), radians.
    pub(crate) tilt: [f32; 2],
    /// None: the map as given.
    pub(crate) correction: Option<&'a MapCorrectionEstimate>,
}

impl StaticScene {
    /// Computes the tables that drawing needs: a fraction of a second for a large image.
    pub(crate) fn new(setup: Setup) -> Self {
        let height = setup
            .viewpoint_height
            .unwrap_or(localize::robot::DEFAULT_MIRROR_RIM_HEIGHT);
        let mut config = LocalizeConfig::default();
        config.matching.viewpoint_height = height;
        let basis = setup.map_basis(&config).unwrap_or_default();
        let camera = setup.camera.map(|(config, map)| CameraModel {
            inverse: InverseGroundMap::new(&map),
            config,
            map,
            viewpoint_height: height,
            basis,
        });
        StaticScene {
            robot: setup.robot,
            distances: DistanceField::new(&setup.field, &DistanceFieldConfig::default()),
            marking_points: marking_points(&setup.field.markings, MARKING_POINT_SPACING),
            field: setup.field,
            camera,
            colour_table: setup.colours,
            mask: setup.mask.map(Arc::new),
        }
    }

    /// Lines of the markings in pixels, as the camera sees them.
    pub(crate) fn project_markings(&self, view: View<'_>) -> Vec<Vec<[f32; 2]>> {
        let Some(camera) = &self.camera else {
            return Vec::new();
        };
        let robot_from_field = view.pose.inverse();
        let prepared = camera.prepare_correction(view.correction);
        let mut lines: Vec<Vec<[f32; 2]>> = Vec::new();
        let mut last: Option<At<localize::FieldFrame>> = None;
        for &at in &self.marking_points {
            let pixel = camera.project(robot_from_field * at, view.tilt, prepared.as_ref());
            let continues = last
                .is_some_and(|before| before.distance_to(at) < GAP_STEPS * MARKING_POINT_SPACING);
            match (pixel, lines.last_mut()) {
                (Some(pixel), Some(line)) if continues => line.push(pixel),
                (Some(pixel), _) => lines.push(vec![pixel]),
                (None, _) => {}
            }
            last = pixel.map(|_| at);
        }
        lines
    }
}

impl CameraModel {
    /// The map's correction, ready for many points. None while the given map is in use.
    pub(crate) fn prepare_correction(
        &self,
        correction: Option<&MapCorrectionEstimate>,
    ) -> Option<PreparedBasis<'_>> {
        let basis = self.basis.as_ref()?;
        let estimate =
            correction.filter(|estimate| estimate.displacement_at_3_m > DISPLACEMENT_MIN)?;
        let mut coefficients = [0.0; TERMS_MAX];
        for (coefficient, term) in coefficients.iter_mut().zip(basis.terms()) {
            let learned = estimate.terms.iter().find(|each| each.kind == term.kind);
            *coefficient = learned.map_or(0.0, |learned| learned.value);
        }
        Some(basis.prepare(coefficients))
    }

    /// Pixel of a ground point in the image of a robot with this tilt; None if it is not visible.
    pub(crate) fn project(
        &self,
        ground: At<RobotFrame>,
        tilt: [f32; 2],
        correction: Option<&PreparedBasis<'_>>,
    ) -> Option<[f32; 2]> {
        let corrected = map_from_ground([ground.x, ground.y], tilt, self.viewpoint_height)?;
        let [x, y] = correction.map_or(corrected, |correction| {
            invert_displacement(correction, corrected)
        });
        self.inverse.project(&self.map, At::new(x, y))
    }
}

/// The point that the given map shows where the corrected one shows `corrected`. Corrections are small and smooth.
pub(super) fn invert_displacement(correction: &PreparedBasis<'_>, corrected: [f32; 2]) -> [f32; 2] {
    let mut given = corrected;
    for _ in 0..INVERSION_STEPS {
        let [x, y] = correction.displace(given).at;
        given[0] += corrected[0] - x;
        given[1] += corrected[1] - y;
    }
    given
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use localize::map_correction::TermEstimate;

    use super::*;

    #[test]
    fn overlay_follows_the_corrected_map() {
        let robot = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/robots/default.toml");
        let scene = StaticScene::new(Setup::load(&robot, None).expect("a robot"));
        let camera = scene.camera.as_ref().expect("a camera");
        let basis = camera.basis.as_ref().expect("a basis");
        let terms = basis.terms().iter().map(|term| TermEstimate {
            kind: term.kind,
            value: term.std,
            std: 0.0,
        });
        let mut learned = MapCorrectionEstimate {
            terms: terms.collect(),
            displacement_at_3_m: 0.1,
            ..MapCorrectionEstimate::default()
        };
        let prepared = camera.prepare_correction(Some(&learned)).expect("in use");
        let mut moved = 0.0_f32;
        for k in 0..24 {
            let (sin, cos) = (0.26 * k as f32).sin_cos();
            let range = 1.0 + 0.12 * k as f32;
            let ground = At::new(range * cos, range * sin);
            let Some([u, v]) = camera.project(ground, [0.0; 2], Some(&prepared)) else {
                continue;
            };
            // What the given map shows at this pixel, the correction puts where the point is.
            let shown = camera.map.interpolate(u, v).expect("ground");
            let [x, y] = prepared.displace([shown.x, shown.y]).at;
            let error = (x - ground.x).hypot(y - ground.y);
            assert!(error < 0.02, "{ground:?}: {error} m");
            moved = moved.max(shown.distance_to(ground));
        }
        assert!(moved > 0.05, "the correction moves the overlay: {moved} m");
        learned.displacement_at_3_m = 0.0;
        assert!(
            camera.prepare_correction(Some(&learned)).is_none(),
            "the given map is in use"
        );
    }
}
