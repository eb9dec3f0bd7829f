//! When was a message sent? The offset of a device's clock to ours removes transmission jitter from the stamps.

use localize::Stamp;

/// Length of the window over which the least delayed message sets the offset, seconds; the window before counts too.
/// Half a second contains an undelayed message of every device.
const OFFSET_WINDOW: f64 = 0.4;
/// A stamp that is older than its arrival by more is not used, seconds: this program discards what waited for longer.
const DELAY_MAX: f64 = 0.25;
/// Delay beyond which messages count as late, seconds: a busy bus or computer can cause less.
const LATE_MIN: f64 = 0.05;
/// Time for which all messages are late before the clock is the reason, seconds.
const LATE_TIME: f64 = 0.2;
/// Time for which a clock must run like ours before its stamps are used again, seconds.
const TRUST_TIME: f64 = 3.0;

/// Converts a device's time to ours by the offset of the least delayed message. While the device's clock does not run like
/// ours, the time of arrival is the stamp.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct DeviceClock {
    offset: Option<ClockOffset>,
    fault: Option<ClockFault>,
}

/// How a device's clock differed from ours when this was last noticed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ClockFault {
    /// Arrival of the message.
    noticed: Stamp,
    /// Step, seconds; `None` if the clock stands still or runs unevenly.
    pub(crate) step: Option<f64>,
}

#[derive(Debug, Clone, Copy)]
struct ClockOffset {
    device_us: u32,
    first_arrival: Stamp,
    /// Device time since the first message, nanoseconds.
    device_ns: i64,
    window_start: Stamp,
    /// Smallest host time at the device's zero, nanoseconds: in this window, and in the one before.
    min_offset_ns: i64,
    previous_min_offset_ns: i64,
    /// Arrival and device time of the first message since which all were late.
    late_since: Option<(Stamp, i64)>,
}

impl ClockOffset {
    fn new(time_us: u32, arrival: Stamp) -> Self {
        ClockOffset {
            device_us: time_us,
            first_arrival: arrival,
            device_ns: 0,
            window_start: arrival,
            min_offset_ns: arrival.0,
            previous_min_offset_ns: arrival.0,
            late_since: None,
        }
    }

    fn offset_ns(&self) -> i64 {
        self.min_offset_ns.min(self.previous_min_offset_ns)
    }

    /// Host time of the last message.
    fn stamp(&self) -> Stamp {
        Stamp(self.device_ns + self.offset_ns())
    }

    /// The offset after another message, and the step of the clock if it does not run like ours: `Some(None)` if it stands
    /// still or runs unevenly.
    fn update(&self, time_us: u32, arrival: Stamp) -> (Self, Option<Option<f64>>) {
        let step_ns = i64::from(time_us.wrapping_sub(self.device_us) as i32) * 1000;
        let mut next = ClockOffset {
            device_us: time_us,
            device_ns: self.device_ns + step_ns,
            ..*self
        };
        if arrival - next.window_start > OFFSET_WINDOW {
            next.window_start = arrival;
            next.previous_min_offset_ns = self.min_offset_ns;
            next.min_offset_ns = i64::MAX;
        }
        next.min_offset_ns = next.min_offset_ns.min(arrival.0 - next.device_ns);
        let step_ahead = (self.offset_ns() - next.offset_ns()) as f64 * 1e-9;
        // The first messages may be late.
        if step_ahead > LATE_MIN && arrival - self.first_arrival > OFFSET_WINDOW {
            return (next, Some(Some(step_ahead)));
        }
        let delay = arrival - next.stamp();
        if delay <= LATE_MIN {
            next.late_since = None;
            return (next, None);
        }
        let (since, device_ns) = *next.late_since.get_or_insert((arrival, next.device_ns));
        let late_for = arrival - since;
        if late_for <= LATE_TIME {
            return (next, None);
        }
        // After a step the clock runs on like ours.
        let advance = (next.device_ns - device_ns) as f64 * 1e-9;
        let runs = (advance - late_for).abs() < 0.5 * late_for;
        (next, Some(runs.then_some(-delay)))
    }
}

impl DeviceClock {
    /// Host time at the device's `time_us` (wrapping); never later than the arrival.
    pub(crate) fn update_host_stamp(&mut self, time_us: u32, arrival: Stamp) -> Stamp {
        let Some(last) = self.offset else {
            self.offset = Some(ClockOffset::new(time_us, arrival));
            return arrival;
        };
        let (next, fault) = last.update(time_us, arrival);
        if let Some(step) = fault {
            // A clock that fails again before it was trusted again did not merely step.
            let repeated = self.fault(arrival).is_some();
            self.offset = Some(ClockOffset::new(time_us, arrival));
            self.fault = Some(ClockFault {
                noticed: arrival,
                step: step.filter(|_| !repeated),
            });
            return arrival;
        }
        self.offset = Some(next);
        let stamp = next.stamp();
        if self.fault(arrival).is_some() || arrival - stamp > DELAY_MAX {
            return arrival;
        }
        stamp
    }

