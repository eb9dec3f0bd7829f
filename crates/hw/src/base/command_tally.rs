//! Which commands did the base take? Counts of what was sent on the bus, and of what the base confirmed.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use localize::Stamp;

/// Time for the report of a kick, seconds: boards report the kicker at 10 Hz or more.
const KICK_REPORT_MAX: f64 = 1.0;
/// Most commands waiting for a confirmation: a second of them.
const PENDING_MAX: usize = 128;

/// Counts of the commands of one source; a handle made by [`super::BaseHandle::counting`] adds to it.
#[derive(Debug, Default)]
pub struct CommandTally {
    sent: AtomicU64,
    confirmed: AtomicU64,
}

impl CommandTally {
    /// Commands and kicks that were sent on the bus.
    pub fn sent(&self) -> u64 {
        self.sent.load(Ordering::Relaxed)
    }

    /// Commands during whose validity the base reported its wheels without a pressed emergency stop, and kicks that it
    /// reported as carried out.
    pub fn confirmed(&self) -> u64 {
        self.confirmed.load(Ordering::Relaxed)
    }
}

/// A sent command that the base has not confirmed yet.
#[derive(Debug)]
struct Pending {
    tally: Arc<CommandTally>,
    sent: Stamp,
    deadline: Stamp,
    /// Sequence number of the message, for a kick.
    kick: Option<u16>,
}

/// The sent commands that wait for a report of the base.
#[derive(Debug, Default)]
pub(super) struct Confirmations {
    pending: VecDeque<Pending>,
    emergency_stop: bool,
}

impl Confirmations {
    /// A motion command was sent.
    pub(super) fn on_drive_sent(
        &mut self,
        tally: Option<Arc<CommandTally>>,
        sent: Stamp,
        deadline: Stamp,
    ) {
        self.push(tally, sent, deadline, None);
    }

    /// A kick was sent in the message `sequence`.
    pub(super) fn on_kick_sent(
        &mut self,
        tally: Option<Arc<CommandTally>>,
        sent: Stamp,
        sequence: u16,
    ) {
        self.push(tally, sent, sent + KICK_REPORT_MAX, Some(sequence));
    }

    fn push(
        &mut self,
        tally: Option<Arc<CommandTally>>,
        sent: Stamp,
        deadline: Stamp,
        kick: Option<u16>,
    ) {
        let Some(tally) = tally else { return };
        tally.sent.fetch_add(1, Ordering::Relaxed);
        if self.pending.len() == PENDING_MAX {
            self.pending.pop_front();
        }
        self.pending.push_back(Pending {
            tally,
            sent,
            deadline,
            kick,
        });
    }

    /// The base reported its wheels at `stamp`: it confirms the commands sent before that are valid then.
    pub(super) fn on_wheel_report(&mut self, stamp: Stamp) {
        let emergency_stop = self.emergency_stop;
        self.pending.retain(|pending| {
            if pending.kick.is_some() || stamp < pending.sent {
                return pending.deadline >= stamp;
            }
            if stamp <= pending.deadline && !emergency_stop {
                pending.tally.confirmed.fetch_add(1, Ordering::Relaxed);
            }
            false
        });
    }

    /// The base reported the sequence number of its last kick at `stamp`.
    pub(super) fn on_kicker_report(&mut self, last_kick: u16, stamp: Stamp) {
        self.pending.retain(|pending| {
            let carried_out = pending.kick == Some(last_kick) && stamp >= pending.sent;
            if carried_out {
                pending.tally.confirmed.fetch_add(1, Ordering::Relaxed);
            }
            !carried_out
        });
    }

    /// Is the emergency stop pressed?
    pub(super) fn emergency_stop(&self) -> bool {
        self.emergency_stop
    }

    /// The base reported its emergency stop.
    pub(super) fn on_switches(&mut self, emergency_stop: bool) {
        self.emergency_stop = emergency_stop;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    #[test]
    fn only_a_report_during_the_validity_confirms_a_command() {
        let tally = Arc::new(CommandTally::default());
        let mut waiting = Confirmations::default();
        let counts = || (tally.sent(), tally.confirmed());
        let source = || Some(Arc::clone(&tally));
        waiting.on_drive_sent(source(), Stamp(10 * MS), Stamp(110 * MS));
        // A report from before the command was sent.
        waiting.on_wheel_report(Stamp(9 * MS));
        assert_eq!(counts(), (1, 0));
        waiting.on_wheel_report(Stamp(20 * MS));
        waiting.on_wheel_report(Stamp(30 * MS));
        assert_eq!(counts(), (1, 1));
        waiting.on_drive_sent(source(), Stamp(40 * MS), Stamp(140 * MS));
        waiting.on_wheel_report(Stamp(150 * MS));
        assert_eq!(
            counts(),
            (2, 1),
            "the report came after the command had expired"
        );
        waiting.on_switches(true);
        waiting.on_drive_sent(source(), Stamp(200 * MS), Stamp(300 * MS));
        waiting.on_wheel_report(Stamp(210 * MS));
        assert_eq!(counts(), (3, 1), "the emergency stop is pressed");
        waiting.on_kick_sent(source(), Stamp(400 * MS), 77);
        waiting.on_wheel_report(Stamp(410 * MS));
        waiting.on_kicker_report(76, Stamp(420 * MS));
        assert_eq!(counts(), (4, 1));
        waiting.on_kicker_report(77, Stamp(500 * MS));
        waiting.on_kicker_report(77, Stamp(600 * MS));
        assert_eq!(counts(), (4, 2));
    }
}
