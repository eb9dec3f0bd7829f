//! What does the base's thread do? It sends commands to the bus at a fixed rate and receives its messages.

use std::sync::Arc;

use localize::Stamp;
use localize::omni::{OmniKinematics, Twist};
use localize::sample::VelocityCommand;

use super::command_buffer::{BaseRequest, MotionCommand, SharedCommands, Timed};
use super::command_tally::Confirmations;
use super::link::{BaseLink, BaseReport, MotorCommand};
use super::odometer::{Odometer, OdometryUpdate};
use crate::clock;
use crate::config::BaseDeviceConfig;
use crate::error::HwError;
use crate::event_queue::{DeviceEvent, EventQueue};
use crate::health::HealthState;
use crate::monitor::Monitor;
use crate::worker::{PauseDetector, StallDetector, Waker, pause_reason};

/// State of the base's thread.
pub(super) struct ControlLoop {
    pub(super) device: BaseDeviceConfig,
    pub(super) omni: OmniKinematics,
    pub(super) motor_signs: Vec<f32>,
    pub(super) speed_max: f32,
    pub(super) wheel_radius: f32,
    pub(super) odometer: Odometer,
    pub(super) confirmations: Confirmations,
    pub(super) commands: Arc<SharedCommands>,
    pub(super) monitor: Monitor,
    pub(super) queue: EventQueue,
}

impl ControlLoop {
    /// Sends and receives until the bus fails (an error) or the waker stops it.
    pub(super) fn run(&mut self, link: &mut BaseLink, waker: &Waker) -> Result<(), HwError> {
        let period = 1.0 / f64::from(self.device.rate_hz);
        let start = clock::now();
        let mut stall_detector = StallDetector::new(&self.device.port, self.device.stall);
        let mut reports = Vec::new();
        // When the last command is repeated, and from when on a new one is sent.
        let (mut next_send, mut next_new) = (start, start);
        // Commands from before the bus was open are discarded: the wheels stop first.
        self.commands.lock().halt(start);
        self.confirmations = Confirmations::default();
        let mut pause_detector = PauseDetector::new(start);
        link.send_motor_command(MotorCommand::Release, start)?;
        while !waker.stop_requested() {
            let now = clock::now();
            let (is_new, stops) = {
                let buffer = self.commands.lock();
                (buffer.pending, buffer.stops())
            };
            // New commands go out at once, but no faster than the rate: a serial line would queue them.
            if (is_new && (stops || now >= next_new)) || now >= next_send {
                self.send_commands(link, now, start)?;
                // The period restarts at a new command, so that it is not sent twice in a row.
                next_send = now + period;
                if is_new {
                    next_new = next_send;
                }
            }
            let until = if self.commands.lock().pending {
                next_new.min(next_send)
            } else {
                next_send
            };
            let readable = waker.wait(Some(link.fd()), until);
            if let Some(pause) = pause_detector.check(clock::now()) {
                link.discard_input()?;
                self.monitor.report_event(pause_reason(pause));
                stall_detector.on_message(clock::now(), link.stats().garbage_bytes);
                continue;
            }
            if readable {
                let arrival = clock::now();
                link.receive(arrival, &mut reports)?;
                let stats = link.stats();
                self.monitor.set_decoder_stats(stats);
                let jumps = self.odometer.counter_jumps;
                for report in reports.drain(..) {
                    stall_detector.on_message(arrival, stats.garbage_bytes);
                    self.process_report(report, arrival);
                }
                if let Some(step) = link.take_clock_step() {
                    let reason = format!("the board's clock stepped by {step:.2} s");
                    self.monitor.report_event(reason);
                }
                if self.odometer.counter_jumps > jumps {
                    let reason = "a wheel's counter jumped: odometry restarts".to_owned();
                    self.monitor.report_event(reason);
                }
            }
            let now = clock::now();
            stall_detector.check(now, link.stats().garbage_bytes)?;
            self.update_health(now, start);
        }
        self.commands.lock().halt(clock::now());
        self.send_commands(link, clock::now(), start)
    }

    /// Sends the commands that are valid now. `start`: of the connection. A base that must not drive gets no speeds and no kicks, and
    /// its dribbler stands: they would turn the moment it may again.
    fn send_commands(
        &mut self,
        link: &mut BaseLink,
        now: Stamp,
        start: Stamp,
    ) -> Result<(), HwError> {
        let (request, drive_tally, kick, kick_tally, dribble) = {
            let mut buffer = self.commands.lock();
            buffer.pending = false;
            (
                buffer.current_request(now, self.device.brake_time),
                buffer.take_drive_tally(),
                buffer.take_kick(now),
                buffer.take_kick_tally(),
                buffer.current_dribble(now),
            )
        };
        let may_drive = !self.confirmations.emergency_stop() && !self.is_blind(now, start);
        let twist = match request {
            BaseRequest::Drive(_) if !may_drive => {
                link.send_motor_command(MotorCommand::Brake, now)?;
                Twist::default()
            }
            BaseRequest::Drive(request) => {
                let command = self.motor_command(request, now);
                link.send_motor_command(command, now)?;
                self.confirmations
                    .on_drive_sent(drive_tally, now, request.deadline);
                match command {
                    MotorCommand::Speeds { twist, .. } => twist,
                    MotorCommand::Brake | MotorCommand::Release => Twist::default(),
                }
            }
            BaseRequest::Brake | BaseRequest::Release => {
                let command = if request == BaseRequest::Brake {
                    MotorCommand::Brake
                } else {
                    MotorCommand::Release
                };
                link.send_motor_command(command, now)?;
                self.commands.lock().stops_sent += 1;
                self.commands.stop_sent.notify_all();
                Twist::default()
            }
        };
        self.queue
            .push(DeviceEvent::Command(VelocityCommand { stamp: now, twist }));
        if let Some(kick) = kick.filter(|_| may_drive) {
            let sequence = link.kick(kick.value, kick.remaining(now), now)?;
            self.confirmations.on_kick_sent(kick_tally, now, sequence);
        }
        if let Some(dribble) = dribble {
            let speeds = if may_drive { dribble.value } else { [0.0; 2] };
            link.dribble(speeds, dribble.remaining(now), now)?;
        }
        Ok(())
    }

