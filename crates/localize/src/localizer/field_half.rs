//! Field half: log odds from compass readings and coloured goals, and a test whether the compass works
//! (docs/methods.md 9.2).

use serde::{Deserialize, Serialize};

use crate::config::CompassConfig;
use crate::frames::wrap_angle;
use crate::math;
use crate::stamp::Stamp;

/// Log odds of the field half of the tracked pose.
///
/// The errors of one compass are correlated: a stuck one, or one next to a motor, contradicts permanently. An established
/// half is therefore only overturned by a compass that was observed to follow the robot's rotation, and either deviates by half a
/// turn more than while it agreed, as after the robot was carried to its mirrored place, or contradicts for longer than it
/// agreed: steel or a motor nearby turns it for some seconds. Whether the robot was carried or the compass was reset, no later reading
/// tells: the half stays open until another source decides.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct HalfEvidence {
    /// Of the tracked half against the other one.
    log_odds: f32,
    /// The log odds have reached their maximum, or the half was given.
    established: bool,
    compass_monitor: Option<CompassMonitor>,
    /// Rotation over which the compass agreed with the half, radians, at most [`AGREED_TURN_MAX`].
    agreed_turn: f32,
    /// Mean deviation of the tracked heading from the compass while it last agreed, radians.
    agreed_deviation: Option<f32>,
    /// Log odds of contradicting readings that do not count yet, at most 0. They leave the half unknown until the robot
    /// has turned far enough to tell a working compass from a stuck one.
    withheld: f32,
    /// The compass agreed with the half and then overturned it: the robot was carried, or the compass was reset. Its readings no longer
    /// tell which.
    compass_doubted: bool,
}

/// What is known about the field half of a tracked pose: enough for another localizer to go on from.
///
/// The test of the compass begins anew.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct HalfState {
    /// Log odds of the tracked half against the other one.
    pub log_odds: f32,
    /// Log odds of contradicting readings that do not count yet, at most 0.
    pub withheld: f32,
    /// The log odds have reached their maximum, or the half was given.
    pub established: bool,
    /// The compass agreed with the half and then overturned it.
    #[serde(default)]
    pub compass_doubted: bool,
}

/// An established half counts as if the compass had agreed with it at least over this rotation, radians.
const ESTABLISHED_TURN: f32 = std::f32::consts::PI;

/// Rotation beyond which more agreement adds nothing, radians: a robot that was carried to the other half is to be found.
const AGREED_TURN_MAX: f32 = 4.0 * std::f32::consts::PI;

/// Log odds that a doubted compass may give a half, as a share of those of a known one.
const DOUBTED_SHARE: f32 = 0.5;

/// Distance of a change of the deviation from half a turn up to which the robot's place may have changed, standard deviations of
/// a reading.
const HALF_TURN_SIGMAS: f32 = 2.0;

/// Rotation of the contradiction that overturns a half over that of the agreement.
const CONTRADICTION_RATIO: f32 = 2.0;

/// Rotations are counted in steps of this size, radians, so that the noise of the heading adds none.
const TURN_STEP: f32 = 0.2;

/// Weight of one image's goals, below 1 since successive images show the same goal in the same light.
const GOAL_EVIDENCE_SHARE: f32 = 0.2;

/// Deviation of the tracked heading from the compass. It is constant if the compass works, whatever its offset.
#[derive(Debug, Clone, Copy)]
struct CompassMonitor {
    stamp: Stamp,
    /// Deviation at the start. The others are relative to it.
    reference_deviation: f32,
    mean_deviation: f32,
    count: f32,
    smoothed_deviation: f32,
    /// Tracked heading at the start.
    start_heading: f32,
    /// Largest rotation since the start.
    rotation_max: f32,
    /// Heading up to which rotations are counted.
    counted_heading: f32,
    /// Sum of the rotations, either way, that no reading has been credited with yet.
    uncredited_turn: f32,
    /// Rotation over which verified readings contradicted the half.
    contradicted_turn: f32,
}

impl HalfEvidence {
    /// Half after a global search: these log odds, not established.
    pub(super) fn with_log_odds(log_odds: f32) -> Self {
        HalfEvidence {
            log_odds,
            ..HalfEvidence::default()
        }
    }

    /// Half given from outside: established.
    pub(super) fn external(config: &CompassConfig) -> Self {
        HalfEvidence {
            log_odds: config.log_odds_max,
            established: true,
            ..HalfEvidence::default()
        }
    }

