//! Plotted curves as CSV.

use crate::view::curves::{Curve, unit_of};

/// The curves' samples of a time range: a line for each time at which one of them has a sample.
pub(super) fn csv(curves: &[(&str, Curve<'_>)], (from, to): (f64, f64)) -> String {
    let mut text = "time (s)".to_owned();
    for (name, _) in curves {
        let title = match unit_of(name) {
            "" => (*name).to_owned(),
            unit => format!("{name} ({unit})"),
        };
        text += &format!(",{}", quoted(&title));
    }
    text.push('\n');
    let mut next: Vec<usize> = curves
        .iter()
        .map(|(_, curve)| curve.between(from, to).start)
        .collect();
    loop {
        let times = curves
            .iter()
            .zip(&next)
            .filter(|((_, curve), next)| **next < curve.len())
            .map(|((_, curve), next)| curve.point(*next)[0]);
        let Some(time) = times.min_by(f64::total_cmp).filter(|time| *time <= to) else {
            return text;
        };
        let mut line = format!("{time:.6}");
        for ((_, curve), next) in curves.iter().zip(&mut next) {
            line.push(',');
            if *next < curve.len() && curve.point(*next)[0] == time {
                let value = curve.point(*next)[1];
                *next += 1;
                // An empty field where there is no value, as in the CSV files of other commands.
                match curve.text(value) {
                    Some(text) => line += &quoted(text),
                    None if value.is_finite() => line += &value.to_string(),
                    None => {}
                }
            }
        }
        if time >= from {
            text += &line;
            text.push('\n');
        }
    }
}

fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}
