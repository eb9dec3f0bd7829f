//! How is the robot moved, and how far did it move? One face for the base board and for VESCs on their three buses.

mod link;
mod odometer;
mod orders;
mod report;
mod server;

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use localize::Stamp;
use localize::omni::OmniKinematics;
use localize::robot::BaseConfig;

pub use orders::{Drive, Kick};
pub use report::{KickerReport, PowerReport, SwitchReport};

use crate::clock;
use crate::config::{BaseDevice, Bus};
use crate::error::HwError;
use crate::health::{Health, Monitor};
use crate::inbox::Inbox;
use crate::worker::{Bell, Worker};
use link::Link;
use odometer::Odometer;
use orders::Orders;
use server::Server;

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
        let omni = OmniKinematics::new(&angles, wheels.wheel_radius, wheels.wheel_distance)
            .map_err(|error| HwError::Config {
                key: "base.wheel_angles_deg",
                reason: error.to_string(),
            })?;
        let count = omni.wheel_count();
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
