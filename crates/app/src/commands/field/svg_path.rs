//! Which lines and arcs does the path of an SVG element draw? Commands M, L, H, V, A and Z.

use anyhow::{Context, Result, bail};

/// A straight piece or a circular arc in user units; y points down.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Stroke {
    Line([f64; 2], [f64; 2]),
    /// From a start by a signed angle (radians, in the direction from x to y).
    Arc {
        centre: [f64; 2],
        start: [f64; 2],
        sweep: f64,
    },
}

/// Numbers and letters of a path or of a list of points.
pub(super) struct Scanner<'a> {
    rest: &'a str,
}

impl<'a> Scanner<'a> {
    pub(super) fn new(text: &'a str) -> Self {
        Scanner { rest: text }
    }

    fn skip(&mut self) {
        self.rest = self
            .rest
            .trim_start_matches(|letter: char| letter.is_whitespace() || letter == ',');
    }

    /// The next command letter, if the next sign is one.
    fn command(&mut self) -> Option<char> {
        self.skip();
        let letter = self.rest.chars().next().filter(char::is_ascii_alphabetic)?;
        self.rest = &self.rest[1..];
        Some(letter)
    }

    pub(super) fn is_at_end(&mut self) -> bool {
        self.skip();
        self.rest.is_empty()
    }

    fn has_number(&mut self) -> bool {
        self.skip();
        self.rest
            .starts_with(|letter: char| letter.is_ascii_digit() || "+-.".contains(letter))
    }

    /// The next number.
    pub(super) fn number(&mut self) -> Result<f64> {
        self.skip();
        let bytes = self.rest.as_bytes();
        let mut end = usize::from(matches!(bytes.first(), Some(b'+' | b'-')));
        let mut has_point = false;
        while let Some(&byte) = bytes.get(end) {
            match byte {
                b'0'..=b'9' => {}
                b'.' if !has_point => has_point = true,
                b'e' | b'E' => {
                    end += usize::from(matches!(bytes.get(end + 1), Some(b'+' | b'-')));
                }
                _ => break,
            }
            end += 1;
        }
        let text = self.rest.get(..end).unwrap_or_default();
        let value: f64 = text
            .parse()
            .ok()
            .filter(|value: &f64| value.is_finite())
            .with_context(|| {
                let near: String = self.rest.chars().take(12).collect();
                format!("no number at {near:?}")
            })?;
        self.rest = &self.rest[end..];
        Ok(value)
    }

    /// A flag of an arc: 0 or 1, which may stand directly before the next number.
    fn flag(&mut self) -> Result<bool> {
        self.skip();
        let flag = match self.rest.as_bytes().first() {
            Some(b'0') => false,
            Some(b'1') => true,
            _ => bail!("no flag (0 or 1) of an arc"),
        };
        self.rest = &self.rest[1..];
        Ok(flag)
    }
}

/// The strokes of a path.
pub(super) fn strokes(text: &str) -> Result<Vec<Stroke>> {
    let mut scanner = Scanner::new(text);
    let mut strokes = Vec::new();
    let [mut at, mut first] = [[0.0; 2]; 2];
    let mut command = None;
    while !scanner.is_at_end() {
        command = match scanner.command() {
            Some(letter) => Some(letter),
            // Further pairs after a move are lines.
            None if scanner.has_number() => match command {
                Some('M') => Some('L'),
                Some('m') => Some('l'),
                other => other,
            },
            None => bail!("path with the sign {:?}", scanner.rest.chars().next()),
        };
        let letter = command.context("path without a command")?;
        let origin = if letter.is_ascii_lowercase() {
            at
        } else {
            [0.0; 2]
        };
        let from = at;
        match letter.to_ascii_uppercase() {
            'M' => {
                at = [origin[0] + scanner.number()?, origin[1] + scanner.number()?];
                first = at;
                continue;
            }
            'L' => at = [origin[0] + scanner.number()?, origin[1] + scanner.number()?],
            'H' => at[0] = origin[0] + scanner.number()?,
            'V' => at[1] = origin[1] + scanner.number()?,
            'Z' => {
                at = first;
                // Numbers after it would belong to no command.
                command = None;
            }
            'A' => {
                let radii = [scanner.number()?, scanner.number()?];
                let _rotation = scanner.number()?;
                let (large, clockwise) = (scanner.flag()?, scanner.flag()?);
                at = [origin[0] + scanner.number()?, origin[1] + scanner.number()?];
                strokes.extend(arc(from, at, radii, large, clockwise)?);
                continue;
            }
            other => bail!(
                "path command {other:?} is not supported (expected M, L, H, V, A or Z). Convert curves to circular arcs or lines"
            ),
        }
        if from != at {
            strokes.push(Stroke::Line(from, at));
        }
    }
    Ok(strokes)
}

