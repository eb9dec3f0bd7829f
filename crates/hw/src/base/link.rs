//! How is an order said on each bus, and what do the answers mean? Base board, VESC over UART, CAN and slcan.

use std::os::fd::{AsFd, BorrowedFd};

use localize::Stamp;
use localize::sample::{Compass, Imu};

use super::{Kick, KickerReport, PowerReport, SwitchReport};
use crate::can_socket::CanSocket;
use crate::config::{BaseDevice, Bus};
use crate::device_clock::DeviceClock;
use crate::error::HwError;
use crate::serial::Serial;
use crate::wire::board::{self, Message, Packet};
use crate::wire::vesc::Request;
use crate::wire::vesc_can::{Order, Status};
use crate::wire::{Stream, Tally, slcan, vesc};

/// Longest time to wait until an order is written, seconds: half a cycle of commands.
const WRITE_TIME: f64 = 0.005;
/// Longest time for which a board is told to hold a command, seconds.
const VALID_MAX: f64 = 0.1;
/// Ticks of a VESC's tachometer in one electrical revolution.
const TICKS_PER_ELECTRICAL_TURN: f32 = 6.0;
/// Frames taken from a CAN socket at once.
const FRAMES_AT_ONCE: usize = 64;

/// Speeds for the wheels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Wheels {
    /// Speed of each wheel (rad/s, as its motor turns) for so many seconds, and the robot's velocity that they make.
    Turn([f32; 4], localize::omni::Twist, f64),
    /// Speed zero, held.
    Brake,
    /// No current.
    Release,
}

/// What the base says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Said {
    /// Counters of all wheels.
    Counts([u32; 4], Stamp),
    /// Counter of one wheel.
    Count(usize, u32, Stamp),
    Power(PowerReport),
    Kicker(KickerReport),
    Switches(SwitchReport),
    Imu(Imu),
    Compass(Compass),
}

enum Port {
    Board(Serial, Stream<Packet>),
    Uart(Serial, Stream<vesc::Reply>),
    Can(CanSocket),
    Slcan(Serial, Stream<slcan::Line>),
}

/// An open line to the base.
pub(super) struct Link {
    port: Port,
    device: BaseDevice,
    wheels: usize,
    /// Electrical revolutions per minute at a wheel speed of 1 rad/s.
    erpm_per_speed: f32,
    sequence: u16,
    clock: DeviceClock,
    /// Which controller is asked next (UART).
    asked: usize,
    power: PowerReport,
    /// Frames of the CAN bus that came from another node or say something else.
    foreign: u64,
}

impl Link {
    /// Opens the bus for so many wheels.
    pub(super) fn open(
        device: &BaseDevice,
        wheels: usize,
        ticks_per_turn: f32,
    ) -> Result<Self, HwError> {
        let serial = || Serial::open(&device.port, device.baud);
        let port = match device.bus {
            Bus::Board => Port::Board(serial()?, board::stream()),
            Bus::VescUart => Port::Uart(serial()?, vesc::stream()),
            Bus::VescCan => Port::Can(CanSocket::open(&device.port)?),
            Bus::VescSlcan => {
                let serial = serial()?;
                let Some(lines) = slcan::open(device.can_bit_rate) else {
                    let reason = format!("{} bit/s is no rate of slcan", device.can_bit_rate);
                    let key = "base.can_bit_rate";
                    return Err(HwError::Config { key, reason });
                };
                serial.write(&lines, crate::clock::now() + 0.1)?;
                Port::Slcan(serial, slcan::stream())
            }
        };
        Ok(Link {
            port,
            device: device.clone(),
            wheels,
            erpm_per_speed: 60.0 / std::f32::consts::TAU * ticks_per_turn
                / TICKS_PER_ELECTRICAL_TURN,
            sequence: 0,
            clock: DeviceClock::default(),
            asked: 0,
            power: PowerReport::default(),
            foreign: 0,
        })
    }

    /// By how much the board's clock stepped since this was last asked, seconds.
    pub(super) fn take_clock_step(&mut self) -> Option<f64> {
        self.clock.take_step()
    }

