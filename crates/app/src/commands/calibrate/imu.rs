//! `mirrorball calibrate imu`: how does the inertial unit lie in the robot, and what does it measure at rest?

use std::path::PathBuf;

use anyhow::{Context, Result};
use localize::robot::ImuCalibration;
use localize::sensors::imu_calibration::{ImuFit, fit_imu};
use serde::Serialize;
use vision::output_file::write_file;

use super::drive::DriveArgs;

/// Mounting and constant errors of the inertial unit, from rest and a drive.
///
/// The robot stands still for a few seconds, turns on the spot both ways, and drives with starts and stops. Calibrate the
/// wheels first. A folder needs imu.csv.
#[derive(clap::Args)]
#[command(after_help = "Example: mirrorball calibrate imu drive/ --out imu.toml")]
pub(super) struct ImuArgs {
    #[command(flatten)]
    drive: DriveArgs,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Outcome {
    #[serde(flatten)]
    calibration: ImuCalibration,
    /// Of roll and pitch, and of yaw.
    mount_std_deg: [f32; 2],
    rate_bias_std_deg: f32,
    acceleration_bias_std: f32,
    rest_s: f32,
    turned_deg: f32,
    accelerations: usize,
    out: PathBuf,
}

/// Runs the command.
pub(super) fn run(args: &ImuArgs, json: bool) -> Result<()> {
    let DriveArgs { drive: path, out } = &args.drive;
    let drive = args.drive.load("imu")?;
    let odometry: Vec<_> = match drive.robot.odometry {
        Some(wheels) => drive
            .odometry
            .iter()
            .map(|sample| wheels.apply(sample))
            .collect(),
        None => drive.odometry,
    };
    let fit = fit_imu(&drive.imu, &odometry).with_context(|| path.display().to_string())?;
    let text = calibration_text(&fit);
    write_file(out, &text).with_context(|| format!("cannot write {}", out.display()))?;
    if json {
        let outcome = Outcome {
            calibration: fit.calibration,
            mount_std_deg: fit.mount_std_deg,
            rate_bias_std_deg: fit.rate_bias_std_deg,
            acceleration_bias_std: fit.acceleration_bias_std,
            rest_s: fit.rest,
            turned_deg: fit.turned_deg,
            accelerations: fit.accelerations,
            out: out.clone(),
        };
        println!("{}", serde_json::to_string(&outcome)?);
        return Ok(());
    }
    print!("{text}");
    println!(
        "# {:.1} s at rest, {:.0}° of turns on the spot, {} accelerations",
        fit.rest, fit.turned_deg, fit.accelerations
    );
    println!("# {}", out.display());
    Ok(())
}

fn calibration_text(fit: &ImuFit) -> String {
    let ImuCalibration {
        mount_deg,
        acceleration_bias,
        rate_bias_deg,
    } = fit.calibration;
    let list = |values: [f32; 3]| values.map(|value| format!("{value:.3}")).join(", ");
    let [tilt_std, yaw_std] = fit.mount_std_deg;
    format!(
        "# Written by `mirrorball calibrate imu`. In robot.toml: include = [\"imu.toml\"]\n\
         # standard deviations: roll and pitch {tilt_std:.2}°, yaw {yaw_std:.2}°, rate {:.3} °/s, force {:.3} m/s²\n\
         [imu.calibration]\nmount_deg = [{}]\nacceleration_bias = [{}]\nrate_bias_deg = [{}]\n",
        fit.rate_bias_std_deg,
        fit.acceleration_bias_std,
        list(mount_deg),
        list(acceleration_bias),
        list(rate_bias_deg)
    )
}
