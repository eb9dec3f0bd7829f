//! `mirrorball calibrate map`: where on the ground does each pixel look, by a strip on the floor?

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow};
use localize::robot::{CameraConfig, RobotConfig};
use localize::toml_file;
use localize::toml_location::key_location;
use serde::Serialize;
use vision::calibrate::{CalibrationError, ImageResidual, Strip, calibrate_strip, fit_mount};
use vision::image::Image;
use vision::output_file::ensure_can_create;
use vision::{GroundMap, Mount, Profile, overlay};

use crate::commands::arguments;
use crate::commands::inputs::Inputs;
use crate::pictures::text;

use super::images::{SkippedImage, load_strip_images};

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

/// What `--json` prints.
#[derive(Serialize)]
pub(crate) struct Outcome {
    pub(crate) images: usize,
    pub(crate) used: usize,
    pub(super) left_out: Vec<SkippedImage>,
    /// Root mean square residual, pixels along the radius (strip, profile).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) rms_px: Option<f64>,
    /// Root mean square distance of the line points from the markings, metres (lines).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) rms_m: Option<f64>,
    /// Share of the line points on markings (lines).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) inlier_share: Option<f64>,
    /// Camera found with the map (lines without an initial map).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) camera: Option<FoundCamera>,
    /// Distance between the maps of two halves of the images, metres: up to 3 m, and 3 to 5 m, null where no line is seen (lines).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) disagreement_m: Option<[f32; 2]>,
    /// Distance up to which the images show lines, metres (lines).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) reach_m: Option<f64>,
    /// Why the map may be wrong (lines).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) warning: Option<String>,
    /// File of the field whose sizes were fitted (lines).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) field: Option<PathBuf>,
    /// Sizes that the images tell and that differ from the given field's, as edits of its file (lines).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) told_sizes: Option<Vec<String>>,
    /// Sizes that the images do not tell, as edits of the given field's file (lines).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) untold_sizes: Option<Vec<String>>,
    /// Estimated mount of the mirror (profile).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) mount: Option<Mount>,
    pub(crate) map: PathBuf,
}

/// The camera as `[camera]` of robot.toml has it.
#[derive(Serialize)]
pub(crate) struct FoundCamera {
    pub(super) centre_px: [f32; 2],
    pub(super) forward_deg: f32,
    pub(super) flipped: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) outer_radius_px: Option<f32>,
}

/// Rings drawn into the picture, metres.
const RINGS: [f32; 8] = [0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0];

/// The robot's camera; an error if the mirror's axis is not known.
fn camera_of(robot: &RobotConfig, robot_file: &Path) -> Result<CameraConfig> {
    let section = robot
        .camera
        .as_ref()
        .with_context(|| format!("{}: has no [camera]", robot_file.display()))?;
    section.camera().with_context(|| {
        format!(
            "{}: [camera] has no centre_px. `mirrorball calibrate rim` measures it",
            robot_file.display()
        )
    })
}

pub(crate) fn calibrate_map(args: &MapArgs) -> Result<(Outcome, Vec<ImageResidual>)> {
    ensure_map_can_be_saved(
        &Inputs::of([&*args.dir]),
        &args.out,
        args.picture.as_deref(),
    )?;
    let robot_file = args.dir.join("robot.toml");
    let robot = RobotConfig::load(&robot_file)?;
    let camera = camera_of(&robot, &robot_file)?;
    let path = args.dir.join("strip.toml");
    let (strip, text): (Strip, _) = toml_file::read(&path)?;
    strip.check().map_err(|error| match error {
        CalibrationError::Value { key, .. } => {
            anyhow!("{}: {error}", key_location(&path, &text, key))
        }
        error => error.into(),
    })?;
    let images = load_strip_images(&args.dir)?;
    let calibration = calibrate_strip(&camera, &strip, &images)
        .with_context(|| args.dir.display().to_string())?;
    let (map, rms_px, mount) = if args.profile {
        let mirror = robot
            .mirror
            .as_ref()
            .with_context(|| format!("{}: has no [mirror]", robot_file.display()))?;
        let fit = fit_mount(
            &camera,
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

pub(super) fn outcome(images: &[ImageResidual], out: &Path) -> Outcome {
    let left_out = SkippedImage::from_residuals(images);
    Outcome {
        images: images.len(),
        used: images.len() - left_out.len(),
        left_out,
        rms_px: None,
        rms_m: None,
        inlier_share: None,
        warning: None,
        field: None,
        told_sizes: None,
        untold_sizes: None,
        camera: None,
        disagreement_m: None,
        reach_m: None,
        mount: None,
        map: out.to_owned(),
    }
}

/// An error before the work if its result could not be written.
///
/// `inputs`: the robot's map among them may be replaced.
pub(super) fn ensure_map_can_be_saved(
    inputs: &Inputs,
    out: &Path,
    picture: Option<&Path>,
) -> Result<()> {
    inputs.ensure_kept([picture])?;
    inputs.without("map").ensure_kept([Some(out)])?;
    arguments::ensure_distinct_outputs([Some(out), picture])?;
    ensure_can_create(out).with_context(|| out.display().to_string())?;
    if let Some(picture) = picture {
        Image::ensure_can_save(picture)?;
    }
    Ok(())
}

pub(super) fn save(
    map: &GroundMap,
    out: &Path,
    picture: Option<&Path>,
    image: Option<&Image>,
) -> Result<()> {
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
    label_rings(&mut image, map);
    Ok(image.save(path)?)
}

/// Writes each ring's distance at its left front, where the map shows it; a label that would cover another is left out.
fn label_rings(image: &mut Image, map: &GroundMap) {
    let mut last: Option<[i64; 2]> = None;
    for ring in RINGS {
        let apart = |u: usize, v: usize| {
            let at = map.at(u, v)?;
            let beside = ring * std::f32::consts::FRAC_1_SQRT_2;
            Some((at.x - beside).hypot(at.y - beside))
        };
        let pixels = (0..map.height_px).flat_map(|v| (0..map.width_px).map(move |u| (u, v)));
        let nearest = pixels
            .filter_map(|(u, v)| Some((apart(u, v)?, [u as i64, v as i64])))
            .min_by(|a, b| a.0.total_cmp(&b.0));
        let Some((off, [u, v])) = nearest else {
            continue;
        };
        let covers = last.is_some_and(|[_, other]| (other - v).abs() < text::LETTER_HEIGHT_PX);
        if off > 0.1 * ring || covers {
            continue;
        }
        let label = format!("{ring} m");
        let left = u - text::LETTER_WIDTH_PX * label.len() as i64 / 2;
        let top = v - text::LETTER_HEIGHT_PX / 2;
        for row in top..top + text::LETTER_HEIGHT_PX {
            for column in left..2 * u - left {
                overlay::draw_pixel(image, column, row, [0; 3]);
            }
        }
        text::draw_text(image, [left, top], &label, [255; 3]);
        last = Some([u, v]);
    }
}
