//! Samples between images: wheels, inertial unit, commands, compass and goals, in the order of their stamps.
//!
//! An image is older than the newest samples, since cameras are slow. The state after the last image is therefore kept
//! with all samples since (docs/methods.md 8.10).

use super::motion_inputs::{MotionInputs, MotionMeasurement};
use super::stuck_compass::StuckCompass;
use super::{BUFFERED_MAX, COMPASS_READINGS_MAX, LastOdometry, Localizer, Snapshot};
use crate::filter::{PoseFilter, PredictionInput};
use crate::omni::Twist;
use crate::sample::{Compass, GoalObservation, Imu, Odometry, VelocityCommand};
use crate::stamp::Stamp;

impl Localizer {
    /// Adds a motion of the wheels. Samples arrive in the order of their stamps and before the image of the same stamp.
    /// An image may be older than the newest odometry.
    pub fn add_odometry(&mut self, sample: &Odometry) {
        let motion = [sample.dx, sample.dy, sample.dtheta];
        if motion.iter().any(|value| !value.is_finite()) {
            self.odometry_continuous = false;
            return;
        }
        let gap_max = self.config.mode.odometry_gap_max;
        let Some(previous) = self.last_odometry else {
            self.last_odometry = Some(LastOdometry {
                stamp: sample.stamp,
                twist: Twist::default(),
            });
            // The interval of a first sample is assumed to begin at the last image.
            let seconds = self.filter_stamp.seconds_until(sample.stamp);
            // One that ends before the time of a pose that was told is no gap after it.
            let is_before = self.has_pose_hypotheses() && seconds <= 0.0;
            self.odometry_continuous =
                is_before || self.has_pose_hypotheses() && seconds <= gap_max;
            if self.odometry_continuous && !is_before {
                self.move_particles(sample.stamp, motion);
                self.receive(MotionMeasurement::Wheels(*sample));
            } else {
                self.receive(MotionMeasurement::WheelsRestarted(*sample));
            }
            return;
        };
        let interval = previous.stamp.seconds_until(sample.stamp);
        if interval <= 0.0 {
            self.count_out_of_order();
            return;
        }
        self.stuck_compass.add_odometry(sample);
        self.out_of_order_count = 0;
        let [x, y, theta] = motion.map(|value| value / interval as f32);
        self.last_odometry = Some(LastOdometry {
            stamp: sample.stamp,
            twist: Twist { x, y, theta },
        });
        if interval > gap_max {
            self.fit_monitor.restart_wheels();
            self.odometry_continuous &= self
                .motion_inputs
                .imu_active(sample.stamp, &self.config.attitude);
            self.receive(MotionMeasurement::WheelsRestarted(*sample));
            return;
        }
        self.fit_monitor.add_wheels(motion);
        // `predict_to` has already moved the particles over a part of the interval if an image lies within it.
        let remaining = self
            .particles_stamp
            .seconds_until(sample.stamp)
            .min(interval);
        if remaining > 0.0 {
            let share = (remaining / interval) as f32;
            self.move_particles(sample.stamp, motion.map(|value| value * share));
        }
        self.receive(MotionMeasurement::Wheels(*sample));
    }

    /// Adds a reading of the inertial unit. Readings that are not finite are dropped.
    pub fn add_imu(&mut self, sample: &Imu) {
        let values = sample.specific_force.iter().chain(&sample.angular_velocity);
        if values.copied().all(f32::is_finite) {
            let [_, _, bias] = self.motion_inputs.attitude.gyro_bias();
            self.stuck_compass.add_imu(sample, bias);
            self.odometry_continuous &= !self.ends_pause(sample.stamp);
            self.receive(MotionMeasurement::Imu(*sample));
        }
    }

    /// Have wheels, inertial unit and camera all been silent before this stamp, for longer than odometry may be?
    fn ends_pause(&self, stamp: Stamp) -> bool {
        let wheels = self.last_odometry.map(|last| last.stamp);
        let last = self
            .motion_inputs
            .imu_stamp()
            .max(wheels)
            .max(self.last_image);
        last.is_some_and(|last| last.seconds_until(stamp) > self.config.mode.odometry_gap_max)
    }

    /// Adds a velocity command. Commands that are not finite are dropped.
    pub fn add_command(&mut self, sample: &VelocityCommand) {
        let twist = sample.twist;
        if [twist.x, twist.y, twist.theta]
            .into_iter()
            .all(f32::is_finite)
        {
            self.receive(MotionMeasurement::Command(*sample));
        }
    }

