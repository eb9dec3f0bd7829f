//! Which commands did the base take? Counts of what was sent on the bus, and of what the base confirmed.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use localize::Stamp;

/// Time for the report of a kick, seconds: boards report the kicker at 10 Hz or more.
const KICK_REPORT_MAX: f64 = 1.0;
/// Time after which a board must follow new commands, seconds: its report of an expired command may be this old.
const FOLLOW_TIME: f64 = 0.2;
/// A command that comes so shortly before the last one expires may come after it, seconds.
const VALIDITY_MARGIN: f64 = 0.02;
/// Time without speeds after a report that the base receives no commands, seconds. A shorter one would let the wheels stop and go.
const SPEEDLESS_TIME: f64 = 1.0;
/// Time for which such a report counts, seconds: until speeds that are sent again have had the time to be followed or not.
const CONTRADICTION_TIME: f64 = 2.0;
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

    /// Commands during whose validity, after their arrival, the base reported all its wheels, without a pressed emergency stop and
    /// without a report that it receives no commands; and kicks that it reported as carried out.
    pub fn confirmed(&self) -> u64 {
        self.confirmed.load(Ordering::Relaxed)
    }
}

/// A sent command that the base has not confirmed yet.
#[derive(Debug)]
struct Pending {
    tally: Arc<CommandTally>,
    /// When the line has carried it.
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
    /// End of the validity of the last command.
    valid_until: Stamp,
    /// Since when valid commands arrive without a gap, and since when such that move the wheels.
    valid_since: Option<Stamp>,
    moving_since: Option<Stamp>,
    /// The base has reported a command of speed zero as valid.
    zero_is_valid: bool,
    /// When the base last reported that its last command had expired, although valid ones arrived until then.
    contradicted: Option<Stamp>,
}

impl Confirmations {
    /// What was sent has not reached the base: it is to be forgotten.
    pub(super) fn on_output_discarded(&mut self) {
        self.pending.clear();
        self.valid_since = None;
        self.moving_since = None;
    }

    /// A command, that moves the wheels or not, arrives at `arrival` and is valid until then.
    pub(super) fn on_command_sent(&mut self, moves: bool, arrival: Stamp, valid_until: Stamp) {
        let is_continuous = arrival + VALIDITY_MARGIN <= self.valid_until;
        self.valid_until = valid_until;
        let since = |since: Option<Stamp>| since.filter(|_| is_continuous).or(Some(arrival));
        self.valid_since = since(self.valid_since);
        self.moving_since = since(self.moving_since).filter(|_| moves);
    }

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

