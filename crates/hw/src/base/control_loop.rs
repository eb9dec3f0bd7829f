//! What does the base's thread do? It tells the bus what is wanted, in time, and hears what the bus says.

use std::sync::Arc;

use localize::Stamp;
use localize::omni::{OmniKinematics, Twist};
use localize::sample::VelocityCommand;

use super::command_buffer::BaseRequest;
use super::link::{BaseLink, BaseReport, MotorCommand};
use super::odometer::{Odometer, OdometryUpdate};
use super::{MotionCommand, SharedCommands};
use crate::clock;
use crate::config::BaseDeviceConfig;
use crate::error::HwError;
use crate::event_queue::{DeviceEvent, EventQueue};
use crate::health::{HealthState, Monitor};
use crate::worker::{StallDetector, Waker};

/// What the thread works with.
pub(super) struct ControlLoop {
    pub(super) device: BaseDeviceConfig,
    pub(super) omni: OmniKinematics,
    pub(super) motor_signs: Vec<f32>,
    pub(super) speed_max: f32,
    pub(super) wheel_radius: f32,
    pub(super) odometer: Odometer,
    pub(super) commands: Arc<SharedCommands>,
    pub(super) monitor: Monitor,
    pub(super) inbox: EventQueue,
}

impl ControlLoop {
    /// Speaks and listens until the bus fails (an error) or the bell stops it.
    pub(super) fn run(&mut self, link: &mut BaseLink, bell: &Waker) -> Result<(), HwError> {
        let period = 1.0 / f64::from(self.device.rate_hz);
        let began = clock::now();
        let mut watch = StallDetector::new(&self.device.port, self.device.stall);
        let mut said = Vec::new();
        let mut next = began;
        // Whatever was commanded before the line was there: it begins with wheels that stand.
        self.commands.lock().halt(began);
        link.send_motor_command(MotorCommand::Release, began)?;
        while !bell.stop_requested() {
            let now = clock::now();
            let news = self.commands.lock().pending;
            if news || now >= next {
                self.send_commands(link, now)?;
                // A new command moves the rhythm along with it: the bus is not told twice in a row.
                next = now + period;
            }
            if bell.wait(Some(link.fd()), next) {
                let arrival = clock::now();
                link.receive(arrival, &mut said)?;
                let tally = link.stats();
                self.monitor.set_decoder_stats(tally);
                let jumps = self.odometer.counter_jumps;
                for said in said.drain(..) {
                    watch.on_message(arrival, tally.garbage_bytes);
                    self.receive(said, arrival);
                }
                if let Some(step) = link.take_clock_step() {
                    let reason = format!("the board's clock stepped by {step:.2} s");
                    self.monitor.report_event(reason);
                }
                if self.odometer.counter_jumps > jumps {
                    let reason = "a wheel's counter jumped: odometry begins anew".to_owned();
                    self.monitor.report_event(reason);
                }
            }
            let now = clock::now();
            watch.check(now, link.stats().garbage_bytes)?;
            self.update_health(now, began);
        }
        self.commands.lock().halt(clock::now());
        self.send_commands(link, clock::now())
    }

    /// Tells the bus what is wanted now.
    fn send_commands(&self, link: &mut BaseLink, now: Stamp) -> Result<(), HwError> {
        let (order, kick, dribble) = {
            let mut orders = self.commands.lock();
            orders.pending = false;
            (
                orders.current_request(now, self.device.brake_time),
                orders.take_kick(now),
                orders.current_dribble(now),
            )
        };
        let told = match order {
            BaseRequest::Drive(drive, left) => {
                let wheels = self.motor_command(drive, left);
                link.send_motor_command(wheels, now)?;
                match wheels {
                    MotorCommand::Speeds(_, twist, _) => twist,
                    MotorCommand::Brake | MotorCommand::Release => Twist::default(),
                }
            }
            BaseRequest::Brake | BaseRequest::Release => {
                let wheels = if order == BaseRequest::Brake {
                    MotorCommand::Brake
                } else {
                    MotorCommand::Release
                };
                link.send_motor_command(wheels, now)?;
                self.commands.lock().stops_sent += 1;
                self.commands.stop_sent.notify_all();
                Twist::default()
            }
        };
        self.inbox.push(DeviceEvent::Command(VelocityCommand {
            stamp: now,
            twist: told,
        }));
        if let Some((kick, left)) = kick {
            link.kick(kick, left, now)?;
        }
        if let Some((speeds, left)) = dribble {
            link.dribble(speeds, left, now)?;
        }
        Ok(())
    }

    /// Speeds of the motors, no rim faster than the robot's top speed.
    fn motor_command(&self, drive: MotionCommand, left: f64) -> MotorCommand {
        let (mut speeds, twist) = match drive {
            MotionCommand::Twist(twist) => {
                let twist = self.omni.limit_twist(twist, self.speed_max);
                let mut speeds = [0.0; 4];
                for (speed, wanted) in speeds.iter_mut().zip(self.omni.wheel_speeds(twist)) {
                    *speed = wanted;
                }
                (speeds, twist)
            }
            MotionCommand::WheelSpeeds(speeds) => {
                let fastest = speeds
                    .iter()
                    .fold(0.0_f32, |most, speed| most.max(speed.abs()));
                let share = (self.speed_max / (fastest * self.wheel_radius)).min(1.0);
                // Standing wheels make 0/0: nothing to slow down.
                let share = if share.is_finite() { share } else { 1.0 };
                let speeds = speeds.map(|speed| share * speed);
                let (twist, _) = self.omni.twist(&speeds[..self.omni.wheel_count()]);
                (speeds, twist)
            }
        };
        for (speed, sign) in speeds.iter_mut().zip(&self.motor_signs) {
            *speed *= sign;
        }
        MotorCommand::Speeds(speeds, twist, left)
    }

    fn receive(&mut self, said: BaseReport, arrival: Stamp) {
        let moved = match said {
            BaseReport::WheelCounts(counts, stamp) => self
                .odometer
                .update_all(&counts[..self.omni.wheel_count()], stamp),
            BaseReport::WheelCount(wheel, count, stamp) => {
                self.odometer.update_wheel(wheel, count, stamp)
            }
            BaseReport::Power(report) => return self.inbox.push(DeviceEvent::Power(report)),
            BaseReport::Kicker(report) => return self.inbox.push(DeviceEvent::Kicker(report)),
            BaseReport::Switches(report) => return self.inbox.push(DeviceEvent::Switches(report)),
            BaseReport::Imu(imu) => return self.inbox.push(DeviceEvent::Imu(imu)),
            BaseReport::Compass(compass) => return self.inbox.push(DeviceEvent::Compass(compass)),
        };
        // The base's rate is that of its odometry.
        if moved != OdometryUpdate::Incomplete {
            self.monitor.count_message(arrival);
        }
        if let OdometryUpdate::Motion(odometry) = moved {
            self.inbox.push(DeviceEvent::Odometry(odometry));
        }
    }

    /// Running, unless a wheel is not heard; before the first word of all it is what it was.
    fn update_health(&self, now: Stamp, began: Stamp) {
        let limit = self.device.stall;
        match self.odometer.silent_wheel(now, began, limit) {
            Some(wheel) => {
                let reason = match self.device.nodes.get(wheel) {
                    Some(node) => format!("controller {node} of wheel {wheel} is silent"),
                    None => "the board sends no encoder counts".to_owned(),
                };
                self.monitor.set_state(HealthState::Stalled, Some(reason));
            }
            None if self.odometer.all_updated_since(began) => {
                self.monitor.set_state(HealthState::Running, None)
            }
            None => {}
        }
    }
}
