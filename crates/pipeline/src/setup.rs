//! Which robot, on which field? From robot.toml to what a spine runs on: field, ground map, eyes, localizer.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, bail, ensure};
use localize::Field;
use localize::robot::CameraConfig;
use localize::robot::RobotConfig;
use vision::calibrate::mask::load_mask;
use vision::colour::colour_table::{ColourTable, TableKind, load_labels};
use vision::{GroundMap, Mount, Profile, optics};

/// A robot and its field, read and checked.
pub struct Setup {
    /// The robot's file.
    pub robot: RobotConfig,
    /// The field it names.
    pub field: Field,
    /// Camera and ground map; a recording of line points has none.
    pub camera: Option<(CameraConfig, Arc<GroundMap>)>,
    /// Colours learned from labels; without, vision learns them from the images.
    pub colours: Option<ColourTable>,
    /// Where the robot does not see itself, one entry a pixel, row by row.
    pub mask: Option<Vec<bool>>,
    /// Height of the mirror above the ground, metres, where its profile says it.
    pub viewpoint_height: Option<f32>,
}

impl Setup {
    /// Reads a robot file and what it names.
    ///
    /// `map`: a calibrated map to measure with in place of the robot's own.
    pub fn load(robot_file: &Path, map: Option<&Path>) -> Result<Self> {
        let robot = RobotConfig::load(robot_file)?;
        let field = Field::load(&robot.field)?;
        Setup::new(robot_file, robot, field, map)
    }

    /// From a robot that is read already, perhaps on another field than its own; its file is named in errors.
    pub fn new(
        robot_file: &Path,
        robot: RobotConfig,
        field: Field,
        map: Option<&Path>,
    ) -> Result<Self> {
        let camera = match &robot.camera {
            Some(camera) => Some((
                camera.clone(),
                Arc::new(load_ground_map(robot_file, &robot, camera, map)?),
            )),
            None => None,
        };
        let viewpoint_height = match &robot.mirror {
            Some(mirror) => Some(profile_viewpoint_height(&Profile::load(&mirror.profile)?)),
            None => None,
        };
        let mask = match (&robot.mask, &robot.camera) {
            (Some(path), Some(camera)) => Some(load_mask(path, camera.width_px, camera.height_px)?),
            _ => None,
        };
        Ok(Setup {
            mask,
            colours: load_colours(robot_file, &robot)?,
            robot,
            field,
            camera,
            viewpoint_height,
        })
    }
}

/// Where the view of the floor comes from: the mirror half way out.
fn profile_viewpoint_height(profile: &Profile) -> f32 {
    let (inner, outer) = profile.radii();
    profile.height_and_slope((inner + outer) / 2.0).0 as f32
}

/// The saved table, or one learned from labels (those that robot.toml names, or labels.csv beside it).
fn load_colours(robot_file: &Path, robot: &RobotConfig) -> Result<Option<ColourTable>> {
    if let Some(saved) = &robot.colours {
        return Ok(Some(ColourTable::load(saved)?));
    }
    let beside = robot_file.with_file_name("labels.csv");
    let Some(path) = robot
        .labels
        .clone()
        .or_else(|| beside.exists().then_some(beside))
    else {
        return Ok(None);
    };
    let table = ColourTable::learn(&load_labels(&path)?, TableKind::Yuv);
    Ok(Some(table.with_context(|| {
        format!("{}: has no label", path.display())
    })?))
}

/// The map a robot measures with: the one given, else its calibrated one, else the one its mirror should have.
fn load_ground_map(
    robot_file: &Path,
    robot: &RobotConfig,
    camera: &CameraConfig,
    given: Option<&Path>,
) -> Result<GroundMap> {
    let calibrated = given
        .map(PathBuf::from)
        .or_else(|| robot.map.as_ref().map(|map| map.file.clone()));
    let (map, source) = match (calibrated, &robot.mirror) {
        (Some(file), _) => (GroundMap::load(&file)?, file),
        (None, Some(mirror)) => {
            let profile = Profile::load(&mirror.profile)?;
            let rays = optics::trace_rays(camera, &profile, &Mount::default())
                .with_context(|| robot_file.display().to_string())?;
            (rays.ground_map(), mirror.profile.clone())
        }
        (None, None) => bail!(
            "{}: neither [map] nor [mirror]: nothing says which ground a pixel shows",
            robot_file.display()
        ),
    };
    ensure!(
        (map.width_px, map.height_px) == (camera.width_px, camera.height_px),
        "{} is for {} × {} pixels, but the camera of {} has {} × {}",
        source.display(),
        map.width_px,
        map.height_px,
        robot_file.display(),
        camera.width_px,
        camera.height_px
    );
    let seen = map.x.iter().filter(|x| x.is_finite()).count();
    ensure!(seen > 0, "{}: no pixel shows ground", source.display());
    Ok(map)
}
