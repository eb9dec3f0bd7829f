//! Mirror profile: a surface of revolution, interpolated smoothly between samples without ringing at kinks.

use std::path::{Path, PathBuf};

use localize::input_file::{self, TEXT_BYTES_MAX};

use crate::csv_error;

/// A mirror of revolution about the camera's axis: height above the ground over radius.
///
/// ```
/// # fn main() -> Result<(), vision::optics::mirror::ProfileError> {
/// use vision::Profile;
///
/// // A cone: 1 cm higher for each centimetre of radius.
/// let radius: Vec<f64> = (0..10).map(|i| 0.01 * f64::from(i)).collect();
/// let height = radius.iter().map(|r| 0.7 + r).collect();
/// let cone = Profile::new(radius, height)?;
/// let (height, slope) = cone.height_and_slope(0.055);
/// assert!((height - 0.755).abs() < 1e-9 && (slope - 1.0).abs() < 1e-9);
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Profile {
    radius: Vec<f64>,
    height: Vec<f64>,
    slope: Vec<f64>,
}

/// Why a profile is invalid.
#[derive(Debug, thiserror::Error)]
pub enum ProfileError {
    /// The file cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// A line of the file is not a valid sample.
    #[error("{}: line {line}: {reason}", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// Counted from 1.
        line: u64,
        /// What is wrong.
        reason: String,
    },
    /// The samples do not form a profile.
    #[error("sample {index} (radius {radius} m): {reason}")]
    Sample {
        /// Counted from 0.
        index: usize,
        /// Its radius, metres.
        radius: f64,
        /// What is wrong.
        reason: String,
    },
}

/// Fewest samples that Akima's slopes need.
const SAMPLES_MIN: usize = 5;
/// Larger radii and heights mean that the file is not in metres.
const RADIUS_MAX: f64 = 2.0;
const HEIGHT_MAX: f64 = 10.0;

/// A steeper rise between two samples is no mirror, but a number whose end is missing.
const SLOPE_MAX: f64 = 50.0;

/// Radii and heights up to which a profile that is not in metres is in centimetres.
const CENTIMETRES_MAX: [f64; 2] = [50.0, 200.0];

/// The unit of a profile that is not in metres.
fn likely_unit(radius: &[f64], height: &[f64]) -> &'static str {
    let largest = |values: &[f64]| {
        values
            .iter()
            .fold(0.0_f64, |most, value| most.max(value.abs()))
    };
    let [radius_max, height_max] = CENTIMETRES_MAX;
    if largest(radius) <= radius_max && largest(height) <= height_max {
        "centimetres"
    } else {
        "millimetres"
    }
}

impl Profile {
    /// Interpolates samples of (radius, height above the ground), metres.
    ///
    /// Slopes are Akima's: local, exact on straight parts, and without ringing next to a kink.
    pub fn new(radius: Vec<f64>, height: Vec<f64>) -> Result<Self, ProfileError> {
        let refuse = |index: usize, reason: &str| {
            let radius = radius.get(index).copied().unwrap_or(f64::NAN);
            Err(ProfileError::Sample {
                index,
                radius,
                reason: reason.to_owned(),
            })
        };
        if radius.len() != height.len() || radius.len() < SAMPLES_MIN {
            return refuse(
                radius.len().min(height.len()),
                "a profile needs at least five samples of radius and height",
            );
        }
        for index in 0..radius.len() {
            if !(radius[index].is_finite() && height[index].is_finite()) {
                return refuse(index, "not a finite number");
            }
            if radius[index] > RADIUS_MAX || height[index].abs() > HEIGHT_MAX {
                let unit = likely_unit(&radius, &height);
                let (r, h) = (radius[index], height[index]);
                return refuse(
                    index,
                    &format!(
                        "radius {r}, height {h} out of range (expected metres: radius <= {RADIUS_MAX}, \
                         height <= {HEIGHT_MAX}). These look like {unit}"
                    ),
                );
            }
            if radius[index] < 0.0 {
                return refuse(index, "negative radius (expected >= 0)");
            }
            if index > 0 && radius[index] <= radius[index - 1] {
                return refuse(
                    index,
                    "the profile folds back: each radius must exceed the one before",
                );
            }
            if index > 0 {
                let [rise, run] =
                    [&height, &radius].map(|values| values[index] - values[index - 1]);
                if rise.abs() > SLOPE_MAX * run {
                    let [before, here] = [height[index - 1], height[index]];
                    return refuse(
                        index,
                        &format!(
                            "height {here} after {before} (expected a slope below {SLOPE_MAX}): a cut number?"
                        ),
                    );
                }
            }
        }
        let slope = akima_slopes(&radius, &height);
        Ok(Profile {
            radius,
            height,
            slope,
        })
    }

