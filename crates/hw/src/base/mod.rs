//! How is the robot driven, and how far did it move? One interface for the base board and for VESCs on three buses.

mod command_buffer;
mod command_tally;
mod control_loop;
mod link;
mod odometer;
mod reports;

use std::sync::{Arc, PoisonError};
use std::time::Duration;

use localize::Stamp;
use localize::robot::BaseConfig;

pub use command_buffer::{Kick, MotionCommand};
pub use command_tally::CommandTally;
pub use reports::{KickerReport, PowerReport, SwitchReport};

use crate::clock;
use crate::config::{BaseDeviceConfig, Bus, check_count};
use crate::error::HwError;
use crate::event_queue::EventQueue;
use crate::health::{HealthReport, HealthState};
use crate::monitor::Monitor;
use crate::worker::{Waker, Worker};
use command_buffer::{CommandBuffer, SharedCommands};
use command_tally::Confirmations;
use control_loop::{ControlLoop, OutputState};
use link::BaseLink;
use odometer::Odometer;

/// Fastest kick that is accepted, m/s.
const KICK_SPEED_MAX: f32 = 30.0;
/// Fastest turn of a dribbling wheel that is accepted, rad/s.
const DRIBBLE_SPEED_MAX: f32 = 3000.0;

/// The base of the robot. Dropping it stops the wheels.
#[derive(Debug)]
pub struct BaseDriver {
    handle: BaseHandle,
    _worker: Worker,
    monitor: Monitor,
}

/// Commands for all motors that the line of a base carries in a second, by its baud rate; `None` without a serial line.
///
/// If it is less than `rate_hz`, fewer commands are sent: the newest each time that the line has carried the last.
pub fn command_rate_max(device: &BaseDeviceConfig, wheels: &BaseConfig) -> Option<f64> {
    link::command_rate_max(device, wheels.wheel_angles_deg.len())
}

/// Commands the base; clones command the same base as long as it exists.
#[derive(Debug, Clone)]
pub struct BaseHandle {
    commands: Arc<SharedCommands>,
    waker: Arc<Waker>,
    command_age_max: f64,
    has_kicker: bool,
    monitor: Monitor,
    tally: Option<Arc<CommandTally>>,
}

impl BaseDriver {
    /// Starts the base's thread, which opens the bus as soon as it is present and pushes its samples into the queue.
    ///
    /// `wheels` is robot.toml's `[base]`. Fails for an invalid configuration; a missing device is a state of
    /// [`BaseDriver::health`].
    pub fn start(
        device: &BaseDeviceConfig,
        wheels: &BaseConfig,
        queue: &EventQueue,
    ) -> Result<Self, HwError> {
        device.check()?;
        let omni = wheels.kinematics().map_err(|error| HwError::Config {
            key: "base.wheel_angles_deg",
            reason: error.to_string(),
        })?;
        let count = omni.wheel_count();
        check_count("base.wheel_angles_deg", count, count.min(4))?;
        device.check_entries(count)?;
        let monitor = Monitor::new("base", queue);
        let commands = Arc::new(SharedCommands::default());
        let signs = (0..4).map(|wheel| {
            let reversed = device.reversed.get(wheel).copied().unwrap_or(false);
            if reversed { -1.0 } else { 1.0 }
        });
        let signs: Vec<f32> = signs.collect();
        let radians_per_tick = std::f32::consts::TAU / wheels.ticks_per_turn;
        let odometer = Odometer::new(
            omni.clone(),
            signs[..count]
                .iter()
                .map(|sign| sign * radians_per_tick)
                .collect(),
            wheels.speed_max / wheels.wheel_radius,
            device.stall,
        );
        let mut control_loop = ControlLoop {
            device: device.clone(),
            omni,
            motor_signs: signs,
            speed_max: wheels.speed_max,
            wheel_radius: wheels.wheel_radius,
            odometer,
            confirmations: Confirmations::default(),
            output: OutputState::default(),
            commands: Arc::clone(&commands),
            monitor: monitor.clone(),
            queue: queue.clone(),
        };
        let (device_config, ticks) = (device.clone(), wheels.ticks_per_turn);
        let worker = Worker::start(
            "base",
            &monitor,
            move || BaseLink::open(&device_config, count, ticks),
            move |link, waker| control_loop.run(link, waker),
        )?;
        let handle = BaseHandle {
            commands,
            waker: worker.waker(),
            command_age_max: f64::from(device.command_age_max),
            has_kicker: device.bus == Bus::Board,
            monitor: monitor.clone(),
            tally: None,
        };
        Ok(BaseDriver {
            handle,
            _worker: worker,
            monitor,
        })
    }

    /// A handle to command it.
    pub fn handle(&self) -> BaseHandle {
        self.handle.clone()
    }