    /// Why the stamps are times of arrival now; `None` while they are those of the device's clock.
    pub(crate) fn fault(&self, now: Stamp) -> Option<ClockFault> {
        self.fault.filter(|fault| now - fault.noticed <= TRUST_TIME)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Largest error of the stamps of a clock that shows `time_us` at each time of sending, every 10 ms without a delay, and how
    /// often the times of arrival were the stamps.
    fn stamp_errors(count: i64, time_us: impl Fn(i64) -> i64) -> (f64, i64, DeviceClock) {
        let mut clock = DeviceClock::default();
        let (mut largest, mut on_arrival) = (0.0_f64, 0);
        for index in 0..count {
            let sent = Stamp(index * 10_000_000);
            let stamp = clock.update_host_stamp(time_us(index * 10_000) as u32, sent);
            largest = largest.max((stamp - sent).abs());
            on_arrival += i64::from(clock.fault(sent).is_some());
        }
        (largest, on_arrival, clock)
    }

    #[test]
    fn clock_that_stands_still_or_wraps_early_or_runs_wrong_is_replaced_by_the_arrival() {
        let (largest, on_arrival, clock) = stamp_errors(1000, |_| 0);
        assert!(largest < 0.3 && on_arrival > 970, "{largest} {on_arrival}");
        let fault = clock.fault(Stamp(9_990_000_000)).expect("a fault");
        assert_eq!(fault.step, None, "it stands still");
        let (largest, on_arrival, _) = stamp_errors(1000, |time_us| time_us % 1_000_000);
        assert!(largest < 0.05 && on_arrival > 870, "{largest} {on_arrival}");
        let (largest, on_arrival, _) = stamp_errors(1000, |time_us| time_us / 1000);
        assert!(largest < 0.3 && on_arrival > 970, "{largest} {on_arrival}");
        let (largest, ..) = stamp_errors(1000, |time_us| time_us * 2);
        assert!(largest < 0.05, "{largest}");
        // A crystal that is off by 0.1 % is none of these.
        let (largest, on_arrival, _) = stamp_errors(1000, |time_us| time_us * 1001 / 1000);
        assert!(largest < 0.01 && on_arrival == 0, "{largest} {on_arrival}");
    }

    #[test]
    fn transmission_jitter_does_not_affect_stamps() {
        let mut clock = DeviceClock::default();
        // Sent every 10 ms, 1 ms transmission, every third delayed by 6 ms; the board's clock wraps meanwhile.
        for index in 0..300u32 {
            let sent = i64::from(index) * 10_000_000;
            let delay = if index % 3 == 2 { 6_000_000 } else { 1_000_000 };
            let time_us = (u32::MAX - 1_000_000).wrapping_add(index * 10_000);
            let stamp = clock.update_host_stamp(time_us, Stamp(sent + delay));
            assert!((stamp.0 - sent - 1_000_000).abs() < 20_000, "{index}");
        }
        let later = Stamp(4_000_000_000);
        assert_eq!(clock.fault(later), None);
        assert_eq!(
            clock.update_host_stamp(12, later),
            later,
            "a restarted board has a new offset"
        );
        for index in 1..40 {
            let arrival = later + 0.01 * f64::from(index);
            assert_eq!(
                clock.update_host_stamp(12 + index as u32 * 10_000, arrival),
                arrival
            );
        }
        let step = clock.fault(later + 0.4).expect("a fault").step;
        assert!(step.is_some_and(|step| step < -2.0), "{step:?}");
        let much_later = later + 10.0;
        assert_eq!(clock.fault(much_later), None, "trusted again");
    }

    #[test]
    fn messages_that_a_busy_computer_delivers_late_are_no_fault_of_the_clock() {
        let mut clock = DeviceClock::default();
        for index in 0..300i64 {
            let sent = index * 10_000_000;
            // From time to time nothing is read for 0.15 s.
            let read = if index % 50 >= 35 {
                (index / 50 * 50 + 50) * 10_000_000
            } else {
                sent
            };
            let stamp = clock.update_host_stamp(index as u32 * 10_000, Stamp(read));
            assert_eq!(
                (stamp, clock.fault(Stamp(read))),
                (Stamp(sent), None),
                "{index}"
            );
        }
    }

    #[test]
    fn clock_step_is_reported_and_its_samples_are_stamped_on_arrival_within_a_quarter_of_a_second()
    {
        for step_us in [500_000i64, 100_000, -500_000, -100_000] {
            let mut clock = DeviceClock::default();
            let (mut wrong, mut step) = (0, None);
            for index in 0..600i64 {
                let sent = Stamp(index * 10_000_000);
                let shift = if index < 100 { 0 } else { step_us };
                let stamp =
                    clock.update_host_stamp((2_000_000 + index * 10_000 + shift) as u32, sent);
                wrong += i32::from((stamp - sent).abs() > 1e-3);
                step = step.or(clock.fault(sent).and_then(|fault| fault.step));
            }
            assert!(wrong <= 25, "{step_us}: {wrong}");
            let step = step.expect("a step");
            assert!((step - step_us as f64 * 1e-6).abs() < 0.02, "{step}");
            assert_eq!(clock.fault(Stamp(5_990_000_000)), None, "trusted again");
        }
    }
}