    /// Reads `radius_m,height_m` (height above the ground) from a CSV file.
    pub fn load(path: &Path) -> Result<Self, ProfileError> {
        let at = |line, reason: String| ProfileError::Line {
            path: path.to_owned(),
            line,
            reason,
        };
        let not_a_row = |error: csv::Error| at(csv_error::line(&error), csv_error::reason(&error));
        let text = input_file::read(path, TEXT_BYTES_MAX).map_err(|source| ProfileError::Read {
            path: path.to_owned(),
            source,
        })?;
        let mut reader = csv::ReaderBuilder::new()
            .trim(csv::Trim::All)
            .from_reader(text.as_slice());
        let header = reader.headers().map_err(not_a_row)?;
        if header.iter().ne(["radius_m", "height_m"]) {
            let found = header.iter().collect::<Vec<_>>().join(",");
            return Err(at(
                1,
                format!("wrong header: {found:?} (expected radius_m,height_m)"),
            ));
        }
        let (mut radius, mut height, mut lines) = (Vec::new(), Vec::new(), Vec::new());
        for record in reader.records() {
            let record = record.map_err(not_a_row)?;
            let line = record.position().map_or(0, csv::Position::line);
            let number = |column: usize| {
                record[column]
                    .parse::<f64>()
                    .map_err(|error| at(line, format!("{:?}: {error}", &record[column])))
            };
            let (r, h) = (number(0)?, number(1)?);
            radius.push(r);
            height.push(h);
            lines.push(line);
        }
        Profile::new(radius, height).map_err(|error| match error {
            ProfileError::Sample { index, reason, .. } => at(
                lines.get(index).or(lines.last()).copied().unwrap_or(1),
                reason,
            ),
            other => other,
        })
    }

    /// Innermost and outermost radius, metres.
    pub fn radii(&self) -> (f64, f64) {
        (self.radius[0], self.radius[self.radius.len() - 1])
    }

    /// The samples: (radius, height above the ground), metres.
    pub fn samples(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        self.radius.iter().copied().zip(self.height.iter().copied())
    }

    /// Height above the ground (metres) and slope at a radius; extrapolated linearly beyond the ends.
    pub fn height_and_slope(&self, radius: f64) -> (f64, f64) {
        let last = self.radius.len() - 1;
        if radius <= self.radius[0] {
            return (
                self.height[0] + self.slope[0] * (radius - self.radius[0]),
                self.slope[0],
            );
        }
        if radius >= self.radius[last] {
            return (
                self.height[last] + self.slope[last] * (radius - self.radius[last]),
                self.slope[last],
            );
        }
        let upper = self.radius.partition_point(|&r| r <= radius).min(last);
        let lower = upper - 1;
        let step = self.radius[upper] - self.radius[lower];
        let s = (radius - self.radius[lower]) / step;
        let (h0, h1) = (self.height[lower], self.height[upper]);
        let (m0, m1) = (self.slope[lower] * step, self.slope[upper] * step);
        // Cubic Hermite: h0 + s·(m0 + s·(b + s·a)).
        let a = 2.0 * (h0 - h1) + m0 + m1;
        let b = 3.0 * (h1 - h0) - 2.0 * m0 - m1;
        (
            h0 + s * (m0 + s * (b + s * a)),
            (m0 + s * (2.0 * b + 3.0 * s * a)) / step,
        )
    }
}

