//! How is the robot moved, and how far did it move? One face for the base board and for VESCs on their three buses.

mod command_buffer;
mod control_loop;
mod link;
mod odometer;
mod reports;

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use localize::Stamp;
use localize::omni::OmniKinematics;
use localize::robot::BaseConfig;

pub use command_buffer::{Kick, MotionCommand};
pub use reports::{KickerReport, PowerReport, SwitchReport};

use crate::clock;
use crate::config::{BaseDeviceConfig, Bus};
use crate::error::HwError;
use crate::event_queue::EventQueue;
use crate::health::{HealthReport, Monitor};
use crate::worker::{Waker, Worker};
use command_buffer::CommandBuffer;
use control_loop::ControlLoop;
use link::BaseLink;
use odometer::Odometer;

/// The base of the robot. Dropping it stops the wheels.
#[derive(Debug)]
pub struct BaseDriver {
    handle: BaseHandle,
    _worker: Worker,
    monitor: Monitor,
}

/// Where the base is commanded from; clones command the same base, for as long as it is there.
#[derive(Debug, Clone)]
pub struct BaseHandle {
    commands: Arc<SharedCommands>,
    waker: Arc<Waker>,
    command_age_max: f64,
    has_kicker: bool,
}

/// Where commands lie until the thread takes them.
#[derive(Debug, Default)]
struct SharedCommands {
    buffer: Mutex<CommandBuffer>,
    stop_sent: Condvar,
}

impl SharedCommands {
    fn lock(&self) -> MutexGuard<'_, CommandBuffer> {
        self.buffer.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl BaseDriver {
    /// Starts the base's thread, which opens the bus now or whenever it appears; what it says goes into the inbox.
    ///
    /// `wheels` is robot.toml's `[base]`. Refuses a configuration that cannot work; a missing device is no error here but
    /// a state of [`Base::health`].
    pub fn start(
        device: &BaseDeviceConfig,
        wheels: &BaseConfig,
        inbox: &EventQueue,
    ) -> Result<Self, HwError> {
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
        let desk = Arc::new(SharedCommands::default());
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
        let mut server = ControlLoop {
            device: device.clone(),
            omni,
            motor_signs: signs,
            speed_max: wheels.speed_max,
            wheel_radius: wheels.wheel_radius,
            odometer,
            commands: Arc::clone(&desk),
            monitor: monitor.clone(),
            inbox: inbox.clone(),
        };
        let (opened, ticks) = (device.clone(), wheels.ticks_per_turn);
        let worker = Worker::start(
            "base",
            &monitor,
            move || BaseLink::open(&opened, count, ticks),
            move |link, bell| server.run(link, bell),
        )?;
        let helm = BaseHandle {
            commands: desk,
            waker: worker.waker(),
            command_age_max: f64::from(device.command_age_max),
            has_kicker: device.bus == Bus::Board,
        };
        Ok(BaseDriver {
            handle: helm,
            _worker: worker,
            monitor,
        })
    }

    /// Where it is commanded from.
    pub fn handle(&self) -> BaseHandle {
        self.handle.clone()
    }

    /// How the base is.
    pub fn health(&self) -> HealthReport {
        self.monitor.health(clock::now())
    }
}

impl BaseHandle {
    /// Drives until the deadline (CLOCK_MONOTONIC), or for `command_age_max` from now if that is sooner.
    ///
    /// A command that is no number stops the wheels and is refused.
    pub fn drive(&self, drive: MotionCommand, deadline: Stamp) -> Result<(), HwError> {
        let now = clock::now();
        self.check_open()?;
        let finite = match drive {
            MotionCommand::Twist(twist) => [twist.x, twist.y, twist.theta]
                .iter()
                .all(|part| part.is_finite()),
            MotionCommand::WheelSpeeds(speeds) => speeds.iter().all(|speed| speed.is_finite()),
        };
        if finite {
            let deadline = deadline.min(now + self.command_age_max);
            self.commands.lock().set_drive(drive, deadline);
        } else {
            self.commands.lock().halt(now);
        }
        self.waker.wake();
        if finite {
            return Ok(());
        }
        Err(self.rejection(format!("{drive:?} is no speed: the wheels stop")))
    }

    /// Kicks once, unless that cannot be done before the deadline.
    pub fn kick(&self, kick: Kick, deadline: Stamp) -> Result<(), HwError> {
        self.check_open()?;
        if !self.has_kicker {
            return Err(self.rejection("VESCs have no kicker".to_owned()));
        }
        if !(0.0..=30.0).contains(&kick.speed) {
            let reason = format!("{} m/s is no speed of a kick", kick.speed);
            return Err(self.rejection(reason));
        }
        self.commands.lock().set_kick(kick, deadline);
        self.waker.wake();
        Ok(())
    }

    /// Turns the left and right dribbling wheel (rad/s, positive pulls the ball in) until the deadline, or for
    /// `command_age_max` from now if that is sooner.
    pub fn dribble(&self, speeds: [f32; 2], deadline: Stamp) -> Result<(), HwError> {
        self.check_open()?;
        if !self.has_kicker {
            return Err(self.rejection("VESCs have no dribbling wheels".to_owned()));
        }
        if !speeds.iter().all(|speed| speed.abs() <= 3000.0) {
            return Err(self.rejection(format!("{speeds:?} rad/s are no speeds")));
        }
        let deadline = deadline.min(clock::now() + self.command_age_max);
        self.commands.lock().set_dribble(speeds, deadline);
        self.waker.wake();
        Ok(())
    }

    /// Stops the wheels, and waits until the bus has been told, so long at most; false if it was not told.
    pub fn halt(&self, patience: Duration) -> bool {
        let mut orders = self.commands.lock();
        let sent = orders.stops_sent;
        orders.halt(clock::now());
        self.waker.wake();
        let waiting = |orders: &mut CommandBuffer| orders.stops_sent == sent;
        let (orders, timeout) = self
            .commands
            .stop_sent
            .wait_timeout_while(orders, patience, waiting)
            .unwrap_or_else(PoisonError::into_inner);
        drop(orders);
        !timeout.timed_out()
    }

    /// Stops the wheels as [`Helm::halt`] does, and takes no command from then on.
    pub fn close(&self, patience: Duration) -> bool {
        self.commands.lock().closed = true;
        self.halt(patience)
    }

    fn check_open(&self) -> Result<(), HwError> {
        if self.commands.lock().closed {
            return Err(self.rejection("takes no more commands".to_owned()));
        }
        Ok(())
    }

    fn rejection(&self, reason: String) -> HwError {
        let device = "base".to_owned();
        HwError::Unsupported { device, reason }
    }
}
