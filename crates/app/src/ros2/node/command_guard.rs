//! Which velocity commands of ROS 2 are executed? Possible ones that come in time.
//!
//! A Twist has no time, but DDS gives each message that of its sender. Clocks need not be equal: the shortest delay of a sender
//! so far is taken for no delay. A message that took longer by more than its validity has waited somewhere, for example while
//! this program was stopped.

use std::collections::BTreeMap;

use localize::Stamp;
use localize::omni::Twist as PlanarTwist;
use serde::Serialize;

use super::super::messages::Twist;

/// A sender whose messages are all late for this time has set its clock, seconds.
const CLOCK_STEP_TIME: f64 = 1.0;
/// Senders whose delays are kept.
const SENDERS_MAX: usize = 16;
/// Drift of two clocks against each other, seconds per second.
const CLOCK_DRIFT: f64 = 1e-4;

/// Why a command is not executed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Refusal {
    /// Not finite, or faster than `speed_max`.
    Senseless,
    /// It waited longer than a command is valid.
    Late,
    /// The configuration does not accept commands.
    Closed,
}

impl Refusal {
    /// What the operator can do.
    pub(crate) fn explain(self) -> &'static str {
        match self {
            Refusal::Senseless => "a velocity that is not finite, or above speed_max",
            Refusal::Late => "they arrive late: the network or this machine is overloaded",
            Refusal::Closed => "set accept_commands = true in [ros2] of network.toml",
        }
    }
}

/// Checks commands. Reads no clock.
#[derive(Debug)]
pub(crate) struct CommandGuard {
    accepts: bool,
    /// Seconds.
    valid_for: f64,
    speed_max: f64,
    senders: BTreeMap<[u8; 16], SenderClock>,
}

#[derive(Debug, Clone, Copy)]
struct SenderClock {
    /// Arrival by our clock minus sending by the sender's, the shortest so far, seconds.
    delay_min: f64,
    /// Arrival of the last message.
    last: Stamp,
    /// Since when every message is late.
    late_since: Option<Stamp>,
}

impl CommandGuard {
    pub(crate) fn new(accepts: bool, valid_max_ms: f32, speed_max: f32) -> Self {
        CommandGuard {
            accepts,
            valid_for: f64::from(valid_max_ms) / 1e3,
            speed_max: f64::from(speed_max),
            senders: BTreeMap::new(),
        }
    }

    /// The velocity and the end of its validity.
    ///
    /// `sent_ns`: time by the sender's clock, if the message has one. `arrival`: by our clock.
    pub(crate) fn accept(
        &mut self,
        twist: &Twist,
        sender: [u8; 16],
        sent_ns: Option<i64>,
        arrival: Stamp,
    ) -> Result<(PlanarTwist, Stamp), Refusal> {
        if !self.accepts {
            return Err(Refusal::Closed);
        }
        let values = [twist.linear.x, twist.linear.y, twist.angular.z];
        let speeds = [values[0].hypot(values[1]), values[2].abs()];
        if !speeds.iter().all(|speed| *speed <= self.speed_max) {
            return Err(Refusal::Senseless);
        }
        let waited = sent_ns.map_or(0.0, |sent_ns| self.waited(sender, sent_ns, arrival));
        if waited > self.valid_for {
            return Err(Refusal::Late);
        }
        let [x, y, theta] = values.map(|value| value as f32);
        Ok((
            PlanarTwist { x, y, theta },
            arrival + (self.valid_for - waited),
        ))
    }

    /// How much longer than the fastest message of this sender the message took, seconds.
    fn waited(&mut self, sender: [u8; 16], sent_ns: i64, arrival: Stamp) -> f64 {
        let delay = (arrival.0.saturating_sub(sent_ns)) as f64 * 1e-9;
        if self.senders.len() >= SENDERS_MAX && !self.senders.contains_key(&sender) {
            let oldest = self.senders.iter().min_by_key(|(_, clock)| clock.last);
            if let Some(oldest) = oldest.map(|(sender, _)| *sender) {
                self.senders.remove(&oldest);
            }
        }
        let clock = self.senders.entry(sender).or_insert(SenderClock {
            delay_min: delay,
            last: arrival,
            late_since: None,
        });
        let since_last = arrival - clock.last;
        clock.last = arrival;
        clock.delay_min = (clock.delay_min + CLOCK_DRIFT * since_last.max(0.0)).min(delay);
        if delay - clock.delay_min <= self.valid_for {
            clock.late_since = None;
        } else if arrival - *clock.late_since.get_or_insert(arrival) > CLOCK_STEP_TIME {
            clock.delay_min = delay;
            clock.late_since = None;
        }
        delay - clock.delay_min
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SENDER: [u8; 16] = [7; 16];

    fn forward(speed: f64) -> Twist {
        let mut twist = Twist::default();
        twist.linear.x = speed;
        twist
    }

    fn guard() -> CommandGuard {
        CommandGuard::new(true, 100.0, 3.0)
    }

    #[test]
    fn commands_that_waited_while_the_program_was_stopped_are_late() {
        let mut guard = guard();
        // The sender's clock is 50 s ahead.
        let mut send = |sent_s: f64, arrival_s: f64| {
            let sent_ns = ((sent_s + 50.0) * 1e9) as i64;
            let arrival = Stamp::from_seconds(arrival_s);
            guard.accept(&forward(1.0), SENDER, Some(sent_ns), arrival)
        };
        for step in 0..20 {
            let sent_s = f64::from(step) * 0.05;
            let (_, until) = send(sent_s, sent_s + 0.001).expect("in time");
            assert!((until - Stamp::from_seconds(sent_s + 0.101)).abs() < 1e-6);
        }
        // Stopped for five seconds: a hundred messages arrive within milliseconds.
        for step in 0..98 {
            let sent_s = 1.0 + f64::from(step) * 0.05;
            let result = send(sent_s, 6.0 + f64::from(step) * 1e-5);
            assert_eq!(result, Err(Refusal::Late), "{step}");
        }
        assert!(send(6.0, 6.002).is_ok());
        // One that is a little late is valid for the rest of its time.
        let (_, until) = send(6.05, 6.111).expect("in time");
        assert!((until - Stamp::from_seconds(6.151)).abs() < 1e-3);
    }

    #[test]
    fn a_sender_that_sets_its_clock_back_is_accepted_again() {
        let mut guard = guard();
        let mut refused = 0;
        for step in 0..100 {
            let now_s = f64::from(step) * 0.05;
            let sent_s = if step < 20 { now_s } else { now_s - 30.0 };
            let sent_ns = (sent_s * 1e9) as i64;
            let arrival = Stamp::from_seconds(now_s);
            let result = guard.accept(&forward(1.0), SENDER, Some(sent_ns), arrival);
            refused += u32::from(result.is_err());
        }
        assert!((10..40).contains(&refused), "{refused}");
    }

    #[test]
    fn senseless_and_unwanted_commands_are_refused() {
        let now = Stamp::from_seconds(1.0);
        for speed in [3.1, -4.0, f64::NAN, f64::INFINITY] {
            let result = guard().accept(&forward(speed), SENDER, None, now);
            assert_eq!(result, Err(Refusal::Senseless), "{speed}");
        }
        let mut diagonal = forward(2.5);
        diagonal.linear.y = 2.5;
        let result = guard().accept(&diagonal, SENDER, None, now);
        assert_eq!(result, Err(Refusal::Senseless));
        let mut closed = CommandGuard::new(false, 100.0, 3.0);
        let result = closed.accept(&forward(1.0), SENDER, None, now);
        assert_eq!(result, Err(Refusal::Closed));
    }
}
