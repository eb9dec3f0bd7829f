//! `mirrorball calibrate lines`: the ground map from the field's own lines.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use localize::Field;
use localize::robot::{CameraSection, RobotConfig};
use vision::calibrate::{
    ImageResidual, LINES_IMAGES_MAX, LinesCalibration, NamedImage, calibrate_lines,
    calibrate_unknown_mirror, doubt,
};

use super::images::load_spread_images;
use super::map::{FoundCamera, Outcome, ensure_map_can_be_saved, outcome, save};
use crate::commands::inputs::Inputs;
use pipeline::PipelineConfig;
use pipeline::paths;
use pipeline::setup::Setup;

/// Ground map from the field's lines: no strip, poses unknown.
///
/// The folder is a recording (robot.toml, frames.csv). The calibration starts from --map, else from the robot's own map or
/// mirror profile, which may be wrong by a fifth. Without any of them it needs the image's size and the field alone: the
/// mirror is found, too, from a dozen images all over the field.
#[derive(clap::Args)]
#[command(after_help = "Example: mirrorball calibrate lines samples/sequence --out map.npz")]
pub(crate) struct LinesArgs {
    /// The recording folder.
    pub(crate) dir: PathBuf,
    /// Start from this map.
    #[arg(long, value_name = "START.npz", conflicts_with = "from_nothing")]
    pub(crate) map: Option<PathBuf>,
    /// Ignore the robot's map, mirror profile and mirror axis.
    #[arg(long)]
    pub(crate) from_nothing: bool,
    /// File for the map.
    #[arg(long, value_name = "MAP.npz")]
    pub(crate) out: PathBuf,
    /// Also draw rings of equal distance into the first image.
    #[arg(long, value_name = "FILE.png")]
    pub(crate) picture: Option<PathBuf>,
}

/// Steps of the progress bar.
const PROGRESS_STEPS: f32 = 100.0;

pub(crate) fn calibrate_map_from_lines(args: &LinesArgs) -> Result<(Outcome, Vec<ImageResidual>)> {
    let inputs = Inputs::of([&*args.dir]).with_file(args.map.as_deref(), "");
    ensure_map_can_be_saved(&inputs, &args.out, args.picture.as_deref())?;
    let robot_file = args.dir.join("robot.toml");
    let robot = RobotConfig::load(&robot_file)?;
    let section = robot
        .camera
        .as_ref()
        .with_context(|| format!("{}: has no [camera]", robot_file.display()))?;
    let known = args.map.is_some() || robot.map.is_some() || robot.mirror.is_some();
    if args.from_nothing || !known {
        return calibrate_from_nothing(args, section, &Field::load(&robot.field)?);
    }
    let setup = Setup::load(&robot_file, args.map.as_deref())?;
    let (camera, start) = setup
        .camera
        .as_ref()
        .with_context(|| format!("{}: has no [camera]", robot_file.display()))?;
    let images = load_spread_images(&args.dir, LINES_IMAGES_MAX)?;
    let calibration = with_progress(|progress| {
        calibrate_lines(
            camera,
            start,
            &setup.field,
            &known_fields(),
            &images,
            &PipelineConfig::default().vision,
            progress,
        )
    })
    .with_context(|| args.dir.display().to_string())?;
    Ok((
        save_calibration(args, &calibration, &images)?,
        calibration.images,
    ))
}

fn calibrate_from_nothing(
    args: &LinesArgs,
    section: &CameraSection,
    field: &Field,
) -> Result<(Outcome, Vec<ImageResidual>)> {
    let images = load_spread_images(&args.dir, LINES_IMAGES_MAX)?;
    ensure_size(&images, section, &args.dir)?;
    let found = with_progress(|progress| {
        calibrate_unknown_mirror(
            [section.width_px, section.height_px],
            field,
            &known_fields(),
            &images,
            &PipelineConfig::default().vision,
            progress,
        )
    })
    .with_context(|| args.dir.display().to_string())?;
    let calibration = found.calibration;
    let outcome = Outcome {
        camera: Some(FoundCamera {
            centre_px: found.camera.centre_px,
            forward_deg: found.camera.forward_deg,
            flipped: found.camera.flipped,
            outer_radius_px: found.rim.map(|rim| rim.radius_px),
        }),
        ..save_calibration(args, &calibration, &images)?
    };
    Ok((outcome, calibration.images))
}

/// Shows a bar while `work` reports the share that is done.
fn with_progress<T>(work: impl FnOnce(&(dyn Fn(f32) + Sync)) -> T) -> T {
    let bar = crate::progress::bar(PROGRESS_STEPS as u64, "%");
    let lines = crate::progress::Lines::new("calibrate lines");
    let result = work(&|share: f32| {
        bar.set_position((PROGRESS_STEPS * share) as u64);
        lines.show(share);
    });
    bar.finish_and_clear();
    result
}

/// Writes the map, and the picture if wanted.
fn save_calibration(
    args: &LinesArgs,
    calibration: &LinesCalibration,
    images: &[NamedImage],
) -> Result<Outcome> {
    let image = images.first().map(|image| &image.image);
    save(&calibration.map, &args.out, args.picture.as_deref(), image)?;
    Ok(Outcome {
        rms_m: Some(calibration.rms),
        inlier_share: Some(calibration.inlier_share),
        disagreement_m: calibration
            .disagreement
            .map(|apart| [apart.near, apart.far]),
        reach_m: Some(calibration.reach),
        warning: doubt(calibration),
        ..outcome(&calibration.images, &args.out)
    })
}

/// The fields that come with the program; none if its folder is missing.
fn known_fields() -> Vec<(String, Field)> {
    let Ok(folder) = paths::find_resource("config/fields") else {
        return Vec::new();
    };
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)
        .into_iter()
        .flatten()
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| {
            path.extension()
                .is_some_and(|extension| extension == "toml")
        })
        .collect();
    files.sort();
    files
        .into_iter()
        .filter_map(|path| {
            let name = format!("config/fields/{}", path.file_name()?.to_string_lossy());
            Some((name, Field::load(&path).ok()?))
        })
        .collect()
}

fn ensure_size(images: &[NamedImage], section: &CameraSection, dir: &Path) -> Result<()> {
    for NamedImage { name, image } in images {
        ensure!(
            (image.width_px, image.height_px) == (section.width_px, section.height_px),
            "{}: {name} has {} × {} pixels, but robot.toml has {} × {}",
            dir.display(),
            image.width_px,
            image.height_px,
            section.width_px,
            section.height_px
        );
    }
    Ok(())
}
