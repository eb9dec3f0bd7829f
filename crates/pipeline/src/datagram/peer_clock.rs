//! What is the offset of a team-mate's clock? Estimated from round trips of messages, as NTP does.

use std::collections::VecDeque;

/// Number of stored round trips; the fastest one is used, because delays are asymmetric.
const MAX_EXCHANGES: usize = 32;
/// A larger jump means that the clock was set; earlier round trips are dropped then, nanoseconds.
const CLOCK_STEP_NS: i64 = 500_000_000;

/// Clock of a team-mate.
#[derive(Debug, Clone, Default)]
pub struct PeerClock {
    /// Offset and how long the way there and back took; one-way words take "twice as long as can be".
    exchanges: VecDeque<(i64, i64)>,
}

impl PeerClock {
    /// A word sent at `sent_ns` of theirs was heard at `heard_ns` of ours. `echo`: our own word's sending, by our clock,
    /// and how long they held it.
    pub fn add_exchange(&mut self, sent_ns: i64, heard_ns: i64, echo: Option<(i64, i64)>) {
        // Foreign clocks can hold any value: saturating arithmetic.
        let one_way = heard_ns.saturating_sub(sent_ns);
        let whole =
            echo.map(|(ours_ns, held_ns)| heard_ns.saturating_sub(ours_ns).saturating_sub(held_ns));
        let (offset, way) = match whole {
            // One way takes half of the round trip; a negative round trip is ignored.
            Some(way @ 0..1_000_000_000) => (one_way.saturating_sub(way / 2), way),
            // Without a round trip, only a one-way delay of some milliseconds can be assumed.
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
        self.exchanges.push_back((offset, way));
    }

    /// Our time minus theirs, nanoseconds. None before the first message.
    pub fn offset_ns(&self) -> Option<i64> {
        // Of equals the smaller offset: messages are late, never early.
        self.exchanges
            .iter()
            .min_by_key(|(offset, way)| (*way, *offset))
            .map(|(offset, _)| *offset)
    }

    /// Shortest round trip, nanoseconds; the offset is known to half of it.
    pub fn round_trip_ns(&self) -> Option<i64> {
        let quickest = self.exchanges.iter().map(|(_, way)| *way).min()?;
        (quickest < CLOCK_STEP_NS).then_some(quickest)
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
            // Outward 2 to 42 ms, held for 30 ms, back 1 to 31 ms.
            let (there, held, back) = (2 * MS + k % 5 * 10 * MS, 30 * MS, MS + k % 4 * 10 * MS);
            let theirs = now + there + held - offset;
            let heard = now + there + held + back;
            clock.add_exchange(theirs, heard, Some((now, held)));
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
        for wild in [i64::MIN, i64::MAX, 0] {
            clock.add_exchange(wild, i64::MIN, Some((wild, i64::MIN)));
            clock.add_exchange(wild, i64::MAX, Some((i64::MIN, wild)));
        }
        assert!(clock.offset_ns().is_some());
    }
}
