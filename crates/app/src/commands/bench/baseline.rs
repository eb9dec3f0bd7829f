//! Is it slower than it was? Measured figures kept in a file, and this run's beside them.

use std::path::Path;

use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};

/// A difference below this part of the old value is the host's noise, in times.
const TIME_TOLERANCE: f64 = 0.1;
/// The same in all else: equal seeds give equal figures, another compiler or processor other last digits.
const VALUE_TOLERANCE: f64 = 0.01;

/// Figures of a run, as `bench --json` prints them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Baseline {
    /// Processor and number of cores.
    pub machine: String,
    /// Name, value, unit and what is wanted.
    pub figures: Vec<BaselineFigure>,
}

/// One figure.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BaselineFigure {
    /// Its name.
    pub name: String,
    /// Its value.
    pub value: f64,
    /// Its unit.
    pub unit: String,
    /// Bound to be met, as text with its direction.
    pub wanted: String,
}

impl BaselineFigure {
    /// How bad a value is, as its bound tells: small ones are good under `<=`, large ones under `>=`, near ones to `about`.
    fn cost(&self, value: f64) -> f64 {
        if self.wanted.starts_with(">=") || self.unit.contains("real time") {
            return -value;
        }
        match self.wanted.strip_prefix("about ").map(str::parse::<f64>) {
            Some(Ok(aim)) => (value - aim).abs(),
            // Also of times without a bound, and of counts that should be 0.
            _ => value,
        }
    }

    /// Is its bound met? None where there is none.
    fn meets_bound(&self) -> Option<bool> {
        let bound = self.wanted.trim_start_matches(['<', '>', '=', ' ']);
        let bound: f64 = bound.parse().ok()?;
        Some(if self.wanted.starts_with(">=") {
            self.value >= bound
        } else {
            self.value <= bound
        })
    }

    /// Changes below this part of the value mean nothing.
    fn tolerance(&self) -> f64 {
        let timed = self.unit == "ms" || self.unit.contains("real time");
        if timed {
            TIME_TOLERANCE
        } else {
            VALUE_TOLERANCE
        }
    }
}

/// A figure beside its earlier value.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FigureComparison {
    /// Its name.
    pub name: String,
    /// What it was.
    pub before: f64,
    /// What it is.
    pub now: f64,
    /// Now over before; none of a figure that was 0.
    pub ratio: Option<f64>,
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
    pub fn compare_with(&self, earlier: &Baseline) -> Vec<FigureComparison> {
        let pairs = self.figures.iter().filter_map(|now| {
            let before = earlier
                .figures
                .iter()
                .find(|one| one.name == now.name && one.unit == now.unit)?;
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

    /// Names that the earlier one has and this one has not.
    pub fn missing(&self, earlier: &Baseline) -> Vec<String> {
        let known = |name: &str| self.figures.iter().any(|one| one.name == name);
        let gone = earlier.figures.iter().filter(|one| !known(&one.name));
        gone.map(|one| one.name.clone()).collect()
    }
}

/// The table for people: each figure beside its bound and, if there is a baseline, beside what it was.
pub fn print(
    now: &Baseline,
    earlier: Option<&Baseline>,
    compared: &[FigureComparison],
    gone: &[String],
) {
    if let Some(earlier) = earlier.filter(|earlier| earlier.machine != now.machine) {
        println!(
            "the baseline is of another machine ({}): its times are not these",
            earlier.machine
        );
    }
    for figure in &now.figures {
        println!("{}", line(figure, earlier.is_some(), compared));
    }
    if earlier.is_none() {
        return;
    }
    let count = |verdict| compared.iter().filter(|one| one.verdict == verdict).count();
    println!(
        "{} better, {} worse, {} the same (times within {:.0} %, all else within {:.0} %)",
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

fn line(figure: &BaselineFigure, has_baseline: bool, compared: &[FigureComparison]) -> String {
    let BaselineFigure {
        name,
        value,
        unit,
        wanted,
    } = figure;
    let missed = if figure.meets_bound() == Some(false) {
        " missed"
    } else {
        ""
    };
    let mut line = format!("{name:<26} {value:>10.4} {unit:<16} wanted {wanted:<10}{missed:<7}");
    if has_baseline {
        let was = compared.iter().find(|one| one.name == *name);
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
            .map(|&(name, value, unit, wanted)| BaselineFigure {
                name: name.to_owned(),
                value,
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
            .map(|one| one.verdict)
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
        let verdicts: Vec<_> = compared.iter().map(|one| one.verdict).collect();
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
