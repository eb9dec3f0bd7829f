//! `mirrorball calibrate sizes`: widths of lines and ball in the image by distance.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use serde::Serialize;
use vision::calibrate::{SizeCalibration, calibrate_sizes};
use vision::image::Image;
use vision::overlay::{self, Rgb};

use crate::commands::inputs::Inputs;
use crate::pictures::text::{LETTER_HEIGHT_PX, draw_text};

use super::images::{SkippedImage, load_drive_images, print_left_out};
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
    /// Also draw it: measured as crosses, predicted as curves; white for lines, orange for the ball.
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
    Inputs::of([&*args.dir])
        .with_file(args.map.as_deref(), "")
        .ensure_kept([Some(&*args.out), args.picture.as_deref()])?;
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
    print_left_out(&calibration.images);
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
/// Around the axes, with room for numbers and labels, pixels: left and below, right and above.
const MARGIN: [f32; 2] = [60.0, 44.0];
const FREE: [f32; 2] = [20.0, 50.0];
/// The legend needs this width, pixels.
const LEGEND_WIDTH_PX: f32 = 380.0;
const TEXT: Rgb = [200, 200, 200];
const GRID: Rgb = [70, 70, 70];
const LINE: Rgb = [240, 240, 240];
const BALL: Rgb = [255, 140, 0];

/// Sizes over distance with axes and legend.
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
        (distance_max * SCALE[0]).max(LEGEND_WIDTH_PX) + MARGIN[0] + FREE[0],
        size_max * SCALE[1] + MARGIN[1] + FREE[1],
    ];
    let mut image = Image {
        width_px: width as usize,
        height_px: height as usize,
        rgb: vec![30; 3 * width as usize * height as usize],
    };
    let place = |metres: f32, px: f32| {
        [
            MARGIN[0] + metres * SCALE[0],
            height - MARGIN[1] - px * SCALE[1],
        ]
    };
    for metres in 0..=distance_max as usize {
        stroke(
            &mut image,
            place(metres as f32, 0.0),
            place(metres as f32, size_max),
            GRID,
        );
        let [u, v] = place(metres as f32, 0.0).map(|at| at as i64);
        draw_text(&mut image, [u - 4, v + 6], &metres.to_string(), TEXT);
    }
    for px in (0..=size_max as usize).step_by(5) {
        stroke(
            &mut image,
            place(0.0, px as f32),
            place(distance_max, px as f32),
            GRID,
        );
        let [u, v] = place(0.0, px as f32).map(|at| at as i64);
        draw_text(&mut image, [u - 26, v - 8], &format!("{px:>2}"), TEXT);
    }
    let [left, bottom] = place(0.0, 0.0).map(|at| at as i64);
    draw_text(&mut image, [left, bottom + 24], "distance / m", TEXT);
    draw_text(&mut image, [4, 6], "px", TEXT);
    legend(&mut image, left);
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

/// What the colours mean: crosses are measured, curves are those of the map.
fn legend(image: &mut Image, left: i64) {
    for (row, colour, name) in [(0, LINE, "lines"), (1, BALL, "ball")] {
        let top = 6 + 18 * row;
        let middle = (top + LETTER_HEIGHT_PX / 2) as f32;
        overlay::draw_cross(image, [left as f32 + 10.0, middle], 5, colour);
        draw_text(image, [left + 24, top], &format!("{name} measured"), colour);
        let curve = left as f32 + 180.0;
        stroke(image, [curve, middle], [curve + 24.0, middle], colour);
        draw_text(
            image,
            [left + 212, top],
            &format!("{name} by the map"),
            colour,
        );
    }
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
