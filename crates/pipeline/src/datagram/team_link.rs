//! How are team messages encoded as datagrams and decoded? Without I/O or clocks: time is an argument.

use std::collections::BTreeMap;

use anyhow::Result;
use localize::frames::{At, wrap_angle};
use localize::team::{ReportedBall, ReportedObstacle, TeamReport};
use localize::world::{BallSighting, TrackedObject};
use localize::{Pose, Stamp};
use prost::Message;

use super::TeamLinkConfig;
use super::peer_clock::PeerClock;
use crate::cycle::Cycle;
use crate::datagram::authentication::{MacKey, RejectReason, ReplayGuard, append_mac, verify_mac};
use crate::datagram::message::{self, BallRay, Echo, ObjectState, TeamMessage, VERSION};

/// Number of stored senders: more than a team has. Bounds the memory if a foreign program invents robot numbers.
const MAX_PEERS: usize = 16;
/// A sender that is silent for this time loses its place when another one needs it, seconds.
const PEER_AGE_MAX: f64 = 5.0;
/// Number of tracked robots in a message; the most probable ones are sent.
const MAX_OBSTACLES: usize = 16;

/// Counts of datagrams.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
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
    members: Vec<u32>,
    silence: f64,
    key: Option<MacKey>,
    session: u64,
    sequence: u64,
    peers: BTreeMap<u32, Peer>,
    counts: TeamLinkCounts,
}

/// Reception of a teammate's messages.
#[derive(Debug, Clone)]
struct Peer {
    replay_guard: ReplayGuard,
    clock: PeerClock,
    sent_ns: i64,
    received_ns: i64,
}

