//! `mirrorball calibrate latency`: how old is an image when it gets its stamp, by the clock of gyro or wheels?

use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use localize::sensors::latency_calibration::{LatencyFit, fit_latency};
use localize::sensors::wheel_calibration::{DriveFitError, fit_drive};
use serde::Serialize;
use vision::output_file::write_file;

use super::drive::{Drive, DriveArgs};

/// Time from the exposure of an image to its stamp, from a drive with vision that starts, stops and turns often.
///
/// Needs a calibrated ground map. Compares with the gyro if there is one, else with the wheels, whose slip looks like up to
/// ten milliseconds of latency. Scales are estimated too, so a wrong radius does not matter.
#[derive(clap::Args)]
#[command(after_help = "Example: mirrorball calibrate latency drive/ --out latency.toml")]
pub(super) struct LatencyArgs {
    #[command(flatten)]
    drive: DriveArgs,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Outcome {
    camera_latency_s: f32,
    std_s: f32,
    compared_with: &'static str,
    pieces: usize,
    out: PathBuf,
}

/// Latencies below this are that of the stamps' noise, seconds; a stamp cannot be earlier than its exposure.
const NEGATIVE_MAX: f32 = 0.005;

/// Runs the command.
pub(super) fn run(args: &LatencyArgs, json: bool) -> Result<()> {
    let DriveArgs { drive: path, out } = &args.drive;
    let drive = args.drive.load("timing")?;
    let (fit, by) = fit(&drive).with_context(|| path.display().to_string())?;
    let latency = fit.latency;
    ensure!(
        latency > -NEGATIVE_MAX,
        "{}: the images are {:.0} ms ahead of the {by}: its stamps are late, which no camera latency corrects",
        path.display(),
        -1e3 * latency
    );
    let latency = latency.max(0.0);
    let text = format!(
        "# Written by `mirrorball calibrate latency`. In robot.toml: include = [\"latency.toml\"]\n\
         # standard deviation {:.4} s, compared with the {by}\n[timing]\ncamera_latency = {latency:.4}\n",
        fit.std
    );
    write_file(out, &text).with_context(|| format!("cannot write {}", out.display()))?;
    if json {
        let outcome = Outcome {
            camera_latency_s: latency,
            std_s: fit.std,
            compared_with: by,
            pieces: fit.pieces,
            out: out.clone(),
        };
        println!("{}", serde_json::to_string(&outcome)?);
        return Ok(());
    }
    print!("{text}");
    println!("# {} pieces of the drive", fit.pieces);
    println!("# {}", out.display());
    Ok(())
}

/// The latency by the gyro, or by the wheels if there is no inertial unit.
fn fit(drive: &Drive) -> Result<(LatencyFit, &'static str), DriveFitError> {
    if !drive.imu.is_empty() {
        let calibration = drive.robot.imu.as_ref().and_then(|imu| imu.calibration);
        let readings: Vec<_> = match calibration {
            Some(calibration) => drive.imu.iter().map(|one| calibration.apply(one)).collect(),
            None => drive.imu.clone(),
        };
        return Ok((fit_latency(&readings, &drive.poses)?, "gyro"));
    }
    let fit = fit_drive(&drive.odometry, &drive.poses)?;
    let by_wheels = LatencyFit {
        latency: fit.checked_latency()?,
        std: fit.latency_std,
        pieces: fit.pieces,
    };
    Ok((by_wheels, "wheels"))
}
