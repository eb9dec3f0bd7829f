//! `mirrorball calibrate wheels`: how far does the robot really move when its wheels say so?

use std::path::PathBuf;

use anyhow::{Context, Result};
use localize::robot::OdometryCalibration;
use localize::sensors::wheel_calibration::{DriveFit, fit_drive};
use localize::sensors::wheel_geometry::{WheelGeometry, wheel_geometry};
use serde::Serialize;
use vision::output_file::write_file;

use super::drive::DriveArgs;

/// Correction of the wheels' motion from a drive with vision: scales and couplings, and the radii that explain them.
///
/// Needs a calibrated ground map and a minute of driving in all directions with turns, field lines in view.
#[derive(clap::Args)]
#[command(after_help = "Example: mirrorball calibrate wheels drive/ --out wheels.toml")]
pub(super) struct WheelsArgs {
    #[command(flatten)]
    drive: DriveArgs,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Outcome {
    matrix: [[f32; 3]; 3],
    matrix_std: [[f32; 3]; 3],
    wheel_radii_m: Option<Vec<f32>>,
    wheel_distance_m: Option<f32>,
    /// Metres and degrees, at the end of a piece of 0.8 s.
    residual: [f32; 2],
    residual_before: [f32; 2],
    pieces: usize,
    outliers: usize,
    latency_s: f32,
    out: PathBuf,
}

/// Runs the command.
pub(super) fn run(args: &WheelsArgs, json: bool) -> Result<()> {
    let DriveArgs { drive: path, out } = &args.drive;
    let drive = args.drive.load("odometry")?;
    let fit =
        fit_drive(&drive.odometry, &drive.poses).with_context(|| path.display().to_string())?;
    let base = drive.robot.base.as_ref();
    let geometry = base.and_then(|base| wheel_geometry(&fit.matrix, base));
    let text = calibration_text(&fit, base.is_some(), geometry.as_ref())?;
    write_file(out, &text).with_context(|| format!("cannot write {}", out.display()))?;
    if json {
        let outcome = Outcome {
            matrix: fit.matrix,
            matrix_std: fit.matrix_std,
            wheel_distance_m: geometry.as_ref().map(|geometry| geometry.distance),
            wheel_radii_m: geometry.map(|geometry| geometry.radii),
            residual: fit.residual,
            residual_before: fit.residual_before,
            pieces: fit.pieces,
            outliers: fit.outliers,
            latency_s: fit.latency,
            out: out.clone(),
        };
        println!("{}", serde_json::to_string(&outcome)?);
        return Ok(());
    }
    print!("{text}");
    println!(
        "# {} pieces of the drive ({} with slip or wrong poses): {:.1} cm and {:.2}° at the end of 0.8 s, before {:.1} cm and {:.2}°",
        fit.pieces,
        fit.outliers,
        100.0 * fit.residual[0],
        fit.residual[1],
        100.0 * fit.residual_before[0],
        fit.residual_before[1]
    );
    println!("# {}", out.display());
    Ok(())
}

fn calibration_text(
    fit: &DriveFit,
    has_base: bool,
    geometry: Option<&WheelGeometry>,
) -> Result<String> {
    let calibration = OdometryCalibration { matrix: fit.matrix };
    let mut text = String::from(
        "# Written by `mirrorball calibrate wheels`. In robot.toml: include = [\"wheels.toml\"]\n",
    );
    for (row, name) in ["forward", "left", "rotation"].iter().enumerate() {
        let [x, y, theta] = fit.matrix_std[row];
        text += &format!("# {name}: standard deviations {x:.4}, {y:.4}, {theta:.4}\n");
    }
    if let Some(geometry) = geometry {
        let radii: Vec<String> = geometry
            .radii
            .iter()
            .map(|radius| format!("{radius:.4}"))
            .collect();
        text += &format!(
            "# equivalent wheels: radii {} m, {:.4} m from the centre\n",
            radii.join(", "),
            geometry.distance
        );
    } else if has_base {
        text += "# no radii and distance of the wheels explain this matrix: their directions may be other ones than [base] says\n";
    }
    let rows = calibration.matrix.map(|row| {
        let values = row.map(|value| format!("{value:.5}"));
        format!("  [{}],\n", values.join(", "))
    });
    text += &format!("[odometry]\nmatrix = [\n{}]\n", rows.concat());
    Ok(text)
}
