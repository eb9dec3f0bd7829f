//! How are team messages encoded as datagrams and decoded? Without I/O or clocks: time is an argument.

use std::collections::BTreeMap;

use anyhow::Result;
use localize::Stamp;
use localize::team::TeamReport;
use localize::world::TrackedObject;
use prost::Message;

use super::TeamLinkConfig;
use super::peers::{Peer, Peers};
use super::team_message::{
    MAX_OBSTACLES, ball_ray, is_plausible, object_state, report_from_message,
};
use crate::cycle::Cycle;
use crate::datagram::authentication::{MacKey, RejectReason, append_mac, verify_mac};
use crate::datagram::message::{self, Echo, TeamMessage, VERSION};

/// Counts of datagrams.
#[derive(Debug, Clone, Default, PartialEq, Eq, serde::Serialize)]
pub struct TeamLinkCounts {
    /// Accepted messages.
    pub received: u64,
    /// Rejected datagrams by reason.
    pub refused: BTreeMap<RejectReason, u64>,
}

/// The clock of a teammate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
pub struct TeamClock {
    /// Number of the teammate.
    pub robot: u32,
    /// Own clock minus the teammate's, nanoseconds.
    pub clock_offset_ns: i64,
    /// Bound of the error: half a round trip, and what the clocks can have drifted apart since then. None while the
    /// teammate does not receive this robot: then the delay of its messages is unknown.
    pub clock_uncertainty_ns: Option<i64>,
}

/// One robot's end of the team communication.
#[derive(Debug)]
pub struct TeamLink {
    team: u32,
    robot: u32,
    silence: f64,
    key: Option<MacKey>,
    session: u64,
    sequence: u64,
    peers: Peers,
    counts: TeamLinkCounts,
}

impl TeamLink {
    /// `session` must increase with each start, for example nanoseconds since 1970.
    pub fn new(config: &TeamLinkConfig, session: u64) -> Result<Self> {
        let key = config.key.as_deref().map(MacKey::new).transpose()?;
        Ok(TeamLink {
            team: config.team,
            robot: config.robot,
            silence: config.silence,
            peers: Peers::new(config.members.clone(), key.is_some()),
            key,
            session,
            sequence: 0,
            counts: TeamLinkCounts::default(),
        })
    }

    /// Encodes a cycle as a datagram. `now`: time of sending, by the clock of the cycle's stamps.
    pub fn encode_message(&mut self, cycle: &Cycle, now: Stamp) -> Vec<u8> {
        self.sequence += 1;
        let echo = |(robot, peer): (&u32, &Peer)| Echo {
            robot: *robot,
            sent_ns: peer.sent_ns,
            held_ns: now.0.saturating_sub(peer.received_ns),
        };
        let ball = cycle.world.ball.as_ref();
        let mut obstacles: Vec<&TrackedObject> = cycle.world.robots.iter().collect();
        obstacles.sort_by(|a, b| b.probability.total_cmp(&a.probability));
        let message = TeamMessage {
            version: VERSION,
            team: self.team,
            robot: self.robot,
            session: self.session,
            sequence: self.sequence,
            sent_ns: now.0,
            stamp_ns: cycle.stamp.0,
            echoes: self.peers.iter().map(echo).collect(),
            pose: message::Pose::from_estimate(&cycle.estimate),
            ball: ball.and_then(object_state),
            ball_seen_ns: ball.map_or(0, |ball| ball.last_seen.0),
            obstacles: obstacles
                .into_iter()
                .filter_map(object_state)
                .take(MAX_OBSTACLES)
                .collect(),
            ball_ray: ball_ray(cycle),
            pose_by_markings: cycle.team.pose_by_markings,
        };
        append_mac(message.encode_to_vec(), self.key.as_ref())
    }

    /// Decodes a datagram. `now`: time of reception, own clock.
    pub fn receive(&mut self, datagram: &[u8], now: Stamp) -> Result<TeamReport, RejectReason> {
        let report = self.decode_message(datagram, now);
        match &report {
            Ok(_) => self.counts.received += 1,
            Err(why) => *self.counts.refused.entry(*why).or_default() += 1,
        }
        report
    }

    /// Counts of datagrams.
    pub fn counts(&self) -> &TeamLinkCounts {
        &self.counts
    }

    /// The clocks of all teammates that were received, in the order of their numbers. `now`: own clock.
    pub fn team_clocks(&self, now: Stamp) -> Vec<TeamClock> {
        let clock = |(robot, peer): (&u32, &Peer)| {
            let offset = peer.clock.offset(now.0)?;
            Some(TeamClock {
                robot: *robot,
                clock_offset_ns: offset.offset_ns,
                clock_uncertainty_ns: offset.error_max_ns,
            })
        };
        self.peers.iter().filter_map(clock).collect()
    }

