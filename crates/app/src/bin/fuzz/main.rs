//! Does any parser panic, hang or eat the memory? Random changes of good inputs: `tools/fuzz SECONDS [TARGET...]`.
//!
//! It needs neither a nightly compiler nor instrumented code. An input is kept for further changes if its outcome, a
//! count or an error without its numbers, is new. Address space is limited, so that an input that unpacks to gigabytes fails.

mod hang_watch;
mod mutation;
mod targets;

use std::collections::BTreeSet;
use std::io::Write;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

use hang_watch::HangWatch;
use targets::{TARGETS, Target};

/// Longest input, unless a seed is longer.
const LENGTH_MAX: usize = 4096;
/// Most inputs kept for further changes.
const KEPT_MAX: usize = 512;
/// Address space of the process, bytes. The largest legitimate input needs a few hundred megabytes.
const ADDRESS_SPACE: u64 = 6 * 1024 * 1024 * 1024;
fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("fuzz: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let usage = "usage: fuzz SECONDS FOLDER [TARGET...]";
    let seconds: f64 = arguments.next().context(usage)?.parse().context(usage)?;
    let folder = PathBuf::from(arguments.next().context(usage)?);
    let names: Vec<String> = arguments.collect();
    for name in &names {
        if !TARGETS.iter().any(|target| target.name == name) {
            let known: Vec<&str> = TARGETS.iter().map(|target| target.name).collect();
            bail!(
                "unknown target: {name} (expected one of {})",
                known.join(", ")
            );
        }
    }
    let limit = Rlimit {
        current: Some(ADDRESS_SPACE),
        ..getrlimit(Resource::As)
    };
    setrlimit(Resource::As, limit).context("cannot limit the address space")?;
    // A panic is reported once, by its target.
    std::panic::set_hook(Box::new(|_| {}));
    for target in TARGETS {
        if names.is_empty() || names.iter().any(|name| name == target.name) {
            fuzz(target, &folder, Duration::from_secs_f64(seconds))?;
        }
    }
    Ok(())
}

fn fuzz(target: &Target, folder: &Path, duration: Duration) -> Result<()> {
    // In memory where there is such a folder: inputs are written as fast as they are made.
    let memory = Path::new("/dev/shm");
    let memory = if memory.is_dir() {
        memory.to_owned()
    } else {
        std::env::temp_dir()
    };
    let scratch = tempfile::tempdir_in(&memory).context("cannot make a temporary folder")?;
    let mut inputs = seeds(&folder.join("corpus").join(target.name))?;
    let length_max = inputs.iter().map(Vec::len).fold(LENGTH_MAX, usize::max);
    let artifacts = folder.join("artifacts");
    std::fs::create_dir_all(&artifacts)?;
    let current = memory.join(format!("mirrorball-fuzz-{}", target.name));
    let mut outcomes = BTreeSet::new();
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let (started, seed_count, mut runs) = (Instant::now(), inputs.len(), 0);
    let watch = HangWatch::start(target.name, &current, &artifacts);
    while runs < seed_count || started.elapsed() < duration {
        let bytes = if runs < seed_count {
            inputs[runs].clone()
        } else {
            let [one, other] = [0, 1].map(|_| rng.random_range(0..inputs.len()));
            mutation::mutate(&inputs[one], &inputs[other], length_max, &mut rng)
        };
        runs += 1;
        // A failed allocation aborts the process: the input is in this file then.
        std::fs::write(&current, &bytes)?;
        watch.begin_input();
        let mut outcome =
            match catch_unwind(AssertUnwindSafe(|| (target.run)(&bytes, scratch.path()))) {
                Ok(outcome) => outcome,
                Err(panic) => {
                    let saved = artifacts.join(format!("{}-{runs}", target.name));
                    std::fs::write(&saved, &bytes)?;
                    std::fs::remove_file(&current)?;
                    let reason = panic_text(panic.as_ref());
                    bail!(
                        "{}: panic: {reason}; input {}",
                        target.name,
                        saved.display()
                    );
                }
            };
        outcome.retain(|letter| !letter.is_ascii_digit());
        if outcomes.insert(outcome) && runs > seed_count && inputs.len() < KEPT_MAX {
            inputs.push(bytes);
        }
    }
    std::fs::remove_file(&current)?;
    let mut out = std::io::stdout();
    writeln!(
        out,
        "{:<16} {runs:>8} inputs, {:>4} outcomes, {:.0} s",
        target.name,
        outcomes.len(),
        started.elapsed().as_secs_f64()
    )?;
    Ok(())
}

/// The files of a corpus, in the order of their names. An empty corpus starts from an empty input.
fn seeds(folder: &Path) -> Result<Vec<Vec<u8>>> {
    let mut paths: Vec<PathBuf> = match std::fs::read_dir(folder) {
        Ok(entries) => entries
            .map(|entry| Ok(entry?.path()))
            .collect::<Result<_>>()?,
        Err(_) => Vec::new(),
    };
    paths.sort();
    let mut seeds = Vec::new();
    for path in paths {
        seeds
            .push(std::fs::read(&path).with_context(|| format!("cannot read {}", path.display()))?);
    }
    if seeds.is_empty() {
        seeds.push(Vec::new());
    }
    Ok(seeds)
}

fn panic_text(panic: &(dyn std::any::Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().cloned();
    text.or_else(|| panic.downcast_ref::<&str>().map(|text| (*text).to_owned()))
        .unwrap_or_else(|| "no reason given".to_owned())
}
