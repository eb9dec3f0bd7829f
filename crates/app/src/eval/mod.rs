//! `mirrorball eval`: are the papers' results reproduced? Experiments from TOML files, their metrics next to the papers' values.

pub(crate) mod air;
pub(crate) mod certainty;
pub(crate) mod cooperative;
pub(crate) mod drives;
pub(crate) mod experiment;
pub(crate) mod fusion;
pub(crate) mod landscape;
pub(crate) mod mapping;
pub(crate) mod metric;
pub(crate) mod output;
mod page;
pub(crate) mod rendered_mates;
pub(crate) mod searches;
pub(crate) mod stills;
pub(crate) mod team;
pub(crate) mod times;
pub(crate) mod vision;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use serde::Serialize;

use crate::commands::arguments::{UsageError, parse_seed};
use experiment::{Experiment, Part, PartRun};
use output::{CsvRows, EvalResults, PartResults};
use pipeline::paths;

/// Reproduce a paper's experiments and compare our figures with its own: tables, CSV and one HTML page.
///
/// The same seeds give the same figures, except times.
#[derive(clap::Args)]
#[command(after_help = "Example: mirrorball eval lima2001 --out out/lima2001\n\
                  NAME is one of config/experiments (lima2001, minho2016, nubot2013, eyes, fusion, team, air, cooperative, certainty, mapping, all) or the path of a TOML file.")]
pub(crate) struct Args {
    /// The experiment.
    name: String,
    /// Folder for tables and page.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Runs of each drive; overrides the experiment's number.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=10_000))]
    seeds: Option<u64>,
    /// The first seed.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = parse_seed, allow_negative_numbers = true)]
    seed: u64,
    /// Run only the parts whose name contains this.
    #[arg(long, value_name = "TEXT", default_value = "")]
    only: String,
    /// Python interpreter or folder of a virtual environment, for the page (default: $VIRTUAL_ENV, else the build's).
    #[arg(long, value_name = "PATH")]
    python: Option<PathBuf>,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Outcome<'a> {
    #[serde(flatten)]
    results: &'a EvalResults,
    page: Option<PathBuf>,
}

/// Runs the command.
pub(crate) fn run(args: &Args, json: bool) -> Result<()> {
    let path = find_experiment(&args.name)?;
    let experiment = Experiment::load(&path)?;
    let selected = |part: &&Part| part.name.contains(&args.only);
    if !experiment.parts.iter().any(|part| selected(&part)) {
        return Err(UsageError(format!("no part's name contains {:?}", args.only)).into());
    }
    if let Some(python) = args.python.as_deref().filter(|path| !path.exists()) {
        return Err(UsageError(format!(
            "--python {}: no such file or folder",
            python.display()
        ))
        .into());
    }
    // Before parts that take minutes.
    for part in experiment.parts.iter().filter(selected) {
        if let PartRun::Times(times) = &part.run {
            times::ensure_images(times).with_context(|| format!("part {:?}", part.name))?;
        }
    }
    std::fs::create_dir_all(&args.out)
        .with_context(|| format!("cannot write {}", args.out.display()))?;
    let seeds_end = args
        .seed
        .checked_add(args.seeds.unwrap_or(experiment.seeds))
        .context("seed too large (expected first seed + runs <= 2^64 - 1)")?;
    let mut parts = Vec::new();
    for part in experiment.parts.iter().filter(selected) {
        parts.push(run_part(part, args.seed..seeds_end, &args.out)?);
    }
    let name = path
        .file_stem()
        .map(|stem| stem.to_string_lossy().into_owned());
    let results = EvalResults {
        name: name.unwrap_or_default(),
        title: experiment.title.clone(),
        source: experiment.source.clone(),
        differs: experiment.differs.clone(),
        version: env!("CARGO_PKG_VERSION"),
        machine: crate::machine::machine(),
        seeds: [args.seed, seeds_end],
        parts,
    };
    results.write(&args.out)?;
    let page = match page::write(&args.out, args.python.as_deref()) {
        Ok(page) => Some(page),
        Err(error) => {
            stderr_line!("mirrorball: cannot draw the page: {error:#}. The tables are complete");
            None
        }
    };
    if json {
        let results = &results;
        println!("{}", serde_json::to_string(&Outcome { results, page })?);
        return Ok(());
    }
    results.print();
    match page {
        Some(page) => println!("\n{}", page.display()),
        None => println!("\n{}", args.out.join("figures.csv").display()),
    }
    Ok(())
}