    /// Does the board send no encoder counts, or no controller on the bus anything, in this connection? What the wheels do then is
    /// unknown. A connection that was opened anew because of silence knows as little as the one before.
    fn is_blind(&self, now: Stamp, start: Stamp) -> bool {
        let stall = self.device.stall;
        let mut reporting = self.odometer.reporting_wheels(now, start, stall);
        if self.device.nodes.is_empty() {
            !reporting.all(|reports| reports)
        } else {
            !reporting.any(|reports| reports)
        }
    }

    /// Speeds of the motors; no wheel's rim is faster than the robot's top speed.
    fn motor_command(&self, command: Timed<MotionCommand>, now: Stamp) -> MotorCommand {
        let (mut motor_speeds, twist) = match command.value {
            MotionCommand::Twist(twist) => {
                let twist = self.omni.limit_twist(twist, self.speed_max);
                let mut speeds = [0.0; 4];
                for (speed, wheel_speed) in speeds.iter_mut().zip(self.omni.wheel_speeds(twist)) {
                    *speed = wheel_speed;
                }
                (speeds, twist)
            }
            MotionCommand::WheelSpeeds(speeds) => {
                let fastest = speeds
                    .iter()
                    .fold(0.0_f32, |most, speed| most.max(speed.abs()));
                let scale = (self.speed_max / (fastest * self.wheel_radius)).min(1.0);
                // Zero speeds divide by zero and need no limit.
                let scale = if scale.is_finite() { scale } else { 1.0 };
                let speeds = speeds.map(|speed| scale * speed);
                let (twist, _) = self.omni.twist(&speeds[..self.omni.wheel_count()]);
                (speeds, twist)
            }
        };
        for (speed, sign) in motor_speeds.iter_mut().zip(&self.motor_signs) {
            *speed *= sign;
        }
        MotorCommand::Speeds {
            motor_speeds,
            twist,
            valid_for: command.remaining(now),
        }
    }

    fn process_report(&mut self, report: BaseReport, arrival: Stamp) {
        let update = match report {
            BaseReport::WheelCounts(counts, stamp) => {
                self.confirmations.on_wheel_report(stamp);
                self.odometer
                    .update_all(&counts[..self.omni.wheel_count()], stamp)
            }
            BaseReport::WheelCount(wheel, count, stamp) => {
                self.confirmations.on_wheel_report(stamp);
                self.odometer.update_wheel(wheel, count, stamp)
            }
            BaseReport::Power(report) => return self.queue.push(DeviceEvent::Power(report)),
            BaseReport::Kicker(report) => {
                self.confirmations
                    .on_kicker_report(report.last_kick, report.stamp);
                return self.queue.push(DeviceEvent::Kicker(report));
            }
            BaseReport::Switches(report) => {
                self.confirmations.on_switches(report.emergency_stop);
                return self.queue.push(DeviceEvent::Switches(report));
            }
            BaseReport::Imu(imu) => return self.queue.push(DeviceEvent::Imu(imu)),
            BaseReport::Compass(compass) => return self.queue.push(DeviceEvent::Compass(compass)),
        };
        // The rate of the base is that of its odometry.
        if update != OdometryUpdate::Incomplete {
            self.monitor.count_message(arrival);
        }
        if let OdometryUpdate::Motion(odometry) = update {
            self.queue.push(DeviceEvent::Odometry(odometry));
        }
    }

    /// Sets the state: stalled if a wheel is silent, running once all wheels have reported since `start`.
    fn update_health(&self, now: Stamp, start: Stamp) {
        let timeout = self.device.stall;
        match self.odometer.silent_wheel(now, start, timeout) {
            Some(wheel) => {
                let reason = match self.device.nodes.get(wheel) {
                    Some(node) => format!("controller {node} of wheel {wheel} is silent"),
                    None => "the board sends no encoder counts: the wheels are braked".to_owned(),
                };
                self.monitor.set_state(HealthState::Stalled, Some(reason));
            }
            None if self.odometer.all_updated_since(start) => {
                self.monitor.set_state(HealthState::Running, None)
            }
            None => {}
        }
    }
}
