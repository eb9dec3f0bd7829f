//! Is it slower than before? Measured figures saved in a file, compared with those of this run.

use std::path::Path;

use anyhow::{Context, Result};
use localize::input_file;
use serde::{Deserialize, Serialize};
use vision::output_file::write_file;

use super::measure::BenchFigure;

/// Relative difference of a time that counts as noise of the host.
const TIME_TOLERANCE: f64 = 0.1;
/// The same for other figures: equal seeds give equal figures, but compilers and processors differ in the last digits.
const VALUE_TOLERANCE: f64 = 0.01;

/// Figures of a run, as `bench --json` prints them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Baseline {
    /// Processor and number of cores.
    pub machine: String,
    /// Name, value, unit and bound.
    pub figures: Vec<BenchFigure>,
}

impl BenchFigure {
    /// Cost of a value by its bound: lower is better under `<=`, higher under `>=`, nearer under `about`.
    fn cost(&self, value: f64) -> f64 {
        if self.wanted.starts_with(">=") || self.unit.contains("real time") {
            return -value;
        }
        match self.wanted.strip_prefix("about ").map(str::parse::<f64>) {
            Some(Ok(aim)) => (value - aim).abs(),
            // Times without a bound, and counts that should be 0.
            _ => value,
        }
    }

    /// True if its bound is met. None without a bound.
    fn meets_bound(&self) -> Option<bool> {
        let bound = self.wanted.trim_start_matches(['<', '>', '=', ' ']);
        let bound: f64 = bound.parse().ok()?;
        Some(if self.wanted.starts_with(">=") {
            self.value >= bound
        } else {
            self.value <= bound
        })
    }

    /// Relative changes below this are noise.
    fn tolerance(&self) -> f64 {
        if self.is_timed() {
            TIME_TOLERANCE
        } else {
            VALUE_TOLERANCE
        }
    }
}

/// A figure and its earlier value.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct FigureComparison {
    /// Its name.
    pub name: String,
    /// Earlier value.
    pub before: f64,
    /// Value now.
    pub now: f64,
    /// Now over before. None if it was 0.
    pub ratio: Option<f64>,
    /// "same", "better" or "worse".
    pub verdict: &'static str,
}

impl Baseline {
    /// Reads what `bench --save` or `bench --json` wrote.
    pub(super) fn load(path: &Path) -> Result<Self> {
        let text = input_file::read_text(path)
            .with_context(|| format!("cannot read {}", path.display()))?;
        serde_json::from_str(&text).with_context(|| path.display().to_string())
    }

    /// Writes the file.
    pub(super) fn save(&self, path: &Path) -> Result<()> {
        let text = serde_json::to_string_pretty(self)?;
        write_file(path, text).with_context(|| format!("cannot write {}", path.display()))
    }

    /// Compares the figures that both have, in this one's order.
    pub(super) fn compare_with(&self, earlier: &Baseline) -> Vec<FigureComparison> {
        let pairs = self.figures.iter().filter_map(|now| {
            let before = earlier
                .figures
                .iter()
                .find(|figure| figure.name == now.name && figure.unit == now.unit)?;
            Some((before, now))
        });
        pairs
            .map(|(before, now)| {
                let change = now.cost(now.value) - now.cost(before.value);
                let noise = now.tolerance() * before.value.abs();
                let verdict = match change {
                    change if change > noise => "worse",
                    change if change < -noise => "better",
                    _ => "same",
                };
                FigureComparison {
                    name: now.name.clone(),
                    before: before.value,
                    now: now.value,
                    ratio: (before.value != 0.0).then(|| now.value / before.value),
                    verdict,
                }
            })
            .collect()
    }

    /// Names of figures that only the earlier one has.
    pub(super) fn missing(&self, earlier: &Baseline) -> Vec<String> {
        let has = |name: &str| self.figures.iter().any(|figure| figure.name == name);
        let gone = earlier.figures.iter().filter(|figure| !has(&figure.name));
        gone.map(|figure| figure.name.clone()).collect()
    }
}

