//! What is heard between frames? Wheels, inertial unit, commands, compass and goals move what is believed, in the order of
//! their stamps; a frame that comes late goes back to its own time.

use super::motion_inputs::{MotionInputs, MotionMeasurement};
use super::{BUFFERED_MAX, Localizer};
use crate::filter::{PoseFilter, PredictionInput};
use crate::localizer::candidates::Candidates;
use crate::sample::{Compass, GoalObservation, Imu, Odometry, VelocityCommand};
use crate::stamp::Stamp;

impl Localizer {
    /// Moves the expected pose. Samples come in the order of their stamps, before the frame of
    /// the same stamp; a frame may come later than newer odometry.
    pub fn add_odometry(&mut self, sample: &Odometry) {
        let motion = [sample.dx, sample.dy, sample.dtheta];
        if motion.iter().any(|value| !value.is_finite()) {
            self.odometry_continuous = false;
            return;
        }
        let gap = self.config.mode.odometry_gap_max;
        let Some((previous, _)) = self.last_odometry else {
            self.last_odometry = Some((sample.stamp, [0.0; 3]));
            // Its interval began at the last frame, if at all.
            let seconds = self.filter_stamp.seconds_until(sample.stamp);
            self.odometry_continuous = self.has_pose_hypotheses() && (0.0..=gap).contains(&seconds);
            if self.odometry_continuous {
                self.move_particles(sample.stamp, motion);
                self.receive(MotionMeasurement::Wheels(*sample));
            } else {
                self.receive(MotionMeasurement::WheelsRestarted(*sample));
            }
            return;
        };
        let interval = previous.seconds_until(sample.stamp);
        if interval <= 0.0 {
            self.count_out_of_order();
            return;
        }
        self.out_of_order_count = 0;
        self.last_odometry = Some((sample.stamp, motion.map(|value| value / interval as f32)));
        if interval > gap {
            self.odometry_continuous &= self
                .motion_inputs
                .imu_active(sample.stamp, &self.config.attitude);
            self.receive(MotionMeasurement::WheelsRestarted(*sample));
            return;
        }
        // A part of the interval may have been bridged already, for a frame between two samples.
        let left = self
            .particles_stamp
            .seconds_until(sample.stamp)
            .min(interval);
        if left > 0.0 {
            let part = (left / interval) as f32;
            self.move_particles(sample.stamp, motion.map(|value| value * part));
        }
        self.receive(MotionMeasurement::Wheels(*sample));
    }

    /// Feels how the robot turns, leans and is pushed. In the order of the stamps, as all samples.
    pub fn add_imu(&mut self, sample: &Imu) {
        let values = sample.acceleration.iter().chain(&sample.rate);
        if values.copied().all(f32::is_finite) {
            self.receive(MotionMeasurement::Imu(*sample));
        }
    }

    /// Notes what the motors are told.
    pub fn add_command(&mut self, sample: &VelocityCommand) {
        let twist = sample.twist;
        if [twist.x, twist.y, twist.theta]
            .into_iter()
            .all(f32::is_finite)
        {
            self.receive(MotionMeasurement::Command(*sample));
        }
    }

    /// Does something nearby (iron, a motor's current) turn the compass away from what the gyro says, or change the
    /// strength of the magnetic field?
    pub fn compass_disturbed(&self) -> bool {
        self.magnetic_disturbance || self.motion_inputs.attitude.compass_disturbed()
    }

    /// Roll, pitch and yaw by the inertial unit, radians.
    pub fn attitude(&self) -> &crate::sensors::attitude::Attitude {
        &self.motion_inputs.attitude
    }