    /// What can be waited for.
    pub(super) fn fd(&self) -> BorrowedFd<'_> {
        match &self.port {
            Port::Board(serial, _) | Port::Uart(serial, _) | Port::Slcan(serial, _) => {
                serial.as_fd()
            }
            Port::Can(socket) => socket.as_fd(),
        }
    }

    /// Bytes without a message since the bus was opened.
    pub(super) fn tally(&self) -> Tally {
        match &self.port {
            Port::Board(_, stream) => stream.tally(),
            Port::Uart(_, stream) => stream.tally(),
            Port::Slcan(_, stream) => stream.tally(),
            Port::Can(_) => Tally {
                garbage_bytes: self.foreign,
                ..Tally::default()
            },
        }
    }

    /// Tells the wheels; on a UART one controller in turn is asked how it is, too.
    pub(super) fn send(&mut self, wheels: Wheels, now: Stamp) -> Result<(), HwError> {
        let deadline = now + WRITE_TIME;
        if matches!(self.port, Port::Board(..)) {
            return self.send_board(
                board_order(wheels, self.wheels, self.device.send_twist),
                deadline,
            );
        }
        let speed = |wheel: usize| match wheels {
            Wheels::Turn(speeds, ..) => (speeds[wheel] * self.erpm_per_speed) as i32,
            Wheels::Brake | Wheels::Release => 0,
        };
        let release = wheels == Wheels::Release;
        let mut bytes = Vec::new();
        for (wheel, node) in self.device.nodes.iter().enumerate() {
            let (request, order) = if release {
                (Request::SetCurrentMa(0), Order::SetCurrentMa(0))
            } else {
                let erpm = speed(wheel);
                (Request::SetRpm(erpm), Order::SetRpm(erpm))
            };
            match &self.port {
                Port::Uart(..) => bytes.extend(self.for_node(request, *node)),
                Port::Can(socket) => socket.write(&order.encode(*node))?,
                Port::Slcan(..) => slcan::encode(&order.encode(*node), &mut bytes),
                Port::Board(..) => {}
            }
        }
        if matches!(self.port, Port::Uart(..)) {
            self.asked = (self.asked + 1) % self.device.nodes.len().max(1);
            if let Some(node) = self.device.nodes.get(self.asked) {
                bytes.extend(self.for_node(Request::GetValues, *node));
            }
        }
        match &self.port {
            Port::Uart(serial, _) | Port::Slcan(serial, _) => serial.write(&bytes, deadline),
            Port::Board(..) | Port::Can(_) => Ok(()),
        }
    }

    /// Kicks; only a board can.
    pub(super) fn kick(&mut self, kick: Kick, left: f64, now: Stamp) -> Result<(), HwError> {
        let message = board::KickCommand {
            valid_ms: milliseconds(left),
            speed_mm: (kick.speed * 1000.0) as u16,
            lofted: kick.lofted.into(),
            reserved: 0,
        };
        self.send_board(message.into(), now + WRITE_TIME)
    }

    /// Turns the dribbling wheels; only a board can.
    pub(super) fn dribble(
        &mut self,
        speeds: [f32; 2],
        left: f64,
        now: Stamp,
    ) -> Result<(), HwError> {
        let message = board::DribbleCommand {
            valid_ms: milliseconds(left),
            left_drad: (speeds[0] * 10.0) as i16,
            right_drad: (speeds[1] * 10.0) as i16,
        };
        self.send_board(message.into(), now + WRITE_TIME)
    }

    fn for_node(&self, request: Request, node: u8) -> Vec<u8> {
        if node == self.device.uart_node {
            request.encode()
        } else {
            request.encode_forwarded(node)
        }
    }

    fn send_board(&mut self, message: Message, deadline: Stamp) -> Result<(), HwError> {
        let Port::Board(serial, _) = &self.port else {
            return Ok(());
        };
        let sequence = self.sequence;
        self.sequence = sequence.wrapping_add(1);
        serial.write(&Packet { sequence, message }.encode(), deadline)
    }

    /// Takes what has arrived and appends what it means.
    pub(super) fn receive(&mut self, now: Stamp, said: &mut Vec<Said>) -> Result<(), HwError> {
        let mut buffer = [0; 4096];
        match &mut self.port {
            Port::Board(serial, stream) => {
                let bytes = serial.read(&mut buffer, now)?;
                stream.extend(&buffer[..bytes]);
                for packet in stream {
                    let message = board_said(packet.message, &mut self.clock, &self.device, now);
                    said.extend(message);
                }
            }
            Port::Uart(serial, stream) => {
                let bytes = serial.read(&mut buffer, now)?;
                stream.extend(&buffer[..bytes]);
                for reply in stream {
                    let vesc::Reply::Values(values) = reply else {
                        continue;
                    };
                    let Some(wheel) = wheel_of(&self.device.nodes, values.node) else {
                        continue;
                    };
                    self.power.stamp = now;
                    self.power.battery = f32::from(values.voltage_dv) * 0.1;
                    self.power.current[wheel] = values.motor_current_ca as f32 * 0.01;
                    self.power.heat(wheel, values.temperature_ddeg);
                    self.power.fault[wheel] = values.fault;
                    said.push(Said::Count(wheel, values.tachometer as u32, now));
                    said.extend((wheel == 0).then_some(Said::Power(self.power)));
                }
            }
            Port::Can(socket) => {
                let mut frames = Vec::new();
                while let Some(frame) = socket.read(now)? {
                    frames.push(frame);
                    if frames.len() == FRAMES_AT_ONCE {
                        break;
                    }
                }
                self.statuses(&frames, now, said);
            }
            Port::Slcan(serial, stream) => {
                let bytes = serial.read(&mut buffer, now)?;
                stream.extend(&buffer[..bytes]);
                let frames: Vec<_> = stream
                    .filter_map(|line| match line {
                        slcan::Line::Frame(frame) => Some(frame),
                        _ => None,
                    })
                    .collect();
                self.statuses(&frames, now, said);
            }
        }
        Ok(())
    }

    fn statuses(&mut self, frames: &[crate::wire::CanFrame], now: Stamp, said: &mut Vec<Said>) {
        for frame in frames {
            let status = Status::decode(frame)
                .and_then(|(node, status)| Some((wheel_of(&self.device.nodes, node)?, status)));
            let Some((wheel, status)) = status else {
                self.foreign += 1;
                continue;
            };
            self.power.stamp = now;
            match status {
                Status::Motion { current_da, .. } => {
                    self.power.current[wheel] = f32::from(current_da) * 0.1;
                }
                Status::Heat { temperature_ddeg } => self.power.heat(wheel, temperature_ddeg),
                Status::Position {
                    tachometer,
                    voltage_dv,
                } => {
                    self.power.battery = f32::from(voltage_dv) * 0.1;
                    said.push(Said::Count(wheel, tachometer as u32, now));
                    said.extend((wheel == 0).then_some(Said::Power(self.power)));
                }
            }
        }
    }
}