    /// Half of a localizer that went before.
    pub(super) fn from_state(state: HalfState) -> Self {
        HalfEvidence {
            log_odds: state.log_odds,
            withheld: state.withheld,
            established: state.established,
            agreed_turn: f32::from(u8::from(state.established)) * ESTABLISHED_TURN,
            compass_doubted: state.compass_doubted,
            ..HalfEvidence::default()
        }
    }

    /// For a localizer that goes on.
    pub(super) fn state(&self) -> HalfState {
        HalfState {
            log_odds: self.log_odds,
            withheld: self.withheld,
            established: self.established,
            compass_doubted: self.compass_doubted,
        }
    }

    /// Log odds of the tracked half.
    pub(super) fn log_odds(&self) -> f32 {
        self.log_odds
    }

    /// Log odds that include contradicting readings which do not count yet.
    pub(super) fn log_odds_with_withheld(&self) -> f32 {
        self.log_odds + self.withheld
    }

    /// Adds the log odds of an image's coloured goals.
    pub(super) fn update_goals(&mut self, log_odds: f32, config: &CompassConfig) {
        let limit = config.reading_log_odds_max;
        self.log_odds = (self.log_odds + GOAL_EVIDENCE_SHARE * log_odds.clamp(-limit, limit))
            .clamp(-config.log_odds_max, config.log_odds_max);
        self.established |= self.log_odds >= config.log_odds_max;
    }

    /// The tracked pose was turned to the other half.
    pub(super) fn apply_half_turn(&mut self, config: &CompassConfig) {
        let compass_doubted = self.compass_doubted || self.agreed_deviation.is_some();
        let most = most_log_odds(compass_doubted, config);
        *self = HalfEvidence {
            compass_doubted,
            ..HalfEvidence::with_log_odds((-self.log_odds).min(most))
        };
    }

    /// Adds log odds from another source than compass or goals. They do not establish the half.
    pub(super) fn add_log_odds(&mut self, log_odds: f32, config: &CompassConfig) {
        if log_odds.is_finite() {
            self.log_odds =
                (self.log_odds + log_odds).clamp(-config.log_odds_max, config.log_odds_max);
        }
    }

    /// Adds a compass reading. `heading`: tracked heading at `stamp`. `undisturbed`: the reading agrees with the gyro.
    ///
    /// A reading that contradicts the gyro counts once the compass has followed a rotation, one that contradicts an
    /// established half once it has followed a rotation half a turn off, or contradicted for longer than it agreed.
    pub(super) fn update_compass(
        &mut self,
        stamp: Stamp,
        heading: f32,
        reading: f32,
        undisturbed: bool,
        config: &CompassConfig,
    ) {
        let deviation = wrap_angle(heading - reading);
        let mut monitor = match self.compass_monitor {
            Some(monitor) => monitor.update(stamp, heading, deviation, config),
            None => CompassMonitor::new(stamp, heading, deviation),
        };
        if monitor.count == 1.0 {
            // The compass did not follow the robot: what it said before is void.
            self.withheld = 0.0;
        }
        let log_odds = reading_log_odds(deviation, config);
        let agrees = log_odds >= 0.0;
        let verified = monitor.rotation_max >= config.verified_turn_deg.to_radians();
        if verified {
            let turn = std::mem::take(&mut monitor.uncredited_turn);
            if agrees {
                self.agreed_turn = (self.agreed_turn + turn).min(AGREED_TURN_MAX);
            } else {
                monitor.contradicted_turn += turn;
            }
        }
        let overturns = verified && self.is_half_turned(monitor.deviation(), config)
            || monitor.contradicted_turn > CONTRADICTION_RATIO * self.agreed_turn;
        let counts = (verified || undisturbed) && (agrees || !self.established || overturns);
        self.compass_monitor = Some(monitor);
        if counts && agrees {
            self.agreed_deviation = Some(monitor.deviation());
        }
        if counts {
            // What was withheld counts with the reading that it agrees with.
            let withheld = std::mem::take(&mut self.withheld);
            let sum = self.log_odds + log_odds + if agrees { 0.0 } else { withheld };
            // Of a compass that is doubted, agreement leaves the half as open as contradiction had made it.
            let most = if self.compass_doubted {
                self.log_odds
                    .max(DOUBTED_SHARE * config.half_known_log_odds)
            } else {
                config.log_odds_max
            };
            self.log_odds = sum.clamp(-config.log_odds_max, most);
            if self.log_odds >= config.log_odds_max && !self.established {
                self.established = true;
                self.agreed_turn = self.agreed_turn.max(ESTABLISHED_TURN);
            }
        } else {
            self.withheld = (self.withheld + log_odds).clamp(-2.0 * config.log_odds_max, 0.0);
        }
    }

