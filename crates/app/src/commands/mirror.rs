//! `mirrorball mirror`: profile, report, picture or workshop files from a TOML design, by the Python package.

use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::{Subcommand, ValueEnum};
use pyo3::prelude::*;
use pyo3::types::{IntoPyDict, PyDict};

use super::arguments::parse_seed;
use super::inputs::Inputs;
use crate::python;

/// Design mirrors, evaluate them before they are cut, render their image, and export them for the workshop.
#[derive(clap::Args)]
#[command(
    after_help = "Example: mirrorball mirror report lima2001 --out out/lima2001 --mirrors 1000\n\
                  A DESIGN is a TOML file (see config/mirrors) or the name of a ready-made one: lima2001,\n\
                  sphere_cone_1999, nubot2013, minho_like."
)]
pub(crate) struct Args {
    /// Python interpreter or folder of a virtual environment (default: $VIRTUAL_ENV, else the build's).
    #[arg(long, value_name = "PATH", global = true)]
    python: Option<PathBuf>,
    #[command(subcommand)]
    command: MirrorCommand,
}

#[derive(Subcommand)]
enum MirrorCommand {
    /// Compute the profile, or optimize one for given requirements, and write it as CSV.
    #[command(
        after_help = "Example: mirrorball mirror design config/mirrors/wishes.toml --out mirror.csv"
    )]
    Design {
        /// TOML file or ready-made name.
        design: String,
        /// The profile: radius_m,height_m.
        #[arg(long, default_value = "mirror.csv")]
        out: PathBuf,
    },
    /// Draw the mirror's coverage, sharpness and sensitivity to errors: figures and one HTML page.
    #[command(
        after_help = "Example: mirrorball mirror report nubot2013 --out out/nubot2013 --mirrors 1000"
    )]
    Report {
        /// TOML file or ready-made name.
        design: String,
        /// Folder for the figures and index.html.
        #[arg(long)]
        out: PathBuf,
        /// Number of imperfect mirrors to test against the tolerances; 0 for none.
        #[arg(long, default_value_t = 0)]
        mirrors: u32,
        /// Seed of their errors.
        #[arg(long, default_value_t = 1, value_parser = parse_seed, allow_negative_numbers = true)]
        seed: u64,
    },
    /// Render the image of a robot with this mirror.
    #[command(
        after_help = "Examples: mirrorball mirror render minho_like --pose=-3,1,30 --ball=-1,0 --out view.png\n\
                      \x20         mirrorball mirror render mirror.toml --scenario config/scenarios/hall_bright.toml --time 2\n\
                      With --scenario the picture shows the scene with its light, robots and crooked mount, and beside it the\n\
                      floor that the ideal map of the mirror makes of it, with the field's lines where they are."
    )]
    Render {
        /// TOML file or ready-made name.
        design: String,
        /// PNG to write.
        #[arg(long, default_value = "view.png")]
        out: PathBuf,
        /// field.toml [default: the MSL field of 18 × 12 m].
        #[arg(long)]
        field: Option<PathBuf>,
        /// The robot's x and y (metres) and heading (degrees).
        #[arg(
            long,
            value_delimiter = ',',
            num_args = 1,
            default_value = "0,0,0",
            allow_hyphen_values = true
        )]
        pose: Vec<f64>,
        /// A ball's x and y, metres.
        #[arg(long, value_delimiter = ',', num_args = 1, allow_hyphen_values = true)]
        ball: Option<Vec<f64>>,
        /// Scene of a scenario (TOML), with this mirror and camera on its robot; the scenario places robot and ball.
        #[arg(long, conflicts_with_all = ["field", "pose", "ball"])]
        scenario: Option<PathBuf>,
        /// Moment of the scene, seconds from the scenario's start.
        #[arg(long, default_value_t = 0.0, requires = "scenario")]
        time: f64,
    },
    /// Write files for the workshop and print the deviation of each from the design.
    #[command(
        after_help = "Example: mirrorball mirror export lima2001 --out out/workshop --formats csv,dxf,stl"
    )]
    Export {
        /// TOML file or ready-made name.
        design: String,
        /// Folder to write to.
        #[arg(long)]
        out: PathBuf,
        /// File formats.
        #[arg(long, value_delimiter = ',', default_values_t = [ExportFormat::Csv, ExportFormat::Dxf, ExportFormat::Stl, ExportFormat::Pdf])]
        formats: Vec<ExportFormat>,
    },
}

