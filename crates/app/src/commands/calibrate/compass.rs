//! `mirrorball calibrate compass`: hard and soft iron of the robot.

use std::path::PathBuf;

use anyhow::{Context, Result};
use localize::sensors::compass_calibration::{CompassFit, fit_calibration};
use serde::Serialize;
use vision::output_file::write_file;

use pipeline::csv_table::{CsvTable, CsvWriter, format_seconds};

use crate::commands::inputs::Inputs;

/// Compass calibration (hard and soft iron) from magnetometer readings of a full turn of the robot.
///
/// The folder is a recording with magnetometer.csv (stamp_s,x,y: magnetic field in the robot frame, any unit). Disturbed
/// readings are left out.
#[derive(clap::Args)]
#[command(
    after_help = "Example: mirrorball calibrate compass turn/ --out compass.toml --headings turn/compass.csv"
)]
pub(super) struct CompassArgs {
    /// The recording folder.
    dir: PathBuf,
    /// File for the calibration (TOML).
    #[arg(long, value_name = "FILE.toml")]
    out: PathBuf,
    /// Direction of magnetic north on the field, degrees counter-clockwise from its x axis.
    #[arg(
        long,
        value_name = "DEGREES",
        default_value_t = 0.0,
        allow_negative_numbers = true
    )]
    north: f32,
    /// Also write the calibrated headings (stamp_s,heading_rad), as a recording's compass.csv.
    #[arg(long, value_name = "FILE.csv")]
    headings: Option<PathBuf>,
}

#[derive(Serialize)]
struct Outcome {
    #[serde(flatten)]
    fit: CompassFit,
    out: PathBuf,
}

pub(super) fn run(args: &CompassArgs, json: bool) -> Result<()> {
    let inputs = Inputs::of([&*args.dir]).without("compass");
    // compass.csv holds headings of an earlier calibration, which new ones replace.
    let headings = args.headings.as_deref();
    let headings = headings.filter(|path| !path.ends_with("compass.csv"));
    inputs.ensure_kept([Some(&*args.out), headings])?;
    let path = args.dir.join("magnetometer.csv");
    let mut stamps = Vec::new();
    let mut readings = Vec::new();
    for row in CsvTable::read(&path, &["stamp_s", "x", "y"])?.rows() {
        stamps.push(localize::Stamp::from_seconds(row.number("stamp_s")?));
        readings.push([row.number("x")? as f32, row.number("y")? as f32]);
    }
    let mut fit = fit_calibration(&readings).with_context(|| path.display().to_string())?;
    fit.calibration.north_deg = args.north;
    let text = format!(
        "# Written by `mirrorball calibrate compass`. In robot.toml: include = [\"compass.toml\"]\n[compass.calibration]\n{}",
        toml::to_string(&fit.calibration)?
    );
    write_file(&args.out, text).with_context(|| format!("cannot write {}", args.out.display()))?;
    if let Some(path) = &args.headings {
        let mut file = CsvWriter::create(path, "stamp_s,heading_rad")?;
        for (stamp, reading) in stamps.iter().zip(&readings) {
            let heading = fit.calibration.heading(*reading).heading;
            file.write_row(format_args!("{},{heading}", format_seconds(*stamp)))?;
        }
        file.finish()?;
    }
    if json {
        let out = args.out.clone();
        println!("{}", serde_json::to_string(&Outcome { fit, out })?);
        return Ok(());
    }
    println!(
        "{} readings with a residual of {:.2}°, {} disturbed ones left out; error of uncalibrated headings up to {:.1}°",
        fit.used, fit.residual_deg, fit.left_out, fit.raw_error_deg
    );
    println!("{}", args.out.display());
    Ok(())
}
