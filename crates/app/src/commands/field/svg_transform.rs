//! Transforms of SVG elements that keep circles circles: translation, rotation, uniform scale and mirroring.

use anyhow::{Context, Result, bail, ensure};

use super::svg_path::{Scanner, Stroke};

/// x' = a x + c y + e, y' = b x + d y + f.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Similarity([f64; 6]);

impl Default for Similarity {
    fn default() -> Self {
        Similarity([1.0, 0.0, 0.0, 1.0, 0.0, 0.0])
    }
}

impl Similarity {
    pub(super) fn scaling(scale: f64) -> Self {
        Similarity([scale, 0.0, 0.0, scale, 0.0, 0.0])
    }

    /// Reads a list of transforms.
    pub(super) fn parse(text: &str) -> Result<Self> {
        let mut whole = Similarity::default();
        let mut rest = text.trim();
        while !rest.is_empty() {
            let (name, after) = rest.split_once('(').context("transform without '('")?;
            let (inside, after) = after.split_once(')').context("transform without ')'")?;
            let mut scanner = Scanner::new(inside);
            let mut values = Vec::new();
            while !scanner.is_at_end() {
                values.push(scanner.number()?);
            }
            whole = whole.then_inner(&Similarity(matrix(name.trim(), &values)?));
            rest = after.trim_start_matches(|letter: char| letter.is_whitespace() || letter == ',');
        }
        let [a, b, c, d, ..] = whole.0;
        let (first, second) = (a.hypot(b), c.hypot(d));
        ensure!(
            first > 0.0
                && (first - second).abs() <= 1e-3 * first
                && (a * c + b * d).abs() <= 1e-3 * first * second,
            "transform {text:?} distorts circles (expected translate, rotate, uniform scale or mirroring)"
        );
        Ok(whole)
    }

    /// First `inner`, then this one.
    pub(super) fn then_inner(&self, inner: &Similarity) -> Similarity {
        let [a, b, c, d, e, f] = self.0;
        let [ia, ib, ic, id, ie, if_] = inner.0;
        Similarity([
            a * ia + c * ib,
            b * ia + d * ib,
            a * ic + c * id,
            b * ic + d * id,
            a * ie + c * if_ + e,
            b * ie + d * if_ + f,
        ])
    }

    fn point(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [a, b, c, d, e, f] = self.0;
        [a * x + c * y + e, b * x + d * y + f]
    }

    pub(super) fn stroke(&self, stroke: &Stroke) -> Stroke {
        let [a, b, c, d, ..] = self.0;
        match *stroke {
            Stroke::Line(from, to) => Stroke::Line(self.point(from), self.point(to)),
            Stroke::Arc {
                centre,
                start,
                sweep,
            } => Stroke::Arc {
                centre: self.point(centre),
                start: self.point(start),
                sweep: if a * d - b * c < 0.0 { -sweep } else { sweep },
            },
        }
    }
}

fn matrix(name: &str, values: &[f64]) -> Result<[f64; 6]> {
    let turned = |degrees: f64| {
        let (sin, cos) = degrees.to_radians().sin_cos();
        [cos, sin, -sin, cos]
    };
    Ok(match (name, values) {
        ("translate", &[x]) => [1.0, 0.0, 0.0, 1.0, x, 0.0],
        ("translate", &[x, y]) => [1.0, 0.0, 0.0, 1.0, x, y],
        ("scale", &[scale]) => [scale, 0.0, 0.0, scale, 0.0, 0.0],
        ("scale", &[x, y]) => [x, 0.0, 0.0, y, 0.0, 0.0],
        ("rotate", &[degrees]) => {
            let [a, b, c, d] = turned(degrees);
            [a, b, c, d, 0.0, 0.0]
        }
        ("rotate", &[degrees, x, y]) => {
            let [a, b, c, d] = turned(degrees);
            [a, b, c, d, x - a * x - c * y, y - b * x - d * y]
        }
        ("matrix", &[a, b, c, d, e, f]) => [a, b, c, d, e, f],
        _ => bail!(
            "transform {name:?} with {} numbers is not supported",
            values.len()
        ),
    })
}
