//! `mirrorball calibrate lines`: the ground map from the field's own lines.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use localize::Field;
use localize::robot::{CameraSection, RobotConfig};
use vision::calibrate::{
    CalibrationError, ImageResidual, LINES_IMAGES_MAX, LinesCalibration, NamedImage,
    calibrate_lines, calibrate_unknown_field, calibrate_unknown_mirror, doubt,
};
use vision::output_file::{ensure_can_create, write_file};

use super::images::load_spread_images;
use super::map::{FoundCamera, Outcome, ensure_map_can_be_saved, outcome, save};
use crate::commands::arguments;
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
    /// If the sizes in the field file do not fit, find them, too, and write this field file. The robot's map, mirror profile and axis
    /// are ignored.
    #[arg(long, value_name = "FIELD.toml", conflicts_with = "map")]
    pub(crate) fit_field: Option<PathBuf>,
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
    if let Some(field) = &args.fit_field {
        inputs.ensure_kept([Some(&**field)])?;
        arguments::ensure_distinct_outputs([
            Some(&*args.out),
            args.picture.as_deref(),
            Some(field),
        ])?;
        ensure_can_create(field).with_context(|| field.display().to_string())?;
    }
    let robot_file = args.dir.join("robot.toml");
    let robot = RobotConfig::load(&robot_file)?;
    let section = robot
        .camera
        .as_ref()
        .with_context(|| format!("{}: has no [camera]", robot_file.display()))?;
    let known = args.map.is_some() || robot.map.is_some() || robot.mirror.is_some();
    if args.from_nothing || args.fit_field.is_some() || !known {
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
    let size_px = [section.width_px, section.height_px];
    let config = PipelineConfig::default().vision;
    let given = with_progress(|progress| {
        calibrate_unknown_mirror(size_px, field, &known_fields(), &images, &config, progress)
    });
    let may_be_sizes = match &given {
        Ok(found) => args.fit_field.is_some() && found.calibration.better_size.is_some(),
        Err(refused) => refused.may_be_sizes(),
    };
    let sized = may_be_sizes.then(|| {
        with_progress(|progress| {
            calibrate_unknown_field(size_px, field, &images, &config, progress)
        })
    });
    let (found, sized) = match (given, sized) {
        (_, Some(Ok(sized))) if args.fit_field.is_some() => (sized.mirror.clone(), Some(sized)),
        (Err(refused), Some(Ok(sized))) if !sized.changed.is_empty() => {
            Err(CalibrationError::OtherSizes {
                refused: Box::new(refused),
                sizes: sized.changed,
                share_percent: (100.0 * sized.mirror.calibration.on_field_share) as u32,
            })
            .with_context(|| args.dir.display().to_string())?
        }
        (given, _) => (given.with_context(|| args.dir.display().to_string())?, None),
    };
    let calibration = found.calibration;
    let saved = save_calibration(args, &calibration, &images)?;
    if let Some(path) = &args.fit_field {
        let fitted = sized.as_ref().map_or(field, |sized| &sized.field);
        write_field(path, fitted)?;
    }
    let outcome = Outcome {
        camera: Some(FoundCamera {
            centre_px: found.camera.centre_px,
            forward_deg: found.camera.forward_deg,
            flipped: found.camera.flipped,
            outer_radius_px: found.rim.map(|rim| rim.radius_px),
        }),
        field: args.fit_field.clone(),
        told_sizes: sized.as_ref().map(|sized| sized.told.clone()),
        untold_sizes: sized.map(|sized| sized.untold),
        ..saved
    };
    Ok((outcome, calibration.images))
}

fn write_field(path: &Path, field: &Field) -> Result<()> {
    let text = format!(
        "# The sizes of this field are found by `mirrorball calibrate lines --fit-field`, in metres.\n{}",
        toml::to_string(&field.config)?
    );
    write_file(path, text).with_context(|| format!("cannot write {}", path.display()))
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
