//! When was a message sent? The offset of a device's clock to ours removes transmission jitter from the stamps.

use localize::Stamp;

/// Length of the window over which the least delayed message sets the offset, seconds; the window before counts too.
/// A stepped clock is tracked again within a second, and half a second contains an undelayed message of every device.
const OFFSET_WINDOW: f64 = 0.4;
/// Step of a device's clock that is taken as its restart, seconds.
const RESTART_STEP_MIN: f64 = 1.0;
/// Smallest step that is reported, seconds: a busy bus can cause less.
const REPORTED_STEP_MIN: f64 = 0.05;

/// Converts a device's time to ours by the offset of the least delayed message.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct DeviceClock {
    offset: Option<ClockOffset>,
    step: Option<f64>,
}

#[derive(Debug, Clone, Copy)]
struct ClockOffset {
    device_us: u32,
    arrival: Stamp,
    /// Device time since the first message, nanoseconds.
    device_ns: i64,
    window_start: Stamp,
    /// Smallest host time at the device's zero, nanoseconds: in this window, and in the one before.
    min_offset_ns: i64,
    previous_min_offset_ns: i64,
}

impl ClockOffset {
    fn new(time_us: u32, arrival: Stamp) -> Self {
        ClockOffset {
            device_us: time_us,
            arrival,
            device_ns: 0,
            window_start: arrival,
            min_offset_ns: arrival.0,
            previous_min_offset_ns: arrival.0,
        }
    }

    fn offset_ns(&self) -> i64 {
        self.min_offset_ns.min(self.previous_min_offset_ns)
    }
}

impl DeviceClock {
    /// Host time at the device's `time_us` (wrapping); never later than the arrival.
    pub(crate) fn update_host_stamp(&mut self, time_us: u32, arrival: Stamp) -> Stamp {
        let Some(last) = self.offset else {
            self.offset = Some(ClockOffset::new(time_us, arrival));
            return arrival;
        };
        let step_ns = i64::from(time_us.wrapping_sub(last.device_us) as i32) * 1000;
        let step = step_ns as f64 * 1e-9 - (arrival - last.arrival);
        if step.abs() > RESTART_STEP_MIN {
            self.offset = Some(ClockOffset::new(time_us, arrival));
            self.step = Some(step);
            return arrival;
        }
        let mut next = ClockOffset {
            device_us: time_us,
            arrival,
            device_ns: last.device_ns + step_ns,
            ..last
        };
        if arrival - next.window_start > OFFSET_WINDOW {
            next.window_start = arrival;
            next.previous_min_offset_ns = last.min_offset_ns;
            next.min_offset_ns = i64::MAX;
        }
        next.min_offset_ns = next.min_offset_ns.min(arrival.0 - next.device_ns);
        let offset_change = (last.offset_ns() - next.offset_ns()) as f64 * 1e-9;
        if offset_change.abs() > REPORTED_STEP_MIN {
            self.step = Some(offset_change);
        }
        self.offset = Some(next);
        Stamp(next.device_ns + next.offset_ns())
    }

    /// Step of the device's clock since the last call, seconds, if there was one.
    pub(crate) fn take_step(&mut self) -> Option<f64> {
        self.step.take()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
        assert_eq!(clock.take_step(), None);
        let later = Stamp(4_000_000_000);
        assert_eq!(
            clock.update_host_stamp(12, later),
            later,
            "a restarted board has a new offset"
        );
        assert!(clock.take_step().is_some());
    }

    #[test]
    fn clock_step_is_reported_and_tracked_within_one_second() {
        for step_us in [500_000i64, -500_000] {
            let mut clock = DeviceClock::default();
            let mut wrong_until = 0;
            let mut total_step = 0.0;
            for index in 0..400i64 {
                let sent = Stamp(index * 10_000_000);
                let shift = if index < 100 { 0 } else { step_us };
                let stamp =
                    clock.update_host_stamp((2_000_000 + index * 10_000 + shift) as u32, sent);
                if (stamp - sent).abs() > 1e-3 {
                    wrong_until = index;
                }
                total_step += clock.take_step().unwrap_or(0.0);
            }
            assert!(wrong_until < 190, "{step_us}: {wrong_until}");
            assert!(
                (total_step - step_us as f64 * 1e-6).abs() < 0.02,
                "{total_step}"
            );
        }
    }
}
