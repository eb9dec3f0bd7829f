//! `mirrorball calibrate`: rim, ground map from a strip or a drive, its mount, colours, mask of the robot's body, sizes, wheels, inertial
//! unit, latency and compass.

mod colours;
mod compass;
mod drive;
mod images;
mod imu;
mod latency;
mod lines;
mod map;
mod mask;
mod mount;
mod rim;
mod sizes;
mod wheels;

use anyhow::Result;
use pipeline::setup_check::LINES_ORIGIN_STD;

pub(crate) use lines::{LinesArgs, calibrate_map_from_lines};
pub(crate) use map::{MapArgs, Outcome, calibrate_map};

/// Calibrate the camera (rim, ground map and its mount, colours, mask, sizes, latency), the wheels, the inertial unit and the compass.
#[derive(clap::Args)]
#[command(
    subcommand_required = true,
    arg_required_else_help = true,
    after_help = "Example: mirrorball calibrate lines drive/ --out map.npz\n         \
                  mirrorball calibrate wheels drive/ --out wheels.toml"
)]
pub(crate) struct Args {
    #[command(subcommand)]
    command: CalibrateCommand,
}

#[derive(clap::Subcommand)]
enum CalibrateCommand {
    Map(MapArgs),
    Lines(LinesArgs),
    Mount(mount::MountArgs),
    Rim(rim::RimArgs),
    Colours(colours::ColoursArgs),
    Mask(mask::MaskArgs),
    Sizes(sizes::SizesArgs),
    Compass(compass::CompassArgs),
    Wheels(wheels::WheelsArgs),
    Imu(imu::ImuArgs),
    Latency(latency::LatencyArgs),
}

/// Runs the command.
pub(crate) fn run(args: &Args, json: bool) -> Result<()> {
    let (outcome, residuals) = match &args.command {
        CalibrateCommand::Map(args) => calibrate_map(args)?,
        CalibrateCommand::Lines(args) => calibrate_map_from_lines(args)?,
        CalibrateCommand::Mount(args) => return mount::run(args, json),
        CalibrateCommand::Rim(args) => return rim::run(args, json),
        CalibrateCommand::Colours(args) => return colours::run(args, json),
        CalibrateCommand::Mask(args) => return mask::run(args, json),
        CalibrateCommand::Sizes(args) => return sizes::run(args, json),
        CalibrateCommand::Compass(args) => return compass::run(args, json),
        CalibrateCommand::Wheels(args) => return wheels::run(args, json),
        CalibrateCommand::Imu(args) => return imu::run(args, json),
        CalibrateCommand::Latency(args) => return latency::run(args, json),
    };
    if let Some(warning) = &outcome.warning {
        stderr_line!("warning: {warning}");
    }
    if json {
        println!("{}", serde_json::to_string(&outcome)?);
        return Ok(());
    }
    for image in residuals.iter().filter(|image| image.left_out.is_none()) {
        println!(
            "{}: {} points, {:.2} px",
            image.name, image.points, image.rms_px
        );
    }
    images::print_left_out(&residuals);
    println!("{} of {} images used", outcome.used, outcome.images);
    if let Some(rms) = outcome.rms_px {
        println!("residual: {rms:.2} px");
    }
    if let (Some(rms), Some(share)) = (outcome.rms_m, outcome.inlier_share) {
        println!(
            "residual: {:.1} cm; {:.0} % of the line points lie on markings",
            100.0 * rms,
            100.0 * share
        );
    }
    if let Some([near, far]) = outcome.disagreement_m {
        let far = match far.is_nan() {
            true => String::new(),
            false => format!(" and {:.1} cm from 3 to 5 m", 100.0 * far),
        };
        println!(
            "halves of the images differ by {:.1} cm up to 3 m{far} (median), where they show lines",
            100.0 * near
        );
    }
    if let Some(reach) = outcome.reach_m {
        println!("line points reach {reach:.1} m: farther out nothing checks the map");
    }
    if let Some(camera) = &outcome.camera {
        println!(
            "camera: {}",
            toml::to_string(camera)?.trim().replace('\n', ", ")
        );
        println!(
            "forward_deg and flipped are guesses, as lines look alike mirrored and turned by half a turn: a drive with wheels \
             tells. The map's origin is good to some centimetres: give [map] origin_std = {LINES_ORIGIN_STD}. `mirrorball calibrate mount` \
             measures all three from a drive"
        );
    }
    if let Some(mount) = outcome.mount {
        println!(
            "mount: {}",
            toml::to_string(&mount)?.trim().replace('\n', ", ")
        );
    }
    print_field(&outcome);
    println!("map: {}", outcome.map.display());
    Ok(())
}

/// The fitted field, if one was written.
fn print_field(outcome: &Outcome) {
    let Some(field) = &outcome.field else {
        return;
    };
    match (&outcome.told_sizes, &outcome.untold_sizes) {
        (Some(told), Some(untold)) => {
            if !told.is_empty() {
                println!("sizes by the images: {}", told.join(", "));
            }
            if !untold.is_empty() {
                println!(
                    "not told by the images, measure them: {}",
                    untold.join(", ")
                );
            }
            println!(
                "lines do not tell the scale of field and mirror together: it is that in which the median size is that of the field \
                 file. Measure one size, and scale the others if it differs"
            );
        }
        _ => println!("the sizes of the field file fit"),
    }
    println!("field: {}", field.display());
}
