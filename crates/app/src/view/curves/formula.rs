//! A series derived from others by a formula: `= 100 * {/truth/error.distance}`.
//!
//! A name in braces is a quantity or a field. `{NAME}'` is its change per second. The formula has a value at each sample
//! of the first name; the others have their last value before it.

use anyhow::{Context, Result, ensure};
use exmex::{Express, FlatEx};

use super::curve::{Curve, FORMULA_MARK};
use super::sample_series::SampleSeries;

/// Most samples computed at a time, so that no drawn frame waits.
const SAMPLES_PER_UPDATE: usize = 20_000;

/// A formula and its values so far.
pub(crate) struct FormulaSeries {
    formula: Formula,
    pub(crate) series: SampleSeries,
    /// Samples of the first input that have been used, and how far it was thinned then.
    used: (usize, usize),
}

struct Formula {
    expression: FlatEx<f64>,
    inputs: Vec<Input>,
    /// Number of the input of each variable of the expression.
    variables: Vec<usize>,
}

#[derive(Debug, Clone, PartialEq)]
struct Input {
    name: String,
    /// Its change per second instead of its value.
    rate: bool,
}

impl FormulaSeries {
    /// Parses a formula; the mark at its start may be left out.
    pub(crate) fn parse(text: &str) -> Result<Self> {
        Ok(FormulaSeries {
            formula: Formula::parse(text.trim_start_matches(FORMULA_MARK).trim())?,
            series: SampleSeries::default(),
            used: (0, 1),
        })
    }

    /// Names of the series that it is computed from.
    pub(crate) fn inputs(&self) -> impl Iterator<Item = &str> {
        self.formula.inputs.iter().map(|input| input.name.as_str())
    }

    /// Computes values at new samples of the first input. `complete`: no input will get further samples.
    pub(crate) fn update(&mut self, inputs: &[Curve<'_>], complete: bool) {
        let Some(first) = inputs.first() else {
            return;
        };
        if first.thinning() != self.used.1 || first.len() < self.used.0 {
            self.series = SampleSeries::default();
            self.used = (0, first.thinning());
        }
        // Where an input has not been read yet, its last value would be an old one.
        let ends = inputs.iter().map(|input| input.end());
        let end = ends.fold(f64::INFINITY, f64::min);
        let stop = first.len().min(self.used.0 + SAMPLES_PER_UPDATE);
        for index in self.used.0..stop {
            let [time, _] = first.point(index);
            if time > end && !complete {
                break;
            }
            self.series.push(time, self.formula.value(inputs, time));
            self.used.0 = index + 1;
        }
    }
}

impl Formula {
    fn parse(text: &str) -> Result<Self> {
        let mut inputs: Vec<Input> = Vec::new();
        let mut plain = String::new();
        let mut rest = text;
        while let Some((before, after)) = rest.split_once('{') {
            let (name, after) = after.split_once('}').context("a { without its }")?;
            let (rate, after) = match after.strip_prefix('\'') {
                Some(after) => (true, after),
                None => (false, after),
            };
            let name = name.trim().to_owned();
            ensure!(
                !name.is_empty() && !name.starts_with(FORMULA_MARK),
                "braces hold the name of a quantity or of a field"
            );
            let input = Input { name, rate };
            let known = inputs.iter().position(|other| *other == input);
            let number = known.unwrap_or_else(|| {
                inputs.push(input);
                inputs.len() - 1
            });
            plain += &format!("{before}input_{number}");
            rest = after;
        }
        plain += rest;
        ensure!(
            !inputs.is_empty(),
            "a formula needs a name in braces: = 100 * {{/truth/error.distance}}"
        );
        let expression: FlatEx<f64> =
            exmex::parse(&plain).map_err(|error| anyhow::anyhow!("{}", error.msg()))?;
        let variables = expression.var_names().iter().map(|name| {
            let number = name
                .strip_prefix("input_")
                .and_then(|text| text.parse().ok());
            number.with_context(|| format!("unknown name: {name} (names stand in braces)"))
        });
        Ok(Formula {
            variables: variables.collect::<Result<_>>()?,
            expression,
            inputs,
        })
    }

    fn value(&self, inputs: &[Curve<'_>], time: f64) -> f64 {
        let values = self.variables.iter().map(|number| {
            let (Some(curve), Some(input)) = (inputs.get(*number), self.inputs.get(*number)) else {
                return f64::NAN;
            };
            let until = curve.count_until(time);
            let Some([at, value]) = until.checked_sub(1).map(|index| curve.point(index)) else {
                return f64::NAN;
            };
            if !input.rate {
                return value;
            }
            match until.checked_sub(2).map(|index| curve.point(index)) {
                Some([before, last]) if at > before => (value - last) / (at - before),
                _ => f64::NAN,
            }
        });
        let values: Vec<f64> = values.collect();
        self.expression.eval(&values).unwrap_or(f64::NAN)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn series(points: &[[f64; 2]]) -> SampleSeries {
        let mut series = SampleSeries::default();
        for [time, value] in points {
            series.push(*time, *value);
        }
        series
    }

    #[test]
    fn a_formula_has_a_value_at_each_sample_of_its_first_name() {
        let first = series(&[[0.0, 1.0], [1.0, 2.0], [2.0, 4.0], [3.0, 8.0]]);
        let second = series(&[[0.5, 10.0], [1.9, 20.0]]);
        let mut sum = FormulaSeries::parse("= {/a.x} * 2 + {b c}").expect("a formula");
        assert_eq!(sum.inputs().collect::<Vec<_>>(), ["/a.x", "b c"]);
        let inputs = [Curve::Samples(&first), Curve::Samples(&second)];
        sum.update(&inputs, false);
        // Beyond the last sample of `b c` only once nothing more can come.
        assert_eq!(sum.series.len(), 2);
        sum.update(&inputs, true);
        assert!(sum.series.point(0)[1].is_nan());
        let values: Vec<f64> = (1..4).map(|index| sum.series.point(index)[1]).collect();
        assert_eq!(values, [14.0, 28.0, 36.0]);
    }

    #[test]
    fn a_prime_is_the_change_per_second() {
        let first = series(&[[0.0, 1.0], [0.5, 2.0], [1.0, -1.0]]);
        let mut rate = FormulaSeries::parse("abs({x}')").expect("a formula");
        rate.update(&[Curve::Samples(&first)], true);
        assert!(rate.series.point(0)[1].is_nan());
        assert_eq!(rate.series.point(1)[1], 2.0);
        assert_eq!(rate.series.point(2)[1], 6.0);
    }

    #[test]
    fn more_than_ten_names_keep_their_places() {
        let all: Vec<SampleSeries> = (0..12).map(|n| series(&[[0.0, f64::from(n)]])).collect();
        let names: Vec<String> = (0..12).map(|n| format!("{{n{n}}}")).collect();
        let text = format!("{} - {}", names[..11].join(" + "), names[11]);
        let mut formula = FormulaSeries::parse(&text).expect("a formula");
        let inputs: Vec<Curve<'_>> = all.iter().map(Curve::Samples).collect();
        formula.update(&inputs, true);
        assert_eq!(formula.series.point(0)[1], 55.0 - 11.0);
    }

    #[test]
    fn invalid_formulas_say_why() {
        for (text, reason) in [
            ("= 1 + 2", "braces"),
            ("= {a", "without its }"),
            ("= {a} +* ", ""),
            ("= {a} + b", "unknown name: b"),
            ("= {}", "braces"),
        ] {
            let error = FormulaSeries::parse(text).err().expect(text);
            assert!(format!("{error:#}").contains(reason), "{text}: {error:#}");
        }
    }
}