    /// Does the compass deviate by half a turn more than while it agreed?
    fn is_half_turned(&self, deviation: f32, config: &CompassConfig) -> bool {
        self.agreed_deviation.is_some_and(|agreed| {
            let beside = std::f32::consts::PI - wrap_angle(deviation - agreed).abs();
            beside < HALF_TURN_SIGMAS * config.std_deg.to_radians()
        })
    }
}

impl CompassMonitor {
    fn new(stamp: Stamp, heading: f32, deviation: f32) -> Self {
        CompassMonitor {
            stamp,
            reference_deviation: deviation,
            mean_deviation: 0.0,
            count: 1.0,
            smoothed_deviation: 0.0,
            start_heading: heading,
            rotation_max: 0.0,
            counted_heading: heading,
            uncredited_turn: 0.0,
            contradicted_turn: 0.0,
        }
    }

    /// Mean deviation, radians.
    fn deviation(&self) -> f32 {
        wrap_angle(self.reference_deviation + self.mean_deviation)
    }

    /// Adds a reading. Restarts if the compass does not follow the robot's rotation.
    fn update(
        mut self,
        stamp: Stamp,
        heading: f32,
        deviation: f32,
        config: &CompassConfig,
    ) -> Self {
        let seconds = self.stamp.seconds_until(stamp).max(0.0) as f32;
        self.stamp = stamp;
        let relative = wrap_angle(deviation - self.reference_deviation);
        // Smoothing removes the noise. The deviation of a stuck compass remains.
        let share = 1.0 - math::exp(-seconds / config.smoothing_time);
        self.smoothed_deviation += share * wrap_angle(relative - self.smoothed_deviation);
        self.count += 1.0;
        self.mean_deviation += wrap_angle(relative - self.mean_deviation) / self.count;
        self.rotation_max = self
            .rotation_max
            .max(wrap_angle(heading - self.start_heading).abs());
        let turn = wrap_angle(heading - self.counted_heading).abs();
        if turn >= TURN_STEP {
            self.counted_heading = heading;
            self.uncredited_turn += turn;
        }
        if wrap_angle(self.smoothed_deviation - self.mean_deviation).abs()
            > 3.0 * config.std_deg.to_radians()
        {
            return CompassMonitor::new(stamp, heading, deviation);
        }
        self
    }
}

/// Log odds that compass readings may add up to: of one that is doubted, agreement leaves the half open.
fn most_log_odds(compass_doubted: bool, config: &CompassConfig) -> f32 {
    if compass_doubted {
        DOUBTED_SHARE * config.half_known_log_odds
    } else {
        config.log_odds_max
    }
}