    /// Health of the base.
    pub fn health(&self) -> HealthReport {
        self.monitor.health(clock::now())
    }
}

impl BaseHandle {
    /// A handle whose commands are counted in `tally`.
    pub fn counting(&self, tally: &Arc<CommandTally>) -> Self {
        BaseHandle {
            tally: Some(Arc::clone(tally)),
            ..self.clone()
        }
    }

    /// Drives until the deadline (CLOCK_MONOTONIC), or for `command_age_max` from now if that is sooner.
    ///
    /// A command that is not finite stops the wheels and is an error.
    pub fn drive(&self, command: MotionCommand, deadline: Stamp) -> Result<(), HwError> {
        let now = clock::now();
        self.check_open()?;
        let finite = match command {
            MotionCommand::Twist(twist) => [twist.x, twist.y, twist.theta]
                .iter()
                .all(|part| part.is_finite()),
            MotionCommand::WheelSpeeds(speeds) => speeds.iter().all(|speed| speed.is_finite()),
        };
        if finite {
            let deadline = deadline.min(now + self.command_age_max);
            self.commands
                .lock()
                .set_drive(command, deadline, self.tally.clone());
        } else {
            self.commands.lock().halt(now);
        }
        self.waker.wake();
        if finite {
            return Ok(());
        }
        let reason =
            format!("invalid speed: {command:?} (expected finite numbers). The wheels stop");
        Err(self.rejection(reason))
    }

    /// Kicks once; the kick is discarded if it cannot be sent before the deadline.
    pub fn kick(&self, kick: Kick, deadline: Stamp) -> Result<(), HwError> {
        self.check_open()?;
        if !self.has_kicker {
            return Err(self.rejection("a base of VESCs has no kicker".to_owned()));
        }
        if !(0.0..=KICK_SPEED_MAX).contains(&kick.speed) {
            let speed = kick.speed;
            let reason =
                format!("invalid kick speed: {speed} m/s (expected 0 to {KICK_SPEED_MAX})");
            return Err(self.rejection(reason));
        }
        self.commands
            .lock()
            .set_kick(kick, deadline, self.tally.clone());
        self.waker.wake();
        Ok(())
    }

    /// Sets the speeds of the left and right dribbling wheel (rad/s, positive pulls the ball in) until the deadline, or
    /// for `command_age_max` from now if that is sooner.
    pub fn dribble(&self, speeds: [f32; 2], deadline: Stamp) -> Result<(), HwError> {
        self.check_open()?;
        if !self.has_kicker {
            return Err(self.rejection("a base of VESCs has no dribbling wheels".to_owned()));
        }
        if !speeds.iter().all(|speed| speed.abs() <= DRIBBLE_SPEED_MAX) {
            let reason =
                format!("invalid speeds: {speeds:?} rad/s (expected at most {DRIBBLE_SPEED_MAX})");
            return Err(self.rejection(reason));
        }
        let deadline = deadline.min(clock::now() + self.command_age_max);
        self.commands.lock().set_dribble(speeds, deadline);
        self.waker.wake();
        Ok(())
    }

    /// Why the wheels do not follow commands now: a pressed emergency stop, or a base that is not connected or stalled.
    pub fn obstacle(&self) -> Option<String> {
        let health = self.monitor.health(clock::now());
        match health.state {
            HealthState::Running | HealthState::Clock => self
                .commands
                .lock()
                .emergency_stop
                .then(|| "the emergency stop is pressed".to_owned()),
            _ => Some(health.reason.map_or_else(
                || "the base does not deliver".to_owned(),
                |reason| format!("no usable base: {reason}"),
            )),
        }
    }

    /// Stops the wheels and waits until the bus has carried the stop; false if that took longer than `timeout`.
    pub fn halt(&self, timeout: Duration) -> bool {
        let mut buffer = self.commands.lock();
        let stops_before = buffer.stops_sent;
        buffer.halt(clock::now());
        self.waker.wake();
        let waiting = |buffer: &mut CommandBuffer| buffer.stops_sent == stops_before;
        let (buffer, result) = self
            .commands
            .stop_sent
            .wait_timeout_while(buffer, timeout, waiting)
            .unwrap_or_else(PoisonError::into_inner);
        drop(buffer);
        !result.timed_out()
    }

    /// Stops the wheels as [`BaseHandle::halt`] does, and accepts no more commands.
    pub fn close(&self, timeout: Duration) -> bool {
        self.commands.lock().closed = true;
        self.halt(timeout)
    }

    fn check_open(&self) -> Result<(), HwError> {
        if self.commands.lock().closed {
            return Err(
                self.rejection("the base is closed and accepts no more commands".to_owned())
            );
        }
        Ok(())
    }

    fn rejection(&self, reason: String) -> HwError {
        let device = "base".to_owned();
        HwError::Unsupported { device, reason }
    }
}
