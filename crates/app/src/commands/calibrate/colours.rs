//! `mirrorball calibrate colours`: a colour table, from labels or from images alone.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use serde::Serialize;
use vision::calibrate::{LearnedColours, learn_colours};
use vision::colour::colour_table::{
    ColourTable, Label, TableKind, canonical_class_name, load_labels,
};
use vision::colour::lookup_table::{CLASS_NAMES, ColourClass};
use vision::image::{Image, rgb_to_yuv};
use vision::{Vision, overlay};

use crate::commands::inputs::Inputs;

use super::images::{SkippedImage, load_drive_images};
use pipeline::PipelineConfig;
use pipeline::setup::Setup;

/// Colour table from images, for the key `colours` of robot.toml.
///
/// The folder is a recording (robot.toml, frames.csv). Without labels, carpet and white are learned from each image as in
/// `run`, and all images vote. With labels (a CSV of file,u,v,class, paths relative to it) the table is learned from the
/// labelled pixels.
#[derive(clap::Args)]
#[command(
    after_help = "Example: mirrorball calibrate colours samples/sequence --out colours.table --picture colours.png"
)]
pub(super) struct ColoursArgs {
    /// The recording folder; optional with --labels.
    #[arg(required_unless_present = "labels")]
    dir: Option<PathBuf>,
    /// Labelled pixels to learn from.
    #[arg(long, value_name = "LABELS.csv")]
    labels: Option<PathBuf>,
    /// File for the table over Y, U and V (16 MiB).
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Also write the table over U and V of the same labels (64 KiB).
    #[arg(long, value_name = "FILE")]
    uv: Option<PathBuf>,
    /// Also draw the first image next to its classes.
    #[arg(long, value_name = "FILE.png")]
    picture: Option<PathBuf>,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Outcome {
    /// Numbers of used and of all images (without labels).
    #[serde(skip_serializing_if = "Option::is_none")]
    images: Option<[usize; 2]>,
    left_out: Vec<SkippedImage>,
    /// Labelled pixels by class, and the share that the table classifies correctly.
    labels: Vec<ClassShare>,
    table: PathBuf,
    #[serde(skip_serializing_if = "Option::is_none")]
    uv_table: Option<PathBuf>,
    /// Share of the pixels (of the labels, or of all images) with the same class in both tables.
    tables_agree: f64,
}

#[derive(Serialize)]
struct ClassShare {
    class: String,
    pixels: usize,
    given_back: f64,
}

/// Runs the command.
pub(super) fn run(args: &ColoursArgs, json: bool) -> Result<()> {
    let inputs = Inputs::of(args.dir.as_deref()).with_file(args.labels.as_deref(), "labels");
    inputs.ensure_kept([args.picture.as_deref()])?;
    inputs
        .without("colours")
        .ensure_kept([Some(&*args.out), args.uv.as_deref()])?;
    let LearnedTables {
        yuv,
        uv,
        mut outcome,
        first_image,
    } = match &args.labels {
        Some(labels) => learn_from_labels(args, labels)?,
        None => learn_from_images(args)?,
    };
    yuv.save(&args.out)?;
    if let Some(path) = &args.uv {
        uv.save(path)?;
        outcome.uv_table = Some(path.clone());
    }
    if let (Some(path), Some(image)) = (&args.picture, first_image) {
        draw_classes(&image, &yuv).save(path)?;
    }
    if json {
        println!("{}", serde_json::to_string(&outcome)?);
        return Ok(());
    }
    for left_out in &outcome.left_out {
        println!("{}: left out: {}", left_out.file, left_out.reason);
    }
    for class in &outcome.labels {
        println!(
            "{}: {} labelled pixels, {:.1} % classified correctly",
            class.class,
            class.pixels,
            100.0 * class.given_back
        );
    }
    if let Some([used, all]) = outcome.images {
        println!("{used} of {all} images used");
    }
    println!(
        "both tables agree on {:.1} % of these pixels",
        100.0 * outcome.tables_agree
    );
    println!("table: {}", outcome.table.display());
    Ok(())
}

/// Both tables of a calibration.
struct LearnedTables {
    yuv: ColourTable,
    uv: ColourTable,
    outcome: Outcome,
    first_image: Option<Image>,
}

fn learn_from_labels(args: &ColoursArgs, path: &Path) -> Result<LearnedTables> {
    let labels = load_labels(path)?;
    let learn = |kind| {
        ColourTable::learn(&labels, kind).with_context(|| format!("{}: no labels", path.display()))
    };
    let tables = [learn(TableKind::Yuv)?, learn(TableKind::Uv)?];
    let mut names: Vec<&str> = labels
        .iter()
        .map(|label| canonical_class_name(&label.class))
        .collect();
    names.sort_unstable();
    names.dedup();
    let is_correct = |label: &&Label| {
        let class = tables[0].class(rgb_to_yuv(label.rgb));
        tables[0].name(class) == Some(canonical_class_name(&label.class))
    };
    let share = |name: &&str| {
        let members = labels
            .iter()
            .filter(|label| canonical_class_name(&label.class) == *name);
        let pixels = members.clone().count();
        ClassShare {
            class: (*name).to_owned(),
            pixels,
            given_back: members.filter(is_correct).count() as f64 / pixels.max(1) as f64,
        }
    };
    let outcome = Outcome {
        images: None,
        left_out: Vec::new(),
        labels: names.iter().map(share).collect(),
        table: args.out.clone(),
        uv_table: None,
        tables_agree: agreement(&tables, labels.iter().map(|label| label.rgb)),
    };
    let first_image = match &args.dir {
        Some(dir) => load_drive_images(dir)?
            .into_iter()
            .next()
            .map(|image| image.image),
        None => None,
    };
    let [yuv, uv] = tables;
    Ok(LearnedTables {
        yuv,
        uv,
        outcome,
        first_image,
    })
}

fn learn_from_images(args: &ColoursArgs) -> Result<LearnedTables> {
    let dir = args.dir.as_deref().context("no recording folder")?;
    let robot_file = dir.join("robot.toml");
    let setup = Setup::load(&robot_file, None)?;
    let (camera, map) = setup
        .camera
        .as_ref()
        .with_context(|| format!("{}: no [camera]", robot_file.display()))?;
    let config = PipelineConfig::default().vision;
    let line_width = setup.field.config.line_width;
    let mask = setup.mask.as_deref();
    let mut vision = Vision::with_mask(map, camera, mask, line_width, config.clone())?;
    let images = load_drive_images(dir)?;
    let learned: LearnedColours =
        learn_colours(&mut vision, &images).with_context(|| dir.display().to_string())?;
    let tables = [TableKind::Yuv, TableKind::Uv].map(|kind| learned.table(kind, &config));
    let outcome = Outcome {
        images: Some([learned.models.len(), images.len()]),
        left_out: SkippedImage::from_residuals(&learned.images),
        labels: Vec::new(),
        table: args.out.clone(),
        uv_table: None,
        tables_agree: agreement(
            &tables,
            images
                .iter()
                .flat_map(|image| image.image.rgb.chunks_exact(3))
                .map(|rgb| [rgb[0], rgb[1], rgb[2]]),
        ),
    };
    let first_image = images.into_iter().next().map(|image| image.image);
    let [yuv, uv] = tables;
    Ok(LearnedTables {
        yuv,
        uv,
        outcome,
        first_image,
    })
}

fn agreement(tables: &[ColourTable; 2], pixels: impl Iterator<Item = [u8; 3]>) -> f64 {
    let (mut same, mut all) = (0usize, 0usize);
    for rgb in pixels {
        let yuv = rgb_to_yuv(rgb);
        same += usize::from(tables[0].class(yuv) == tables[1].class(yuv));
        all += 1;
    }
    same as f64 / all.max(1) as f64
}

/// An image next to the classes of its pixels.
fn draw_classes(image: &Image, table: &ColourTable) -> Image {
    let mut classes = image.clone();
    for rgb in classes.rgb.chunks_exact_mut(3) {
        let class = table.class(rgb_to_yuv([rgb[0], rgb[1], rgb[2]]));
        let known = usize::from(class.0) < CLASS_NAMES.len();
        rgb.copy_from_slice(&overlay::class_colour(if known {
            class
        } else {
            ColourClass::OTHER
        }));
    }
    crate::pictures::field::side_by_side(image, &classes)
}
