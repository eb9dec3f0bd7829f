//! `mirrorball calibrate`: what does this camera show? Ground map from a strip or a drive, colours, own body, sizes; and,
//! from a turn, where is north?

mod colours;
mod compass;
mod mask;
mod sizes;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use localize::robot::RobotConfig;
use serde::Serialize;
use vision::calibrate::{
    ImageResidual, NamedImage, Strip, StripImage, calibrate_lines, calibrate_strip, fit_mount,
};
use vision::image::Image;
use vision::{GroundMap, Mount, Profile, overlay};

use pipeline::PipelineConfig;
use pipeline::csv_table::CsvTable;
use pipeline::setup::Setup;

/// Calibrate what the camera shows of the ground.
#[derive(clap::Args)]
#[command(subcommand_required = true, arg_required_else_help = true)]
pub struct Args {
    #[command(subcommand)]
    command: CalibrateCommand,
}

#[derive(clap::Subcommand)]
enum CalibrateCommand {
    Map(MapArgs),
    Lines(LinesArgs),
    Colours(colours::ColoursArgs),
    Mask(mask::MaskArgs),
    Sizes(sizes::SizesArgs),
    Compass(compass::CompassArgs),
}

/// From images of the robot turning beside a radial strip of black and white bars.
///
/// The folder holds robot.toml, strip.toml (the strip's edges) and strip.csv (file,direction_rad: where the strip
/// lies in the robot frame in each image). No symmetry of the mirror is assumed.
#[derive(clap::Args)]
#[command(
    after_help = "Example: mirrorball calibrate map samples/calibration --out map.npz --picture map.png"
)]
pub struct MapArgs {
    /// The folder.
    pub(crate) dir: PathBuf,
    /// Where the map goes.
    #[arg(long, value_name = "MAP.npz")]
    pub(crate) out: PathBuf,
    /// Also draw rings of equal distance into the first image.
    #[arg(long, value_name = "FILE.png")]
    pub(crate) picture: Option<PathBuf>,
    /// Trust the mirror's profile and fit only tilt, offset and focal length.
    #[arg(long)]
    pub(crate) profile: bool,
}

/// From the field's own lines while driving: no strip, poses unknown.
///
/// The folder is a recording (robot.toml, frames.csv). The map starts from the one given, or the robot's own, and may
/// be a fifth off.
#[derive(clap::Args)]
#[command(after_help = "Example: mirrorball calibrate lines samples/sequence --out map.npz")]
pub struct LinesArgs {
    /// The recording folder.
    pub(crate) dir: PathBuf,
    /// Start from this map.
    #[arg(long, value_name = "START.npz")]
    pub(crate) map: Option<PathBuf>,
    /// Where the map goes.
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
    /// How the mirror really sits (profile).
    #[serde(skip_serializing_if = "Option::is_none")]
    mount: Option<Mount>,
    pub(crate) map: PathBuf,
}

#[derive(Serialize)]
struct SkippedImage {
    file: String,
    reason: String,
}

impl SkippedImage {
    fn from_residuals(images: &[ImageResidual]) -> Vec<SkippedImage> {
        let left_out = images.iter().filter_map(|image| {
            Some(SkippedImage {
                file: image.name.clone(),
                reason: image.left_out.clone()?,
            })
        });
        left_out.collect()
    }
}

/// Rings drawn into the picture, metres.
const RINGS: [f32; 8] = [0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0];

