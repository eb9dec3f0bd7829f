//! How is an order said on each bus, and what do the answers mean? Base board, VESC over UART, CAN and slcan.

use std::os::fd::{AsFd, BorrowedFd};

use localize::Stamp;
use localize::sample::{Compass, Imu};

use super::{Kick, KickerReport, PowerReport, SwitchReport};
use crate::can_socket::CanSocket;
use crate::config::{BaseDeviceConfig, Bus};
use crate::device_clock::DeviceClock;
use crate::error::HwError;
use crate::serial::SerialPort;
use crate::wire::board::{self, Message, Packet};
use crate::wire::vesc::Request;
use crate::wire::vesc_can::{VescCommand, VescStatus};
use crate::wire::{DecoderStats, StreamDecoder, slcan, vesc};

/// Longest time to wait until an order is written, seconds: half a cycle of commands.
const WRITE_TIMEOUT: f64 = 0.005;
/// Longest time for which a board is told to hold a command, seconds.
const COMMAND_VALIDITY_MAX: f64 = 0.1;
/// Ticks of a VESC's tachometer in one electrical revolution.
const TACHOMETER_STEPS_PER_REVOLUTION: f32 = 6.0;
/// Frames taken from a CAN socket at once.
const CAN_FRAMES_PER_READ: usize = 64;

/// Speeds for the wheels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum MotorCommand {
    /// Speed of each wheel (rad/s, as its motor turns) for so many seconds, and the robot's velocity that they make.
    Speeds([f32; 4], localize::omni::Twist, f64),
    /// Speed zero, held.
    Brake,
    /// No current.
    Release,
}

/// What the base says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum BaseReport {
    /// Counters of all wheels.
    WheelCounts([u32; 4], Stamp),
    /// Counter of one wheel.
    WheelCount(usize, u32, Stamp),
    Power(PowerReport),
    Kicker(KickerReport),
    Switches(SwitchReport),
    Imu(Imu),
    Compass(Compass),
}

enum Transport {
    Board(SerialPort, StreamDecoder<Packet>),
    Uart(SerialPort, StreamDecoder<vesc::Reply>),
    Can(CanSocket),
    Slcan(SerialPort, StreamDecoder<slcan::SlcanMessage>),
}

/// An open line to the base.
pub(super) struct BaseLink {
    transport: Transport,
    device: BaseDeviceConfig,
    wheel_count: usize,
    /// Electrical revolutions per minute at a wheel speed of 1 rad/s.
    erpm_per_rad_s: f32,
    sequence: u16,
    clock: DeviceClock,
    /// Which controller is asked next (UART).
    polled_wheel: usize,
    power: PowerReport,
    /// Frames of the CAN bus that came from another node or say something else.
    foreign_frames: u64,
}

impl BaseLink {
    /// Opens the bus for so many wheels.
    pub(super) fn open(
        device: &BaseDeviceConfig,
        wheels: usize,
        ticks_per_turn: f32,
    ) -> Result<Self, HwError> {
        let serial = || SerialPort::open(&device.port, device.baud);
        let port = match device.bus {
            Bus::Board => Transport::Board(serial()?, board::decoder()),
            Bus::VescUart => Transport::Uart(serial()?, vesc::decoder()),
            Bus::VescCan => Transport::Can(CanSocket::open(&device.port)?),
            Bus::VescSlcan => {
                let serial = serial()?;
                let Some(lines) = slcan::open_channel_commands(device.can_bit_rate) else {
                    let reason = format!("{} bit/s is no rate of slcan", device.can_bit_rate);
                    let key = "base.can_bit_rate";
                    return Err(HwError::Config { key, reason });
                };
                serial.write(&lines, crate::clock::now() + 0.1)?;
                Transport::Slcan(serial, slcan::decoder())
            }
        };
        Ok(BaseLink {
            transport: port,
            device: device.clone(),
            wheel_count: wheels,
            erpm_per_rad_s: 60.0 / std::f32::consts::TAU * ticks_per_turn
                / TACHOMETER_STEPS_PER_REVOLUTION,
            sequence: 0,
            clock: DeviceClock::default(),
            polled_wheel: 0,
            power: PowerReport::default(),
            foreign_frames: 0,
        })
    }

    /// By how much the board's clock stepped since this was last asked, seconds.
    pub(super) fn take_clock_step(&mut self) -> Option<f64> {
        self.clock.take_step()
    }