    /// Notes a compass reading; it decides the half of the field, and where a search begins.
    pub fn add_compass(&mut self, sample: &Compass) {
        let heading = self.config.compass.heading(sample);
        self.magnetic_disturbance = heading.is_none();
        let Some(heading) = heading else {
            return;
        };
        self.last_compass = Some(Compass { heading, ..*sample });
        let undisturbed = !self
            .motion_inputs
            .imu_active(sample.stamp, &self.config.attitude)
            || self.motion_inputs.attitude.update_compass(
                sample.stamp,
                heading,
                &self.config.attitude,
            );
        let config = &self.config.compass;
        if let Some(belief) = &self.filter
            && undisturbed
            && self.filter_stamp.seconds_until(sample.stamp).abs() <= config.age_max
        {
            self.half_evidence
                .receive_compass(sample.stamp, belief.pose().theta, heading, config);
        }
    }

    /// Notes the goals that the frame of this stamp shows, before its line points are seen; where their colours differ,
    /// they decide the half of the field too.
    pub fn add_goals(&mut self, stamp: Stamp, sights: &[GoalObservation]) {
        let sane = |sight: &&GoalObservation| {
            let sizes = [sight.at.x, sight.at.y, sight.std, sight.width];
            sizes.iter().all(|value| value.is_finite()) && sight.std >= 0.0
        };
        self.pending_goals = Some((stamp, sights.iter().filter(sane).copied().collect()));
    }

    /// The goals noted for a frame.
    pub(super) fn take_goals(&mut self, stamp: Stamp) -> Vec<GoalObservation> {
        let noted = self.pending_goals.take().filter(|(of, _)| *of == stamp);
        noted.map_or_else(Vec::new, |(_, sights)| sights)
    }

    /// Hears log odds for the half of the field in which the belief is, rather than the other one, of a source that is
    /// no compass: the team's ball (`team::TeamView::half_evidence`).
    pub fn add_half_log_odds(&mut self, odds: f32) {
        if self.filter.is_some() {
            self.half_evidence.add_log_odds(odds, &self.config.compass);
        }
    }

    /// For a frame that is older than what was heard since (cameras are slow): back to the last frame, forward to this
    /// one; what was heard after it is returned.
    pub(super) fn rewind_to(&mut self, exposed: Stamp) -> Vec<MotionMeasurement> {
        let Some(base) = self
            .snapshot
            .take_if(|base| base.filter_stamp <= exposed && exposed < self.filter_stamp)
        else {
            return Vec::new();
        };
        self.filter_stamp = base.filter_stamp;
        self.motion_inputs = base.motion_inputs;
        self.filter = base.filter;
        self.alternative = base.alternative;
        self.candidates = base.candidates;
        let mut later = std::mem::take(&mut self.buffered);
        let after = later.partition_point(|one| one.stamp() <= exposed);
        for one in later.drain(..after) {
            self.receive(one);
        }
        later
    }

    /// Is there anything that odometry moves?
    pub(super) fn has_pose_hypotheses(&self) -> bool {
        self.filter.is_some() || !self.candidates.is_empty() || self.global_search.is_in_progress()
    }

    /// Has the motion been reported without a gap from the last frame to this one?
    pub(super) fn odometry_covers(&self, stamp: Stamp) -> bool {
        let gap = self.config.mode.odometry_gap_max;
        self.odometry_continuous
            && self.has_pose_hypotheses()
            && self.filter_stamp.seconds_until(stamp) <= gap
            && (self.motion_inputs.imu_active(stamp, &self.config.attitude)
                || self
                    .last_odometry
                    .is_some_and(|(last, _)| last.seconds_until(stamp) <= gap))
    }

    /// Carries on from the last sample to the frame.
    pub(super) fn predict_to(&mut self, stamp: Stamp) {
        let seconds = self.particles_stamp.seconds_until(stamp) as f32;
        if seconds > 0.0 {
            let rate = self.last_odometry.map_or([0.0; 3], |(_, rate)| rate);
            self.move_particles(stamp, rate.map(|value| value * seconds));
        }
        if self.filter_stamp < stamp {
            let span = self.motion_inputs.prediction_input(
                self.filter_stamp,
                stamp,
                &self.config.attitude,
            );
            self.predict(&span, stamp);
        }
    }