    fn decode_message(&mut self, datagram: &[u8], now: Stamp) -> Result<TeamReport, RejectReason> {
        let content = verify_mac(datagram, self.key.as_ref())?;
        let message = TeamMessage::decode(content).map_err(|_foreign| RejectReason::Foreign)?;
        // Other programs' bytes may decode by chance. They lack a version then.
        if message.version == 0 {
            return Err(RejectReason::Foreign);
        }
        if message.version != VERSION {
            return Err(RejectReason::Version);
        }
        if message.team != self.team {
            return Err(RejectReason::Team);
        }
        if message.robot == self.robot {
            let is_own = message.session == self.session;
            return Err(if is_own {
                RejectReason::Own
            } else {
                RejectReason::Duplicate
            });
        }
        if !is_plausible(&message) {
            return Err(RejectReason::Senseless);
        }
        let (own, silence) = (self.robot, self.silence);
        let is_member = self.peers.is_member(message.robot);
        let order = (message.session, message.sequence);
        let peer = self.peers.accept(message.robot, order, now, silence)?;
        let echo = message.echoes.iter().find(|echo| echo.robot == own);
        let echo = echo.map(|echo| (echo.sent_ns, echo.held_ns));
        peer.clock.add_exchange(message.sent_ns, now.0, echo);
        (peer.sent_ns, peer.received_ns) = (message.sent_ns, now.0);
        let offset = peer.clock.offset(now.0).map_or(0, |clock| clock.offset_ns);
        // The clock offset has an error, but a report is never from the future.
        let ours = |theirs: i64| Stamp(theirs.saturating_add(offset).min(now.0));
        Ok(report_from_message(&message, is_member, ours))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::random_cycle;

    fn link(robot: u32, key: Option<&str>) -> TeamLink {
        let config = TeamLinkConfig {
            robot,
            key: key.map(str::to_owned),
            ..TeamLinkConfig::default()
        };
        TeamLink::new(&config, 7).expect("a link")
    }

    /// A message of `robot` at `seconds`.
    fn message(sender: &mut TeamLink, seconds: f64) -> Vec<u8> {
        let mut cycle = random_cycle(0);
        cycle.world.robots.clear();
        cycle.world.ball = None;
        cycle.estimate.pose = None;
        sender.encode_message(&cycle, Stamp::from_seconds(seconds))
    }

    /// Sends a message of `robot` to `receiver` at `seconds`.
    fn send(receiver: &mut TeamLink, robot: u32, seconds: f64) -> Result<(), RejectReason> {
        let now = Stamp::from_seconds(seconds);
        let mut sender = link(robot, None);
        // Each message comes from a later start of its sender.
        sender.session = now.0 as u64;
        let message = message(&mut sender, seconds);
        receiver.receive(&message, now).map(|_| ())
    }

    #[test]
    fn forged_speakers_do_not_shut_out_the_team() {
        let mut receiver = link(1, None);
        assert_eq!(send(&mut receiver, 2, 0.1), Ok(()));
        for number in 100..200 {
            let expected = if number < 115 {
                Ok(())
            } else {
                Err(RejectReason::Full)
            };
            assert_eq!(send(&mut receiver, number, 0.2), expected, "{number}");
        }
        // Numbers of the team take a place at once, and the first team-mate has kept its own.
        assert_eq!(send(&mut receiver, 5, 0.3), Ok(()));
        assert!(receiver.peers.contains(2) && receiver.peers.len() == 16);
        // Other numbers age out.
        assert_eq!(send(&mut receiver, 300, 1.0), Err(RejectReason::Full));
        assert_eq!(send(&mut receiver, 300, 6.0), Ok(()));
        assert!(receiver.peers.contains(2) && receiver.peers.contains(5));
    }

    #[test]
    fn recorded_messages_are_refused_after_others_took_the_place_of_their_sender() {
        let key = Some("a shared phrase");
        let (mut receiver, mut member) = (link(1, key), link(2, key));
        let receive = |receiver: &mut TeamLink, message: &[u8], seconds| {
            let report = receiver.receive(message, Stamp::from_seconds(seconds));
            report.map(|report| report.is_member)
        };
        let recorded = message(&mut member, 0.1);
        assert_eq!(receive(&mut receiver, &recorded, 0.1), Ok(true));
        for number in 30..46 {
            let forged = message(&mut link(number, key), 6.0);
            assert_eq!(receive(&mut receiver, &forged, 6.0), Ok(false));
        }
        assert!(!receiver.peers.contains(2));
        let replayed = receive(&mut receiver, &recorded, 20.0);
        assert_eq!(replayed, Err(RejectReason::Old));
        // A rejected message takes no place.
        assert!(!receiver.peers.contains(2));
        let next = message(&mut member, 20.0);
        assert_eq!(receive(&mut receiver, &next, 20.0), Ok(true));
    }

    #[test]
    fn message_of_another_robot_under_our_number_is_told_from_our_own() {
        let mut ours = link(1, None);
        let mut other = link(1, None);
        other.session += 1;
        let now = Stamp::from_seconds(0.1);
        let own = message(&mut ours, 0.1);
        assert_eq!(ours.receive(&own, now), Err(RejectReason::Own));
        let duplicate = message(&mut other, 0.1);
        assert_eq!(ours.receive(&duplicate, now), Err(RejectReason::Duplicate));
    }
}
