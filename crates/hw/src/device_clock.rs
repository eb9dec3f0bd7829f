//! When was a message made? A device's own clock, set against ours, so that jitter on the way is none of the stamps.

use localize::Stamp;

/// How fast a device's clock may run away from ours: 100 ppm is a poor crystal's.
const DRIFT: f64 = 1e-4;
/// A step of a device's clock against ours that means it was restarted, seconds.
const RESTART: f64 = 1.0;

/// A device's clock, set by the message that was least delayed on its way.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct DeviceClock {
    last: Option<LastSeen>,
}

#[derive(Debug, Clone, Copy)]
struct LastSeen {
    time_us: u32,
    arrival: Stamp,
    /// The device's time since the first message, and our time at its zero; nanoseconds.
    board_ns: i64,
    zero_ns: i64,
}

impl DeviceClock {
    /// Our time at the device's `time_us` (wrapping); never later than the arrival.
    pub(crate) fn stamp(&mut self, time_us: u32, arrival: Stamp) -> Stamp {
        let fresh = LastSeen {
            time_us,
            arrival,
            board_ns: 0,
            zero_ns: arrival.0,
        };
        let Some(last) = self.last else {
            self.last = Some(fresh);
            return arrival;
        };
        let step_ns = i64::from(time_us.wrapping_sub(last.time_us) as i32) * 1000;
        let elapsed = arrival - last.arrival;
        if (step_ns as f64 * 1e-9 - elapsed).abs() > RESTART {
            self.last = Some(fresh);
            return arrival;
        }
        let board_ns = last.board_ns + step_ns;
        let drifted = last.zero_ns + (elapsed * DRIFT * 1e9) as i64;
        let zero_ns = drifted.min(arrival.0 - board_ns);
        self.last = Some(LastSeen {
            time_us,
            arrival,
            board_ns,
            zero_ns,
        });
        Stamp(board_ns + zero_ns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn late_messages_are_stamped_when_they_were_made() {
        let mut clock = DeviceClock::default();
        // Made each 10 ms, 1 ms on the way, every third held up by 6 ms; the board's clock wraps meanwhile.
        for index in 0..300u32 {
            let made = i64::from(index) * 10_000_000;
            let delay = if index % 3 == 2 { 6_000_000 } else { 1_000_000 };
            let time_us = (u32::MAX - 1_000_000).wrapping_add(index * 10_000);
            let stamp = clock.stamp(time_us, Stamp(made + delay));
            assert!((stamp.0 - made - 1_000_000).abs() < 20_000, "{index}");
        }
        let later = Stamp(4_000_000_000);
        assert_eq!(
            clock.stamp(12, later),
            later,
            "a restarted board begins anew"
        );
    }
}
