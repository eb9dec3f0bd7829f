//! How is the robot moved, and how far did it move? One face for the base board and for VESCs on their three buses.

mod link;
mod odometer;
mod orders;

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use localize::Stamp;
use localize::omni::{Omni, Twist};
use localize::sample::Command;
use vision::robot::BaseConfig;

pub use orders::{Drive, Kick};

use crate::clock;
use crate::config::{BaseDevice, Bus};
use crate::error::HwError;
use crate::health::{Health, Monitor, State};
use crate::inbox::{Event, Inbox};
use crate::worker::{Bell, Watch, Worker};
use link::{Link, Said, Wheels};
use odometer::{Moved, Odometer};
use orders::{Order, Orders};

/// Battery and motors.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PowerReport {
    /// When it was measured.
    pub stamp: Stamp,
    /// Battery, volts.
    pub battery: f32,
    /// Hottest motor driver, °C.
    pub temperature_c: f32,
    /// Current of each motor, amperes.
    pub current: [f32; 4],
    /// Fault code of each motor's driver, 0 for none (VESC).
    pub fault: [u8; 4],
}

impl PowerReport {
    /// One driver's temperature, 0.1 °C; the first wheel's begins a new round.
    fn heat(&mut self, wheel: usize, temperature_ddeg: i16) {
        let temperature_c = f32::from(temperature_ddeg) * 0.1;
        self.temperature_c = if wheel == 0 {
            temperature_c
        } else {
            self.temperature_c.max(temperature_c)
        };
    }
}

/// The kicker.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct KickerReport {
    /// When it was measured.
    pub stamp: Stamp,
    /// Voltage of its capacitor, volts.
    pub charge: f32,
    /// It can kick now.
    pub ready: bool,
    /// It is charging.
    pub charging: bool,
    /// It cannot charge.
    pub broken: bool,
    /// The ball is before it.
    pub ball: bool,
    /// Sequence number of the last kick that was carried out.
    pub last_kick: u16,
}

/// What keeps the robot from moving.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SwitchReport {
    /// When it was read.
    pub stamp: Stamp,
    /// One bit for each pressed bumper, from the front counter-clockwise.
    pub bumpers: u8,
    /// The emergency stop is pressed.
    pub emergency_stop: bool,
    /// The board has stopped the wheels for want of a fresh command.
    pub command_stale: bool,
}

/// The base of the robot. Dropping it stops the wheels.
#[derive(Debug)]
pub struct Base {
    helm: Helm,
    _worker: Worker,
    monitor: Monitor,
}

/// Where the base is commanded from; clones command the same base, for as long as it is there.
#[derive(Debug, Clone)]
pub struct Helm {
    desk: Arc<Desk>,
    bell: Arc<Bell>,
    command_age_max: f64,
    kicks: bool,
}

/// Where commands lie until the thread takes them.
#[derive(Debug, Default)]
struct Desk {
    orders: Mutex<Orders>,
    stopped: Condvar,
}

impl Desk {
    fn orders(&self) -> MutexGuard<'_, Orders> {
        self.orders.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Base {
    /// Starts the base's thread, which opens the bus now or whenever it appears; what it says goes into the inbox.
    ///
    /// `wheels` is robot.toml's `[base]`. Refuses a configuration that cannot work; a missing device is no error here but
    /// a state of [`Base::health`].
    pub fn start(device: &BaseDevice, wheels: &BaseConfig, inbox: &Inbox) -> Result<Self, HwError> {
        device.check()?;
        let angles: Vec<f32> = wheels
            .wheel_angles_deg
            .iter()
            .map(|a| a.to_radians())
            .collect();
        let omni =
            Omni::new(&angles, wheels.wheel_radius, wheels.wheel_distance).map_err(|error| {
                HwError::Config {
                    key: "base.wheel_angles_deg",
                    reason: error.to_string(),
                }
            })?;
        let count = omni.wheels();
        for (key, given, wanted) in [
            ("base.wheel_angles_deg", count, count.min(4)),
            (
                "base.nodes",
                device.nodes.len(),
                if device.bus == Bus::Board { 0 } else { count },
            ),
            (
                "base.reversed",
                device.reversed.len(),
                if device.reversed.is_empty() { 0 } else { count },
            ),
        ] {
            if given != wanted {
                let reason = format!("has {given} entries, {wanted} are wanted");
                return Err(HwError::Config { key, reason });
            }
        }
        let monitor = Monitor::new("base", inbox);
        let desk = Arc::new(Desk::default());
        let signs = (0..4).map(|wheel| {
            let reversed = device.reversed.get(wheel).copied().unwrap_or(false);
            if reversed { -1.0 } else { 1.0 }
        });
        let signs: Vec<f32> = signs.collect();
        let per_tick = std::f32::consts::TAU / wheels.ticks_per_turn;
        let odometer = Odometer::new(
            omni.clone(),
            signs[..count].iter().map(|sign| sign * per_tick).collect(),
            wheels.speed_max / wheels.wheel_radius,
            device.stall,
        );
        let mut server = Server {
            device: device.clone(),
            omni,
            signs,
            speed_max: wheels.speed_max,
            wheel_radius: wheels.wheel_radius,
            odometer,
            desk: Arc::clone(&desk),
            monitor: monitor.clone(),
            inbox: inbox.clone(),
        };
        let (opened, ticks) = (device.clone(), wheels.ticks_per_turn);
        let worker = Worker::start(
            "base",
            &monitor,
            move || Link::open(&opened, count, ticks),
            move |link, bell| server.serve(link, bell),
        )?;
        let helm = Helm {
            desk,
            bell: worker.bell(),
            command_age_max: f64::from(device.command_age_max),
            kicks: device.bus == Bus::Board,
        };
        Ok(Base {
            helm,
            _worker: worker,
            monitor,
        })
    }

    /// Where it is commanded from.
    pub fn helm(&self) -> Helm {
        self.helm.clone()
    }

    /// How the base is.
    pub fn health(&self) -> Health {
        self.monitor.health(clock::now())
    }
}

impl Helm {
    /// Drives until the deadline (CLOCK_MONOTONIC), or for `command_age_max` from now if that is sooner.
    ///
    /// A command that is no number stops the wheels and is refused.
    pub fn drive(&self, drive: Drive, deadline: Stamp) -> Result<(), HwError> {
        let now = clock::now();
        self.check_open()?;
        let finite = match drive {
            Drive::Twist(twist) => [twist.x, twist.y, twist.theta]
                .iter()
                .all(|part| part.is_finite()),
            Drive::Wheels(speeds) => speeds.iter().all(|speed| speed.is_finite()),
        };
        if finite {
            let deadline = deadline.min(now + self.command_age_max);
            self.desk.orders().drive(drive, deadline);
        } else {
            self.desk.orders().halt(now);
        }
        self.bell.ring();
        if finite {
            return Ok(());
        }
        Err(self.unfit(format!("{drive:?} is no speed: the wheels stop")))
    }