    /// Moves the relocaliser's particles.
    pub(super) fn move_particles(&mut self, stamp: Stamp, motion: [f32; 3]) {
        self.particles_stamp = stamp;
        self.global_search.predict(motion);
    }

    fn predict(&mut self, span: &PredictionInput, to: Stamp) {
        self.filter_stamp = to;
        let config = &self.config.filter;
        for_each_filter(
            &mut self.filter,
            &mut self.alternative,
            &mut self.candidates,
            |belief| {
                belief.predict(span, config);
            },
        );
    }

    /// Moves belief, rival and candidates by a sample, and notes it for a late frame.
    pub(super) fn receive(&mut self, witness: MotionMeasurement) {
        let stamp = witness.stamp();
        // What moves nothing needs no time either: the next frame's search begins then.
        let reached = if self.filter_stamp.0 == i64::MIN {
            stamp
        } else {
            self.filter_stamp
        };
        let ahead = stamp.max(reached);
        let rested = if let MotionMeasurement::Imu(imu) = &witness {
            let config = &self.config.filter.collision;
            let (span, rested) =
                self.motion_inputs
                    .receive_imu(imu, reached, &self.config.attitude, config);
            self.predict(&span, ahead);
            rested
        } else {
            let span = self
                .motion_inputs
                .prediction_input(reached, ahead, &self.config.attitude);
            self.predict(&span, ahead);
            None
        };
        self.apply_measurement(&witness, rested);
        if self.buffered.len() >= BUFFERED_MAX {
            self.buffered.clear();
            self.snapshot = None;
        }
        self.buffered.push(witness);
    }

    /// Tells belief, rival and candidates what a witness said at the time they have reached.
    fn apply_measurement(&mut self, witness: &MotionMeasurement, rested: Option<f32>) {
        let (config, attitude) = (&self.config.filter, &self.config.attitude);
        let motion = &mut self.motion_inputs;
        let way = match witness {
            MotionMeasurement::Wheels(odometry) => Some(motion.receive_wheels(odometry, attitude)),
            MotionMeasurement::WheelsRestarted(odometry) => {
                motion.restart_wheels(odometry.stamp);
                None
            }
            MotionMeasurement::Command(command) => {
                motion.receive_command(command.twist);
                None
            }
            MotionMeasurement::Imu(_) => None,
        };
        for_each_filter(
            &mut self.filter,
            &mut self.alternative,
            &mut self.candidates,
            |belief| {
                if matches!(witness, MotionMeasurement::WheelsRestarted(_)) {
                    belief.restart_wheels();
                }
                if let Some(way) = &way {
                    belief.update_wheels(way, config);
                }
                if let Some(seconds) = rested {
                    belief.zero_velocity_update(seconds);
                }
            },
        );
    }

    /// A sample older than the last: left out, unless the source's clock was set back.
    pub(super) fn count_out_of_order(&mut self) {
        self.out_of_order_count += 1;
        if self.out_of_order_count >= self.config.mode.out_of_order_max {
            self.out_of_order_count = 0;
            self.reset();
            self.last_odometry = None;
            self.last_compass = None;
            self.motion_inputs = MotionInputs::default();
            self.filter_stamp = Stamp(i64::MIN);
            self.particles_stamp = Stamp(i64::MIN);
        }
    }
}

/// Every belief that the motion moves.
fn for_each_filter(
    belief: &mut Option<PoseFilter>,
    rival: &mut Option<(PoseFilter, u32)>,
    candidates: &mut Candidates,
    act: impl FnMut(&mut PoseFilter),
) {
    let belief = belief.iter_mut();
    let rival = rival.iter_mut().map(|(belief, _)| belief);
    belief
        .chain(rival)
        .chain(candidates.filters_mut())
        .for_each(act);
}
