//! What lies on the ground for a calibration with a strip? Bars of known lengths, in metres.

use std::ops::RangeInclusive;

use serde::{Deserialize, Serialize};

use crate::calibrate::CalibrationError;

/// A straight strip of alternating black and white bars on the ground, radially from the robot's axis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Strip {
    /// Distance of the first bar's near edge from the robot's axis, metres.
    pub first_edge: f64,
    /// Length of each bar, metres.
    pub spacing: f64,
    /// Number of bars.
    pub bars: usize,
    /// Width of the strip, metres.
    pub width: f64,
    /// Colour of the bar next to the robot.
    pub first_bar: BarColour,
}

/// A bar's colour.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BarColour {
    /// Black.
    Black,
    /// White.
    White,
}

/// Plausible values in metres. A value beyond them is in another unit.
const FIRST_EDGE: RangeInclusive<f64> = 0.05..=2.0;
const SPACING: RangeInclusive<f64> = 0.02..=1.0;
const WIDTH: RangeInclusive<f64> = 0.02..=2.0;

impl Strip {
    /// Refuses values that no strip on the floor has, and names the first one with the likely unit.
    pub fn check(&self) -> Result<(), CalibrationError> {
        let lengths = [
            ("first_edge", self.first_edge, FIRST_EDGE),
            ("spacing", self.spacing, SPACING),
            ("width", self.width, WIDTH),
        ];
        for (key, value, plausible) in &lengths {
            if plausible.contains(value) {
                continue;
            }
            let all_in = |metres: f64| {
                let mut lengths = lengths.iter();
                lengths.all(|(_, value, plausible)| plausible.contains(&(value * metres)))
            };
            let unit = if all_in(0.01) {
                ". The file looks like centimetres"
            } else if all_in(0.001) {
                ". The file looks like millimetres"
            } else {
                ""
            };
            let (least, most) = (plausible.start(), plausible.end());
            return Err(CalibrationError::Value {
                key,
                value: *value,
                reason: format!("expected {least} to {most} metres{unit}"),
            });
        }
        if !(4..=1000).contains(&self.bars) {
            return Err(CalibrationError::Value {
                key: "bars",
                value: self.bars as f64,
                reason: "expected 4 to 1000 bars".to_owned(),
            });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strip_in_another_unit_is_refused_with_its_value_and_the_unit() {
        let scaled = |scale: f64| Strip {
            first_edge: scale * 0.4,
            spacing: scale * 0.25,
            bars: 23,
            width: scale * 0.3,
            first_bar: BarColour::Black,
        };
        scaled(1.0).check().expect("metres");
        for (scale, wanted) in [
            (
                100.0,
                "first_edge = 40: expected 0.05 to 2 metres. The file looks like centimetres",
            ),
            (
                1000.0,
                "first_edge = 400: expected 0.05 to 2 metres. The file looks like millimetres",
            ),
        ] {
            let message = scaled(scale).check().expect_err("refused").to_string();
            assert_eq!(message, wanted);
        }
        let mixed = Strip {
            spacing: 25.0,
            ..scaled(1.0)
        };
        let message = mixed.check().expect_err("refused").to_string();
        assert_eq!(message, "spacing = 25: expected 0.02 to 1 metres");
    }
}
