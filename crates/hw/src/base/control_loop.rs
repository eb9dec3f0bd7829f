//! What does the base's thread do? It sends commands to the bus at a fixed rate and receives its messages.

use std::sync::Arc;

use localize::Stamp;
use localize::omni::{OmniKinematics, Twist};
use localize::sample::VelocityCommand;

use super::command_buffer::{BaseRequest, MotionCommand, SharedCommands, Timed};
use super::command_tally::Confirmations;
use super::link::{BaseLink, BaseReport, MotorCommand, command_rate_max};
use super::odometer::{Odometer, OdometryUpdate};
use super::reports::SwitchReport;
use crate::clock;
use crate::config::{BaseDeviceConfig, COMMAND_VALIDITY_MAX};
use crate::error::HwError;
use crate::event_queue::{DeviceEvent, EventQueue};
use crate::health::HealthState;
use crate::monitor::Monitor;
use crate::worker::{PauseDetector, StallDetector, Waker, pause_reason};

/// Time after which a bus that carries commands is asked again whether it has, seconds.
const IDLE_POLL_PERIOD: f64 = 0.001;

/// State of the base's thread.
pub(super) struct ControlLoop {
    pub(super) device: BaseDeviceConfig,
    pub(super) omni: OmniKinematics,
    pub(super) motor_signs: Vec<f32>,
    pub(super) speed_max: f32,
    pub(super) wheel_radius: f32,
    pub(super) odometer: Odometer,
    pub(super) confirmations: Confirmations,
    pub(super) output: OutputState,
    pub(super) commands: Arc<SharedCommands>,
    pub(super) monitor: Monitor,
    pub(super) queue: EventQueue,
}

/// What the bus has taken of the last commands.
#[derive(Debug, Default)]
pub(super) struct OutputState {
    /// The last command drives.
    drives: bool,
    /// The last command stops the wheels, and the bus has not carried it yet.
    stop_on_the_way: bool,
    /// Since when commands wait because the bus does not carry the last one.
    blocked_since: Option<Stamp>,
}

impl ControlLoop {
    /// Sends and receives until the bus fails (an error) or the waker stops it.
    pub(super) fn run(&mut self, link: &mut BaseLink, waker: &Waker) -> Result<(), HwError> {
        let period = 1.0 / f64::from(self.device.rate_hz);
        // Since when the wheels' silence counts: the connection, or the end of a pause.
        let mut start = clock::now();
        let mut stall_detector = StallDetector::new(&self.device.port, self.device.stall);
        let mut reports = Vec::new();
        // When the last command is repeated, and from when on a new one is sent.
        let (mut next_send, mut next_new) = (start, start);
        // Commands from before the bus was open are discarded: the wheels stop first.
        self.commands.lock().halt(start);
        self.confirmations = Confirmations::default();
        self.output = OutputState::default();
        let mut rate_checked = false;
        let mut pause_detector = PauseDetector::new(start);
        link.send_motor_command(MotorCommand::Release, start)?;
        while !waker.stop_requested() {
            let now = clock::now();
            let (is_new, stops) = {
                let buffer = self.commands.lock();
                (buffer.pending, buffer.stops())
            };
            self.confirm_stop(link.is_idle(now));
            let mut waits = false;
            // New commands go out at once, but no faster than the rate: a serial line would queue them.
            if (is_new && (stops || now >= next_new)) || now >= next_send {
                waits = !self.send_commands(link, now, start)?;
                if !waits {
                    // The period restarts at a new command, so that it is not sent twice in a row.
                    next_send = now + period;
                    if is_new {
                        next_new = next_send;
                    }
                }
            }
            let until = if waits || self.output.stop_on_the_way {
                link.carried_at(now).max(now + IDLE_POLL_PERIOD)
            } else if self.commands.lock().pending {
                next_new.min(next_send)
            } else {
                next_send
            };
            let readable = waker.wait(Some(link.fd()), until);
            let arrival = clock::now();
            if let Some(pause) = pause_detector.check(arrival) {
                link.discard_input()?;
                // The base has rightly stopped meanwhile, and the line has carried what waited.
                self.confirmations.on_output_discarded();
                self.output.blocked_since = None;
                self.monitor.report_event(pause_reason(pause));
                stall_detector.on_message(arrival, link.stats().garbage_bytes);
                start = arrival;
                continue;
            }
            if readable {
                link.receive(arrival, &mut reports)?;
                let stats = link.stats();
                self.monitor.set_decoder_stats(stats);
                let jumps = self.odometer.counter_jumps;
                for report in reports.drain(..) {
                    stall_detector.on_message(arrival, stats.garbage_bytes);
                    self.process_report(report, arrival);
                }
                if self.odometer.counter_jumps > jumps {
                    let reason = "a wheel's counter jumped: odometry restarts".to_owned();
                    self.monitor.report_event(reason);
                }
            }
            // By the time of the check for a pause: one that began since is no silence of the base.
            stall_detector.check(arrival, link.stats().garbage_bytes)?;
            self.update_health(link, arrival, start);
            if !rate_checked && self.odometer.all_updated_since(start) {
                rate_checked = true;
                self.report_slow_line();
            }
        }
        self.commands.lock().halt(clock::now());
        let deadline = clock::now() + COMMAND_VALIDITY_MAX;
        while !self.send_commands(link, clock::now(), start)? && clock::now() < deadline {
            waker.wait(None, clock::now() + IDLE_POLL_PERIOD);
        }
        // A port that is closed waits for its output, or drops it.
        while !link.is_idle(clock::now()) && clock::now() < deadline {
            waker.wait(None, clock::now() + IDLE_POLL_PERIOD);
        }
        self.confirm_stop(link.is_idle(clock::now()));
        Ok(())
    }

