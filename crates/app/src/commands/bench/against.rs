//! Is it faster than another executable? Both measure the same figure in alternation: what else the machine does hits both.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, Result, ensure};
use serde::Serialize;

use super::baseline::Baseline;
use super::measure::BenchFigure;

/// Measurements of each executable, per figure.
const ROUNDS: usize = 5;

/// A timed figure of both executables.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct PairedFigure {
    /// Its name.
    pub name: String,
    /// Its unit.
    pub unit: String,
    /// Median over the rounds, of the other executable.
    pub other: f64,
    /// The same of this one.
    pub own: f64,
    /// This one over the other: median of the ratios of the rounds.
    pub ratio: f64,
    /// Smallest and largest ratio of a round.
    pub ratio_range: [f64; 2],
}

/// The two executables.
struct Pair {
    own: PathBuf,
    other: PathBuf,
}

/// Measures the timed figures among `names` that both executables have; calls `report` after each.
pub(super) fn compare_against(
    other: &Path,
    names: &[&str],
    mut report: impl FnMut(&PairedFigure),
) -> Result<Vec<PairedFigure>> {
    let pair = Pair {
        own: std::env::current_exe().context("cannot find this executable")?,
        // A bare name is a file here, too, and no command of the search path.
        other: std::path::absolute(other)
            .with_context(|| format!("cannot find {}", other.display()))?,
    };
    let mut paired = Vec::new();
    for name in names {
        if let Some(figure) = pair.compare(name)? {
            report(&figure);
            paired.push(figure);
        }
    }
    Ok(paired)
}

impl Pair {
    /// `None` for a figure that is not a time or that the other executable does not have.
    fn compare(&self, name: &str) -> Result<Option<PairedFigure>> {
        let mut rounds = Vec::new();
        let mut unit = String::new();
        for round in 0..ROUNDS {
            // Who is first changes from round to round: the second finds warmer caches of the system.
            let other_first = round % 2 == 0;
            let first = measure(if other_first { &self.other } else { &self.own }, name)?;
            let second = measure(if other_first { &self.own } else { &self.other }, name)?;
            let (Some(first), Some(second)) = (first, second) else {
                return Ok(None);
            };
            let (other, own) = if other_first {
                (first, second)
            } else {
                (second, first)
            };
            if !own.is_timed() || own.unit != other.unit {
                return Ok(None);
            }
            unit = own.unit;
            rounds.push([other.value, own.value]);
        }
        Ok(Some(PairedFigure::new(name, unit, &rounds)))
    }
}

impl PairedFigure {
    /// `rounds`: the values of the other executable and of this one.
    fn new(name: &str, unit: String, rounds: &[[f64; 2]]) -> Self {
        let sorted = |value: fn(&[f64; 2]) -> f64| {
            let mut values: Vec<f64> = rounds.iter().map(value).collect();
            values.sort_by(f64::total_cmp);
            values
        };
        let middle = rounds.len() / 2;
        let ratios = sorted(|[other, own]| own / other);
        PairedFigure {
            name: name.to_owned(),
            unit,
            other: sorted(|round| round[0])[middle],
            own: sorted(|round| round[1])[middle],
            ratio: ratios[middle],
            ratio_range: [ratios[0], ratios[rounds.len() - 1]],
        }
    }

    /// One line of the table.
    pub(super) fn line(&self) -> String {
        let [low, high] = self.ratio_range;
        format!(
            "{:<26} {:>10.4} {:<12} other {:>10.4}   x {:.3} ({low:.3} to {high:.3})",
            self.name, self.own, self.unit, self.other, self.ratio
        )
    }
}

/// One measurement by an executable. `None` if it does not know the figure.
fn measure(executable: &Path, name: &str) -> Result<Option<BenchFigure>> {
    let shown = executable.display();
    let output = Command::new(executable)
        .args(["bench", "--json", "--only", name])
        .stderr(Stdio::piped())
        .output()
        .with_context(|| format!("cannot run {shown}"))?;
    let message = String::from_utf8_lossy(&output.stderr);
    if message.contains("no figure's name contains") {
        return Ok(None);
    }
    ensure!(
        output.status.success(),
        "{shown} bench --only {name} failed: {}",
        message.trim()
    );
    let run: Baseline = serde_json::from_slice(&output.stdout)
        .with_context(|| format!("{shown} bench --json printed no figures"))?;
    Ok(run.figures.into_iter().find(|figure| figure.name == name))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ratio_is_of_rounds_not_of_medians() {
        // The machine halves its speed after two rounds; the ratio stays.
        let rounds = [
            [1.0, 0.8],
            [1.1, 0.88],
            [2.0, 1.6],
            [2.2, 1.76],
            [2.1, 1.68],
        ];
        let figure = PairedFigure::new("see", "ms".to_owned(), &rounds);
        assert!((figure.ratio - 0.8).abs() < 1e-12, "{figure:?}");
        assert!((figure.ratio_range[1] - figure.ratio_range[0]).abs() < 1e-12);
        assert_eq!((figure.other, figure.own), (2.0, 1.6));
    }

    #[test]
    fn executable_that_cannot_run_is_named() {
        let message = measure(Path::new("/nonexistent/mirrorball"), "see").expect_err("no file");
        assert!(message.to_string().contains("/nonexistent/mirrorball"));
    }
}