/// Prints a table: each figure with its bound and, if there is a baseline, its earlier value.
pub(super) fn print(
    now: &Baseline,
    earlier: Option<&Baseline>,
    compared: &[FigureComparison],
    gone: &[String],
) {
    if let Some(earlier) = earlier.filter(|earlier| earlier.machine != now.machine) {
        println!(
            "baseline of another machine: {} (times are not comparable)",
            earlier.machine
        );
    }
    for figure in &now.figures {
        println!("{}", line(figure, earlier.is_some(), compared));
    }
    if earlier.is_none() {
        return;
    }
    let count = |verdict| {
        compared
            .iter()
            .filter(|pair| pair.verdict == verdict)
            .count()
    };
    println!(
        "{} better, {} worse, {} the same (times within {:.0} %, other figures within {:.0} %)",
        count("better"),
        count("worse"),
        count("same"),
        100.0 * TIME_TOLERANCE,
        100.0 * VALUE_TOLERANCE
    );
    if !gone.is_empty() {
        println!("in the baseline only: {}", gone.join(", "));
    }
}

fn line(figure: &BenchFigure, has_baseline: bool, compared: &[FigureComparison]) -> String {
    let BenchFigure {
        name,
        value,
        p99,
        unit,
        wanted,
    } = figure;
    let missed = if figure.meets_bound() == Some(false) {
        " missed"
    } else {
        ""
    };
    let mut line = format!("{name:<26} {value:>10.4} {unit:<16} wanted {wanted:<10}{missed:<7}");
    if let Some(p99) = p99 {
        line += &format!(" 99 % {p99:>8.4}");
    }
    if has_baseline {
        let was = compared.iter().find(|pair| pair.name == *name);
        line += &was.map_or_else(
            || " new".to_owned(),
            |was| {
                let ratio = was
                    .ratio
                    .map_or_else(String::new, |ratio| format!(" x {ratio:.2}"));
                format!(" was {:>10.4}{ratio:<8} {}", was.before, was.verdict)
            },
        );
    }
    line.trim_end().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn baseline(values: &[(&str, f64, &str)]) -> Baseline {
        let values: Vec<_> = values.iter().map(|&(n, v, u)| (n, v, u, "-")).collect();
        bounded(&values)
    }

    fn bounded(values: &[(&str, f64, &str, &str)]) -> Baseline {
        let figures = values
            .iter()
            .map(|&(name, value, unit, wanted)| BenchFigure {
                name: name.to_owned(),
                value,
                p99: None,
                unit: unit.to_owned(),
                wanted: wanted.to_owned(),
            });
        Baseline {
            machine: "a machine".to_owned(),
            figures: figures.collect(),
        }
    }

    #[test]
    fn verdict_follows_speed_and_ignores_changes_below_tolerance() {
        let before = baseline(&[
            ("see", 1.0, "ms"),
            ("play", 8.0, "x real time"),
            ("gone", 1.0, "ms"),
        ]);
        let now = baseline(&[
            ("see", 0.5, "ms"),
            ("play", 4.0, "x real time"),
            ("new", 1.0, "ms"),
        ]);
        let verdicts: Vec<_> = now
            .compare_with(&before)
            .iter()
            .map(|pair| pair.verdict)
            .collect();
        assert_eq!(verdicts, ["better", "worse"]);
        let near = baseline(&[("see", 1.05, "ms")]);
        assert_eq!(near.compare_with(&before)[0].verdict, "same");
    }

    #[test]
    fn accuracy_verdict_follows_the_direction_of_the_bound() {
        let before = bounded(&[
            ("error", 0.40, "cm", "<= 0.7"),
            ("found", 99.0, "%", ">= 97"),
            ("nees", 3.5, "", "about 3"),
            ("alarms", 0.0, "frames", "0"),
        ]);
        let now = bounded(&[
            ("error", 0.42, "cm", "<= 0.7"),
            ("found", 99.5, "%", ">= 97"),
            ("nees", 2.9, "", "about 3"),
            ("alarms", 2.0, "frames", "0"),
        ]);
        let compared = now.compare_with(&before);
        let verdicts: Vec<_> = compared.iter().map(|pair| pair.verdict).collect();
        assert_eq!(verdicts, ["worse", "same", "better", "worse"]);
        assert_eq!(compared[3].ratio, None);
        assert_eq!(now.figures[3].meets_bound(), Some(false));
        assert_eq!(now.figures[2].meets_bound(), None);
        assert_eq!(baseline(&[]).missing(&now).len(), 4);
        assert!(line(&now.figures[3], true, &compared).contains("missed"));
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
