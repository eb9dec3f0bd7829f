//! Which robot plays on which field? Loads what robot.toml names: field, camera, ground map, colours, mask.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, bail, ensure};
use localize::Field;
use localize::config::LocalizeConfig;
use localize::filter::FilterConfig;
use localize::map_correction::MapBasis;
use localize::robot::{CameraConfig, CameraSection, ImuCalibration, RobotConfig};
use vision::calibrate::mask::load_mask;
use vision::colour::colour_table::{ColourTable, TableKind, load_labels};
use vision::optics::map_basis;
use vision::{GroundMap, Mount, Profile, optics};

use crate::recording::Table;

/// A robot and its field, loaded and validated.
#[derive(Clone)]
pub struct Setup {
    /// Contents of the robot file.
    pub robot: RobotConfig,
    /// The field that the robot file names.
    pub field: Field,
    /// Camera and ground map. None for a recording of line points.
    pub camera: Option<(CameraConfig, Arc<GroundMap>)>,
    /// Colours learned from labels. None: vision learns them from the images.
    pub colours: Option<ColourTable>,
    /// False where the image shows the robot itself; one entry per pixel, row by row.
    pub mask: Option<Vec<bool>>,
    /// Height of the mirror above the ground, metres, if its profile is known.
    pub viewpoint_height: Option<f32>,
    /// The mirror whose ideal mount gave the ground map. None for a calibrated map.
    pub traced_mirror: Option<Profile>,
    /// What measures: messages name the keys of devices, or the columns of tables.
    pub sensors: SensorSource,
}

/// Where samples of wheels, compass and inertial unit come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum SensorSource {
    /// Tables of a recording.
    #[default]
    Tables,
    /// Devices of hardware.toml.
    Devices,
}

impl SensorSource {
    /// Where the operator finds a sensor.
    pub fn place(self, table: Table) -> &'static str {
        match (self, table) {
            (SensorSource::Tables, Table::Images) => "frames.csv",
            (SensorSource::Tables, Table::Odometry) => "odometry.csv",
            (SensorSource::Tables, Table::Compass) => "compass.csv",
            (SensorSource::Tables, Table::Imu) => "imu.csv",
            (SensorSource::Devices, Table::Images) => "[camera] of hardware.toml",
            (SensorSource::Devices, Table::Odometry) => "[base] of hardware.toml",
            (SensorSource::Devices, Table::Compass) => "the compass of hardware.toml",
            (SensorSource::Devices, Table::Imu) => "the inertial unit of hardware.toml",
        }
    }
}

impl Setup {
    /// Reads a robot file and the files that it names.
    ///
    /// `map`: a calibrated ground map that replaces the robot's own.
    pub fn load(robot_file: &Path, map: Option<&Path>) -> Result<Self> {
        Setup::load_on_field(robot_file, None, map)
    }

    /// As [`Setup::load`], on another field than that of the robot file, if one is given.
    pub fn load_on_field(
        robot_file: &Path,
        field: Option<Field>,
        map: Option<&Path>,
    ) -> Result<Self> {
        let robot = RobotConfig::load(robot_file)?;
        let field = match field {
            Some(field) => field,
            None => Field::load(&robot.field)?,
        };
        Setup::new(robot_file, robot, field, map)
    }

    /// A robot without camera: line points come from another vision system.
    pub fn without_camera(field: Field) -> Self {
        Setup {
            robot: RobotConfig {
                field: PathBuf::new(),
                include: Vec::new(),
                camera: None,
                exposure: None,
                mirror: None,
                map: None,
                mask: None,
                labels: None,
                colours: None,
                base: None,
                odometry: None,
                timing: None,
                imu: None,
                compass: None,
                body: None,
            },
            field,
            camera: None,
            colours: None,
            mask: None,
            viewpoint_height: None,
            traced_mirror: None,
            sensors: SensorSource::default(),
        }
    }