/// File formats for workshops.
#[derive(Clone, Copy, ValueEnum)]
enum ExportFormat {
    Csv,
    Dxf,
    Stl,
    Step,
    /// Dimensioned drawing with tables of radii and of what imperfections cost.
    Pdf,
}

impl std::fmt::Display for ExportFormat {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            ExportFormat::Csv => "csv",
            ExportFormat::Dxf => "dxf",
            ExportFormat::Stl => "stl",
            ExportFormat::Step => "step",
            ExportFormat::Pdf => "pdf",
        })
    }
}

/// Runs a subcommand; `json` prints the result object instead of text.
pub(crate) fn run(args: &Args, json: bool) -> Result<()> {
    ensure_inputs_kept(&args.command)?;
    python::start(args.python.as_deref())?;
    let outcome = Python::attach(|py| {
        call_python(py, &args.command, json)
            .map(|text| println!("{text}"))
            .map_err(|error| python::explain_error(py, &error))
    });
    python::finish();
    outcome
}

/// Rejects a file to write that is the design or the scene. Folders get names that no input has.
fn ensure_inputs_kept(command: &MirrorCommand) -> Result<()> {
    let (inputs, out) = match command {
        MirrorCommand::Design { design, out } => (Inputs::of([Path::new(design)]), out),
        MirrorCommand::Render {
            design,
            out,
            field,
            scenario,
            ..
        } => (
            Inputs::of([Path::new(design)])
                .with_file(field.as_deref(), "")
                .with_file(scenario.as_deref(), ""),
            out,
        ),
        MirrorCommand::Report { .. } | MirrorCommand::Export { .. } => return Ok(()),
    };
    inputs.ensure_kept([Some(&**out)])
}

fn call_python(py: Python<'_>, command: &MirrorCommand, json: bool) -> PyResult<String> {
    let commands = py.import("mirrorball.mirror.command")?;
    let text = |path: &Path| path.display().to_string();
    let options = PyDict::new(py);
    let (name, design) = match command {
        MirrorCommand::Design { design, out } => {
            options.set_item("out", text(out))?;
            ("design", design)
        }
        MirrorCommand::Report {
            design,
            out,
            mirrors,
            seed,
        } => {
            options.update(
                [("mirrors", u64::from(*mirrors)), ("seed", *seed)]
                    .into_py_dict(py)?
                    .as_mapping(),
            )?;
            options.set_item("out", text(out))?;
            ("report", design)
        }
        MirrorCommand::Render {
            design,
            out,
            field,
            pose,
            ball,
            scenario,
            time,
        } => {
            options.set_item("out", text(out))?;
            options.set_item("field", field.as_deref().map(text))?;
            options.set_item("pose", pose)?;
            options.set_item("ball", ball.as_ref())?;
            options.set_item("scenario", scenario.as_deref().map(text))?;
            options.set_item("time_s", time)?;
            ("render", design)
        }
        MirrorCommand::Export {
            design,
            out,
            formats,
        } => {
            options.set_item("out", text(out))?;
            let formats: Vec<String> = formats.iter().map(ExportFormat::to_string).collect();
            options.set_item("formats", formats)?;
            ("export", design)
        }
    };
    let result = commands.getattr(name)?.call((design,), Some(&options))?;
    let formatter = if json { "as_json" } else { "as_text" };
    commands.getattr(formatter)?.call1((result,))?.extract()
}