/// Log odds of one reading for the half in which the heading deviates from it by `deviation`, radians.
///
/// A reading is as good as the limit of its log odds says: with a small probability it says nothing. One that is far from both halves
/// is such a one, however much farther it is from one of them.
fn reading_log_odds(deviation: f32, config: &CompassConfig) -> f32 {
    let std = config.std_deg.to_radians();
    let nothing = 1.0 / (math::exp(config.reading_log_odds_max) - 1.0).max(1e-6);
    let log_likelihood =
        |deviation: f32| math::ln(math::exp(-0.5 * deviation * deviation / (std * std)) + nothing);
    log_likelihood(deviation) - log_likelihood(std::f32::consts::PI - deviation.abs())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ten seconds at 30 Hz of a robot that rotates at 0.5 rad/s. `reading`: compass heading from heading and index.
    fn feed_compass(half: &mut HalfEvidence, start: f32, reading: impl Fn(f32, usize) -> f32) {
        let config = CompassConfig::default();
        for k in 0..300 {
            let time = start + k as f32 / 30.0;
            let heading = wrap_angle(0.5 * time);
            let noise = 0.1 * (k as f32 * 2.4).sin();
            let reading = wrap_angle(reading(heading, k) + noise);
            half.update_compass(
                Stamp::from_seconds(f64::from(time)),
                heading,
                reading,
                true,
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
    fn contradiction_leaves_an_established_half_unknown_until_the_robot_has_turned() {
        let config = CompassConfig::default();
        let mut half = HalfEvidence::external(&config);
        for k in 0..30 {
            // At rest nobody can tell a stuck compass from a robot that was turned around.
            half.update_compass(Stamp(k * 33_000_000), 0.0, 3.1, false, &config);
        }
        assert!(
            half.log_odds() >= 9.0 && half.log_odds_with_withheld() < config.half_known_log_odds
        );
    }

    #[test]
    fn compass_that_is_disturbed_for_some_seconds_leaves_the_half_unknown() {
        let config = CompassConfig::default();
        for disturbance in [2.6_f32, -2.5] {
            let disturbed = |heading: f32, _| heading + disturbance;
            let mut half = HalfEvidence::default();
            feed_compass(&mut half, 0.0, |heading, _| heading);
            feed_compass(&mut half, 10.0, disturbed);
            assert!(half.log_odds() >= 9.0, "{}", half.log_odds());
            assert!(half.log_odds_with_withheld() < config.half_known_log_odds);
            feed_compass(&mut half, 20.0, |heading, _| heading);
            assert!(half.log_odds_with_withheld() >= config.half_known_log_odds);
            // For longer than it ever agreed: the robot is in the other half.
            for period in 3..9 {
                feed_compass(&mut half, 10.0 * period as f32, disturbed);
            }
            assert!(
                half.log_odds() < -config.half_known_log_odds,
                "{}",
                half.log_odds()
            );
        }
    }

    #[test]
    fn compass_far_from_both_halves_tells_none() {
        let config = CompassConfig::default();
        for deviation in [1.35_f32, 1.7, -1.5, -1.9] {
            let disturbed = |heading: f32, _| heading + deviation;
            let mut half = HalfEvidence::default();
            feed_compass(&mut half, 0.0, disturbed);
            let told = half.log_odds_with_withheld().abs();
            assert!(told < config.half_known_log_odds, "{deviation}: {told}");
            let mut known = HalfEvidence::default();
            feed_compass(&mut known, 0.0, |heading, _| heading);
            feed_compass(&mut known, 10.0, disturbed);
            let left = known.log_odds_with_withheld();
            assert!(left >= config.half_known_log_odds, "{deviation}: {left}");
        }
    }

    #[test]
    fn compass_that_turns_by_half_a_turn_overturns_the_half_once_it_has_followed_a_rotation() {
        let mut half = HalfEvidence::default();
        feed_compass(&mut half, 0.0, |heading, _| heading + 0.2);
        feed_compass(&mut half, 10.0, |heading, _| {
            heading + 0.2 + std::f32::consts::PI
        });
        assert!(half.log_odds() <= -9.0, "{}", half.log_odds());
    }

    #[test]
    fn half_that_a_turned_compass_has_overturned_stays_open() {
        let config = CompassConfig::default();
        let mut half = HalfEvidence::default();
        feed_compass(&mut half, 0.0, |heading, _| heading);
        feed_compass(&mut half, 10.0, |heading, _| heading + std::f32::consts::PI);
        half.apply_half_turn(&config);
        // The tracked heading is the turned one from now on.
        for period in 2..6 {
            feed_compass(&mut half, 10.0 * period as f32, |heading, _| heading);
            assert!(half.log_odds() < config.half_known_log_odds, "{period}");
        }
        // Another source may decide: the goals.
        (0..100).for_each(|_| half.update_goals(4.0, &config));
        assert!(half.log_odds() >= config.half_known_log_odds);
        // A half that was given wrongly is no reason to doubt a compass that never agreed with it.
        let mut given = HalfEvidence::external(&config);
        feed_compass(&mut given, 0.0, |heading, _| heading + std::f32::consts::PI);
        given.apply_half_turn(&config);
        feed_compass(&mut given, 10.0, |heading, _| heading);
        assert!(given.log_odds() >= config.half_known_log_odds);
    }

    #[test]
    fn unestablished_half_flips_within_three_readings() {
        let mut half = HalfEvidence::with_log_odds(2.0);
        let config = CompassConfig::default();
        for k in 0..3 {
            half.update_compass(Stamp(k * 33_000_000), 0.0, 3.1, true, &config);
        }
        assert!(half.log_odds() < -2.0, "{}", half.log_odds());
    }
}