    /// Counts the last stop once the bus has carried it.
    fn confirm_stop(&mut self, is_idle: bool) {
        if is_idle && std::mem::take(&mut self.output.stop_on_the_way) {
            self.commands.lock().stops_sent += 1;
            self.commands.stop_sent.notify_all();
        }
    }

    /// Reports a line that does not carry the commands of the configured rate.
    fn report_slow_line(&self) {
        let rate_max = command_rate_max(&self.device, self.omni.wheel_count());
        if let Some(rate_max) = rate_max.filter(|most| *most < f64::from(self.device.rate_hz)) {
            let BaseDeviceConfig { baud, rate_hz, .. } = self.device;
            self.monitor.report_event(format!(
                "{baud} baud carry {rate_max:.0} of {rate_hz} commands per second: fewer are sent"
            ));
        }
    }

    /// Sends the commands that are valid when they arrive. `start`: of the connection, or the end of a pause. A base that must not drive gets no speeds and no
    /// kicks, and its dribbler stands: they would turn the moment it may again.
    ///
    /// False if the bus still carries the last commands: the newest wait here, where they expire, and not behind old ones. Only a stop
    /// goes out at once, in place of commands that drive.
    fn send_commands(
        &mut self,
        link: &mut BaseLink,
        now: Stamp,
        start: Stamp,
    ) -> Result<bool, HwError> {
        let may_drive = !self.confirmations.emergency_stop()
            && !self.confirmations.needs_zero_speeds(now)
            && !self.is_blind(now, start);
        let is_idle = link.is_idle(now);
        let arrival = link.command_arrival(now);
        let (request, drive_tally, kick, kick_tally, dribble) = {
            let mut buffer = self.commands.lock();
            let request = buffer.current_request(arrival, self.device.brake_time);
            let drives = may_drive && matches!(request, BaseRequest::Drive(_));
            if !is_idle && (drives || !self.output.drives) {
                self.output.blocked_since.get_or_insert(now);
                return Ok(false);
            }
            buffer.pending = false;
            (
                request,
                buffer.take_drive_tally(),
                buffer.take_kick(arrival),
                buffer.take_kick_tally(),
                buffer.current_dribble(arrival),
            )
        };
        if is_idle {
            self.output.blocked_since = None;
        } else if link.discard_output(now)? {
            self.confirmations.on_output_discarded();
        }
        let arrival = link.command_arrival(now);
        let command = match request {
            BaseRequest::Drive(request) if may_drive => self.motor_command(request, arrival),
            BaseRequest::Drive(_) | BaseRequest::Brake => MotorCommand::Brake,
            BaseRequest::Release => MotorCommand::Release,
        };
        link.send_motor_command(command, now)?;
        let twist = match (command, request) {
            (MotorCommand::Speeds { twist, .. }, BaseRequest::Drive(request)) => {
                self.confirmations
                    .on_drive_sent(drive_tally, arrival, request.deadline);
                twist
            }
            _ => Twist::default(),
        };
        self.output.drives = matches!(command, MotorCommand::Speeds { .. });
        self.output.stop_on_the_way = !matches!(request, BaseRequest::Drive(_));
        let valid_until = match request {
            BaseRequest::Drive(request) if self.output.drives => request.deadline,
            _ => arrival + COMMAND_VALIDITY_MAX,
        };
        self.confirmations
            .on_command_sent(command.moves(), arrival, valid_until);
        self.queue
            .push(DeviceEvent::Command(VelocityCommand { stamp: now, twist }));
        // A kick that waits on its way to the board would be carried out whenever the board receives it.
        let may_kick = may_drive && !self.confirmations.receives_nothing(now);
        if let Some(kick) = kick.filter(|_| may_kick) {
            let sequence = link.kick(kick.value, kick.remaining(arrival), now)?;
            self.confirmations
                .on_kick_sent(kick_tally, link.carried_at(now), sequence);
        }
        if let Some(dribble) = dribble {
            let speeds = if may_kick { dribble.value } else { [0.0; 2] };
            link.dribble(speeds, dribble.remaining(arrival), now)?;
        }
        Ok(true)
    }

