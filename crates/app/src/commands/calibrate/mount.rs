//! `mirrorball calibrate mount`: where are forward, left and the origin of a ground map that lines alone gave?

use std::path::PathBuf;

use anyhow::{Context, Result};
use pipeline::PipelineConfig;
use pipeline::recording::Recording;
use pipeline::setup::Setup;
use pipeline::setup_check::{MapMount, find_map_mount};
use serde::Serialize;

use super::map::ensure_map_can_be_saved;
use crate::commands::inputs::Inputs;
use crate::commands::locate::EXTERNAL_POINT_STD;

/// Forward, left and origin of a ground map, from a drive with wheels.
///
/// The lines of a field look alike turned by half a turn and mirrored: `calibrate lines` without a start map guesses. The
/// wheels tell, on a drive forward and sideways with turns. The origin becomes the point that the wheels turn about.
#[derive(clap::Args)]
#[command(
    after_help = "Example: mirrorball calibrate mount drive/ --map map.npz --out mounted.npz"
)]
pub(super) struct MountArgs {
    /// The recording folder of a drive.
    drive: PathBuf,
    /// The map, in place of the robot's own.
    #[arg(long, value_name = "MAP.npz")]
    map: Option<PathBuf>,
    /// File for the map in the robot frame.
    #[arg(long, value_name = "MAP.npz")]
    out: PathBuf,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Outcome {
    mirrored: bool,
    turn_deg: f32,
    turn_std_deg: f32,
    /// None if the drive tells it no better than it is known: it stayed.
    origin_m: Option<[f32; 2]>,
    /// Of the origin of the written map, per axis: the value for robot.toml.
    origin_std_m: f32,
    /// That by the drive alone.
    origin_std_by_drive_m: f32,
    wheels_agree: f32,
    wheels_agree_before: f32,
    keyframes: usize,
    map: PathBuf,
}

/// Runs the command.
pub(super) fn run(args: &MountArgs, json: bool) -> Result<()> {
    let inputs = Inputs::of([&*args.drive]).with_file(args.map.as_deref(), "");
    ensure_map_can_be_saved(&inputs, &args.out, None)?;
    let place = || args.drive.display().to_string();
    let setup = Setup::load(&args.drive.join("robot.toml"), args.map.as_deref())?;
    let (_, map) = setup
        .camera
        .as_ref()
        .with_context(|| format!("{}: robot.toml has no [camera]", place()))?;
    let recording = Recording::open(&args.drive, EXTERNAL_POINT_STD)?;
    let mount =
        find_map_mount(&recording, &setup, &PipelineConfig::default()).with_context(place)?;
    mount.apply(map).save(&args.out)?;
    if json {
        println!("{}", serde_json::to_string(&outcome(&mount, args))?);
        return Ok(());
    }
    println!(
        "ground points turned by {:+.1} degrees (standard deviation {:.1}){}",
        mount.turn.to_degrees(),
        mount.turn_std.to_degrees(),
        if mount.mirrored {
            ", then mirrored"
        } else {
            ""
        }
    );
    match mount.origin {
        Some([x, y]) => println!(
            "origin moved to ({x:+.3}, {y:+.3}) m (standard deviation {:.3} per axis)",
            mount.origin_std
        ),
        None => println!(
            "origin left where it was: the drive tells it to {:.3} m per axis, and it is known to {:.3} (more turns tell it better)",
            mount.origin_std_by_drive, mount.origin_std
        ),
    }
    println!(
        "wheels agree with the poses of {} images by {:.0} %, before {:.0} %",
        mount.keyframes,
        100.0 * mount.wheels_agree[1],
        100.0 * mount.wheels_agree[0]
    );
    println!("map: {}", args.out.display());
    println!("in robot.toml, so that poses count what is not certain:");
    println!(
        "[map]\nfile = {:?}\norigin_std = {:.3}\nturn_std_deg = {:.1}",
        args.out.display().to_string(),
        mount.origin_std,
        mount.turn_std.to_degrees()
    );
    Ok(())
}

fn outcome(mount: &MapMount, args: &MountArgs) -> Outcome {
    Outcome {
        mirrored: mount.mirrored,
        turn_deg: mount.turn.to_degrees(),
        turn_std_deg: mount.turn_std.to_degrees(),
        origin_m: mount.origin,
        origin_std_m: mount.origin_std,
        origin_std_by_drive_m: mount.origin_std_by_drive,
        wheels_agree: mount.wheels_agree[1],
        wheels_agree_before: mount.wheels_agree[0],
        keyframes: mount.keyframes,
        map: args.out.clone(),
    }
}
