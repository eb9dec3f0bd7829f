//! What is heard between frames? Wheels, inertial unit, commands, compass and goals move what is believed, in the order of
//! their stamps; a frame that comes late goes back to its own time.

use super::motion::{Motion, Witness};
use super::{HEARD_MAX, Localizer};
use crate::candidates::Candidates;
use crate::filter::{Belief, Span};
use crate::sample::{Command, Compass, GoalSight, Imu, Odometry};
use crate::stamp::Stamp;

impl Localizer {
    /// Moves the expected pose. Samples come in the order of their stamps, before the frame of
    /// the same stamp; a frame may come later than newer odometry.
    pub fn odometry(&mut self, sample: &Odometry) {
        let motion = [sample.dx, sample.dy, sample.dtheta];
        if motion.iter().any(|value| !value.is_finite()) {
            self.led = false;
            return;
        }
        let gap = self.config.mode.gap_max;
        let Some((previous, _)) = self.odometry else {
            self.odometry = Some((sample.stamp, [0.0; 3]));
            // Its interval began at the last frame, if at all.
            let seconds = self.reached.seconds_until(sample.stamp);
            self.led = self.follows() && (0.0..=gap).contains(&seconds);
            if self.led {
                self.carry(sample.stamp, motion);
                self.hear(Witness::Wheels(*sample));
            } else {
                self.hear(Witness::WheelsAnew(*sample));
            }
            return;
        };
        let interval = previous.seconds_until(sample.stamp);
        if interval <= 0.0 {
            self.note_past();
            return;
        }
        self.past = 0;
        self.odometry = Some((sample.stamp, motion.map(|value| value / interval as f32)));
        if interval > gap {
            self.led &= self.motion.watched(sample.stamp, &self.config.attitude);
            self.hear(Witness::WheelsAnew(*sample));
            return;
        }
        // A part of the interval may have been bridged already, for a frame between two samples.
        let left = self.carried.seconds_until(sample.stamp).min(interval);
        if left > 0.0 {
            let part = (left / interval) as f32;
            self.carry(sample.stamp, motion.map(|value| value * part));
        }
        self.hear(Witness::Wheels(*sample));
    }

    /// Feels how the robot turns, leans and is pushed. In the order of the stamps, as all samples.
    pub fn imu(&mut self, sample: &Imu) {
        let values = sample.acceleration.iter().chain(&sample.rate);
        if values.copied().all(f32::is_finite) {
            self.hear(Witness::Imu(*sample));
        }
    }

    /// Notes what the motors are told.
    pub fn command(&mut self, sample: &Command) {
        let twist = sample.twist;
        if [twist.x, twist.y, twist.theta]
            .into_iter()
            .all(f32::is_finite)
        {
            self.hear(Witness::Command(*sample));
        }
    }

    /// Does something nearby (iron, a motor's current) turn the compass away from what the gyro says, or change the
    /// strength of the magnetic field?
    pub fn compass_disturbed(&self) -> bool {
        self.iron_nearby || self.motion.attitude.disturbed()
    }

    /// Roll, pitch and yaw by the inertial unit, radians.
    pub fn attitude(&self) -> &crate::attitude::Attitude {
        &self.motion.attitude
    }

    /// Notes a compass reading; it decides the half of the field, and where a search begins.
    pub fn compass(&mut self, sample: &Compass) {
        let heading = self.config.compass.heading(sample);
        self.iron_nearby = heading.is_none();
        let Some(heading) = heading else {
            return;
        };
        self.compass = Some(Compass { heading, ..*sample });
        let undisturbed = !self.motion.watched(sample.stamp, &self.config.attitude)
            || self
                .motion
                .attitude
                .compass(sample.stamp, heading, &self.config.attitude);
        let config = &self.config.compass;
        if let Some(belief) = &self.belief
            && undisturbed
            && self.reached.seconds_until(sample.stamp).abs() <= config.age_max
        {
            self.half
                .hear(sample.stamp, belief.pose().theta, heading, config);
        }
    }

    /// Notes the goals that the frame of this stamp shows, before its line points are seen; where their colours differ,
    /// they decide the half of the field too.
    pub fn goals(&mut self, stamp: Stamp, sights: &[GoalSight]) {
        let sane = |sight: &&GoalSight| {
            let sizes = [sight.at.x, sight.at.y, sight.std, sight.width];
            sizes.iter().all(|value| value.is_finite()) && sight.std >= 0.0
        };
        self.goals = Some((stamp, sights.iter().filter(sane).copied().collect()));
    }

    /// The goals noted for a frame.
    pub(super) fn goals_of(&mut self, stamp: Stamp) -> Vec<GoalSight> {
        let noted = self.goals.take().filter(|(of, _)| *of == stamp);
        noted.map_or_else(Vec::new, |(_, sights)| sights)
    }

    /// Hears log odds for the half of the field in which the belief is, rather than the other one, of a source that is
    /// no compass: the team's ball (`team::TeamView::half_evidence`).
    pub fn half_evidence(&mut self, odds: f32) {
        if self.belief.is_some() {
            self.half.add(odds, &self.config.compass);
        }
    }

