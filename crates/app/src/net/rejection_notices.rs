//! Which rejected datagrams does the operator hear of? The first one of each sender and reason, and again after a pause.

use std::collections::BTreeMap;
use std::net::{IpAddr, SocketAddr};

use localize::Stamp;

/// Without one for this time, the next datagram of the same sender and kind is reported again, seconds.
const PAUSE: f64 = 60.0;
/// Most senders and kinds that are remembered: senders may be invented.
const KNOWN_MAX: usize = 64;

/// When datagrams of each sender and kind `K` came last.
#[derive(Debug)]
pub(super) struct RejectionNotices<K> {
    known: BTreeMap<(Option<IpAddr>, K), Stamp>,
}

impl<K: Ord> RejectionNotices<K> {
    pub(super) fn new() -> Self {
        RejectionNotices {
            known: BTreeMap::new(),
        }
    }

    /// True if a datagram of a sender at `now` is to be reported. A program may send each from another port, so that the port does
    /// not tell senders apart.
    pub(super) fn is_due(&mut self, source: Option<SocketAddr>, kind: K, now: Stamp) -> bool {
        let key = (source.map(|source| source.ip()), kind);
        let is_recent = |last: &Stamp| now - *last < PAUSE;
        if let Some(last) = self.known.get_mut(&key) {
            let was_recent = is_recent(last);
            *last = now;
            return !was_recent;
        }
        if self.known.len() == KNOWN_MAX {
            self.known.retain(|_, last| is_recent(last));
        }
        let has_place = self.known.len() < KNOWN_MAX;
        if has_place {
            self.known.insert(key, now);
        }
        has_place
    }
}

/// An address as text.
pub(super) fn name(source: Option<SocketAddr>) -> String {
    source.map_or_else(
        || "an unknown address".to_owned(),
        |source| source.to_string(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn source(host: u8, port: u16) -> Option<SocketAddr> {
        Some(SocketAddr::from(([10, 0, 0, host], port)))
    }

    #[test]
    fn each_sender_and_kind_is_reported_once_and_again_after_a_pause() {
        let mut notices = RejectionNotices::new();
        let mut is_due = |host, port, kind: &'static str, seconds| {
            notices.is_due(source(host, port), kind, Stamp::from_seconds(seconds))
        };
        assert!(is_due(1, 70, "key", 0.0));
        assert!(!is_due(1, 70, "key", 0.1) && !is_due(1, 71, "key", 0.2));
        assert!(is_due(1, 70, "version", 0.3) && is_due(2, 70, "key", 0.3));
        for second in 1..200 {
            assert!(!is_due(1, 70, "key", f64::from(second)), "{second}");
        }
        assert!(is_due(2, 70, "key", 199.0));
        assert!(is_due(1, 70, "key", 260.0));
    }

    #[test]
    fn invented_senders_do_not_flood_the_operator() {
        let mut notices = RejectionNotices::new();
        let mut reported = 0;
        for k in 0..10_000_u32 {
            let source = Some(SocketAddr::from((k.to_be_bytes(), 7)));
            let now = Stamp::from_seconds(f64::from(k) * 1e-3);
            reported += usize::from(notices.is_due(source, (), now));
        }
        assert_eq!(reported, KNOWN_MAX);
        assert!(notices.is_due(source(1, 1), (), Stamp::from_seconds(100.0)));
    }
}