    /// As [`Setup::load`], with a robot and a field that are already loaded. Errors name `robot_file`.
    pub fn new(
        robot_file: &Path,
        robot: RobotConfig,
        field: Field,
        map: Option<&Path>,
    ) -> Result<Self> {
        let camera = match &robot.camera {
            Some(section) => {
                let map = load_ground_map(robot_file, &robot, section, map)?;
                let camera = section.camera().or_else(|| axis_from_map(section, &map));
                let camera = camera.with_context(|| no_axis(robot_file))?;
                Some((camera, Arc::new(map)))
            }
            None => None,
        };
        let profile = match &robot.mirror {
            Some(mirror) => Some(Profile::load(&mirror.profile)?),
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
            viewpoint_height: profile.as_ref().map(profile_viewpoint_height),
            traced_mirror: profile.filter(|profile| is_traced(camera.as_ref(), profile)),
            camera,
            sensors: SensorSource::default(),
        })
    }
}

impl Setup {
    /// True if the ground map was calibrated, so that centre, forward direction and flip of the camera do not matter.
    pub fn is_calibrated(&self) -> bool {
        self.robot.map.is_some() || self.robot.mirror.is_none()
    }

    /// The possible errors of the ground map. None without a camera. Errors if a mirror cannot be traced.
    pub fn map_basis(&self, config: &LocalizeConfig) -> Result<Option<MapBasis>> {
        let Some((camera, map)) = &self.camera else {
            return Ok(None);
        };
        let (height, config) = (config.matching.viewpoint_height, &config.map_correction);
        Ok(Some(match &self.traced_mirror {
            Some(profile) => map_basis::basis_from_profile(camera, profile, height, config)?,
            None => map_basis::basis_from_map(camera, map, height, config),
        }))
    }

    /// Age of an image at its stamp, seconds: that of the settings, else that of robot.toml.
    pub fn camera_latency(&self, filter: &FilterConfig) -> f32 {
        let own = self.robot.timing.map(|timing| timing.camera_latency);
        match (filter.camera_latency, own) {
            (0.0, Some(own)) => own,
            (latency, _) => latency,
        }
    }

    /// Mounting and errors of the inertial unit. None if they are not calibrated.
    pub fn imu_calibration(&self) -> Option<ImuCalibration> {
        self.robot.imu.as_ref().and_then(|imu| imu.calibration)
    }

    /// Standard deviation of the map's origin from the robot's centre, per axis, metres: that of robot.toml, else `default`.
    /// The map of a mirror as designed has its origin at the centre.
    pub fn map_origin_std(&self, default: f32) -> f32 {
        if self.camera.is_none() || self.traced_mirror.is_some() {
            return 0.0;
        }
        let stated = self.robot.map.as_ref().and_then(|map| map.origin_std);
        stated.unwrap_or(default)
    }

    /// Standard deviation of the map's forward direction, radians.
    pub fn map_turn_std(&self) -> f32 {
        let stated = self.robot.map.as_ref().and_then(|map| map.turn_std_deg);
        stated.unwrap_or(0.0).to_radians()
    }
}

/// Is the ground map that of the mirror as designed? Logs store such a map beside the profile.
fn is_traced(camera: Option<&(CameraConfig, Arc<GroundMap>)>, profile: &Profile) -> bool {
    let Some((camera, map)) = camera else {
        return false;
    };
    let bits = |values: &[f32]| {
        values
            .iter()
            .map(|value| value.to_bits())
            .collect::<Vec<_>>()
    };
    optics::trace_rays(camera, profile, &Mount::default()).is_ok_and(|rays| {
        let traced = rays.ground_map();
        bits(&traced.x) == bits(&map.x) && bits(&traced.y) == bits(&map.y)
    })
}

/// The camera with the axis of a calibrated map. None if the map shows too little ground.
///
/// The map's outermost pixel is no rim: a map may end at its last calibrated ground.
fn axis_from_map(section: &CameraSection, map: &GroundMap) -> Option<CameraConfig> {
    let found = optics::camera_from_map::camera_from_map(map)?;
    Some(CameraConfig {
        forward_deg: found.forward_deg,
        flipped: found.flipped,
        ..section.with_axis(found.centre_px, section.outer_radius_px)
    })
}

fn no_axis(robot_file: &Path) -> String {
    format!(
        "{}: [camera] has no centre_px. `mirrorball calibrate rim` measures it",
        robot_file.display()
    )
}

/// Height of the viewpoint, metres: the mirror's height at the mean of its inner and outer radius.
fn profile_viewpoint_height(profile: &Profile) -> f32 {
    let (inner, outer) = profile.radii();
    profile.height_and_slope((inner + outer) / 2.0).0 as f32
}

