//! What is the offset of a teammate's clock? It is estimated from round trips of messages, as in NTP.

use std::collections::VecDeque;

/// Number of stored exchanges. The one with the smallest bound of its error is used.
const MAX_EXCHANGES: usize = 32;
/// Longest round trip that counts as measured, nanoseconds.
const ROUND_TRIP_MAX_NS: i64 = 1_000_000_000;
/// Where no round trip is measured, a larger jump of the offset means that the clock was set, nanoseconds.
const CLOCK_STEP_NS: i64 = 500_000_000;
/// One over the largest relative difference of two clocks' rates: 0.05 % each, by which the kernel at most slews a clock
/// that it disciplines. A quartz alone is ten times better.
const RATE_DIFFERENCE_INVERSE: i64 = 1000;
/// Error of whole nanoseconds: of the readings of sending and holding, of half the round trip, and of the offset's reader.
const READING_ERROR_NS: i64 = 4;

/// Clock of a teammate.
#[derive(Debug, Clone, Default)]
pub(super) struct PeerClock {
    exchanges: VecDeque<Exchange>,
}

/// A received message.
#[derive(Debug, Clone, Copy)]
struct Exchange {
    received_ns: i64,
    /// Own clock minus peer clock.
    offset_ns: i64,
    /// Bound of the offset's error when the message was received. None without an echo: then the delay is unknown.
    error_max_ns: Option<i64>,
}

/// Offset of a clock with a bound of its error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct ClockOffset {
    /// Own clock minus peer clock, nanoseconds.
    pub(super) offset_ns: i64,
    /// Bound of the error, nanoseconds. None without a round trip.
    pub(super) error_max_ns: Option<i64>,
}

impl PeerClock {
    /// Adds a message sent at `sent_ns` (peer clock) and received at `received_ns` (own clock).
    ///
    /// `echo`: when we sent the message that the peer echoes (own clock), and how long the peer held it, nanoseconds.
    pub(super) fn add_exchange(
        &mut self,
        sent_ns: i64,
        received_ns: i64,
        echo: Option<(i64, i64)>,
    ) {
        let exchange = Exchange::new(sent_ns, received_ns, echo);
        if let Some(known) = self.offset(received_ns) {
            let difference = known.offset_ns.saturating_sub(exchange.offset_ns);
            // Two bounds that exclude each other: one of the clocks was set.
            let difference_max = match (known.error_max_ns, exchange.error_max_ns) {
                (Some(known), Some(new)) => known.saturating_add(new),
                _ => CLOCK_STEP_NS,
            };
            if difference.saturating_abs() > difference_max {
                self.exchanges.clear();
            }
        }
        if self.exchanges.len() == MAX_EXCHANGES {
            self.exchanges.pop_front();
        }
        self.exchanges.push_back(exchange);
    }

    /// The offset at `now_ns` (own clock). None before the first message.
    pub(super) fn offset(&self, now_ns: i64) -> Option<ClockOffset> {
        let bound = |exchange: &Exchange| exchange.error_max_ns(now_ns);
        // Without round trips the delay is neglected. The smallest offset is best: messages arrive late, never early.
        let best = self.exchanges.iter().min_by_key(|exchange| {
            let bound = bound(exchange);
            (bound.is_none(), bound, exchange.offset_ns)
        })?;
        Some(ClockOffset {
            offset_ns: best.offset_ns,
            error_max_ns: bound(best),
        })
    }
}

impl Exchange {
    // A peer clock can have any value, so arithmetic saturates.
    fn new(sent_ns: i64, received_ns: i64, echo: Option<(i64, i64)>) -> Self {
        let one_way_ns = received_ns.saturating_sub(sent_ns);
        let measured = echo.and_then(|(ours_ns, held_ns)| {
            let round_trip_ns = received_ns.saturating_sub(ours_ns).saturating_sub(held_ns);
            // The peer's clock measured the time for which it held our message.
            let held_error_ns = drift_max_ns(held_ns).saturating_add(READING_ERROR_NS);
            let is_plausible = held_ns >= 0
                && (held_error_ns.saturating_neg()..ROUND_TRIP_MAX_NS).contains(&round_trip_ns);
            let round_trip_ns = round_trip_ns.max(0);
            // The offset is that of the moment of sending, up to a round trip before the message was received.
            let error_ns = held_error_ns.saturating_add(drift_max_ns(round_trip_ns));
            is_plausible.then_some((round_trip_ns / 2, error_ns))
        });
        Exchange {
            received_ns,
            // The one-way delay is taken as half of the round trip, and lies between none and all of it.
            offset_ns: one_way_ns.saturating_sub(measured.map_or(0, |(half_ns, _)| half_ns)),
            error_max_ns: measured.map(|(half_ns, error_ns)| half_ns.saturating_add(error_ns)),
        }
    }