    /// Kicks once, unless that cannot be done before the deadline.
    pub fn kick(&self, kick: Kick, deadline: Stamp) -> Result<(), HwError> {
        self.check_open()?;
        if !self.kicks {
            return Err(self.unfit("VESCs have no kicker".to_owned()));
        }
        if !(0.0..=30.0).contains(&kick.speed) {
            let reason = format!("{} m/s is no speed of a kick", kick.speed);
            return Err(self.unfit(reason));
        }
        self.desk.orders().kick(kick, deadline);
        self.bell.ring();
        Ok(())
    }

    /// Turns the left and right dribbling wheel (rad/s, positive pulls the ball in) until the deadline, or for
    /// `command_age_max` from now if that is sooner.
    pub fn dribble(&self, speeds: [f32; 2], deadline: Stamp) -> Result<(), HwError> {
        self.check_open()?;
        if !self.kicks {
            return Err(self.unfit("VESCs have no dribbling wheels".to_owned()));
        }
        if !speeds.iter().all(|speed| speed.abs() <= 3000.0) {
            return Err(self.unfit(format!("{speeds:?} rad/s are no speeds")));
        }
        let deadline = deadline.min(clock::now() + self.command_age_max);
        self.desk.orders().dribble(speeds, deadline);
        self.bell.ring();
        Ok(())
    }

    /// Stops the wheels, and waits until the bus has been told, so long at most; false if it was not told.
    pub fn halt(&self, patience: Duration) -> bool {
        let mut orders = self.desk.orders();
        let sent = orders.stops_sent;
        orders.halt(clock::now());
        self.bell.ring();
        let waiting = |orders: &mut Orders| orders.stops_sent == sent;
        let (orders, timeout) = self
            .desk
            .stopped
            .wait_timeout_while(orders, patience, waiting)
            .unwrap_or_else(PoisonError::into_inner);
        drop(orders);
        !timeout.timed_out()
    }

    /// Stops the wheels as [`Helm::halt`] does, and takes no command from then on.
    pub fn close(&self, patience: Duration) -> bool {
        self.desk.orders().closed = true;
        self.halt(patience)
    }

    fn check_open(&self) -> Result<(), HwError> {
        if self.desk.orders().closed {
            return Err(self.unfit("takes no more commands".to_owned()));
        }
        Ok(())
    }

    fn unfit(&self, reason: String) -> HwError {
        let device = "base".to_owned();
        HwError::Unfit { device, reason }
    }
}

/// What the thread works with.
struct Server {
    device: BaseDevice,
    omni: Omni,
    signs: Vec<f32>,
    speed_max: f32,
    wheel_radius: f32,
    odometer: Odometer,
    desk: Arc<Desk>,
    monitor: Monitor,
    inbox: Inbox,
}

impl Server {
    /// Speaks and listens until the bus fails (an error) or the bell stops it.
    fn serve(&mut self, link: &mut Link, bell: &Bell) -> Result<(), HwError> {
        let period = 1.0 / f64::from(self.device.rate_hz);
        let began = clock::now();
        let mut watch = Watch::new(&self.device.port, self.device.stall);
        let mut said = Vec::new();
        let mut next = began;
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
        self.inbox.put(Event::Command(Command {
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
                let twist = self.omni.limited(twist, self.speed_max);
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
                let (twist, _) = self.omni.twist(&speeds[..self.omni.wheels()]);
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
            Said::Counts(counts, stamp) => {
                self.odometer.read_all(&counts[..self.omni.wheels()], stamp)
            }
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

/// Standing still.
impl Default for Drive {
    fn default() -> Self {
        Drive::Twist(Twist::default())
    }
}
