//! What is said and what is believed to have been said? Words to datagrams and back; a function of what it is given.

use std::collections::BTreeMap;

use anyhow::Result;
use localize::frame::At;
use localize::team::{ReportedBall, TeamReport};
use localize::world::TrackedObject;
use localize::{Pose, Stamp};
use prost::Message;

use super::{Clock, LinkConfig};
use crate::cycle::Cycle;
use crate::datagram::message::{self, Echo, Spot, TeamWord, VERSION};
use crate::datagram::seal::{Key, Refused, Turnstile, open, seal};

/// Speakers that are remembered; a team has fewer, and a stranger who makes up numbers shall not fill the memory.
const MATES_MOST: usize = 16;
/// Robots that are told to the team: the surest ones.
const OBSTACLES_MOST: usize = 16;

/// Datagrams so far.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Counts {
    /// Words taken.
    pub heard: u64,
    /// Datagrams refused, by reason.
    pub refused: BTreeMap<Refused, u64>,
}

/// One robot's side of the talk.
#[derive(Debug)]
pub struct Talk {
    team: u32,
    robot: u32,
    silence: f64,
    key: Option<Key>,
    session: u64,
    sequence: u64,
    mates: BTreeMap<u32, Heard>,
    counts: Counts,
}

/// The last of a team-mate.
#[derive(Debug, Clone, Default)]
struct Heard {
    turnstile: Turnstile,
    clock: Clock,
    sent_ns: i64,
    heard_ns: i64,
}

impl Talk {
    /// Begins; `session`: larger for each start, nanoseconds since 1970 will do.
    pub fn new(config: &LinkConfig, session: u64) -> Result<Self> {
        Ok(Talk {
            team: config.team,
            robot: config.robot,
            silence: config.silence,
            key: config.key.as_deref().map(Key::new).transpose()?,
            session,
            sequence: 0,
            mates: BTreeMap::new(),
            counts: Counts::default(),
        })
    }

    /// The datagram that tells the team of a cycle, sent at `now` of the clock that stamped it.
    pub fn word(&mut self, cycle: &Cycle, now: Stamp) -> Vec<u8> {
        self.sequence += 1;
        let echo = |(robot, heard): (&u32, &Heard)| Echo {
            robot: *robot,
            sent_ns: heard.sent_ns,
            held_ns: now.0.saturating_sub(heard.heard_ns),
        };
        let ball = cycle.world.ball.as_ref();
        let mut obstacles: Vec<&TrackedObject> = cycle.world.robots.iter().collect();
        obstacles.sort_by(|a, b| b.probability.total_cmp(&a.probability));
        let word = TeamWord {
            version: VERSION,
            team: self.team,
            robot: self.robot,
            session: self.session,
            sequence: self.sequence,
            sent_ns: now.0,
            stamp_ns: cycle.stamp.0,
            echoes: self.mates.iter().map(echo).collect(),
            pose: message::Pose::of(&cycle.estimate),
            ball: ball.and_then(spot),
            ball_seen_ns: ball.map_or(0, |ball| ball.last_seen.0),
            obstacles: obstacles
                .into_iter()
                .filter_map(spot)
                .take(OBSTACLES_MOST)
                .collect(),
        };
        seal(word.encode_to_vec(), self.key.as_ref())
    }

    /// What a datagram says that was heard at `now` of our clock.
    pub fn hear(&mut self, datagram: &[u8], now: Stamp) -> Result<TeamReport, Refused> {
        let report = self.understand(datagram, now);
        match &report {
            Ok(_) => self.counts.heard += 1,
            Err(why) => *self.counts.refused.entry(*why).or_default() += 1,
        }
        report
    }

    /// Datagrams so far.
    pub fn counts(&self) -> &Counts {
        &self.counts
    }

    /// A team-mate's clock.
    pub fn clock(&self, robot: u32) -> Option<&Clock> {
        self.mates.get(&robot).map(|heard| &heard.clock)
    }