    /// For a frame that is older than what was heard since (cameras are slow): back to the last frame, forward to this
    /// one; what was heard after it is returned.
    pub(super) fn go_back(&mut self, exposed: Stamp) -> Vec<Witness> {
        let Some(base) = self
            .base
            .take_if(|base| base.reached <= exposed && exposed < self.reached)
        else {
            return Vec::new();
        };
        self.reached = base.reached;
        self.motion = base.motion;
        self.belief = base.belief;
        self.rival = base.rival;
        self.candidates = base.candidates;
        let mut later = std::mem::take(&mut self.heard);
        let after = later.partition_point(|one| one.stamp() <= exposed);
        for one in later.drain(..after) {
            self.hear(one);
        }
        later
    }

    /// Is there anything that odometry moves?
    pub(super) fn follows(&self) -> bool {
        self.belief.is_some() || !self.candidates.is_empty() || self.relocaliser.active()
    }

    /// Has the motion been reported without a gap from the last frame to this one?
    pub(super) fn leads_to(&self, stamp: Stamp) -> bool {
        let gap = self.config.mode.gap_max;
        self.led
            && self.follows()
            && self.reached.seconds_until(stamp) <= gap
            && (self.motion.watched(stamp, &self.config.attitude)
                || self
                    .odometry
                    .is_some_and(|(last, _)| last.seconds_until(stamp) <= gap))
    }

    /// Carries on from the last sample to the frame.
    pub(super) fn bridge(&mut self, stamp: Stamp) {
        let seconds = self.carried.seconds_until(stamp) as f32;
        if seconds > 0.0 {
            let rate = self.odometry.map_or([0.0; 3], |(_, rate)| rate);
            self.carry(stamp, rate.map(|value| value * seconds));
        }
        if self.reached < stamp {
            let span = self.motion.span(self.reached, stamp, &self.config.attitude);
            self.advance(&span, stamp);
        }
    }

    /// Moves the relocaliser's particles.
    pub(super) fn carry(&mut self, stamp: Stamp, motion: [f32; 3]) {
        self.carried = stamp;
        self.relocaliser.moved(motion);
    }

    fn advance(&mut self, span: &Span, to: Stamp) {
        self.reached = to;
        let config = &self.config.filter;
        each(
            &mut self.belief,
            &mut self.rival,
            &mut self.candidates,
            |belief| {
                belief.advance(span, config);
            },
        );
    }

    /// Moves belief, rival and candidates by a sample, and notes it for a late frame.
    pub(super) fn hear(&mut self, witness: Witness) {
        let stamp = witness.stamp();
        // What moves nothing needs no time either: the next frame's search begins then.
        let reached = if self.reached.0 == i64::MIN {
            stamp
        } else {
            self.reached
        };
        let ahead = stamp.max(reached);
        let rested = if let Witness::Imu(imu) = &witness {
            let config = &self.config.filter.collision;
            let (span, rested) = self
                .motion
                .feel(imu, reached, &self.config.attitude, config);
            self.advance(&span, ahead);
            rested
        } else {
            let span = self.motion.span(reached, ahead, &self.config.attitude);
            self.advance(&span, ahead);
            None
        };
        self.tell(&witness, rested);
        if self.heard.len() >= HEARD_MAX {
            self.heard.clear();
            self.base = None;
        }
        self.heard.push(witness);
    }

    /// Tells belief, rival and candidates what a witness said at the time they have reached.
    fn tell(&mut self, witness: &Witness, rested: Option<f32>) {
        let (config, attitude) = (&self.config.filter, &self.config.attitude);
        let motion = &mut self.motion;
        let way = match witness {
            Witness::Wheels(odometry) => Some(motion.roll(odometry, attitude)),
            Witness::WheelsAnew(odometry) => {
                motion.roll_anew(odometry.stamp);
                None
            }
            Witness::Command(command) => {
                motion.told(command.twist);
                None
            }
            Witness::Imu(_) => None,
        };
        each(
            &mut self.belief,
            &mut self.rival,
            &mut self.candidates,
            |belief| {
                if matches!(witness, Witness::WheelsAnew(_)) {
                    belief.wheels_interrupted();
                }
                if let Some(way) = &way {
                    belief.wheels(way, config);
                }
                if let Some(seconds) = rested {
                    belief.rest(seconds);
                }
            },
        );
    }

    /// A sample older than the last: left out, unless the source's clock was set back.
    pub(super) fn note_past(&mut self) {
        self.past += 1;
        if self.past >= self.config.mode.past_max {
            self.past = 0;
            self.forget();
            self.odometry = None;
            self.compass = None;
            self.motion = Motion::default();
            self.reached = Stamp(i64::MIN);
            self.carried = Stamp(i64::MIN);
        }
    }
}

/// Every belief that the motion moves.
fn each(
    belief: &mut Option<Belief>,
    rival: &mut Option<(Belief, u32)>,
    candidates: &mut Candidates,
    act: impl FnMut(&mut Belief),
) {
    let belief = belief.iter_mut();
    let rival = rival.iter_mut().map(|(belief, _)| belief);
    belief
        .chain(rival)
        .chain(candidates.beliefs())
        .for_each(act);
}
