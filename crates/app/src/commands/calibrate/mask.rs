//! `mirrorball calibrate mask`: which pixels show the robot itself?

use std::path::PathBuf;

use anyhow::{Context, Result};
use localize::robot::RobotConfig;
use serde::Serialize;
use vision::calibrate::mask::save_mask;
use vision::calibrate::{calibrate_mask, find_rim};
use vision::image::Image;

use crate::commands::inputs::Inputs;

use super::images::load_drive_images;

/// Mask of the robot's own body from a few images of the robot turning in place.
///
/// The folder is a recording (robot.toml, frames.csv) with at least six images at headings around the circle. The mask is
/// a grey PNG, black where the image shows the robot itself, for the key `mask` of robot.toml.
#[derive(clap::Args)]
#[command(
    after_help = "Example: mirrorball calibrate mask samples/calibration --out mask.png --picture seen.png"
)]
pub(super) struct MaskArgs {
    /// The recording folder.
    dir: PathBuf,
    /// File for the mask.
    #[arg(long, value_name = "MASK.png")]
    out: PathBuf,
    /// Also draw the mask into the first image.
    #[arg(long, value_name = "FILE.png")]
    picture: Option<PathBuf>,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Outcome {
    images: usize,
    /// Share of the mirror's image that shows the robot itself.
    own_share: f64,
    mask: PathBuf,
}

/// Runs the command.
pub(super) fn run(args: &MaskArgs, json: bool) -> Result<()> {
    let inputs = Inputs::of([&*args.dir]);
    inputs.ensure_kept([args.picture.as_deref()])?;
    inputs.without("mask").ensure_kept([Some(&*args.out)])?;
    let robot_file = args.dir.join("robot.toml");
    let robot = RobotConfig::load(&robot_file)?;
    let section = robot
        .camera
        .as_ref()
        .with_context(|| format!("{}: no [camera]", robot_file.display()))?;
    let images: Vec<Image> = load_drive_images(&args.dir)?
        .into_iter()
        .map(|image| image.image)
        .collect();
    let camera = match section.camera() {
        Some(camera) => camera,
        None => {
            let rim = find_rim(&images.iter().collect::<Vec<_>>())
                .with_context(|| format!("{}: [camera] has no centre_px", robot_file.display()))?;
            section.with_axis(rim.centre_px, Some(rim.radius_px))
        }
    };
    let mask = calibrate_mask(&camera, &images).with_context(|| args.dir.display().to_string())?;
    save_mask(&mask, camera.width_px, camera.height_px, &args.out)?;
    if let (Some(path), Some(first)) = (&args.picture, images.first()) {
        let mut picture = first.clone();
        for (rgb, _) in picture
            .rgb
            .chunks_exact_mut(3)
            .zip(&mask)
            .filter(|(_, free)| !**free)
        {
            rgb.copy_from_slice(&[255, 0, 120]);
        }
        picture.save(path)?;
    }
    let inside = (0..mask.len()).filter(|pixel| {
        let (u, v) = (pixel % camera.width_px, pixel / camera.width_px);
        camera.is_inside_mirror(u as f32, v as f32)
    });
    let own = inside.clone().filter(|&pixel| !mask[pixel]).count();
    let outcome = Outcome {
        images: images.len(),
        own_share: own as f64 / inside.count().max(1) as f64,
        mask: args.out.clone(),
    };
    if json {
        println!("{}", serde_json::to_string(&outcome)?);
        return Ok(());
    }
    println!(
        "{} images: the robot covers {:.1} % of the mirror's image",
        outcome.images,
        100.0 * outcome.own_share
    );
    println!("mask: {}", outcome.mask.display());
    Ok(())
}
