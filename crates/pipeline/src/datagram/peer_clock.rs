//! What is the offset of a teammate's clock? It is estimated from round trips of messages, as in NTP.

use std::collections::VecDeque;

/// Number of stored round trips. The shortest one is used, because it has the smallest asymmetry of delays.
const MAX_EXCHANGES: usize = 32;
/// A larger jump of the offset means that the clock was set, nanoseconds. Earlier round trips are then dropped.
const CLOCK_STEP_NS: i64 = 500_000_000;

/// Clock of a teammate.
#[derive(Debug, Clone, Default)]
pub struct PeerClock {
    /// Offset and round trip, nanoseconds. Messages without an echo get `CLOCK_STEP_NS` as their round trip.
    exchanges: VecDeque<(i64, i64)>,
}

impl PeerClock {
    /// Adds a message sent at `sent_ns` (peer clock) and received at `received_ns` (own clock).
    ///
    /// `echo`: when we sent the message that the peer echoes (own clock), and how long the peer held it, nanoseconds.
    pub fn add_exchange(&mut self, sent_ns: i64, received_ns: i64, echo: Option<(i64, i64)>) {
        // A peer clock can have any value, so arithmetic saturates.
        let one_way = received_ns.saturating_sub(sent_ns);
        let measured = echo
            .map(|(ours_ns, held_ns)| received_ns.saturating_sub(ours_ns).saturating_sub(held_ns));
        let (offset, round_trip) = match measured {
            // The one-round_trip delay is taken as half of the round trip. Negative round trips are ignored.
            Some(round_trip @ 0..1_000_000_000) => {
                (one_way.saturating_sub(round_trip / 2), round_trip)
            }
            // Without a round trip the one-round_trip delay is neglected; it is usually some milliseconds.
            _ => (one_way, CLOCK_STEP_NS),
        };
        if let Some(known) = self.offset_ns()
            && known.saturating_sub(offset).saturating_abs() > CLOCK_STEP_NS
        {
            self.exchanges.clear();
        }
        if self.exchanges.len() == MAX_EXCHANGES {
            self.exchanges.pop_front();
        }
        self.exchanges.push_back((offset, round_trip));
    }

    /// Own clock minus peer clock, nanoseconds. None before the first message.
    pub fn offset_ns(&self) -> Option<i64> {
        // Of equal round trips the smaller offset is better: messages arrive late, never early.
        self.exchanges
            .iter()
            .min_by_key(|(offset, round_trip)| (*round_trip, *offset))
            .map(|(offset, _)| *offset)
    }

    /// Shortest round trip, nanoseconds. Half of it bounds the error of the offset.
    pub fn round_trip_ns(&self) -> Option<i64> {
        let shortest = self
            .exchanges
            .iter()
            .map(|(_, round_trip)| *round_trip)
            .min()?;
        (shortest < CLOCK_STEP_NS).then_some(shortest)
    }
}

#[cfg(test)]
mod tests {
    use super::PeerClock;

    const MS: i64 = 1_000_000;

    #[test]
    fn clock_offset_error_is_below_half_the_shortest_round_trip() {
        let (offset, mut clock) = (-7_123 * MS, PeerClock::default());
        let mut now = 1_000 * MS;
        for k in 0..40_i64 {
            // 2 to 42 ms to the peer, 30 ms held, 1 to 31 ms back.
            let (there, held, back) = (2 * MS + k % 5 * 10 * MS, 30 * MS, MS + k % 4 * 10 * MS);
            let theirs = now + there + held - offset;
            let received = now + there + held + back;
            clock.add_exchange(theirs, received, Some((now, held)));
            now += 100 * MS;
        }
        let error = clock.offset_ns().expect("known") - offset;
        assert!(error.abs() <= 2 * MS, "{error}");
        assert_eq!(clock.round_trip_ns(), Some(3 * MS));
    }

    #[test]
    fn clock_step_resets_the_offset_and_extreme_times_do_not_overflow() {
        let mut clock = PeerClock::default();
        clock.add_exchange(0, 5 * MS, Some((0, 4 * MS)));
        clock.add_exchange(100_000 * MS, 10 * MS, None);
        assert_eq!(clock.offset_ns(), Some(10 * MS - 100_000 * MS));
        for extreme in [i64::MIN, i64::MAX, 0] {
            clock.add_exchange(extreme, i64::MIN, Some((extreme, i64::MIN)));
            clock.add_exchange(extreme, i64::MAX, Some((i64::MIN, extreme)));
        }
        assert!(clock.offset_ns().is_some());
    }
}
