//! On which stage does the play go on? Field, camera and map of one source, with what drawing needs of them.

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

/// Distance between points of a projected line, metres: a bent line still looks bent.
const MARKING_POINT_SPACING: f32 = 0.1;
/// A gap between neighbours longer than so many steps is no line but the next marking.
const GAP_STEPS: f32 = 1.5;

/// Field, camera and map.
pub(crate) struct StaticScene {
    /// The robot's file.
    pub(crate) robot: RobotConfig,
    /// The field.
    pub(crate) field: Field,
    /// Camera and map, with the way back from the ground into the image.
    pub(crate) camera: Option<CameraModel>,
    /// Colours learned from labels.
    pub(crate) colour_table: Option<ColourTable>,
    /// What the robot sees of itself, one entry a pixel; false where it does.
    pub(crate) mask: Option<Arc<Vec<bool>>>,
    /// Distance to the nearest marking.
    pub(crate) distances: DistanceField,
    /// Points along the markings, marking after marking.
    marking_points: Vec<At<localize::FieldFrame>>,
}

/// What the camera shows of the ground.
pub(crate) struct CameraModel {
    /// The camera.
    pub(crate) config: CameraConfig,
    /// Pixel to ground.
    pub(crate) map: Arc<GroundMap>,
    /// Ground to pixel.
    pub(crate) inverse: InverseGroundMap,
    /// Height of the viewpoint, metres.
    pub(crate) viewpoint_height: f32,
}

impl StaticScene {
    /// Works out what drawing needs: a fraction of a second for a large camera.
    pub(crate) fn new(setup: Setup) -> Self {
        let height = setup
            .viewpoint_height
            .unwrap_or(localize::robot::DEFAULT_MIRROR_RIM_HEIGHT);
        let eye = setup.camera.map(|(camera, map)| CameraModel {
            inverse: InverseGroundMap::new(&map),
            config: camera,
            map,
            viewpoint_height: height,
        });
        StaticScene {
            robot: setup.robot,
            distances: DistanceField::new(&setup.field, &DistanceFieldConfig::default()),
            marking_points: marking_points(&setup.field.markings, MARKING_POINT_SPACING),
            field: setup.field,
            camera: eye,
            colour_table: setup.colours,
            mask: setup.mask.map(Arc::new),
        }
    }

    /// The markings as the camera should see them from a pose, leaning by `lean`: pieces of lines in pixels.
    pub(crate) fn project_markings(&self, pose: Pose, lean: [f32; 2]) -> Vec<[[f32; 2]; 2]> {
        let Some(eye) = &self.camera else {
            return Vec::new();
        };
        let robot_from_field = pose.inverse();
        let mut pieces = Vec::new();
        let mut last: Option<(At<localize::FieldFrame>, [f32; 2])> = None;
        for &at in &self.marking_points {
            let seen = eye.project(robot_from_field * at, lean);
            if let (Some((before, from)), Some(to)) = (last, seen)
                && before.distance_to(at) < GAP_STEPS * MARKING_POINT_SPACING
            {
                pieces.push([from, to]);
            }
            last = seen.map(|pixel| (at, pixel));
        }
        pieces
    }
}

impl CameraModel {
    /// Where a point of the ground is in the image of a robot that leans.
    pub(crate) fn project(&self, ground: At<RobotFrame>, tilt: [f32; 2]) -> Option<[f32; 2]> {
        let [x, y] = map_from_ground([ground.x, ground.y], tilt, self.viewpoint_height)?;
        self.inverse.project(&self.map, At::new(x, y))
    }
}
