//! The constant part of a source: field, camera and ground map, with the tables that drawing needs.

use std::sync::Arc;

use localize::field::Field;
use localize::frames::{At, Pose, RobotFrame};
use localize::matching::distance_field::{DistanceField, DistanceFieldConfig};
use localize::robot::CameraConfig;
use localize::robot::RobotConfig;
use localize::tilt::map_from_ground;
use vision::GroundMap;
use vision::colour::colour_table::ColourTable;
use vision::overlay::marking_points;

use super::inverse_ground_map::InverseGroundMap;
use pipeline::setup::Setup;

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
}

impl StaticScene {
    /// Computes the tables that drawing needs: a fraction of a second for a large image.
    pub(crate) fn new(setup: Setup) -> Self {
        let height = setup
            .viewpoint_height
            .unwrap_or(localize::robot::DEFAULT_MIRROR_RIM_HEIGHT);
        let camera = setup.camera.map(|(config, map)| CameraModel {
            inverse: InverseGroundMap::new(&map),
            config,
            map,
            viewpoint_height: height,
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

    /// Line segments of the markings in pixels, as the camera sees them from `pose` with the tilt (rad) `tilt`.
    pub(crate) fn project_markings(&self, pose: Pose, tilt: [f32; 2]) -> Vec<[[f32; 2]; 2]> {
        let Some(camera) = &self.camera else {
            return Vec::new();
        };
        let robot_from_field = pose.inverse();
        let mut segments = Vec::new();
        let mut last: Option<(At<localize::FieldFrame>, [f32; 2])> = None;
        for &at in &self.marking_points {
            let pixel = camera.project(robot_from_field * at, tilt);
            if let (Some((before, from)), Some(to)) = (last, pixel)
                && before.distance_to(at) < GAP_STEPS * MARKING_POINT_SPACING
            {
                segments.push([from, to]);
            }
            last = pixel.map(|pixel| (at, pixel));
        }
        segments
    }
}

impl CameraModel {
    /// Pixel of a ground point in the image of a robot with this tilt; None if it is not visible.
    pub(crate) fn project(&self, ground: At<RobotFrame>, tilt: [f32; 2]) -> Option<[f32; 2]> {
        let [x, y] = map_from_ground([ground.x, ground.y], tilt, self.viewpoint_height)?;
        self.inverse.project(&self.map, At::new(x, y))
    }
}