    /// Adds a compass reading, unless the magnetic field is disturbed or the compass hangs. It decides the field half and gives the
    /// global search its heading prior.
    pub fn add_compass(&mut self, sample: &Compass) {
        if self.stuck_compass.hangs_at(sample) {
            self.compass_readings.clear();
            return;
        }
        let Some(heading) = self.config.compass.heading(sample) else {
            return;
        };
        let compass = Compass { heading, ..*sample };
        let kept = f64::from(self.latency()) + self.config.compass.age_max;
        let is_old = |reading: &Compass| reading.stamp.seconds_until(compass.stamp) > kept;
        while self.compass_readings.len() >= COMPASS_READINGS_MAX
            || self.compass_readings.front().is_some_and(is_old)
        {
            self.compass_readings.pop_front();
        }
        self.compass_readings.push_back(compass);
        self.receive(MotionMeasurement::Compass(compass));
    }

    /// Corrects the attitude by a compass reading, and adds it to the evidence for the field half.
    fn apply_compass(&mut self, sample: &Compass) {
        let heading = sample.heading;
        let attitude = &self.config.attitude;
        let undisturbed = !self.motion_inputs.imu_active(sample.stamp, attitude)
            || self
                .motion_inputs
                .attitude
                .update_compass(sample.stamp, heading, attitude);
        let config = &self.config.compass;
        let age = self.filter_stamp.seconds_until(sample.stamp);
        if let Some(track) = self.state.track_mut()
            && age.abs() <= config.age_max
        {
            let expected = track.filter.pose().theta + track.filter.twist().theta * age as f32;
            track.half_evidence.update_compass(
                sample.stamp,
                expected,
                heading,
                undisturbed,
                config,
            );
        }
    }

    /// Adds the goals in the image of this stamp, before its line points. Goals of different colours decide the field
    /// half.
    pub fn add_goals(&mut self, stamp: Stamp, goals: &[GoalObservation]) {
        let is_valid = |goal: &&GoalObservation| {
            let sizes = [goal.at.x, goal.at.y, goal.std, goal.width];
            sizes.iter().all(|value| value.is_finite()) && goal.std >= 0.0
        };
        self.pending_goals = Some((stamp, goals.iter().filter(is_valid).copied().collect()));
    }

    /// The goals in the image of this stamp.
    pub(super) fn take_goals(&mut self, stamp: Stamp) -> Vec<GoalObservation> {
        let pending = self
            .pending_goals
            .take()
            .filter(|(goals_stamp, _)| *goals_stamp == stamp);
        pending.map_or_else(Vec::new, |(_, goals)| goals)
    }

    /// Adds log odds of the tracked pose's field half from another source than the compass: the team's ball
    /// (docs/methods.md 12.3).
    pub fn add_half_log_odds(&mut self, log_odds: f32) {
        // A late image restarts from the snapshot.
        let snapshot = self.snapshot.as_mut().map(|snapshot| &mut snapshot.state);
        for state in [Some(&mut self.state), snapshot].into_iter().flatten() {
            if let Some(track) = state.track_mut() {
                track
                    .half_evidence
                    .add_log_odds(log_odds, &self.config.compass);
            }
        }
    }

    /// Keeps the state after an image, for a next image that is older than samples received meanwhile.
    pub(super) fn take_snapshot(&mut self) {
        match self.state.filter().map(PoseFilter::twist) {
            Some(twist) => self.own_motion.add(self.filter_stamp, twist),
            None => self.own_motion.clear(),
        }
        self.keep_snapshot();
    }

    /// Keeps the state, from which the next image restarts.
    pub(super) fn keep_snapshot(&mut self) {
        self.buffered.clear();
        self.snapshot = Some(Box::new(Snapshot {
            filter_stamp: self.filter_stamp,
            motion_inputs: self.motion_inputs.clone(),
            state: self.state.clone(),
        }));
    }

    /// For an image that is older than samples already received: restores the snapshot and replays the samples up to
    /// the exposure. Returns the later ones.
    pub(super) fn rewind_to(&mut self, exposed: Stamp) -> Vec<MotionMeasurement> {
        let Some(snapshot) = self
            .snapshot
            .take_if(|snapshot| snapshot.filter_stamp <= exposed && exposed < self.filter_stamp)
        else {
            return Vec::new();
        };
        self.filter_stamp = snapshot.filter_stamp;
        self.motion_inputs = snapshot.motion_inputs;
        self.state = snapshot.state;
        let mut later = std::mem::take(&mut self.buffered);
        let split = later.partition_point(|measurement| measurement.stamp() <= exposed);
        for measurement in later.drain(..split) {
            self.receive(measurement);
        }
        later
    }

    /// Is there anything that odometry moves?
    pub(super) fn has_pose_hypotheses(&self) -> bool {
        !self.state.is_lost() || self.global_search.is_in_progress()
    }

    /// Does odometry or an inertial unit cover the time from the last image to this one without a gap?
    pub(super) fn odometry_covers(&self, stamp: Stamp) -> bool {
        let gap_max = self.config.mode.odometry_gap_max;
        let elapsed = self.filter_stamp.seconds_until(stamp);
        self.odometry_continuous
            && self.has_pose_hypotheses()
            && elapsed <= gap_max
            // A pose that was told for the time of this very image needs none.
            && (elapsed == 0.0
                || self.motion_inputs.imu_active(stamp, &self.config.attitude)
                || self
                    .last_odometry
                    .is_some_and(|last| last.stamp.seconds_until(stamp) <= gap_max))
    }

