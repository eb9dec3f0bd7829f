//! How is the field lit? Uniform light whose level changes with time, and spots of lamps and windows.

use serde::{Deserialize, Serialize};

/// `[light]` of a scenario; levels are relative to the light that suits the default exposure.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LightConfig {
    /// Constant level, used without keyframes.
    pub level: f32,
    /// Colour of the light: red, green and blue, relative to white.
    #[serde(deserialize_with = "localize::fixed_array::deserialize")]
    pub colour: [f32; 3],
    /// Levels at given times, interpolated linearly.
    pub keyframes: Vec<LightKeyframe>,
    /// Lamps and windows: brighter (or darker) parts of the field.
    pub spots: Vec<LightSpot>,
}

impl Default for LightConfig {
    fn default() -> Self {
        LightConfig {
            level: 1.0,
            colour: [1.0; 3],
            keyframes: Vec::new(),
            spots: Vec::new(),
        }
    }
}

/// The level at a time.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LightKeyframe {
    /// Seconds.
    pub time: f64,
    /// Relative level.
    pub level: f32,
}

/// A round spot of light on the field.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LightSpot {
    /// Centre on the field, metres.
    pub x: f32,
    /// Centre on the field, metres.
    pub y: f32,
    /// Radius at which it has decayed to 1/e, metres.
    pub radius: f32,
    /// Light added at its centre, relative to the uniform light; negative for a shadow.
    pub strength: f32,
    /// White gloss added at its centre: the reflection of a window on the floor, independent of the floor's colour.
    #[serde(default)]
    pub gloss: f32,
}

/// Largest level of light, and strength of a spot, relative to the usual light.
const LEVEL_MAX: f32 = 1000.0;
/// Largest coordinate and radius of a spot, metres.
const SPOT_COORDINATE_MAX: f32 = 1000.0;

impl LightSpot {
    fn is_sound(&self) -> bool {
        let far = |value: f32| !(value.abs() <= SPOT_COORDINATE_MAX);
        !far(self.x)
            && !far(self.y)
            && (1e-3..=SPOT_COORDINATE_MAX).contains(&self.radius)
            && self.strength.abs() <= LEVEL_MAX
            && (0.0..=LEVEL_MAX).contains(&self.gloss)
    }
}

impl LightConfig {
    /// The level at a time.
    pub fn level_at(&self, time: f64) -> f32 {
        let keys = &self.keyframes;
        let after = keys.partition_point(|key| key.time <= time);
        match (after.checked_sub(1).map(|i| keys[i]), keys.get(after)) {
            (Some(before), Some(next)) => {
                let part = ((time - before.time) / (next.time - before.time)) as f32;
                before.level + part * (next.level - before.level)
            }
            (Some(end), None) => end.level,
            (None, Some(first)) => first.level,
            (None, None) => self.level,
        }
    }

    /// Light at a point of the field relative to the uniform light, and the gloss there.
    pub(crate) fn spot_light_at(&self, x: f32, y: f32) -> (f32, f32) {
        let mut sum = (1.0, 0.0);
        for spot in &self.spots {
            let distance2 = (x - spot.x).powi(2) + (y - spot.y).powi(2);
            let part = (-distance2 / (spot.radius * spot.radius)).exp();
            sum.0 += spot.strength * part;
            sum.1 += spot.gloss * part;
        }
        (sum.0.max(0.0), sum.1.max(0.0))
    }

    pub(crate) fn check(&self) -> Result<(), (String, String)> {
        let level_ok = |level: f32| (0.0..=LEVEL_MAX).contains(&level);
        let keys_ok = self.keyframes.iter().all(|key| level_ok(key.level));
        if !level_ok(self.level) || !keys_ok || !self.colour.iter().all(|&part| level_ok(part)) {
            return Err((
                "level".to_owned(),
                format!("invalid level (expected numbers from 0 to {LEVEL_MAX})"),
            ));
        }
        if self
            .keyframes
            .windows(2)
            .any(|pair| !(pair[0].time < pair[1].time))
            || !self.keyframes.iter().all(|key| key.time.is_finite())
        {
            return Err((
                "keyframes".to_owned(),
                "invalid order (expected increasing times)".to_owned(),
            ));
        }
        if self.spots.iter().any(|spot| !spot.is_sound()) {
            return Err((
                "spots".to_owned(),
                format!(
                    "invalid spot (expected coordinates up to {SPOT_COORDINATE_MAX}, radius above 0 to {SPOT_COORDINATE_MAX}, strength and gloss up to {LEVEL_MAX}, gloss of at least 0)"
                ),
            ));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn light_level_is_interpolated_linearly() {
        let key = |time, level| LightKeyframe { time, level };
        let light = LightConfig {
            keyframes: vec![key(1.0, 1.0), key(3.0, 0.5)],
            ..LightConfig::default()
        };
        assert_eq!(light.level_at(0.0), 1.0);
        assert_eq!(light.level_at(2.0), 0.75);
        assert_eq!(light.level_at(9.0), 0.5);
    }
}
