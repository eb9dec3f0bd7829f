//! What does the base's thread do? It tells the bus what is wanted, in time, and hears what the bus says.

use std::sync::Arc;

use localize::Stamp;
use localize::omni::{OmniKinematics, Twist};
use localize::sample::VelocityCommand;

use super::link::{Link, Said, Wheels};
use super::odometer::{Moved, Odometer};
use super::orders::Order;
use super::{Desk, Drive};
use crate::clock;
use crate::config::BaseDevice;
use crate::error::HwError;
use crate::health::{Monitor, State};
use crate::inbox::{Event, Inbox};
use crate::worker::{Bell, Watch};

/// What the thread works with.
pub(super) struct Server {
    pub(super) device: BaseDevice,
    pub(super) omni: OmniKinematics,
    pub(super) signs: Vec<f32>,
    pub(super) speed_max: f32,
    pub(super) wheel_radius: f32,
    pub(super) odometer: Odometer,
    pub(super) desk: Arc<Desk>,
    pub(super) monitor: Monitor,
    pub(super) inbox: Inbox,
}

impl Server {
    /// Speaks and listens until the bus fails (an error) or the bell stops it.
    pub(super) fn serve(&mut self, link: &mut Link, bell: &Bell) -> Result<(), HwError> {
        let period = 1.0 / f64::from(self.device.rate_hz);
        let began = clock::now();
        let mut watch = Watch::new(&self.device.port, self.device.stall);
        let mut said = Vec::new();
        let mut next = began;
        // Whatever was commanded before the line was there: it begins with wheels that stand.
        self.desk.orders().halt(began);
        link.send(Wheels::Release, began)?;
        while !bell.stopped() {
            let now = clock::now();
            let news = self.desk.orders().news;
            if news || now >= next {
                self.speak(link, now)?;
                // A new command moves the rhythm along with it: the bus is not told twice in a row.
                next = now + period;
            }
            if bell.wait(Some(link.fd()), next) {
                let arrival = clock::now();
                link.receive(arrival, &mut said)?;
                let tally = link.tally();
                self.monitor.tally(tally);
                let jumps = self.odometer.jumps;
                for said in said.drain(..) {
                    watch.message(arrival, tally.garbage_bytes);
                    self.hear(said, arrival);
                }
                if let Some(step) = link.take_clock_step() {
                    let reason = format!("the board's clock stepped by {step:.2} s");
                    self.monitor.notice(reason);
                }
                if self.odometer.jumps > jumps {
                    let reason = "a wheel's counter jumped: odometry begins anew".to_owned();
                    self.monitor.notice(reason);
                }
            }
            let now = clock::now();
            watch.check(now, link.tally().garbage_bytes)?;
            self.judge(now, began);
        }
        self.desk.orders().halt(clock::now());
        self.speak(link, clock::now())
    }

    /// Tells the bus what is wanted now.
    fn speak(&self, link: &mut Link, now: Stamp) -> Result<(), HwError> {
        let (order, kick, dribble) = {
            let mut orders = self.desk.orders();
            orders.news = false;
            (
                orders.order(now, self.device.brake_time),
                orders.take_kick(now),
                orders.dribbling(now),
            )
        };
        let told = match order {
            Order::Drive(drive, left) => {
                let wheels = self.wheels(drive, left);
                link.send(wheels, now)?;
                match wheels {
                    Wheels::Turn(_, twist, _) => twist,
                    Wheels::Brake | Wheels::Release => Twist::default(),
                }
            }
            Order::Brake | Order::Release => {
                let wheels = if order == Order::Brake {
                    Wheels::Brake
                } else {
                    Wheels::Release
                };
                link.send(wheels, now)?;
                self.desk.orders().stops_sent += 1;
                self.desk.stopped.notify_all();
                Twist::default()
            }
        };
        self.inbox.put(Event::Command(VelocityCommand {
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
    fn wheels(&self, drive: Drive, left: f64) -> Wheels {
        let (mut speeds, twist) = match drive {
            Drive::Twist(twist) => {
                let twist = self.omni.limit_twist(twist, self.speed_max);
                let mut speeds = [0.0; 4];
                for (speed, wanted) in speeds.iter_mut().zip(self.omni.wheel_speeds(twist)) {
                    *speed = wanted;
                }
                (speeds, twist)
            }
            Drive::Wheels(speeds) => {
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
        for (speed, sign) in speeds.iter_mut().zip(&self.signs) {
            *speed *= sign;
        }
        Wheels::Turn(speeds, twist, left)
    }

    fn hear(&mut self, said: Said, arrival: Stamp) {
        let moved = match said {
            Said::Counts(counts, stamp) => self
                .odometer
                .read_all(&counts[..self.omni.wheel_count()], stamp),
            Said::Count(wheel, count, stamp) => self.odometer.read_one(wheel, count, stamp),
            Said::Power(report) => return self.inbox.put(Event::Power(report)),
            Said::Kicker(report) => return self.inbox.put(Event::Kicker(report)),
            Said::Switches(report) => return self.inbox.put(Event::Switches(report)),
            Said::Imu(imu) => return self.inbox.put(Event::Imu(imu)),
            Said::Compass(compass) => return self.inbox.put(Event::Compass(compass)),
        };
        // The base's rate is that of its odometry.
        if moved != Moved::Waiting {
            self.monitor.message(arrival);
        }
        if let Moved::By(odometry) = moved {
            self.inbox.put(Event::Odometry(odometry));
        }
    }

    /// Running, unless a wheel is not heard; before the first word of all it is what it was.
    fn judge(&self, now: Stamp, began: Stamp) {
        let limit = self.device.stall;
        match self.odometer.silent(now, began, limit) {
            Some(wheel) => {
                let reason = match self.device.nodes.get(wheel) {
                    Some(node) => format!("controller {node} of wheel {wheel} is silent"),
                    None => "the board sends no encoder counts".to_owned(),
                };
                self.monitor.state(State::Stalled, Some(reason));
            }
            None if self.odometer.heard_all_since(began) => {
                self.monitor.state(State::Running, None)
            }
            None => {}
        }
    }
}
