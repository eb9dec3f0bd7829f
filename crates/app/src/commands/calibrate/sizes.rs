//! `mirrorball calibrate sizes`: widths of lines and ball in the image by distance.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use serde::Serialize;
use vision::calibrate::{SizeCalibration, calibrate_sizes};
use vision::image::Image;
use vision::overlay::{self, Rgb};

use super::images::{SkippedImage, load_drive_images};
use pipeline::PipelineConfig;
use pipeline::csv_table::CsvWriter;
use pipeline::setup::Setup;

/// Widths of lines and ball in pixels by distance from a drive, measured and predicted by the map.
///
/// The folder is a recording (robot.toml, frames.csv). The table's columns are distance_m,line_px,line_px_by_map,lines,
/// ball_px,ball_px_by_map,balls; cells with too few detections are empty.
#[derive(clap::Args)]
#[command(
    after_help = "Example: mirrorball calibrate sizes samples/sequence --out sizes.csv --picture sizes.png"
)]
pub(super) struct SizesArgs {
    /// The recording folder.
    dir: PathBuf,
    /// Use this calibrated ground map (npz) instead of the robot's own.
    #[arg(long, value_name = "MAP.npz")]
    map: Option<PathBuf>,
    /// File for the table.
    #[arg(long, value_name = "FILE.csv")]
    out: PathBuf,
    /// Also draw it: measured as crosses, predicted as curves; white for lines, orange for the ball; a grid of 1 m, 5 px.
    #[arg(long, value_name = "FILE.png")]
    picture: Option<PathBuf>,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Outcome {
    images: usize,
    left_out: Vec<SkippedImage>,
    lines: usize,
    balls: usize,
    /// Root mean square difference between measured and predicted widths, pixels.
    line_rms_px: Option<f32>,
    ball_rms_px: Option<f32>,
    table: PathBuf,
}

/// Runs the command.
pub(super) fn run(args: &SizesArgs, json: bool) -> Result<()> {
    let robot_file = args.dir.join("robot.toml");
    let setup = Setup::load(&robot_file, args.map.as_deref())?;
    let (camera, map) = setup
        .camera
        .as_ref()
        .with_context(|| format!("{}: no [camera]", robot_file.display()))?;
    let mut config = PipelineConfig::default().vision;
    if let Some(height) = setup.viewpoint_height {
        config.objects.viewpoint_height = height;
    }
    let images = load_drive_images(&args.dir)?;
    let calibration = calibrate_sizes(camera, map, setup.field.config.line_width, &images, &config)
        .with_context(|| args.dir.display().to_string())?;
    write(&calibration, &args.out)?;
    if let Some(path) = &args.picture {
        chart(&calibration).save(path)?;
    }
    let outcome = Outcome {
        images: images.len(),
        left_out: SkippedImage::from_residuals(&calibration.images),
        lines: calibration.rows.iter().map(|row| row.lines).sum(),
        balls: calibration.rows.iter().map(|row| row.balls).sum(),
        line_rms_px: calibration.line_rms_px,
        ball_rms_px: calibration.ball_rms_px,
        table: args.out.clone(),
    };
    if json {
        println!("{}", serde_json::to_string(&outcome)?);
        return Ok(());
    }
    let px = |value: Option<f32>| value.map_or("-".to_owned(), |value| format!("{value:.1}"));
    println!("distance  line px (by map)  ball px (by map)");
    for row in &calibration.rows {
        println!(
            "{:5.2} m   {:>6} {:>8}    {:>6} {:>8}",
            row.distance,
            px(row.line_px),
            format!("({})", px(row.line_px_by_map)),
            px(row.ball_px),
            format!("({})", px(row.ball_px_by_map)),
        );
    }
    for left_out in &outcome.left_out {
        println!("{}: left out: {}", left_out.file, left_out.reason);
    }
    println!(
        "residual: lines {} px of {} crossings, ball {} px of {} images",
        px(outcome.line_rms_px),
        outcome.lines,
        px(outcome.ball_rms_px),
        outcome.balls
    );
    println!("table: {}", outcome.table.display());
    Ok(())
}

fn write(calibration: &SizeCalibration, path: &Path) -> Result<()> {
    let header = "distance_m,line_px,line_px_by_map,lines,ball_px,ball_px_by_map,balls";
    let mut file = CsvWriter::create(path, header)?;
    let px = |value: Option<f32>| value.map_or(String::new(), |value| format!("{value:.2}"));
    for row in &calibration.rows {
        file.write_row(format_args!(
            "{:.2},{},{},{},{},{},{}",
            row.distance,
            px(row.line_px),
            px(row.line_px_by_map),
            row.lines,
            px(row.ball_px),
            px(row.ball_px_by_map),
            row.balls
        ))?;
    }
    file.finish()
}

const SCALE: [f32; 2] = [80.0, 14.0];
const MARGIN: f32 = 20.0;
const GRID: Rgb = [70, 70, 70];
const LINE: Rgb = [240, 240, 240];
const BALL: Rgb = [255, 140, 0];

/// Sizes over distance: the grid is 1 m and 5 px.
fn chart(calibration: &SizeCalibration) -> Image {
    let sizes = calibration.rows.iter().flat_map(|row| {
        [
            row.line_px,
            row.line_px_by_map,
            row.ball_px,
            row.ball_px_by_map,
        ]
    });
    let size_max = sizes.flatten().fold(10.0, f32::max).min(60.0) + 2.0;
    let distance_max = calibration.rows.last().map_or(1.0, |row| row.distance) + 0.5;
    let [width, height] = [
        distance_max * SCALE[0] + 2.0 * MARGIN,
        size_max * SCALE[1] + 2.0 * MARGIN,
    ];
    let mut image = Image {
        width_px: width as usize,
        height_px: height as usize,
        rgb: vec![30; 3 * width as usize * height as usize],
    };
    let place =
        |metres: f32, px: f32| [MARGIN + metres * SCALE[0], height - MARGIN - px * SCALE[1]];
    for metres in 0..=distance_max as usize {
        stroke(
            &mut image,
            place(metres as f32, 0.0),
            place(metres as f32, size_max),
            GRID,
        );
    }
    for px in (0..=size_max as usize).step_by(5) {
        stroke(
            &mut image,
            place(0.0, px as f32),
            place(distance_max, px as f32),
            GRID,
        );
    }
    type Size = fn(&vision::calibrate::SizeBin) -> Option<f32>;
    let curves: [(Rgb, Size, Size); 2] = [
        (LINE, |row| row.line_px, |row| row.line_px_by_map),
        (BALL, |row| row.ball_px, |row| row.ball_px_by_map),
    ];
    for (colour, measured, by_map) in curves {
        let mut last = None;
        for row in &calibration.rows {
            if let Some(px) = measured(row) {
                overlay::draw_cross(&mut image, place(row.distance, px), 5, colour);
            }
            let next = by_map(row).map(|px| place(row.distance, px));
            if let (Some(from), Some(to)) = (last, next) {
                stroke(&mut image, from, to, colour);
            }
            last = next.or(last);
        }
    }
    image
}

fn stroke(image: &mut Image, from: [f32; 2], to: [f32; 2], colour: Rgb) {
    let steps = (to[0] - from[0])
        .abs()
        .max((to[1] - from[1]).abs())
        .ceil()
        .max(1.0);
    for step in 0..=steps as usize {
        let part = step as f32 / steps;
        let [u, v] = [0, 1].map(|i| (from[i] + part * (to[i] - from[i])).round() as i64);
        overlay::draw_pixel(image, u, v, colour);
    }
}
