//! `mirrorball calibrate rim`: where is the mirror's rim in the image?

use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use localize::math;
use serde::Serialize;
use vision::calibrate::find_rim;
use vision::image::Image;
use vision::overlay;

use crate::commands::inputs::Inputs;

use super::images::load_drive_images;

/// Centre and radius of the mirror's rim, for [camera] of robot.toml.
///
/// Reads a recording folder (frames.csv) or images. Several images with different surroundings are better than one: the
/// rim is found where all of them are dark outside.
#[derive(clap::Args)]
#[command(
    after_help = "Example: mirrorball calibrate rim samples/sequence --out rim.toml --picture rim.png"
)]
pub(super) struct RimArgs {
    /// A recording folder, or images of one camera.
    #[arg(required = true, value_name = "DIR or IMAGE")]
    inputs: Vec<PathBuf>,
    /// Also write [camera] with centre_px and outer_radius_px to this file.
    #[arg(long, value_name = "FILE.toml")]
    out: Option<PathBuf>,
    /// Also draw the rim into the first image.
    #[arg(long, value_name = "FILE.png")]
    picture: Option<PathBuf>,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Outcome {
    images: usize,
    centre_px: [f32; 2],
    outer_radius_px: f32,
    /// Root mean square distance of the edge points from the circle, pixels.
    rms_px: f32,
    /// Share of the rim inside the image at which an edge was found.
    visible_share: f32,
}

/// Runs the command.
pub(super) fn run(args: &RimArgs, json: bool) -> Result<()> {
    let inputs = Inputs::of(args.inputs.iter().map(PathBuf::as_path));
    inputs.ensure_kept([args.picture.as_deref()])?;
    inputs
        .without("camera")
        .ensure_kept([args.out.as_deref()])?;
    let mut images: Vec<Image> = Vec::new();
    for input in &args.inputs {
        if input.is_dir() {
            images.extend(
                load_drive_images(input)?
                    .into_iter()
                    .map(|image| image.image),
            );
        } else {
            images.push(Image::load(input)?);
        }
    }
    let first = images.first().context("no image")?;
    ensure!(
        images
            .iter()
            .all(|image| (image.width_px, image.height_px) == (first.width_px, first.height_px)),
        "the images have different sizes (expected those of one camera)"
    );
    let rim = find_rim(&images.iter().collect::<Vec<_>>())?;
    let outcome = Outcome {
        images: images.len(),
        centre_px: rim.centre_px,
        outer_radius_px: rim.radius_px,
        rms_px: rim.rms_px,
        visible_share: rim.visible_share,
    };
    let [u, v] = rim.centre_px;
    let section = format!(
        "[camera]\ncentre_px = [{u:.2}, {v:.2}]\nouter_radius_px = {:.2}\n",
        rim.radius_px
    );
    if let Some(path) = &args.out {
        vision::output_file::write_file(path, &section)
            .with_context(|| format!("cannot write {}", path.display()))?;
    }
    if let Some(path) = &args.picture {
        let mut picture = first.clone();
        for step in 0..3600 {
            let (sin, cos) = math::sin_cos(std::f32::consts::TAU * step as f32 / 3600.0);
            let (u, v) = (u + rim.radius_px * cos, v + rim.radius_px * sin);
            overlay::draw_pixel(
                &mut picture,
                u.round() as i64,
                v.round() as i64,
                overlay::FIELD_LINE_COLOUR,
            );
        }
        picture.save(path)?;
    }
    if json {
        println!("{}", serde_json::to_string(&outcome)?);
        return Ok(());
    }
    print!("{section}");
    println!(
        "# {} images, residual {:.2} px, {:.0} % of the rim inside the image is visible",
        outcome.images,
        rim.rms_px,
        100.0 * rim.visible_share.min(1.0)
    );
    Ok(())
}
