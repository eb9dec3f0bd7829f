//! Is it slower than it was? Measured figures kept in a file, and this run's beside them.

use std::path::Path;

use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};

/// A difference below this part of the old value is the host's noise.
const NOISE: f64 = 0.1;

/// Figures of a run, as `bench --json` prints them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Baseline {
    /// Processor and number of cores.
    pub machine: String,
    /// Name, value, unit and what is wanted.
    pub figures: Vec<Measured>,
}

/// One figure.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// Its name.
    pub name: String,
    /// Its value.
    pub value: f64,
    /// Its unit; `ms` is better small, all else large.
    pub unit: String,
    /// Bound to be met, as text with its direction.
    pub wanted: String,
}

/// A figure beside its earlier value.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Compared {
    /// Its name.
    pub name: String,
    /// What it was.
    pub before: f64,
    /// What it is.
    pub now: f64,
    /// Now over before.
    pub ratio: f64,
    /// same, better, worse.
    pub verdict: &'static str,
}

impl Baseline {
    /// Reads what `bench --save` or `bench --json` wrote.
    pub fn load(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path)
            .with_context(|| format!("cannot read {}", path.display()))?;
        serde_json::from_str(&text).with_context(|| path.display().to_string())
    }

    /// Writes the file.
    pub fn save(&self, path: &Path) -> Result<()> {
        let text = serde_json::to_string_pretty(self)?;
        std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))
    }

    /// Figures that both have, in this one's order.
    pub fn compared(&self, earlier: &Baseline) -> Vec<Compared> {
        let pairs = self.figures.iter().filter_map(|now| {
            let before = earlier
                .figures
                .iter()
                .find(|one| one.name == now.name && one.unit == now.unit)?;
            Some((before, now))
        });
        pairs
            .map(|(before, now)| {
                let ratio = now.value / before.value;
                // How many times better; for times, smaller is.
                let gain = if now.unit == "ms" { 1.0 / ratio } else { ratio };
                let verdict = match gain {
                    gain if gain > 1.0 + NOISE => "better",
                    gain if gain < 1.0 / (1.0 + NOISE) => "worse",
                    _ => "same",
                };
                Compared {
                    name: now.name.clone(),
                    before: before.value,
                    now: now.value,
                    ratio,
                    verdict,
                }
            })
            .collect()
    }
}

/// The table for people; another machine's figures are named as such.
pub fn print(now: &Baseline, earlier: &Baseline, compared: &[Compared]) {
    if now.machine != earlier.machine {
        println!("the baseline is of another machine: {}", earlier.machine);
    }
    println!("{:<24} {:>10} {:>10} {:>7}", "", "before", "now", "ratio");
    for one in compared {
        println!(
            "{:<24} {:>10.4} {:>10.4} {:>7.2} {}",
            one.name, one.before, one.now, one.ratio, one.verdict
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn baseline(values: &[(&str, f64, &str)]) -> Baseline {
        let figures = values.iter().map(|&(name, value, unit)| Measured {
            name: name.to_owned(),
            value,
            unit: unit.to_owned(),
            wanted: "-".to_owned(),
        });
        Baseline {
            machine: "a machine".to_owned(),
            figures: figures.collect(),
        }
    }

    #[test]
    fn less_time_and_more_speed_are_better_and_noise_is_neither() {
        let before = baseline(&[("see", 1.0, "ms"), ("play", 8.0, "x"), ("gone", 1.0, "ms")]);
        let now = baseline(&[("see", 0.5, "ms"), ("play", 4.0, "x"), ("new", 1.0, "ms")]);
        let verdicts: Vec<_> = now
            .compared(&before)
            .iter()
            .map(|one| one.verdict)
            .collect();
        assert_eq!(verdicts, ["better", "worse"]);
        let near = baseline(&[("see", 1.05, "ms")]);
        assert_eq!(near.compared(&before)[0].verdict, "same");
    }

    #[test]
    fn a_saved_baseline_reads_back() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("baseline.json");
        let saved = baseline(&[("see", 1.25, "ms")]);
        saved.save(&path).expect("written");
        assert_eq!(Baseline::load(&path).expect("read"), saved);
        let message = Baseline::load(&folder.path().join("none.json")).expect_err("no file");
        assert!(message.to_string().contains("none.json"));
    }
}