/// Runs the command.
pub fn run(args: &Args, json: bool) -> Result<()> {
    let (outcome, residuals) = match &args.command {
        CalibrateCommand::Map(args) => calibrate_map(args)?,
        CalibrateCommand::Lines(args) => calibrate_map_from_lines(args)?,
        CalibrateCommand::Colours(args) => return colours::run(args, json),
        CalibrateCommand::Mask(args) => return mask::run(args, json),
        CalibrateCommand::Sizes(args) => return sizes::run(args, json),
        CalibrateCommand::Compass(args) => return compass::run(args, json),
    };
    if json {
        println!("{}", serde_json::to_string(&outcome)?);
        return Ok(());
    }
    for image in &residuals {
        match &image.left_out {
            None => println!(
                "{}: {} points, {:.2} px",
                image.name, image.points, image.rms_px
            ),
            Some(reason) => println!("{}: left out: {reason}", image.name),
        }
    }
    println!("{} of {} images used", outcome.used, outcome.images);
    if let Some(rms) = outcome.rms_px {
        println!("residual: {rms:.2} px");
    }
    if let (Some(rms), Some(share)) = (outcome.rms_m, outcome.inlier_share) {
        println!(
            "residual: {:.1} cm; {:.0} % of the line points lie on markings",
            100.0 * rms,
            100.0 * share
        );
    }
    if let Some(mount) = outcome.mount {
        println!(
            "mount: {}",
            toml::to_string(&mount)?.trim().replace('\n', ", ")
        );
    }
    println!("map: {}", outcome.map.display());
    Ok(())
}

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
    let found =
        calibrate_strip(camera, &strip, &images).with_context(|| args.dir.display().to_string())?;
    let (map, rms_px, mount) = if args.profile {
        let mirror = robot
            .mirror
            .as_ref()
            .with_context(|| format!("{}: has no [mirror]", robot_file.display()))?;
        let fit = fit_mount(camera, &Profile::load(&mirror.profile)?, &found.points)
            .with_context(|| args.dir.display().to_string())?;
        let rays = vision::optics::ray_tracing::trace_rays(
            &fit.camera,
            &Profile::load(&mirror.profile)?,
            &fit.mount,
        )?;
        (rays.ground_map(), fit.rms_px, Some(fit.mount))
    } else {
        (found.map, found.rms_px, None)
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
        ..outcome(&found.images, &args.out)
    };
    Ok((outcome, found.images))
}

fn load_strip_images(folder: &Path) -> Result<Vec<StripImage>> {
    let path = folder.join("strip.csv");
    let table = CsvTable::read(&path, &["file", "direction_rad"])?;
    let mut images = Vec::new();
    for row in table.rows() {
        let name = row.text("file")?.to_owned();
        let direction = row.number("direction_rad")?;
        match Image::load(&folder.join(&name)) {
            Ok(image) => images.push(StripImage {
                name,
                direction,
                image,
            }),
            Err(error) => eprintln!("{}: left out: {error}", row.location()),
        }
    }
    ensure!(
        !images.is_empty(),
        "{}: no image can be read",
        path.display()
    );
    Ok(images)
}

pub(crate) fn calibrate_map_from_lines(args: &LinesArgs) -> Result<(Outcome, Vec<ImageResidual>)> {
    let robot_file = args.dir.join("robot.toml");
    let setup = Setup::load(&robot_file, args.map.as_deref())?;
    let (camera, start) = setup
        .camera
        .as_ref()
        .with_context(|| format!("{}: has no [camera]", robot_file.display()))?;
    let images = load_drive_images(&args.dir)?;
    let found = calibrate_lines(
        camera,
        start,
        &setup.field,
        &images,
        &PipelineConfig::default().vision,
    )
    .with_context(|| args.dir.display().to_string())?;
    save(
        &found.map,
        &args.out,
        args.picture.as_deref(),
        images.first().map(|image| &image.image),
    )?;
    let outcome = Outcome {
        rms_m: Some(found.rms),
        inlier_share: Some(found.inlier_share),
        ..outcome(&found.images, &args.out)
    };
    Ok((outcome, found.images))
}

/// The images that a recording's frames.csv names, or strip.csv where there is none; those that cannot be read are named.
fn load_drive_images(folder: &Path) -> Result<Vec<NamedImage>> {
    let frames = folder.join("frames.csv");
    let path = if frames.exists() {
        frames
    } else {
        folder.join("strip.csv")
    };
    let mut images = Vec::new();
    for row in CsvTable::read(&path, &["file"])?.rows() {
        let name = row.text("file")?.to_owned();
        match Image::load(&folder.join(&name)) {
            Ok(image) => images.push(NamedImage { name, image }),
            Err(error) => eprintln!("{}: left out: {error}", row.location()),
        }
    }
    ensure!(
        !images.is_empty(),
        "{}: no image can be read",
        path.display()
    );
    Ok(images)
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
