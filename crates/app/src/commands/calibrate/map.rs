//! `mirrorball calibrate map` and `lines`: where on the ground does each pixel look?

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use localize::robot::RobotConfig;
use serde::Serialize;
use vision::calibrate::{ImageResidual, Strip, calibrate_lines, calibrate_strip, fit_mount};
use vision::image::Image;
use vision::{GroundMap, Mount, Profile, overlay};

use super::images::{SkippedImage, load_drive_images, load_strip_images};
use pipeline::PipelineConfig;
use pipeline::setup::Setup;

/// Ground map from images of the robot turning next to a radial strip of black and white bars.
///
/// The folder contains robot.toml, strip.toml (the strip's edges) and strip.csv (file,direction_rad: direction of the
/// strip in the robot frame). No symmetry of the mirror is assumed.
#[derive(clap::Args)]
#[command(
    after_help = "Example: mirrorball calibrate map samples/calibration --out map.npz --picture map.png"
)]
pub(crate) struct MapArgs {
    /// The folder.
    pub(crate) dir: PathBuf,
    /// File for the map.
    #[arg(long, value_name = "MAP.npz")]
    pub(crate) out: PathBuf,
    /// Also draw rings of equal distance into the first image.
    #[arg(long, value_name = "FILE.png")]
    pub(crate) picture: Option<PathBuf>,
    /// Trust the mirror's profile and fit only tilt, offset and focal length.
    #[arg(long)]
    pub(crate) profile: bool,
}

/// Ground map from the field's lines while driving: no strip, poses unknown.
///
/// The folder is a recording (robot.toml, frames.csv). The calibration starts from --map, else from the robot's own map,
/// which may be wrong by a fifth.
#[derive(clap::Args)]
#[command(after_help = "Example: mirrorball calibrate lines samples/sequence --out map.npz")]
pub(crate) struct LinesArgs {
    /// The recording folder.
    pub(crate) dir: PathBuf,
    /// Start from this map.
    #[arg(long, value_name = "START.npz")]
    pub(crate) map: Option<PathBuf>,
    /// File for the map.
    #[arg(long, value_name = "MAP.npz")]
    pub(crate) out: PathBuf,
    /// Also draw rings of equal distance into the first image.
    #[arg(long, value_name = "FILE.png")]
    pub(crate) picture: Option<PathBuf>,
}

/// What `--json` prints.
#[derive(Serialize)]
pub(crate) struct Outcome {
    pub(crate) images: usize,
    pub(crate) used: usize,
    left_out: Vec<SkippedImage>,
    /// Root mean square residual, pixels along the radius (strip, profile).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) rms_px: Option<f64>,
    /// Root mean square distance of the line points from the markings, metres (lines).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) rms_m: Option<f64>,
    /// Share of the line points on markings (lines).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) inlier_share: Option<f64>,
    /// Estimated mount of the mirror (profile).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) mount: Option<Mount>,
    pub(crate) map: PathBuf,
}

/// Rings drawn into the picture, metres.
const RINGS: [f32; 8] = [0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0];

pub(crate) fn calibrate_map(args: &MapArgs) -> Result<(Outcome, Vec<ImageResidual>)> {
    let robot_file = args.dir.join("robot.toml");
    let robot = RobotConfig::load(&robot_file)?;
    let camera = robot
        .camera
        .as_ref()
        .with_context(|| format!("{}: has no [camera]", robot_file.display()))?;
    let path = args.dir.join("strip.toml");
    let text = std::fs::read_to_string(&path)
        .with_context(|| format!("cannot read {}", path.display()))?;
    let strip: Strip = toml::from_str(&text).with_context(|| path.display().to_string())?;
    let images = load_strip_images(&args.dir)?;
    let calibration =
        calibrate_strip(camera, &strip, &images).with_context(|| args.dir.display().to_string())?;
    let (map, rms_px, mount) = if args.profile {
        let mirror = robot
            .mirror
            .as_ref()
            .with_context(|| format!("{}: has no [mirror]", robot_file.display()))?;
        let fit = fit_mount(
            camera,
            &Profile::load(&mirror.profile)?,
            &calibration.points,
        )
        .with_context(|| args.dir.display().to_string())?;
        let rays = vision::optics::ray_tracing::trace_rays(
            &fit.camera,
            &Profile::load(&mirror.profile)?,
            &fit.mount,
        )?;
        (rays.ground_map(), fit.rms_px, Some(fit.mount))
    } else {
        (calibration.map, calibration.rms_px, None)
    };
    save(
        &map,
        &args.out,
        args.picture.as_deref(),
        images.first().map(|image| &image.image),
    )?;
    let outcome = Outcome {
        rms_px: Some(rms_px),
        mount,
        ..outcome(&calibration.images, &args.out)
    };
    Ok((outcome, calibration.images))
}

pub(crate) fn calibrate_map_from_lines(args: &LinesArgs) -> Result<(Outcome, Vec<ImageResidual>)> {
    let robot_file = args.dir.join("robot.toml");
    let setup = Setup::load(&robot_file, args.map.as_deref())?;
    let (camera, start) = setup
        .camera
        .as_ref()
        .with_context(|| format!("{}: has no [camera]", robot_file.display()))?;
    let images = load_drive_images(&args.dir)?;
    let calibration = calibrate_lines(
        camera,
        start,
        &setup.field,
        &images,
        &PipelineConfig::default().vision,
    )
    .with_context(|| args.dir.display().to_string())?;
    save(
        &calibration.map,
        &args.out,
        args.picture.as_deref(),
        images.first().map(|image| &image.image),
    )?;
    let outcome = Outcome {
        rms_m: Some(calibration.rms),
        inlier_share: Some(calibration.inlier_share),
        ..outcome(&calibration.images, &args.out)
    };
    Ok((outcome, calibration.images))
}

fn outcome(images: &[ImageResidual], out: &Path) -> Outcome {
    let left_out = SkippedImage::from_residuals(images);
    Outcome {
        images: images.len(),
        used: images.len() - left_out.len(),
        left_out,
        rms_px: None,
        rms_m: None,
        inlier_share: None,
        mount: None,
        map: out.to_owned(),
    }
}

fn save(map: &GroundMap, out: &Path, picture: Option<&Path>, image: Option<&Image>) -> Result<()> {
    map.save(out)?;
    let (Some(path), Some(image)) = (picture, image) else {
        return Ok(());
    };
    let mut image = image.clone();
    for v in 0..map.height_px - 1 {
        for u in 0..map.width_px - 1 {
            let (Some(here), Some(right), Some(below)) =
                (map.at(u, v), map.at(u + 1, v), map.at(u, v + 1))
            else {
                continue;
            };
            let ring = |a: f32, b: f32| RINGS.iter().any(|ring| (a - ring) * (b - ring) <= 0.0);
            if ring(here.distance(), right.distance()) || ring(here.distance(), below.distance()) {
                overlay::draw_pixel(&mut image, u as i64, v as i64, overlay::FIELD_LINE_COLOUR);
            }
        }
    }
    Ok(image.save(path)?)
}