    /// What can be waited for.
    pub(super) fn fd(&self) -> BorrowedFd<'_> {
        match &self.transport {
            Transport::Board(serial, _)
            | Transport::Uart(serial, _)
            | Transport::Slcan(serial, _) => serial.as_fd(),
            Transport::Can(socket) => socket.as_fd(),
        }
    }

    /// Bytes without a message since the bus was opened.
    pub(super) fn stats(&self) -> DecoderStats {
        match &self.transport {
            Transport::Board(_, stream) => stream.stats(),
            Transport::Uart(_, stream) => stream.stats(),
            Transport::Slcan(_, stream) => stream.stats(),
            Transport::Can(_) => DecoderStats {
                garbage_bytes: self.foreign_frames,
                ..DecoderStats::default()
            },
        }
    }

    /// Tells the wheels; on a UART one controller in turn is asked how it is, too.
    pub(super) fn send_motor_command(
        &mut self,
        wheels: MotorCommand,
        now: Stamp,
    ) -> Result<(), HwError> {
        let deadline = now + WRITE_TIMEOUT;
        if matches!(self.transport, Transport::Board(..)) {
            return self.send_board(
                board_command(wheels, self.wheel_count, self.device.send_twist),
                deadline,
            );
        }
        let speed = |wheel: usize| match wheels {
            MotorCommand::Speeds(speeds, ..) => (speeds[wheel] * self.erpm_per_rad_s) as i32,
            MotorCommand::Brake | MotorCommand::Release => 0,
        };
        let release = wheels == MotorCommand::Release;
        let mut bytes = Vec::new();
        for (wheel, node) in self.device.nodes.iter().enumerate() {
            let (request, order) = if release {
                (Request::SetCurrentMa(0), VescCommand::SetCurrentMa(0))
            } else {
                let erpm = speed(wheel);
                (Request::SetRpm(erpm), VescCommand::SetRpm(erpm))
            };
            match &self.transport {
                Transport::Uart(..) => bytes.extend(self.encode_for_node(request, *node)),
                Transport::Can(socket) => socket.write(&order.encode(*node))?,
                Transport::Slcan(..) => slcan::encode(&order.encode(*node), &mut bytes),
                Transport::Board(..) => {}
            }
        }
        if matches!(self.transport, Transport::Uart(..)) {
            self.polled_wheel = (self.polled_wheel + 1) % self.device.nodes.len().max(1);
            if let Some(node) = self.device.nodes.get(self.polled_wheel) {
                bytes.extend(self.encode_for_node(Request::GetValues, *node));
            }
        }
        match &self.transport {
            Transport::Uart(serial, _) | Transport::Slcan(serial, _) => {
                serial.write(&bytes, deadline)
            }
            Transport::Board(..) | Transport::Can(_) => Ok(()),
        }
    }

    /// Kicks; only a board can.
    pub(super) fn kick(&mut self, kick: Kick, left: f64, now: Stamp) -> Result<(), HwError> {
        let message = board::KickCommand {
            valid_ms: validity_ms(left),
            speed_mm: (kick.speed * 1000.0) as u16,
            lofted: kick.lofted.into(),
            reserved: 0,
        };
        self.send_board(message.into(), now + WRITE_TIMEOUT)
    }

    /// Turns the dribbling wheels; only a board can.
    pub(super) fn dribble(
        &mut self,
        speeds: [f32; 2],
        left: f64,
        now: Stamp,
    ) -> Result<(), HwError> {
        let message = board::DribbleCommand {
            valid_ms: validity_ms(left),
            left_drad: (speeds[0] * 10.0) as i16,
            right_drad: (speeds[1] * 10.0) as i16,
        };
        self.send_board(message.into(), now + WRITE_TIMEOUT)
    }

    fn encode_for_node(&self, request: Request, node: u8) -> Vec<u8> {
        if node == self.device.uart_node {
            request.encode()
        } else {
            request.encode_forwarded(node)
        }
    }

    fn send_board(&mut self, message: Message, deadline: Stamp) -> Result<(), HwError> {
        let Transport::Board(serial, _) = &self.transport else {
            return Ok(());
        };
        let sequence = self.sequence;
        self.sequence = sequence.wrapping_add(1);
        serial.write(&Packet { sequence, message }.encode(), deadline)
    }

    /// Takes what has arrived and appends what it means.
    pub(super) fn receive(
        &mut self,
        now: Stamp,
        said: &mut Vec<BaseReport>,
    ) -> Result<(), HwError> {
        let mut buffer = [0; 4096];
        match &mut self.transport {
            Transport::Board(serial, stream) => {
                let bytes = serial.read(&mut buffer, now)?;
                stream.extend(&buffer[..bytes]);
                for packet in stream {
                    let message =
                        decode_board_message(packet.message, &mut self.clock, &self.device, now);
                    said.extend(message);
                }
            }
            Transport::Uart(serial, stream) => {
                let bytes = serial.read(&mut buffer, now)?;
                stream.extend(&buffer[..bytes]);
                for reply in stream {
                    let vesc::Reply::Values(values) = reply else {
                        continue;
                    };
                    let Some(wheel) = wheel_index(&self.device.nodes, values.node) else {
                        continue;
                    };
                    self.power.stamp = now;
                    self.power.battery_voltage = f32::from(values.voltage_dv) * 0.1;
                    self.power.motor_current[wheel] = values.motor_current_ca as f32 * 0.01;
                    self.power
                        .update_temperature(wheel, values.temperature_ddeg);
                    self.power.motor_fault[wheel] = values.fault;
                    said.push(BaseReport::WheelCount(wheel, values.tachometer as u32, now));
                    said.extend((wheel == 0).then_some(BaseReport::Power(self.power)));
                }
            }
            Transport::Can(socket) => {
                let mut frames = Vec::new();
                while let Some(frame) = socket.read(now)? {
                    frames.push(frame);
                    if frames.len() == CAN_FRAMES_PER_READ {
                        break;
                    }
                }
                self.process_can_status(&frames, now, said);
            }
            Transport::Slcan(serial, stream) => {
                let bytes = serial.read(&mut buffer, now)?;
                stream.extend(&buffer[..bytes]);
                let frames: Vec<_> = stream
                    .filter_map(|line| match line {
                        slcan::SlcanMessage::Frame(frame) => Some(frame),
                        _ => None,
                    })
                    .collect();
                self.process_can_status(&frames, now, said);
            }
        }
        Ok(())
    }

    fn process_can_status(
        &mut self,
        frames: &[crate::wire::CanFrame],
        now: Stamp,
        said: &mut Vec<BaseReport>,
    ) {
        for frame in frames {
            let status = VescStatus::decode(frame)
                .and_then(|(node, status)| Some((wheel_index(&self.device.nodes, node)?, status)));
            let Some((wheel, status)) = status else {
                self.foreign_frames += 1;
                continue;
            };
            self.power.stamp = now;
            match status {
                VescStatus::Motion { current_da, .. } => {
                    self.power.motor_current[wheel] = f32::from(current_da) * 0.1;
                }
                VescStatus::Temperature { temperature_ddeg } => {
                    self.power.update_temperature(wheel, temperature_ddeg)
                }
                VescStatus::Position {
                    tachometer,
                    voltage_dv,
                } => {
                    self.power.battery_voltage = f32::from(voltage_dv) * 0.1;
                    said.push(BaseReport::WheelCount(wheel, tachometer as u32, now));
                    said.extend((wheel == 0).then_some(BaseReport::Power(self.power)));
                }
            }
        }
    }
}

