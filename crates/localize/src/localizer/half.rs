//! Which half of the field? What compass readings say about it, and whether the compass still turns with the robot.

use crate::config::CompassConfig;
use crate::frame::wrap_angle;
use crate::stamp::Stamp;

/// Evidence that the belief's half of the field is the right one.
///
/// Readings of one compass are no independent witnesses: a stuck one, or one beside a motor, contradicts for as long as
/// it likes. Once the half is well established, only a compass that was seen to turn with the robot may overturn it.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct HalfEvidence {
    /// Log odds that the half is right rather than the other one.
    odds: f32,
    /// Earned by many readings, or told.
    established: bool,
    watch: Option<Watch>,
}

/// Part of a frame's evidence by goals that counts: neighbouring frames show the same goal in the same light.
const GOAL_SHARE: f32 = 0.2;

/// How the belief's heading minus the compass's behaves: constant if the compass lives, whatever its offset.
#[derive(Debug, Clone, Copy)]
struct Watch {
    at: Stamp,
    /// The deviation when the watch began; the others are relative to it.
    origin: f32,
    mean: f32,
    readings: f32,
    recent: f32,
    /// The belief's heading when the watch began.
    heading: f32,
    /// Largest turn since.
    turned: f32,
}

impl HalfEvidence {
    /// As after a search: known with these odds, but not by many readings.
    pub(super) fn with_odds(odds: f32) -> Self {
        HalfEvidence {
            odds,
            ..HalfEvidence::default()
        }
    }

    /// Told by someone who knows.
    pub(super) fn told(config: &CompassConfig) -> Self {
        HalfEvidence {
            odds: config.evidence_max,
            established: true,
            watch: None,
        }
    }

    /// Log odds that the belief's half is right.
    pub(super) fn odds(&self) -> f32 {
        self.odds
    }

    /// Coloured goals were seen, with these log odds for the belief's half.
    pub(super) fn sees_goals(&mut self, odds: f32, config: &CompassConfig) {
        let most = config.reading_max;
        self.odds = (self.odds + GOAL_SHARE * odds.clamp(-most, most))
            .clamp(-config.evidence_max, config.evidence_max);
        self.established |= self.odds >= config.evidence_max;
    }

    /// The belief went to the other half.
    pub(super) fn half_turned(&mut self) {
        *self = HalfEvidence {
            odds: -self.odds,
            established: false,
            watch: None,
        };
    }

    /// Someone else's word, log odds: team-mates who know their half see the ball here or opposite.
    pub(super) fn add(&mut self, odds: f32, config: &CompassConfig) {
        if odds.is_finite() {
            self.odds = (self.odds + odds).clamp(-config.evidence_max, config.evidence_max);
        }
    }

    /// Hears a reading while the belief's heading is `heading`.
    pub(super) fn hear(
        &mut self,
        stamp: Stamp,
        heading: f32,
        reading: f32,
        config: &CompassConfig,
    ) {
        let deviation = wrap_angle(heading - reading);
        let watch = match self.watch {
            Some(watch) => watch.after(stamp, heading, deviation, config),
            None => Watch::new(stamp, heading, deviation),
        };
        self.watch = Some(watch);
        let evidence = evidence(deviation, config);
        let lives = watch.turned >= config.alive_turn_deg.to_radians();
        if evidence >= 0.0 || lives || !self.established {
            self.odds = (self.odds + evidence).clamp(-config.evidence_max, config.evidence_max);
            self.established |= self.odds >= config.evidence_max;
        }
    }
}

impl Watch {
    fn new(at: Stamp, heading: f32, deviation: f32) -> Self {
        Watch {
            at,
            origin: deviation,
            mean: 0.0,
            readings: 1.0,
            recent: 0.0,
            heading,
            turned: 0.0,
        }
    }

    /// One reading later; begun anew if the compass no longer turns with the robot.
    fn after(mut self, stamp: Stamp, heading: f32, deviation: f32, config: &CompassConfig) -> Self {
        let since = self.at.seconds_until(stamp).max(0.0) as f32;
        self.at = stamp;
        let relative = wrap_angle(deviation - self.origin);
        // Noise averages out over a few tenths of a second; a compass that sticks does not come back in that time.
        let share = 1.0 - (-since / config.noise_time).exp();
        self.recent += share * wrap_angle(relative - self.recent);
        self.readings += 1.0;
        self.mean += wrap_angle(relative - self.mean) / self.readings;
        self.turned = self.turned.max(wrap_angle(heading - self.heading).abs());
        if wrap_angle(self.recent - self.mean).abs() > 3.0 * config.std_deg.to_radians() {
            return Watch::new(stamp, heading, deviation);
        }
        self
    }
}

/// Log odds of one reading for the half in which the heading deviates by `deviation` from it.
fn evidence(deviation: f32, config: &CompassConfig) -> f32 {
    let std = config.std_deg.to_radians();
    let other = std::f32::consts::PI - deviation.abs();
    (0.5 * (other * other - deviation * deviation) / (std * std))
        .clamp(-config.reading_max, config.reading_max)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ten seconds at 30 Hz of a robot that turns at 0.5 rad/s, the compass told by `reading`.
    fn drive(evidence: &mut HalfEvidence, from: f32, reading: impl Fn(f32, usize) -> f32) {
        let config = CompassConfig::default();
        for k in 0..300 {
            let time = from + k as f32 / 30.0;
            let heading = wrap_angle(0.5 * time);
            let noise = 0.1 * (k as f32 * 2.4).sin();
            let reading = wrap_angle(reading(heading, k) + noise);
            evidence.hear(
                Stamp::from_seconds(f64::from(time)),
                heading,
                reading,
                &config,
            );
        }
    }

    #[test]
    fn a_stuck_compass_does_not_overturn_an_established_half() {
        let mut half = HalfEvidence::default();
        drive(&mut half, 0.0, |heading, _| heading);
        assert!(half.odds() >= 9.0);
        drive(&mut half, 10.0, |_, _| -1.3);
        assert!(half.odds() >= 9.0, "{}", half.odds());
    }

    #[test]
    fn a_compass_that_turns_with_the_robot_overturns_a_wrong_half() {
        let mut half = HalfEvidence::told(&CompassConfig::default());
        drive(&mut half, 0.0, |heading, _| heading + std::f32::consts::PI);
        assert!(half.odds() <= -9.0, "{}", half.odds());
    }

    #[test]
    fn a_half_that_is_not_established_yields_at_once() {
        let mut half = HalfEvidence::with_odds(2.0);
        let config = CompassConfig::default();
        for k in 0..3 {
            half.hear(Stamp(k * 33_000_000), 0.0, 3.1, &config);
        }
        assert!(half.odds() < -2.0, "{}", half.odds());
    }
}