impl TeamLink {
    /// `session` must increase with each start, for example nanoseconds since 1970.
    pub fn new(config: &TeamLinkConfig, session: u64) -> Result<Self> {
        Ok(TeamLink {
            team: config.team,
            robot: config.robot,
            members: config.members.clone(),
            silence: config.silence,
            key: config.key.as_deref().map(MacKey::new).transpose()?,
            session,
            sequence: 0,
            peers: BTreeMap::new(),
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
            return Err(RejectReason::Foreign);
        }
        if message.robot == self.robot {
            return Err(RejectReason::Own);
        }
        if !is_plausible(&message) {
            return Err(RejectReason::Senseless);
        }
        if !self.peers.contains_key(&message.robot) {
            self.make_place_for(message.robot, now)?;
        }
        let (own, silence) = (self.robot, self.silence);
        let peer = self.peers.entry(message.robot).or_insert_with(|| Peer {
            replay_guard: ReplayGuard::new(self.key.is_some()),
            clock: PeerClock::default(),
            sent_ns: 0,
            received_ns: 0,
        });
        peer.replay_guard
            .accept(message.session, message.sequence, now.seconds(), silence)?;
        let echo = message.echoes.iter().find(|echo| echo.robot == own);
        let echo = echo.map(|echo| (echo.sent_ns, echo.held_ns));
        peer.clock.add_exchange(message.sent_ns, now.0, echo);
        (peer.sent_ns, peer.received_ns) = (message.sent_ns, now.0);
        let offset = peer.clock.offset(now.0).map_or(0, |clock| clock.offset_ns);
        // The clock offset has an error, but a report is never from the future.
        let ours = |theirs: i64| Stamp(theirs.saturating_add(offset).min(now.0));
        let is_member = self.members.contains(&message.robot);
        Ok(report_from_message(&message, is_member, ours))
    }
}

impl TeamLink {
    /// Removes a sender if there is no place for a new one. Numbers of the team come first: they take the place of any
    /// other number, and of a silent one of the team.
    fn make_place_for(&mut self, robot: u32, now: Stamp) -> Result<(), RejectReason> {
        if self.peers.len() < MAX_PEERS {
            return Ok(());
        }
        let age = |peer: &Peer| now - Stamp(peer.received_ns);
        let is_member = |robot: u32| self.members.contains(&robot);
        let replaceable = self.peers.iter().filter(|(number, peer)| {
            age(peer) > PEER_AGE_MAX || (is_member(robot) && !is_member(**number))
        });
        // Others before those of the team, then the longest silent one.
        let replaced = replaceable.max_by(|(a, peer_a), (b, peer_b)| {
            let others = is_member(**b).cmp(&is_member(**a));
            others.then(age(peer_a).total_cmp(&age(peer_b)))
        });
        let replaced = replaced.map(|(number, _)| *number);
        let replaced = replaced.ok_or(RejectReason::Foreign)?;
        self.peers.remove(&replaced);
        Ok(())
    }
}

fn report_from_message(
    message: &TeamMessage,
    is_member: bool,
    ours: impl Fn(i64) -> Stamp,
) -> TeamReport {
    let pose = message.pose.as_ref();
    let std = |i: usize| {
        pose.and_then(|pose| pose.std.get(i))
            .copied()
            .unwrap_or(0.0)
    };
    TeamReport {
        robot: message.robot,
        is_member,
        stamp: ours(message.stamp_ns),
        pose: pose.map(|pose| Pose::new(pose.x, pose.y, pose.theta)),
        pose_std: [std(0), std(1), std(2)],
        half_known: pose.is_some_and(|pose| pose.half_known),
        pose_by_markings: message.pose_by_markings,
        ball: message.ball.as_ref().and_then(|ball| {
            Some(ReportedBall {
                at: At::new(ball.x, ball.y),
                velocity: [ball.velocity_x, ball.velocity_y],
                covariance: ball.covariance[..].try_into().ok()?,
                last_seen: ours(message.ball_seen_ns),
            })
        }),
        obstacles: message
            .obstacles
            .iter()
            .filter_map(|obstacle| {
                Some(ReportedObstacle {
                    at: At::new(obstacle.x, obstacle.y),
                    covariance: obstacle.covariance[..].try_into().ok()?,
                })
            })
            .collect(),
        ball_sighting: message.ball_ray.as_ref().map(|ray| BallSighting {
            azimuth: ray.azimuth,
            elevation: ray.elevation,
            std: [ray.azimuth_std, ray.elevation_std],
            viewpoint_height: ray.height,
            distance: None,
        }),
    }
}

/// The direction of the ball in the field frame; None while the robot is lost. One that others would refuse is not sent,
/// since they would refuse the whole message.
fn ball_ray(cycle: &Cycle) -> Option<BallRay> {
    let (sighting, pose) = (cycle.world.ball_sighting?, cycle.estimate.pose?);
    let ray = BallRay {
        azimuth: wrap_angle(sighting.azimuth + pose.theta),
        elevation: sighting.elevation,
        azimuth_std: sighting.std[0],
        elevation_std: sighting.std[1],
        height: sighting.viewpoint_height,
    };
    ray_is_plausible(&ray).then_some(ray)
}

fn ray_is_plausible(ray: &BallRay) -> bool {
    ray.azimuth.abs() < 100.0
        && ray.elevation.abs() < 2.0
        && (1e-5..10.0).contains(&ray.azimuth_std)
        && (1e-5..10.0).contains(&ray.elevation_std)
        && (0.0..10.0).contains(&ray.height)
}

fn object_state(object: &TrackedObject) -> Option<ObjectState> {
    let on_field = object.on_field?;
    let p = &on_field.covariance;
    Some(ObjectState {
        x: on_field.at.x,
        y: on_field.at.y,
        velocity_x: on_field.velocity[0],
        velocity_y: on_field.velocity[1],
        covariance: vec![p[(0, 0)], p[(0, 1)], p[(1, 1)]],
    })
}

fn is_plausible(message: &TeamMessage) -> bool {
    let object_is_plausible = |object: &ObjectState| {
        let numbers = [object.x, object.y, object.velocity_x, object.velocity_y];
        numbers.iter().all(|value| value.abs() < 100.0)
            && object.covariance.len() == 3
            && object.covariance.iter().all(|value| value.is_finite())
    };
    let pose = message.pose.as_ref().is_none_or(|pose| {
        pose.x.abs() < 100.0
            && pose.y.abs() < 100.0
            && pose.theta.abs() < 100.0
            && pose.std.len() == 3
            && pose.std.iter().all(|std| *std >= 0.0 && std.is_finite())
    });
    pose && message.ball.as_ref().is_none_or(object_is_plausible)
        && message.obstacles.len() <= MAX_OBSTACLES
        && message.obstacles.iter().all(object_is_plausible)
        && message.ball_ray.as_ref().is_none_or(ray_is_plausible)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::random_cycle;

    fn link(robot: u32) -> TeamLink {
        let config = TeamLinkConfig {
            robot,
            ..TeamLinkConfig::default()
        };
        TeamLink::new(&config, 7).expect("a link")
    }

    /// Sends a message of `robot` to `receiver` at `seconds`.
    fn send(receiver: &mut TeamLink, robot: u32, seconds: f64) -> Result<(), RejectReason> {
        let now = Stamp::from_seconds(seconds);
        let mut cycle = random_cycle(0);
        cycle.world.robots.clear();
        cycle.world.ball = None;
        cycle.estimate.pose = None;
        let mut sender = link(robot);
        // Each message comes from a later start of its sender.
        sender.session = now.0 as u64;
        let message = sender.encode_message(&cycle, now);
        receiver.receive(&message, now).map(|_| ())
    }

    #[test]
    fn forged_speakers_do_not_shut_out_the_team() {
        let mut receiver = link(1);
        assert_eq!(send(&mut receiver, 2, 0.1), Ok(()));
        for number in 100..200 {
            let expected = if number < 115 {
                Ok(())
            } else {
                Err(RejectReason::Foreign)
            };
            assert_eq!(send(&mut receiver, number, 0.2), expected, "{number}");
        }
        // Numbers of the team take a place at once, and the first team-mate has kept its own.
        assert_eq!(send(&mut receiver, 5, 0.3), Ok(()));
        assert!(receiver.peers.contains_key(&2) && receiver.peers.len() == MAX_PEERS);
        // Other numbers age out.
        assert_eq!(send(&mut receiver, 300, 1.0), Err(RejectReason::Foreign));
        assert_eq!(send(&mut receiver, 300, 6.0), Ok(()));
        assert!(receiver.peers.contains_key(&2) && receiver.peers.contains_key(&5));
    }
}