fn wheel_index(nodes: &[u8], node: u8) -> Option<usize> {
    nodes.iter().position(|own| *own == node)
}

fn validity_ms(seconds: f64) -> u16 {
    (seconds.min(COMMAND_VALIDITY_MAX) * 1000.0).ceil() as u16
}

/// The board's command; stopped wheels are told zero, and what zero means (hold, let go) is the board's to know.
fn board_command(wheels: MotorCommand, count: usize, send_twist: bool) -> Message {
    let (speeds, twist, left) = match wheels {
        MotorCommand::Speeds(speeds, twist, left) => (speeds, twist, left),
        MotorCommand::Brake | MotorCommand::Release => Default::default(),
    };
    let valid_ms = if left > 0.0 {
        validity_ms(left)
    } else {
        validity_ms(COMMAND_VALIDITY_MAX)
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
fn is_unsaturated(said: &board::Inertia) -> bool {
    let ends = [i16::MIN, i16::MAX];
    let mut values = said.acceleration_2mm.iter().chain(&said.rate_mrad);
    values.all(|value| !ends.contains(value))
}

fn decode_board_message(
    message: Message,
    clock: &mut DeviceClock,
    device: &BaseDeviceConfig,
    now: Stamp,
) -> Option<BaseReport> {
    Some(match message {
        Message::Encoders(said) => {
            BaseReport::WheelCounts(said.count, clock.to_host_stamp(said.time_us, now))
        }
        Message::Power(said) => BaseReport::Power(PowerReport {
            stamp: clock.to_host_stamp(said.time_us, now),
            battery_voltage: f32::from(said.battery_mv) * 1e-3,
            temperature_c: f32::from(said.temperature_ddeg) * 0.1,
            motor_current: said.current_ca.map(|current| f32::from(current) * 0.01),
            motor_fault: [0; 4],
        }),
        Message::Kicker(said) => BaseReport::Kicker(KickerReport {
            stamp: clock.to_host_stamp(said.time_us, now),
            capacitor_voltage: f32::from(said.charge_dv) * 0.1,
            ready: said.flags & 1 != 0,
            charging: said.flags & 2 != 0,
            charge_fault: said.flags & 4 != 0,
            ball_present: said.flags & 8 != 0,
            last_kick: said.last_kick,
        }),
        Message::Switches(said) => BaseReport::Switches(SwitchReport {
            stamp: clock.to_host_stamp(said.time_us, now),
            bumpers: said.bumpers,
            emergency_stop: said.flags & 1 != 0,
            command_stale: said.flags & 2 != 0,
        }),
        Message::Inertia(said) if device.imu && is_unsaturated(&said) => BaseReport::Imu(Imu {
            stamp: clock.to_host_stamp(said.time_us, now),
            acceleration: said.acceleration_2mm.map(|value| f32::from(value) * 2e-3),
            rate: said.rate_mrad.map(|value| f32::from(value) * 1e-3),
        }),
        Message::Heading(said) if device.compass => BaseReport::Compass(Compass {
            stamp: clock.to_host_stamp(said.time_us, now),
            heading: localize::frames::wrap_angle(
                f32::from(said.heading_dmrad) * 1e-4 + device.north_deg.to_radians(),
            ),
            magnetic_field: None,
        }),
        _ => return None,
    })
}