/// The path of an experiment file, from a path or a name in config/experiments.
fn find_experiment(name: &str) -> Result<PathBuf> {
    let file = Path::new(name);
    if file.extension().is_some() {
        return Ok(file.to_owned());
    }
    let is_name = !name.is_empty() && !name.contains(['/', '\\']);
    if !is_name {
        let files = [file.to_owned(), file.with_extension("toml")];
        return files.into_iter().find(|file| file.is_file()).with_context(|| {
            format!(
                "no such experiment: {name:?} (expected a name in config/experiments or a TOML file)"
            )
        });
    }
    let folder = paths::find_resource("config/experiments")?;
    let file = folder.join(format!("{name}.toml"));
    if file.exists() {
        return Ok(file);
    }
    if Path::new(name).is_file() {
        return Ok(PathBuf::from(name));
    }
    let mut known: Vec<String> = std::fs::read_dir(&folder)
        .with_context(|| format!("cannot read {}", folder.display()))?
        .flatten()
        .filter_map(|entry| Some(entry.path().file_stem()?.to_string_lossy().into_owned()))
        .collect();
    known.sort();
    bail!(
        "unknown experiment: {name:?} (expected one of {}, or a TOML file)",
        known.join(", ")
    )
}

fn run_part(part: &Part, seeds: std::ops::Range<u64>, folder: &Path) -> Result<PartResults> {
    let file = format!("{}.csv", part.name);
    let mut rows = CsvRows::new(folder.join(&file));
    let seed = seeds.start;
    let bar = crate::progress::bar(0, "of this part");
    bar.set_message(part.name.clone());
    let (kind, figures) = match &part.run {
        PartRun::Drives(drives) => ("drives", drives::run(drives, seeds, &mut rows, &bar)),
        PartRun::Stills(stills) => ("stills", stills::run(stills, seed, &mut rows, &bar)),
        PartRun::Searches(searches) => ("searches", searches::run(searches, seed, &mut rows, &bar)),
        PartRun::Times(times) => ("times", times::run(times, seed, &mut rows, &bar)),
        PartRun::Landscape(landscape) => (
            "landscape",
            landscape::run(landscape, seed, &mut rows, &bar),
        ),
        PartRun::Vision(runs) => ("eyes", vision::run(runs, seeds, &mut rows, &bar)),
        PartRun::Fusion(fusion) => ("fusion", fusion::run(fusion, seeds, &mut rows, &bar)),
        PartRun::Team(team) => ("team", team::run_synthetic(team, seeds, &mut rows, &bar)),
        PartRun::Air(air) => ("team", air::run(air, seeds, &mut rows, &bar)),
        PartRun::Certificates(runs) => (
            "certificates",
            certainty::run_certificates(runs, seeds, &mut rows, &bar),
        ),
        PartRun::Certainty(runs) => (
            "certainty",
            certainty::run_certainty_drives(runs, seeds, &mut rows, &bar),
        ),
        PartRun::Mapping(runs) => ("mapping", mapping::run(runs, seeds, &mut rows, &bar)),
        PartRun::RenderedMates(runs) => ("team", rendered_mates::run(runs, seeds, &mut rows, &bar)),
        PartRun::Cooperative(runs) => ("team", cooperative::run(runs, seeds, &mut rows, &bar)),
        PartRun::MultiRobot(runs) => ("team", team::run_rendered(runs, seeds, &mut rows, &bar)),
    };
    bar.finish_and_clear();
    let mut figures = figures.with_context(|| format!("part {:?}", part.name))?;
    for figure in &mut figures {
        figure.attach_paper_value(&part.paper);
    }
    rows.finish()?;
    Ok(PartResults {
        name: part.name.clone(),
        title: part.title.clone(),
        kind,
        rows: file,
        figures,
    })
}
