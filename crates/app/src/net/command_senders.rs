//! Who drives the robot by commands, and whose commands are rejected?

use std::net::SocketAddr;

use hw::ReceivedDatagram;

use super::rejection_notices::{self, RejectionNotices};
use pipeline::datagram::authentication::RejectReason;

/// The sender that drives, and which messages about senders the operator has.
pub(super) struct CommandSenders {
    /// Sender of the latest accepted command.
    driving: Option<SocketAddr>,
    /// By reason; None: took over.
    notices: RejectionNotices<Option<RejectReason>>,
}

impl CommandSenders {
    pub(super) fn new() -> Self {
        CommandSenders {
            driving: None,
            notices: RejectionNotices::new(),
        }
    }

    /// Takes note of an accepted command. A message for the operator, if another sender drove before.
    pub(super) fn accept(&mut self, received: &ReceivedDatagram) -> Option<String> {
        let source = received.source;
        let before = self.driving;
        self.driving = source.or(before);
        let is_due = before.is_some()
            && self.driving != before
            && self.notices.is_due(source, None, received.arrival);
        is_due.then(|| {
            let (now, before) = (
                rejection_notices::name(source),
                rejection_notices::name(before),
            );
            format!("remote commands come from {now} now, in place of {before}")
        })
    }

    /// Takes note of a rejected datagram. A message for the operator, if it is the first of its kind.
    pub(super) fn reject(
        &mut self,
        received: &ReceivedDatagram,
        reason: RejectReason,
    ) -> Option<String> {
        let source = received.source;
        let is_due = self.notices.is_due(source, Some(reason), received.arrival);
        is_due.then(|| {
            let name = rejection_notices::name(source);
            format!(
                "a remote command of {name} is rejected: {}",
                self.fault(reason)
            )
        })
    }

    /// The text of a reason. It names the sender that drives.
    pub(super) fn fault(&self, reason: RejectReason) -> String {
        match (reason, self.driving) {
            (RejectReason::Superseded | RejectReason::Shared, Some(driving)) => {
                format!("{reason}. It is {driving}")
            }
            _ => reason.to_string(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use localize::Stamp;

    fn received(port: u16, seconds: f64) -> ReceivedDatagram {
        ReceivedDatagram {
            length: 0,
            arrival: Stamp::from_seconds(seconds),
            source: Some(SocketAddr::from(([127, 0, 0, 1], port))),
        }
    }

    #[test]
    fn sender_that_takes_over_is_named() {
        let mut senders = CommandSenders::new();
        assert_eq!(senders.accept(&received(10, 0.0)), None);
        assert_eq!(senders.accept(&received(10, 0.1)), None);
        let takeover = senders.accept(&received(20, 0.2));
        assert_eq!(
            takeover.as_deref(),
            Some("remote commands come from 127.0.0.1:20 now, in place of 127.0.0.1:10")
        );
        let superseded = RejectReason::Superseded;
        let rejected = senders.reject(&received(10, 0.3), superseded);
        let rejected = rejected.expect("a message");
        assert!(rejected.contains("of 127.0.0.1:10 is rejected: another sender took over"));
        assert!(rejected.ends_with("It is 127.0.0.1:20"), "{rejected}");
        assert_eq!(senders.reject(&received(10, 0.4), superseded), None);
        let fault = senders.fault(RejectReason::Superseded);
        assert!(fault.ends_with("It is 127.0.0.1:20"), "{fault}");
        let shared = senders.reject(&received(10, 0.5), RejectReason::Shared);
        assert!(
            shared.is_some_and(|text| text.ends_with("It is 127.0.0.1:20")),
            "another reason is another message"
        );
        assert_eq!(
            senders.fault(RejectReason::Old),
            RejectReason::Old.to_string()
        );
    }
}