    fn understand(&mut self, datagram: &[u8], now: Stamp) -> Result<TeamReport, Refused> {
        let content = open(datagram, self.key.as_ref())?;
        let word = TeamWord::decode(content).map_err(|_foreign| Refused::Foreign)?;
        // What decodes by chance has no version of ours.
        if word.version == 0 {
            return Err(Refused::Foreign);
        }
        if word.version != VERSION {
            return Err(Refused::Version);
        }
        if word.team != self.team {
            return Err(Refused::Foreign);
        }
        if word.robot == self.robot {
            return Err(Refused::Own);
        }
        if !is_sensible(&word) {
            return Err(Refused::Senseless);
        }
        if !self.mates.contains_key(&word.robot) && self.mates.len() >= MATES_MOST {
            return Err(Refused::Foreign);
        }
        let (own, silence) = (self.robot, self.silence);
        let heard = self.mates.entry(word.robot).or_default();
        heard
            .turnstile
            .pass(word.session, word.sequence, now.seconds(), silence)?;
        let echo = word.echoes.iter().find(|echo| echo.robot == own);
        let echo = echo.map(|echo| (echo.sent_ns, echo.held_ns));
        heard.clock.hear(word.sent_ns, now.0, echo);
        (heard.sent_ns, heard.heard_ns) = (word.sent_ns, now.0);
        let offset = heard.clock.offset_ns().unwrap_or(0);
        // Nothing that was said can be of the future, whatever the clocks think.
        let ours = |theirs: i64| Stamp(theirs.saturating_add(offset).min(now.0));
        Ok(report(&word, ours))
    }
}

fn report(word: &TeamWord, ours: impl Fn(i64) -> Stamp) -> TeamReport {
    let pose = word.pose.as_ref();
    let std = |i: usize| {
        pose.and_then(|pose| pose.std.get(i))
            .copied()
            .unwrap_or(0.0)
    };
    TeamReport {
        robot: word.robot,
        stamp: ours(word.stamp_ns),
        pose: pose.map(|pose| Pose::new(pose.x, pose.y, pose.theta)),
        pose_std: [std(0), std(1), std(2)],
        half_known: pose.is_some_and(|pose| pose.half_known),
        ball: word.ball.as_ref().and_then(|ball| {
            Some(ReportedBall {
                at: At::new(ball.x, ball.y),
                velocity: [ball.velocity_x, ball.velocity_y],
                covariance: ball.covariance[..].try_into().ok()?,
                last_seen: ours(word.ball_seen_ns),
            })
        }),
        obstacles: word
            .obstacles
            .iter()
            .map(|spot| At::new(spot.x, spot.y))
            .collect(),
    }
}

fn spot(object: &TrackedObject) -> Option<Spot> {
    let on_field = object.on_field?;
    let p = &on_field.covariance;
    Some(Spot {
        x: on_field.at.x,
        y: on_field.at.y,
        velocity_x: on_field.velocity[0],
        velocity_y: on_field.velocity[1],
        covariance: vec![p[(0, 0)], p[(0, 1)], p[(1, 1)]],
    })
}

fn is_sensible(word: &TeamWord) -> bool {
    let sensible = |spot: &Spot| {
        let numbers = [spot.x, spot.y, spot.velocity_x, spot.velocity_y];
        numbers.iter().all(|value| value.abs() < 100.0)
            && spot.covariance.len() == 3
            && spot.covariance.iter().all(|value| value.is_finite())
    };
    let pose = word.pose.as_ref().is_none_or(|pose| {
        pose.x.abs() < 100.0
            && pose.y.abs() < 100.0
            && pose.theta.abs() < 100.0
            && pose.std.len() == 3
            && pose.std.iter().all(|std| *std >= 0.0 && std.is_finite())
    });
    pose && word.ball.as_ref().is_none_or(sensible)
        && word.obstacles.len() <= OBSTACLES_MOST
        && word.obstacles.iter().all(sensible)
}