/// The saved colour table, or one learned from labels. Labels are those of robot.toml, else labels.csv beside it.
fn load_colours(robot_file: &Path, robot: &RobotConfig) -> Result<Option<ColourTable>> {
    if let Some(saved) = &robot.colours {
        return Ok(Some(ColourTable::load(saved)?));
    }
    let default = robot_file.with_file_name("labels.csv");
    let Some(path) = robot
        .labels
        .clone()
        .or_else(|| default.exists().then_some(default))
    else {
        return Ok(None);
    };
    let table = ColourTable::learn(&load_labels(&path)?, TableKind::Yuv);
    Ok(Some(table.with_context(|| {
        format!("{}: no label (expected at least one row)", path.display())
    })?))
}

/// A robot sees ground nearer than this, metres.
const NEAREST_GROUND_MAX: f32 = 5.0;
/// Share of the rim's radius in the image up to which a whole profile reaches, wherever it is mounted.
const PROFILE_REACH_MIN: f64 = 0.75;

/// The ground map: `map` if given, else the robot's calibrated map, else a map traced from the mirror profile.
fn load_ground_map(
    robot_file: &Path,
    robot: &RobotConfig,
    camera: &CameraSection,
    map: Option<&Path>,
) -> Result<GroundMap> {
    let calibrated = map
        .map(PathBuf::from)
        .or_else(|| robot.map.as_ref().map(|map| map.file.clone()));
    let (map, source) = match (calibrated, &robot.mirror) {
        (Some(file), _) => (
            GroundMap::load_for_camera(&file, [camera.width_px, camera.height_px])?,
            file,
        ),
        (None, Some(mirror)) => {
            let profile = Profile::load(&mirror.profile)?;
            let camera = camera.camera().with_context(|| no_axis(robot_file))?;
            let rays = optics::trace_rays(&camera, &profile, &Mount::default())
                .with_context(|| robot_file.display().to_string())?;
            ensure_reaches_rim(&profile, &camera)
                .with_context(|| mirror.profile.display().to_string())?;
            (rays.ground_map(), mirror.profile.clone())
        }
        (None, None) => bail!(
            "{}: neither [map] nor [mirror]: nothing says which ground a pixel shows",
            robot_file.display()
        ),
    };
    let visible = map.x.iter().filter(|x| x.is_finite()).count();
    if visible == 0 {
        let [width, height] = [camera.width_px, camera.height_px];
        let outside = camera.centre_px.filter(|[u, v]| {
            !(0.0..=width as f32).contains(u) || !(0.0..=height as f32).contains(v)
        });
        if let Some([u, v]) = outside {
            bail!(
                "{}: camera.centre_px = [{u}, {v}] lies outside the image of {width} × {height} pixels: no pixel shows ground",
                robot_file.display()
            );
        }
        bail!("{}: no pixel shows ground", source.display());
    }
    let nearest = map.nearest_ground();
    ensure!(
        nearest < NEAREST_GROUND_MAX,
        "{}: the nearest ground is {nearest:.1} m away (expected less than {NEAREST_GROUND_MAX} m): lengths in another unit than metres?",
        source.display()
    );
    Ok(map)
}

/// Fails for a profile that ends far inside the rim: the pixels beyond show no ground, and the map would be blamed for it.
fn ensure_reaches_rim(profile: &Profile, camera: &CameraConfig) -> Result<()> {
    let (Some(rim_px), Some(focal_px), Some(pinhole)) =
        (camera.outer_radius_px, camera.focal_px, camera.height)
    else {
        return Ok(());
    };
    let (_, radius) = profile.radii();
    let above_pinhole = profile.height_and_slope(radius).0 - f64::from(pinhole);
    let reach_px = f64::from(focal_px) * radius / above_pinhole;
    ensure!(
        above_pinhole <= 0.0 || reach_px >= PROFILE_REACH_MIN * f64::from(rim_px),
        "the last line has radius {radius} m, which appears {reach_px:.0} pixels from the mirror's centre (expected the mirror's rim, \
         camera.outer_radius_px = {rim_px}). The file is cut, or focal_px or height of the camera is wrong"
    );
    Ok(())
}