    /// Does a wheel not report, by its own controller or by the board's encoder counts, in this connection and since the last pause? What
    /// the wheels do then is unknown. A connection that was opened anew because of silence knows as little as the one before.
    fn is_blind(&self, now: Stamp, start: Stamp) -> bool {
        let timeout = self.device.stall;
        !self.odometer.all_updated_since(start)
            || self
                .odometer
                .silent_wheels(now, start, timeout)
                .next()
                .is_some()
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
        let (update, stamp) = match report {
            BaseReport::WheelCounts(counts, stamp) => {
                let counts = &counts[..self.omni.wheel_count()];
                (self.odometer.update_all(counts, stamp, arrival), stamp)
            }
            BaseReport::WheelCount(wheel, count, stamp) => {
                (self.odometer.update_wheel(wheel, count, stamp), stamp)
            }
            BaseReport::Power(report) => return self.queue.push(DeviceEvent::Power(report)),
            BaseReport::Kicker(report) => {
                self.confirmations
                    .on_kicker_report(report.last_kick, report.stamp);
                return self.queue.push(DeviceEvent::Kicker(report));
            }
            BaseReport::Switches(report) => {
                let SwitchReport {
                    emergency_stop,
                    command_stale,
                    ..
                } = report;
                self.confirmations
                    .on_switches(emergency_stop, command_stale, arrival);
                self.commands.lock().emergency_stop = emergency_stop;
                return self.queue.push(DeviceEvent::Switches(report));
            }
            BaseReport::Imu(imu) => return self.queue.push(DeviceEvent::Imu(imu)),
            BaseReport::Compass(compass) => return self.queue.push(DeviceEvent::Compass(compass)),
        };
        // The rate of the base is that of its odometry.
        if update != OdometryUpdate::Incomplete {
            self.confirmations.on_wheel_report(stamp);
            self.monitor.count_message(arrival);
        }
        if let OdometryUpdate::Motion(odometry) = update {
            self.queue.push(DeviceEvent::Odometry(odometry));
        }
    }

    /// Sets the state: stalled if a wheel is silent or no command arrives, running once all wheels have reported since `start`.
    fn update_health(&self, link: &BaseLink, now: Stamp, start: Stamp) {
        if let Some(reason) = self.stall_reason(now, start) {
            self.monitor.set_state(HealthState::Stalled, Some(reason));
        } else if let Some(fault) = link.clock_fault(now) {
            let what = match fault.step {
                Some(step) => format!("the board's clock stepped by {step:.2} s"),
                None => "the board's clock stands still or runs unevenly".to_owned(),
            };
            let reason = format!("{what}: its messages are stamped on arrival");
            self.monitor.set_state(HealthState::Clock, Some(reason));
        } else if self.odometer.all_updated_since(start) {
            self.monitor.set_state(HealthState::Running, None);
        }
    }

    /// Why the base cannot be driven now.
    fn stall_reason(&self, now: Stamp, start: Stamp) -> Option<String> {
        let timeout = self.device.stall;
        let silent: Vec<usize> = self.odometer.silent_wheels(now, start, timeout).collect();
        if !silent.is_empty() {
            if self.device.nodes.is_empty() {
                return Some("the board sends no encoder counts: the wheels are braked".to_owned());
            }
            let names: Vec<String> = silent
                .iter()
                .filter_map(|wheel| {
                    Some(format!(
                        "{} of wheel {wheel}",
                        self.device.nodes.get(*wheel)?
                    ))
                })
                .collect();
            let (noun, verb) = if names.len() == 1 {
                ("controller", "is")
            } else {
                ("controllers", "are")
            };
            let names = names.join(", ");
            return Some(format!(
                "{noun} {names} {verb} silent: the wheels are braked"
            ));
        }
        let blocked_for = self.output.blocked_since.map_or(0.0, |since| now - since);
        if blocked_for > f64::from(timeout) {
            return Some("it takes no bytes: commands are not sent".to_owned());
        }
        self.confirmations.receives_nothing(now).then(|| {
            "the board reports that its last command has expired, but new ones are sent: it does not receive them, and gets speeds of zero".to_owned()
        })
    }
}