fn wheel_of(nodes: &[u8], node: u8) -> Option<usize> {
    nodes.iter().position(|own| *own == node)
}

fn milliseconds(seconds: f64) -> u16 {
    (seconds.min(VALID_MAX) * 1000.0).ceil() as u16
}

/// The board's command; stopped wheels are told zero, and what zero means (hold, let go) is the board's to know.
fn board_order(wheels: Wheels, count: usize, send_twist: bool) -> Message {
    let (speeds, twist, left) = match wheels {
        Wheels::Turn(speeds, twist, left) => (speeds, twist, left),
        Wheels::Brake | Wheels::Release => Default::default(),
    };
    let valid_ms = if left > 0.0 {
        milliseconds(left)
    } else {
        milliseconds(VALID_MAX)
    };
    if send_twist {
        return Message::from(board::TwistCommand {
            valid_ms,
            forward_mm: (twist.x * 1000.0) as i16,
            left_mm: (twist.y * 1000.0) as i16,
            turn_mrad: (twist.theta * 1000.0) as i16,
        });
    }
    let mut speed_crad = [0; 4];
    for (wire, speed) in speed_crad.iter_mut().zip(speeds).take(count) {
        *wire = (speed * 100.0).round() as i16;
    }
    Message::from(board::WheelCommand {
        valid_ms,
        wheels: count as u8,
        reserved: 0,
        speed_crad,
    })
}

/// False if a value is the least or greatest that the wire can carry: broken sensors put it there.
fn is_measured(said: &board::Inertia) -> bool {
    let ends = [i16::MIN, i16::MAX];
    let mut values = said.acceleration_2mm.iter().chain(&said.rate_mrad);
    values.all(|value| !ends.contains(value))
}

fn board_said(
    message: Message,
    clock: &mut DeviceClock,
    device: &BaseDevice,
    now: Stamp,
) -> Option<Said> {
    Some(match message {
        Message::Encoders(said) => Said::Counts(said.count, clock.stamp(said.time_us, now)),
        Message::Power(said) => Said::Power(PowerReport {
            stamp: clock.stamp(said.time_us, now),
            battery: f32::from(said.battery_mv) * 1e-3,
            temperature_c: f32::from(said.temperature_ddeg) * 0.1,
            current: said.current_ca.map(|current| f32::from(current) * 0.01),
            fault: [0; 4],
        }),
        Message::Kicker(said) => Said::Kicker(KickerReport {
            stamp: clock.stamp(said.time_us, now),
            charge: f32::from(said.charge_dv) * 0.1,
            ready: said.flags & 1 != 0,
            charging: said.flags & 2 != 0,
            broken: said.flags & 4 != 0,
            ball: said.flags & 8 != 0,
            last_kick: said.last_kick,
        }),
        Message::Switches(said) => Said::Switches(SwitchReport {
            stamp: clock.stamp(said.time_us, now),
            bumpers: said.bumpers,
            emergency_stop: said.flags & 1 != 0,
            command_stale: said.flags & 2 != 0,
        }),
        Message::Inertia(said) if device.imu && is_measured(&said) => Said::Imu(Imu {
            stamp: clock.stamp(said.time_us, now),
            acceleration: said.acceleration_2mm.map(|value| f32::from(value) * 2e-3),
            rate: said.rate_mrad.map(|value| f32::from(value) * 1e-3),
        }),
        Message::Heading(said) if device.compass => Said::Compass(Compass {
            stamp: clock.stamp(said.time_us, now),
            heading: localize::frame::wrap_angle(
                f32::from(said.heading_dmrad) * 1e-4 + device.north_deg.to_radians(),
            ),
            magnetic_field: None,
        }),
        _ => return None,
    })
}