/// Akima's slopes: adjacent secants, each weighted by the disagreement of the secants on the other side.
fn akima_slopes(x: &[f64], y: &[f64]) -> Vec<f64> {
    let count = x.len();
    let secant: Vec<f64> = (0..count - 1)
        .map(|i| (y[i + 1] - y[i]) / (x[i + 1] - x[i]))
        .collect();
    let secant_at = |i: isize| -> f64 {
        let last = secant.len() as isize - 1;
        match i {
            ..0 => secant[0] + i as f64 * (secant[1] - secant[0]),
            i if i > last => {
                let last = last as usize;
                secant[last] + (i as usize - last) as f64 * (secant[last] - secant[last - 1])
            }
            i => secant[i as usize],
        }
    };
    (0..count as isize)
        .map(|i| {
            let [before2, before, after, after2] = [i - 2, i - 1, i, i + 1].map(secant_at);
            let (left, right) = ((after2 - after).abs(), (before - before2).abs());
            let total = left + right;
            // Rounding noise of equal secants must not decide the weights.
            if total <= 1e-9 * (1.0 + before.abs() + after.abs()) {
                (before + after) / 2.0
            } else {
                (left * before + right * after) / total
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn profile_reproduces_a_sphere_between_samples() {
        let sphere = |r: f64| 1.0 - (0.25 - r * r).sqrt();
        let radius: Vec<f64> = (0..800).map(|i| f64::from(i) * 0.0005).collect();
        let height = radius.iter().map(|&r| sphere(r)).collect();
        let profile = Profile::new(radius, height).expect("a profile");
        for r in [0.0313, 0.1507, 0.2999] {
            let (height, slope) = profile.height_and_slope(r);
            assert!(
                (height - sphere(r)).abs() < 1e-8,
                "height off by {:e}",
                height - sphere(r)
            );
            assert!((slope - r / (0.25 - r * r).sqrt()).abs() < 1e-6);
        }
    }

    #[test]
    fn profile_does_not_overshoot_at_a_kink() {
        let radius: Vec<f64> = (0..20).map(|i| 0.1 * f64::from(i)).collect();
        let height: Vec<f64> = radius
            .iter()
            .map(|&r| if r < 1.0 { r } else { 1.0 + 0.2 * (r - 1.0) })
            .collect();
        let profile = Profile::new(radius, height).expect("a profile");
        let (height, slope) = profile.height_and_slope(0.85);
        assert!((height - 0.85).abs() < 1e-9 && (slope - 1.0).abs() < 1e-9);
    }

    #[test]
    fn profile_in_another_unit_is_refused_with_its_value_and_the_unit() {
        let metres: Vec<(f64, f64)> = (0..30)
            .map(|i| 0.005 * f64::from(i))
            .map(|r| (r, 0.7 + r))
            .collect();
        let scaled = |scale: f64| {
            let (radius, height) = metres.iter().map(|(r, h)| (scale * r, scale * h)).unzip();
            Profile::new(radius, height)
        };
        scaled(1.0).expect("metres");
        for (scale, value, unit) in [
            (100.0, "height 70", "centimetres"),
            (1000.0, "height 700", "millimetres"),
        ] {
            let message = scaled(scale).expect_err(unit).to_string();
            assert!(
                message.contains(value) && message.ends_with(unit),
                "{message}"
            );
        }
    }

    /// What is said of a file, without its path.
    fn refusal(content: &[u8]) -> String {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("mirror.csv");
        std::fs::write(&path, content).expect("written");
        let message = Profile::load(&path).expect_err("refused").to_string();
        let place = format!("{}: ", path.display());
        let reason = message.strip_prefix(&place);
        reason.unwrap_or_else(|| panic!("{message}")).to_owned()
    }

    #[test]
    fn non_monotonic_radius_is_rejected_with_its_line() {
        let message =
            refusal(b"radius_m,height_m\n0,0.8\n0.01,0.81\n0.02,0.82\n0.015,0.83\n0.03,0.84\n");
        assert!(message.starts_with("line 5: the profile folds back"));
    }

    #[test]
    fn cut_profile_is_rejected_with_its_last_line() {
        let whole = "radius_m,height_m\n0,0.8\n0.001,0.801\n0.002,0.802\n0.003,0.803\n0.004,0.804\n0.005,0.805";
        for (cut, reason) in [
            (7, "line 7: has 1 fields, the header has 2"),
            (5, "line 7: \"\": cannot parse float from empty string"),
            (
                4,
                "line 7: height 0 after 0.804 (expected a slope below 50): a cut number?",
            ),
        ] {
            let message = refusal(&whole.as_bytes()[..whole.len() - cut]);
            assert_eq!(message, reason);
        }
    }

    #[test]
    fn bytes_that_are_no_text_are_rejected_with_their_line() {
        let message = refusal(b"radius_m,height_m\n0,0.8\n0.01,\xff\n");
        assert_eq!(message, "line 3: is not UTF-8 text");
    }
}