    /// The base has reported all its wheels at `stamp`: that confirms the commands sent before that are valid then.
    pub(super) fn on_wheel_report(&mut self, stamp: Stamp) {
        let is_held = self.emergency_stop || self.receives_nothing(stamp);
        self.pending.retain(|pending| {
            if pending.kick.is_some() || stamp < pending.sent {
                return pending.deadline >= stamp;
            }
            if stamp <= pending.deadline && !is_held {
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

    /// The base reported its emergency stop, and whether its last command had expired.
    pub(super) fn on_switches(
        &mut self,
        emergency_stop: bool,
        command_stale: bool,
        arrival: Stamp,
    ) {
        self.emergency_stop = emergency_stop;
        let is_long_ago =
            |since: Option<Stamp>| since.is_some_and(|since| arrival - since > FOLLOW_TIME);
        let has_valid = is_long_ago(self.valid_since);
        if !command_stale {
            self.contradicted = self
                .contradicted
                .filter(|_| self.needs_zero_speeds(arrival));
            self.zero_is_valid |= has_valid && self.moving_since.is_none();
        } else if !emergency_stop
            && has_valid
            && (self.zero_is_valid || is_long_ago(self.moving_since))
        {
            self.contradicted = Some(arrival);
        }
    }

    /// Does the base report that its last command has expired, although valid ones arrive without a gap? Some boards report a
    /// command of speed zero as expired: then only commands that move the wheels are evidence.
    pub(super) fn receives_nothing(&self, now: Stamp) -> bool {
        self.contradicted
            .is_some_and(|reported| now - reported <= CONTRADICTION_TIME)
    }

    /// Must the base get speeds of zero because it receives no commands? It would follow those that it receives late. A base that
    /// reports such commands as valid goes on doing without speeds as long as it receives none. To others, speeds are sent again after
    /// a while: only these can show that it receives commands.
    pub(super) fn needs_zero_speeds(&self, now: Stamp) -> bool {
        self.contradicted
            .is_some_and(|reported| now - reported <= SPEEDLESS_TIME)
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
        waiting.on_switches(true, false, Stamp(190 * MS));
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

    #[test]
    fn report_of_expired_commands_while_new_ones_drive_shows_that_the_base_receives_none() {
        let mut waiting = Confirmations::default();
        let send = |waiting: &mut Confirmations, moves, from: i64, until: i64| {
            for at in (from..until).step_by(10) {
                waiting.on_command_sent(moves, Stamp(at * MS), Stamp((at + 100) * MS));
            }
        };
        // Speeds of zero are no evidence, nor are the first moments of a drive, nor a pressed emergency stop, nor commands with a gap.
        send(&mut waiting, false, 0, 1000);
        waiting.on_switches(false, true, Stamp(900 * MS));
        send(&mut waiting, true, 1000, 1300);
        waiting.on_switches(false, true, Stamp(1100 * MS));
        waiting.on_switches(true, true, Stamp(1300 * MS));
        waiting.on_command_sent(true, Stamp(1395 * MS), Stamp(1500 * MS));
        waiting.on_switches(false, true, Stamp(1400 * MS));
        assert!(!waiting.receives_nothing(Stamp(1410 * MS)));
        send(&mut waiting, true, 1400, 1700);
        waiting.on_switches(false, true, Stamp(1700 * MS));
        assert!(waiting.receives_nothing(Stamp(1710 * MS)));
        let tally = Arc::new(CommandTally::default());
        waiting.on_drive_sent(Some(Arc::clone(&tally)), Stamp(1720 * MS), Stamp(1800 * MS));
        waiting.on_wheel_report(Stamp(1730 * MS));
        assert_eq!((tally.sent(), tally.confirmed()), (1, 0));
        // What it last reported holds while nothing moves, and ends after two seconds.
        send(&mut waiting, false, 1700, 2300);
        waiting.on_switches(false, true, Stamp(2200 * MS));
        assert!(waiting.receives_nothing(Stamp(2600 * MS)));
        assert!(!waiting.receives_nothing(Stamp(3800 * MS)));
        // Another report ends it after a second.
        waiting.on_switches(false, false, Stamp(2300 * MS));
        assert!(waiting.receives_nothing(Stamp(2300 * MS)));
        send(&mut waiting, false, 2300, 2800);
        waiting.on_switches(false, false, Stamp(2800 * MS));
        assert!(!waiting.receives_nothing(Stamp(2800 * MS)));
        // A board that has once reported a speed of zero as valid contradicts by such commands, too.
        waiting.on_switches(false, true, Stamp(2810 * MS));
        assert!(waiting.receives_nothing(Stamp(2810 * MS)));
    }

    /// Sends commands for 6 s to a board that reports each 100 ms; returns when they were zero, and whether the board was named.
    fn drive_for_6_s(
        mut reports_expired: impl FnMut(i64, bool) -> bool,
        idle_until: i64,
    ) -> Vec<(bool, bool)> {
        let mut waiting = Confirmations::default();
        let send_and_report = |at: i64| {
            let now = Stamp(at * MS);
            let zero = at < idle_until || waiting.needs_zero_speeds(now);
            waiting.on_command_sent(!zero, now, now + 0.1);
            if at % 100 == 0 {
                waiting.on_switches(false, reports_expired(at, zero), now);
            }
            (zero, waiting.receives_nothing(now))
        };
        (0..6000).step_by(10).map(send_and_report).collect()
    }

    #[test]
    fn base_gets_zero_speeds_while_it_reports_expired_commands_and_for_a_second_after() {
        let log = drive_for_6_s(|at, _| (2000..4000).contains(&at), 1000);
        let moves = |range: std::ops::Range<usize>| log[range].iter().any(|(zero, _)| !zero);
        assert!(log[100..200].iter().all(|(zero, _)| !zero));
        assert!(!moves(201..490));
        assert!(moves(491..492));
        assert!(log[501..].iter().all(|(zero, named)| !zero && !named));
    }

    #[test]
    fn base_that_reports_zero_speeds_as_expired_is_driven_from_the_start_and_again_after_a_fault() {
        // Such a base reports expired commands before the first speeds.
        let log = drive_for_6_s(|at, zero| zero || (2000..4000).contains(&at), 1000);
        assert!(log[100..200].iter().all(|(zero, named)| !zero && !named));
        assert!(log[540..].iter().all(|(zero, named)| !zero && !named));
        // Meanwhile speeds are tried, no more often than every second, and the name stays.
        let fault = &log[201..400];
        assert!(fault.iter().all(|(_, named)| *named));
        let starts = fault.windows(2).filter(|pair| pair[0].0 && !pair[1].0);
        assert_eq!(starts.count(), 1);
    }
}