    /// Predicts all hypotheses from the last sample to an image.
    pub(super) fn predict_to(&mut self, stamp: Stamp) {
        let seconds = self.particles_stamp.seconds_until(stamp) as f32;
        if seconds > 0.0 {
            let twist = self
                .last_odometry
                .map_or(Twist::default(), |last| last.twist);
            let step = twist.scaled(seconds);
            self.move_particles(stamp, [step.x, step.y, step.theta]);
        }
        if self.filter_stamp < stamp {
            let input = self.motion_inputs.prediction_input(
                self.filter_stamp,
                stamp,
                &self.config.attitude,
            );
            self.predict(&input, stamp);
        }
    }

    /// Moves the particles of the global search.
    fn move_particles(&mut self, stamp: Stamp, motion: [f32; 3]) {
        self.particles_stamp = stamp;
        self.global_search.predict(motion);
    }

    fn predict(&mut self, input: &PredictionInput, to: Stamp) {
        self.filter_stamp = to;
        let config = &self.config.filter;
        self.state
            .for_each_filter(|filter| filter.predict(input, config));
    }

    /// Applies a sample to all filters and buffers it for a late image.
    pub(super) fn receive(&mut self, measurement: MotionMeasurement) {
        if let MotionMeasurement::Compass(compass) = &measurement {
            self.apply_compass(compass);
            self.buffer(measurement);
            return;
        }
        let stamp = measurement.stamp();
        // Before the first image or sample there is no interval to predict over.
        let from = if self.filter_stamp.0 == i64::MIN {
            stamp
        } else {
            self.filter_stamp
        };
        let to = stamp.max(from);
        let (attitude, collision) = (&self.config.attitude, &self.config.filter.collision);
        let (input, stationary) = if let MotionMeasurement::Imu(imu) = &measurement {
            let prediction = self
                .motion_inputs
                .receive_imu(imu, from, attitude, collision);
            (prediction.input, prediction.stationary)
        } else {
            (
                self.motion_inputs.prediction_input(from, to, attitude),
                None,
            )
        };
        self.predict(&input, to);
        self.apply_measurement(&measurement, stationary);
        self.buffer(measurement);
    }

    /// Keeps a sample for a late image.
    fn buffer(&mut self, measurement: MotionMeasurement) {
        if self.buffered.len() >= BUFFERED_MAX {
            self.advance_snapshot();
        }
        self.buffered.push(measurement);
    }

    /// Without images the samples are those of the last half of the buffer.
    fn advance_snapshot(&mut self) {
        let middle = self.buffered[self.buffered.len() / 2].stamp();
        let later = self.rewind_to(middle);
        self.keep_snapshot();
        for measurement in later {
            self.receive(measurement);
        }
    }

    /// Updates all filters by a sample at the time to which they are predicted.
    ///
    /// `stationary`: seconds of this interval during which the robot stood still.
    fn apply_measurement(&mut self, measurement: &MotionMeasurement, stationary: Option<f32>) {
        let (config, attitude) = (&self.config.filter, &self.config.attitude);
        let inputs = &mut self.motion_inputs;
        match measurement {
            MotionMeasurement::Wheels(odometry) => {
                let increment = inputs.receive_wheels(odometry, attitude);
                self.state
                    .for_each_filter(|filter| filter.update_wheels(&increment, config));
            }
            MotionMeasurement::WheelsRestarted(odometry) => {
                inputs.restart_wheels(odometry.stamp);
                self.state.for_each_filter(PoseFilter::restart_wheels);
            }
            MotionMeasurement::Command(command) => inputs.receive_command(command.twist),
            MotionMeasurement::Compass(_) => {}
            MotionMeasurement::Imu(_) => {
                if let Some(seconds) = stationary {
                    self.state
                        .for_each_filter(|filter| filter.zero_velocity_update(seconds));
                }
            }
        }
    }

    /// Counts a sample older than the last one. It is dropped, but after `out_of_order_max` the source's clock is assumed
    /// to have been set back, and localization restarts.
    pub(super) fn count_out_of_order(&mut self) {
        self.out_of_order_count += 1;
        if self.out_of_order_count >= self.config.mode.out_of_order_max {
            self.out_of_order_count = 0;
            self.lose_pose();
            self.last_odometry = None;
            self.compass_readings.clear();
            self.stuck_compass = StuckCompass::default();
            self.motion_inputs = MotionInputs::default();
            self.filter_stamp = Stamp(i64::MIN);
            self.particles_stamp = Stamp(i64::MIN);
            self.keep_snapshot();
        }
    }
}