    /// Bound of the error at `now_ns`: it grows while the clocks run at different rates.
    fn error_max_ns(&self, now_ns: i64) -> Option<i64> {
        let age_ns = now_ns.saturating_sub(self.received_ns).max(0);
        self.error_max_ns
            .map(|error_max_ns| error_max_ns.saturating_add(drift_max_ns(age_ns)))
    }
}

/// The most by which two clocks' offset changes in a duration, nanoseconds.
fn drift_max_ns(duration_ns: i64) -> i64 {
    (duration_ns / RATE_DIFFERENCE_INVERSE).saturating_add(1)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const MS: i64 = 1_000_000;

    /// A peer whose clock starts with an offset and runs at another rate.
    struct Peer {
        offset_ns: i64,
        rate: f64,
    }

    impl Peer {
        /// Own clock minus peer clock.
        fn offset_at(&self, own_ns: i64) -> i64 {
            self.offset_ns - (own_ns as f64 * self.rate) as i64
        }

        fn clock_at(&self, own_ns: i64) -> i64 {
            own_ns - self.offset_at(own_ns)
        }
    }

    proptest! {
        #[test]
        fn stated_uncertainty_covers_the_true_offset(
            offset_ns in -1_000_000_000_000_i64..1_000_000_000_000,
            // Parts per million: two clocks of 500 ppm each.
            rate_ppm in -999.0..999.0,
            // Microseconds: way there, held, way back, time until the next message. Any asymmetry, losses and silences.
            messages in prop::collection::vec(
                (0_i64..200_000, 0_i64..500_000, 0_i64..200_000, 1_000_i64..3_000_000, any::<bool>()),
                1..80,
            ),
            silence_us in 0_i64..60_000_000,
        ) {
            let peer = Peer { offset_ns, rate: rate_ppm * 1e-6 };
            let mut clock = PeerClock::default();
            let mut sent = 5_000 * MS;
            let mut echoed = false;
            for (there, held, back, next, received) in messages {
                let arrived = sent + there * 1000;
                let answered = arrived + held * 1000;
                let held_by_peer = peer.clock_at(answered) - peer.clock_at(arrived);
                let now = answered + back * 1000;
                clock.add_exchange(peer.clock_at(answered), now, received.then_some((sent, held_by_peer)));
                echoed |= received;
                let until_next = [now, now + next * 1000, now + silence_us * 1000];
                for now in until_next {
                    let stated = clock.offset(now).expect("known");
                    if let Some(bound) = stated.error_max_ns {
                        let error = stated.offset_ns - peer.offset_at(now);
                        prop_assert!(error.abs() <= bound, "error {} > {}", error, bound);
                    }
                }
                sent = until_next[1];
            }
            if echoed && clock.exchanges.len() < MAX_EXCHANGES {
                prop_assert!(clock.offset(sent).expect("known").error_max_ns.is_some());
            }
        }
    }

    #[test]
    fn uncertainty_is_half_the_shortest_round_trip_and_grows_with_its_age() {
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
        let stated = clock.offset(now).expect("known");
        assert!((stated.offset_ns - offset).abs() <= MS, "{stated:?}");
        // Half of 3 ms, and 0.1 % of 30 ms and of at most 2.1 s.
        let bound = stated.error_max_ns.expect("measured");
        assert!((1_530_000..3_630_000).contains(&bound), "{bound}");
        let later = clock.offset(now + 60_000 * MS).expect("known");
        assert_eq!(later.error_max_ns.map(|later| later - bound), Some(60 * MS));
    }

    #[test]
    fn clock_step_resets_the_offset_and_extreme_times_do_not_overflow() {
        let mut clock = PeerClock::default();
        let offset = |clock: &PeerClock| clock.offset(10 * MS).map(|stated| stated.offset_ns);
        clock.add_exchange(0, 5 * MS, Some((0, 4 * MS)));
        // A step of 50 ms, far beyond both bounds.
        clock.add_exchange(50 * MS, 10 * MS, Some((5 * MS, 4 * MS)));
        assert_eq!(offset(&clock), Some(-40 * MS - MS / 2));
        clock.add_exchange(100_000 * MS, 10 * MS, None);
        assert_eq!(offset(&clock), Some(10 * MS - 100_000 * MS));
        for extreme in [i64::MIN, i64::MAX, 0] {
            clock.add_exchange(extreme, i64::MIN, Some((extreme, i64::MIN)));
            clock.add_exchange(extreme, i64::MAX, Some((i64::MIN, extreme)));
        }
        assert!(clock.offset(i64::MIN).is_some() && clock.offset(i64::MAX).is_some());
    }
}