/// The circular arc between two points (SVG 1.1, F.6.5).
fn arc(
    from: [f64; 2],
    to: [f64; 2],
    [rx, ry]: [f64; 2],
    large: bool,
    positive: bool,
) -> Result<Option<Stroke>> {
    let (rx, ry) = (rx.abs(), ry.abs());
    let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
    let chord = dx.hypot(dy);
    if chord == 0.0 {
        return Ok(None);
    }
    if rx == 0.0 || ry == 0.0 {
        return Ok(Some(Stroke::Line(from, to)));
    }
    if (rx - ry).abs() > 1e-3 * rx.max(ry) {
        bail!("elliptic arc with radii {rx} and {ry} (expected a circular one)");
    }
    let radius = rx.max(chord / 2.0);
    let height = (radius * radius - chord * chord / 4.0).max(0.0).sqrt();
    let side = if large == positive { 1.0 } else { -1.0 };
    let centre = [
        (from[0] + to[0]) / 2.0 + side * height * dy / chord,
        (from[1] + to[1]) / 2.0 - side * height * dx / chord,
    ];
    let angle = |point: [f64; 2]| (point[1] - centre[1]).atan2(point[0] - centre[0]);
    let turn = (angle(to) - angle(from)).rem_euclid(std::f64::consts::TAU);
    let sweep = if positive {
        turn
    } else {
        turn - std::f64::consts::TAU
    };
    Ok(Some(Stroke::Arc {
        centre,
        start: from,
        sweep,
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn end(stroke: &Stroke) -> [f64; 2] {
        match *stroke {
            Stroke::Line(_, to) => to,
            Stroke::Arc {
                centre,
                start,
                sweep,
            } => {
                let (dx, dy) = (start[0] - centre[0], start[1] - centre[1]);
                let (sin, cos) = sweep.sin_cos();
                [
                    centre[0] + cos * dx - sin * dy,
                    centre[1] + sin * dx + cos * dy,
                ]
            }
        }
    }

    #[test]
    fn relative_and_absolute_commands_draw_the_same() {
        let absolute = strokes("M 1 2 L 4 2 V 6 H 1 Z").expect("a path");
        let relative = strokes("m1,2 3,0v4h-3z").expect("a path");
        assert_eq!(absolute, relative);
        assert_eq!(absolute.len(), 4);
    }

    #[test]
    fn arcs_end_where_the_path_says_whatever_the_flags() {
        for flags in ["0 0", "0 1", "1 0", "1 1"] {
            let drawn = strokes(&format!("M 3 1 A 2 2 0 {flags} 1 2")).expect("an arc");
            let [
                Stroke::Arc {
                    centre,
                    start,
                    sweep,
                },
            ] = drawn[..]
            else {
                panic!("{drawn:?}")
            };
            let [x, y] = end(&drawn[0]);
            assert!((x - 1.0).abs() < 1e-9 && (y - 2.0).abs() < 1e-9);
            let radius = (start[0] - centre[0]).hypot(start[1] - centre[1]);
            assert!((radius - 2.0).abs() < 1e-9);
            assert_eq!(sweep > 0.0, flags.ends_with('1'));
            assert_eq!(sweep.abs() > std::f64::consts::PI, flags.starts_with('1'));
        }
    }

    #[test]
    fn curves_and_ellipses_are_refused_by_name() {
        let error = strokes("M0 0 C 1 1 2 2 3 3")
            .expect_err("a curve")
            .to_string();
        assert!(error.contains("'C'"), "{error}");
        let error = strokes("M0 0 A 1 2 0 0 0 3 3")
            .expect_err("an ellipse")
            .to_string();
        assert!(error.contains("elliptic"), "{error}");
        assert!(
            strokes("M 0 x").is_err() && strokes("1 2").is_err() && strokes("M0 0 Z 4").is_err()
        );
    }

    #[test]
    fn flags_may_touch_the_next_number() {
        assert_eq!(
            strokes("M3 1A2 2 0 011 2").expect("an arc"),
            strokes("M3 1 A 2 2 0 0 1 1 2").expect("an arc")
        );
    }
}
