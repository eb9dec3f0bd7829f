//! Which half of the field? What compass readings say about it, and whether the compass still turns with the robot.

use crate::config::CompassConfig;
use crate::frames::wrap_angle;
use crate::stamp::Stamp;

/// Evidence that the belief's half of the field is the right one.
///
/// Readings of one compass are no independent witnesses: a stuck one, or one beside a motor, contradicts for as long as
/// it likes. Once the half is well established, only a compass that was seen to turn with the robot may overturn it.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct HalfEvidence {
    /// Log odds that the half is right rather than the other one.
    log_odds: f32,
    /// Earned by many readings, or told.
    established: bool,
    compass_monitor: Option<CompassMonitor>,
}

/// Part of a frame's evidence by goals that counts: neighbouring frames show the same goal in the same light.
const GOAL_EVIDENCE_SHARE: f32 = 0.2;

/// How the belief's heading minus the compass's behaves: constant if the compass lives, whatever its offset.
#[derive(Debug, Clone, Copy)]
struct CompassMonitor {
    stamp: Stamp,
    /// The deviation when the watch began; the others are relative to it.
    reference_deviation: f32,
    mean_deviation: f32,
    count: f32,
    smoothed_deviation: f32,
    /// The belief's heading when the watch began.
    start_heading: f32,
    /// Largest turn since.
    turn_max: f32,
}

impl HalfEvidence {
    /// As after a search: known with these odds, but not by many readings.
    pub(super) fn with_log_odds(odds: f32) -> Self {
        HalfEvidence {
            log_odds: odds,
            ..HalfEvidence::default()
        }
    }

    /// Told by someone who knows.
    pub(super) fn external(config: &CompassConfig) -> Self {
        HalfEvidence {
            log_odds: config.log_odds_max,
            established: true,
            compass_monitor: None,
        }
    }

    /// Log odds that the belief's half is right.
    pub(super) fn log_odds(&self) -> f32 {
        self.log_odds
    }

    /// Coloured goals were seen, with these log odds for the belief's half.
    pub(super) fn update_goals(&mut self, odds: f32, config: &CompassConfig) {
        let most = config.reading_log_odds_max;
        self.log_odds = (self.log_odds + GOAL_EVIDENCE_SHARE * odds.clamp(-most, most))
            .clamp(-config.log_odds_max, config.log_odds_max);
        self.established |= self.log_odds >= config.log_odds_max;
    }

    /// The belief went to the other half.
    pub(super) fn apply_half_turn(&mut self) {
        *self = HalfEvidence {
            log_odds: -self.log_odds,
            established: false,
            compass_monitor: None,
        };
    }

    /// Someone else's word, log odds: team-mates who know their half see the ball here or opposite.
    pub(super) fn add_log_odds(&mut self, odds: f32, config: &CompassConfig) {
        if odds.is_finite() {
            self.log_odds = (self.log_odds + odds).clamp(-config.log_odds_max, config.log_odds_max);
        }
    }

    /// Hears a reading while the belief's heading is `heading`.
    pub(super) fn receive_compass(
        &mut self,
        stamp: Stamp,
        heading: f32,
        reading: f32,
        config: &CompassConfig,
    ) {
        let deviation = wrap_angle(heading - reading);
        let watch = match self.compass_monitor {
            Some(watch) => watch.update(stamp, heading, deviation, config),
            None => CompassMonitor::new(stamp, heading, deviation),
        };
        self.compass_monitor = Some(watch);
        let evidence = reading_log_odds(deviation, config);
        let lives = watch.turn_max >= config.verified_turn_deg.to_radians();
        if evidence >= 0.0 || lives || !self.established {
            self.log_odds =
                (self.log_odds + evidence).clamp(-config.log_odds_max, config.log_odds_max);
            self.established |= self.log_odds >= config.log_odds_max;
        }
    }
}

impl CompassMonitor {
    fn new(at: Stamp, heading: f32, deviation: f32) -> Self {
        CompassMonitor {
            stamp: at,
            reference_deviation: deviation,
            mean_deviation: 0.0,
            count: 1.0,
            smoothed_deviation: 0.0,
            start_heading: heading,
            turn_max: 0.0,
        }
    }

    /// One reading later; begun anew if the compass no longer turns with the robot.
    fn update(
        mut self,
        stamp: Stamp,
        heading: f32,
        deviation: f32,
        config: &CompassConfig,
    ) -> Self {
        let since = self.stamp.seconds_until(stamp).max(0.0) as f32;
        self.stamp = stamp;
        let relative = wrap_angle(deviation - self.reference_deviation);
        // Noise averages out over a few tenths of a second; a compass that sticks does not come back in that time.
        let share = 1.0 - (-since / config.smoothing_time).exp();
        self.smoothed_deviation += share * wrap_angle(relative - self.smoothed_deviation);
        self.count += 1.0;
        self.mean_deviation += wrap_angle(relative - self.mean_deviation) / self.count;
        self.turn_max = self
            .turn_max
            .max(wrap_angle(heading - self.start_heading).abs());
        if wrap_angle(self.smoothed_deviation - self.mean_deviation).abs()
            > 3.0 * config.std_deg.to_radians()
        {
            return CompassMonitor::new(stamp, heading, deviation);
        }
        self
    }
}

/// Log odds of one reading for the half in which the heading deviates by `deviation` from it.
fn reading_log_odds(deviation: f32, config: &CompassConfig) -> f32 {
    let std = config.std_deg.to_radians();
    let other = std::f32::consts::PI - deviation.abs();
    (0.5 * (other * other - deviation * deviation) / (std * std))
        .clamp(-config.reading_log_odds_max, config.reading_log_odds_max)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ten seconds at 30 Hz of a robot that turns at 0.5 rad/s, the compass told by `reading`.
    fn feed_compass(evidence: &mut HalfEvidence, from: f32, reading: impl Fn(f32, usize) -> f32) {
        let config = CompassConfig::default();
        for k in 0..300 {
            let time = from + k as f32 / 30.0;
            let heading = wrap_angle(0.5 * time);
            let noise = 0.1 * (k as f32 * 2.4).sin();
            let reading = wrap_angle(reading(heading, k) + noise);
            evidence.receive_compass(
                Stamp::from_seconds(f64::from(time)),
                heading,
                reading,
                &config,
            );
        }
    }

    #[test]
    fn stuck_compass_does_not_flip_an_established_half() {
        let mut half = HalfEvidence::default();
        feed_compass(&mut half, 0.0, |heading, _| heading);
        assert!(half.log_odds() >= 9.0);
        feed_compass(&mut half, 10.0, |_, _| -1.3);
        assert!(half.log_odds() >= 9.0, "{}", half.log_odds());
    }

    #[test]
    fn compass_that_turns_with_the_robot_flips_a_wrong_half() {
        let mut half = HalfEvidence::external(&CompassConfig::default());
        feed_compass(&mut half, 0.0, |heading, _| heading + std::f32::consts::PI);
        assert!(half.log_odds() <= -9.0, "{}", half.log_odds());
    }

    #[test]
    fn unestablished_half_flips_within_three_readings() {
        let mut half = HalfEvidence::with_log_odds(2.0);
        let config = CompassConfig::default();
        for k in 0..3 {
            half.receive_compass(Stamp(k * 33_000_000), 0.0, 3.1, &config);
        }
        assert!(half.log_odds() < -2.0, "{}", half.log_odds());
    }
}
