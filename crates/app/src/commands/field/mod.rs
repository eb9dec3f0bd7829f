//! `mirrorball field`: field files from a drawing or from a drive.

mod field_file;
mod from_recording;
mod from_svg;
mod svg_document;
mod svg_path;
mod svg_transform;

use anyhow::Result;
use clap::Subcommand;

/// Make a field file: from a drawing of the markings, or from a drive past unknown ones.
#[derive(clap::Args)]
#[command(
    after_help = "Example: mirrorball field from-svg hall.svg --out hall.toml\n         \
                  mirrorball field from-recording drive/ --out hall.toml"
)]
pub(crate) struct Args {
    #[command(subcommand)]
    source: Source,
}

#[derive(Subcommand)]
enum Source {
    FromSvg(from_svg::Args),
    FromRecording(from_recording::Args),
}

/// Runs the command.
pub(crate) fn run(args: &Args, json: bool) -> Result<()> {
    match &args.source {
        Source::FromSvg(args) => from_svg::run(args, json),
        Source::FromRecording(args) => from_recording::run(args, json),
    }
}
