//! How are commands and reports encoded on each bus? Base board, VESC over UART, CAN and slcan.

use std::os::fd::{AsFd, BorrowedFd};

use localize::Stamp;
use localize::sample::{Compass, Imu};

use super::command_buffer::Kick;
use super::reports::{KickerReport, PowerReport, SwitchReport};
use crate::can_socket::CanSocket;
use crate::clock;
use crate::config::{BaseDeviceConfig, Bus, COMMAND_VALIDITY_MAX};
use crate::device_clock::{ClockFault, DeviceClock};
use crate::error::HwError;
use crate::serial_line::{SerialLine, transmission_time};
use crate::wire::board::{self, Message, Packet};
use crate::wire::vesc::Request;
use crate::wire::vesc_can::{Addressed, VescCommand, VescStatus};
use crate::wire::{DecoderStats, StreamDecoder, slcan, vesc};

/// Speed of a wheel that is certainly not zero, rad/s: a message resolves 0.01.
const SPEED_MOVING_MIN: f32 = 0.1;
/// Timeout of writing a command, seconds: half a period at 100 Hz.
const WRITE_TIMEOUT: f64 = 0.005;
/// Timeout of writing the commands that open an slcan adapter, seconds.
const ADAPTER_SETUP_TIMEOUT: f64 = 0.1;
/// More frames than the buffer of a CAN socket holds.
const CAN_FRAMES_DISCARDED_MAX: usize = 10_000;
/// Most frames read from a CAN socket at once.
const CAN_FRAMES_PER_READ: usize = 64;

/// Command for the motors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum MotorCommand {
    /// Turn at these speeds.
    Speeds {
        /// Speed of each wheel's motor, rad/s, the sign that of the motor's direction.
        motor_speeds: [f32; 4],
        /// The robot's velocity at these speeds.
        twist: localize::omni::Twist,
        /// Remaining validity, seconds.
        valid_for: f64,
    },
    /// Hold speed zero.
    Brake,
    /// No current.
    Release,
}

impl MotorCommand {
    /// True if a board cannot take it for a command of speed zero.
    pub(super) fn moves(self) -> bool {
        match self {
            MotorCommand::Speeds { motor_speeds, .. } => motor_speeds
                .iter()
                .any(|speed| speed.abs() > SPEED_MOVING_MIN),
            MotorCommand::Brake | MotorCommand::Release => false,
        }
    }
}

/// A message of the base.
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
    Board(SerialLine, StreamDecoder<Packet>),
    Uart(SerialLine, StreamDecoder<vesc::Reply>),
    Can(CanSocket),
    Slcan(SerialLine, StreamDecoder<slcan::SlcanMessage>),
}

/// An open bus to the base.
pub(super) struct BaseLink {
    transport: Transport,
    device: BaseDeviceConfig,
    wheel_count: usize,
    /// Electrical revolutions per minute at a wheel speed of 1 rad/s.
    erpm_per_rad_s: f32,
    sequence: u16,
    clock: DeviceClock,
    /// Wheel whose controller was polled last (UART).
    polled_wheel: usize,
    power: PowerReport,
    /// CAN frames of other nodes or of unknown content.
    foreign_frames: u64,
}

impl BaseLink {
    /// Opens the bus of a base with `wheel_count` wheels.
    pub(super) fn open(
        device: &BaseDeviceConfig,
        wheel_count: usize,
        ticks_per_turn: f32,
    ) -> Result<Self, HwError> {
        let serial = || SerialLine::open(&device.port, device.baud);
        let transport = match device.bus {
            Bus::Board => Transport::Board(serial()?, board::decoder()),
            Bus::VescUart => Transport::Uart(serial()?, vesc::decoder()),
            Bus::VescCan => Transport::Can(CanSocket::open(&device.port)?),
            Bus::VescSlcan => {
                let mut serial = serial()?;
                let Some(commands) = slcan::open_channel_commands(device.can_bit_rate) else {
                    let reason = format!(
                        "invalid slcan bit rate: {} bit/s (expected 10, 20, 50, 100, 125, 250, 500, 800 or 1000 kbit/s)",
                        device.can_bit_rate
                    );
                    let key = "base.can_bit_rate";
                    return Err(HwError::Config { key, reason });
                };
                serial.write(&commands, clock::now() + ADAPTER_SETUP_TIMEOUT)?;
                Transport::Slcan(serial, slcan::decoder())
            }
        };
        Ok(BaseLink {
            transport,
            device: device.clone(),
            wheel_count,
            erpm_per_rad_s: vesc::erpm_per_rad_s(ticks_per_turn),
            sequence: 0,
            clock: DeviceClock::default(),
            polled_wheel: 0,
            power: PowerReport::default(),
            foreign_frames: 0,
        })
    }

    /// How the board's clock differs from ours, while its messages are stamped on arrival.
    pub(super) fn clock_fault(&self, now: Stamp) -> Option<ClockFault> {
        self.clock.fault(now)
    }

    /// The file descriptor to poll for input.
    pub(super) fn fd(&self) -> BorrowedFd<'_> {
        match &self.transport {
            Transport::Board(line, _) => line.as_fd(),
            Transport::Uart(line, _) => line.as_fd(),
            Transport::Slcan(line, _) => line.as_fd(),
            Transport::Can(socket) => socket.as_fd(),
        }
    }

    /// Decoder counts since the bus was opened; foreign CAN frames count as garbage.
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

    /// Sends a command to all motors; on a UART it also polls one controller, in turn.
    pub(super) fn send_motor_command(
        &mut self,
        command: MotorCommand,
        now: Stamp,
    ) -> Result<(), HwError> {
        let deadline = now + WRITE_TIMEOUT;
        if matches!(self.transport, Transport::Board(..)) {
            let message = board_command(command, self.wheel_count, self.device.send_twist);
            return self.send_board(message, deadline);
        }
        let requests = vesc_requests(command, &self.device.nodes, self.erpm_per_rad_s);
        let mut bytes = Vec::new();
        for (node, (request, vesc_command)) in self.device.nodes.iter().zip(requests) {
            match &self.transport {
                Transport::Uart(..) => {
                    bytes.extend(encode_for_node(request, *node, self.device.uart_node))
                }
                Transport::Can(socket) => socket.write(&vesc_command.encode(*node))?,
                Transport::Slcan(..) => slcan::encode(&vesc_command.encode(*node), &mut bytes),
                Transport::Board(..) => {}
            }
        }
        if matches!(self.transport, Transport::Uart(..)) {
            self.polled_wheel = (self.polled_wheel + 1) % self.device.nodes.len().max(1);
            if let Some(node) = self.device.nodes.get(self.polled_wheel) {
                bytes.extend(encode_for_node(
                    Request::GetValues,
                    *node,
                    self.device.uart_node,
                ));
            }
        }
        match &mut self.transport {
            Transport::Uart(line, _) | Transport::Slcan(line, _) => line.write(&bytes, deadline),
            Transport::Board(..) | Transport::Can(_) => Ok(()),
        }
    }

    /// True if the device has everything that was sent: a further command does not wait behind others. The frames of a CAN
    /// socket count as received.
    pub(super) fn is_idle(&self, now: Stamp) -> bool {
        self.line().is_none_or(|line| line.is_idle(now))
    }

    /// By the baud rate, the line has carried everything at this time; now, if it is not a serial line.
    pub(super) fn carried_at(&self, now: Stamp) -> Stamp {
        self.line().map_or(now, SerialLine::carried_at)
    }

    /// When a command for all motors arrives that is sent now.
    pub(super) fn command_arrival(&self, now: Stamp) -> Stamp {
        let bytes = command_bytes(&self.device, self.wheel_count);
        self.line().map_or(now, |line| line.arrival(bytes, now))
    }

    /// Discards the commands that wait in this computer, and ends the message of which the device may have got a part. False if
    /// none wait.
    pub(super) fn discard_output(&mut self, now: Stamp) -> Result<bool, HwError> {
        let (line, end): (_, &[u8]) = match &mut self.transport {
            Transport::Board(line, _) => (line, &[0]),
            Transport::Slcan(line, _) => (line, b"\r"),
            // A controller searches the next packet after one that fails its checksum.
            Transport::Uart(line, _) => (line, &[]),
            Transport::Can(_) => return Ok(false),
        };
        let waits = line.port().unsent_bytes() > 0;
        if waits {
            line.discard_output()?;
            line.write(end, now + WRITE_TIMEOUT)?;
        }
        Ok(waits)
    }

    fn line(&self) -> Option<&SerialLine> {
        match &self.transport {
            Transport::Board(line, _) => Some(line),
            Transport::Uart(line, _) => Some(line),
            Transport::Slcan(line, _) => Some(line),
            Transport::Can(_) => None,
        }
    }

    /// Sends a kick, valid for `valid_for` seconds; does nothing on other buses than the board's.
    ///
    /// Returns the sequence number of its message, by which the board reports it.
    pub(super) fn kick(&mut self, kick: Kick, valid_for: f64, now: Stamp) -> Result<u16, HwError> {
        let sequence = self.sequence;
        let message = board::KickCommand {
            valid_ms: validity_ms(valid_for),
            speed_mm: (kick.speed * 1000.0) as u16,
            lofted: kick.lofted.into(),
            reserved: 0,
        };
        self.send_board(message.into(), now + WRITE_TIMEOUT)?;
        Ok(sequence)
    }

    /// Sends speeds of the dribbling wheels, valid for `valid_for` seconds; does nothing on other buses than the board's.
    pub(super) fn dribble(
        &mut self,
        speeds: [f32; 2],
        valid_for: f64,
        now: Stamp,
    ) -> Result<(), HwError> {
        let message = board::DribbleCommand {
            valid_ms: validity_ms(valid_for),
            left_drad: (speeds[0] * 10.0) as i16,
            right_drad: (speeds[1] * 10.0) as i16,
        };
        self.send_board(message.into(), now + WRITE_TIMEOUT)
    }

    fn send_board(&mut self, message: Message, deadline: Stamp) -> Result<(), HwError> {
        let Transport::Board(line, _) = &mut self.transport else {
            return Ok(());
        };
        let sequence = self.sequence;
        self.sequence = sequence.wrapping_add(1);
        line.write(&Packet { sequence, message }.encode(), deadline)
    }

    /// Discards the input that has arrived, because its age is unknown.
    pub(super) fn discard_input(&mut self) -> Result<(), HwError> {
        match &mut self.transport {
            Transport::Board(line, stream) => line.port().discard_input().map(|()| stream.reset()),
            Transport::Uart(line, stream) => line.port().discard_input().map(|()| stream.reset()),
            Transport::Slcan(line, stream) => line.port().discard_input().map(|()| stream.reset()),
            Transport::Can(socket) => {
                let now = clock::now();
                for _ in 0..CAN_FRAMES_DISCARDED_MAX {
                    if socket.read(now)?.is_none() {
                        break;
                    }
                }
                Ok(())
            }
        }
    }

    /// Reads the input that has arrived and appends its messages to `reports`.
    pub(super) fn receive(
        &mut self,
        now: Stamp,
        reports: &mut Vec<BaseReport>,
    ) -> Result<(), HwError> {
        let mut buffer = [0; 4096];
        match &mut self.transport {
            Transport::Board(line, stream) => {
                let bytes = line.port().read(&mut buffer, now)?;
                stream.extend(&buffer[..bytes]);
                for packet in stream {
                    let message =
                        decode_board_message(packet.message, &mut self.clock, &self.device, now);
                    reports.extend(message);
                }
            }
            Transport::Uart(line, stream) => {
                let bytes = line.port().read(&mut buffer, now)?;
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
                    reports.push(BaseReport::WheelCount(wheel, values.tachometer as u32, now));
                    reports.extend((wheel == 0).then_some(BaseReport::Power(self.power)));
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
                self.process_can_status(&frames, now, reports);
            }
            Transport::Slcan(line, stream) => {
                let bytes = line.port().read(&mut buffer, now)?;
                stream.extend(&buffer[..bytes]);
                let frames: Vec<_> = stream
                    .filter_map(|message| match message {
                        slcan::SlcanMessage::Frame(frame) => Some(frame),
                        _ => None,
                    })
                    .collect();
                self.process_can_status(&frames, now, reports);
            }
        }
        Ok(())
    }

    fn process_can_status(
        &mut self,
        frames: &[crate::wire::CanFrame],
        now: Stamp,
        reports: &mut Vec<BaseReport>,
    ) {
        for frame in frames {
            let Some(Addressed { node, message }) = VescStatus::decode(frame) else {
                self.foreign_frames += 1;
                continue;
            };
            let Some(wheel) = wheel_index(&self.device.nodes, node) else {
                self.foreign_frames += 1;
                continue;
            };
            self.power.stamp = now;
            match message {
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
                    reports.push(BaseReport::WheelCount(wheel, tachometer as u32, now));
                    reports.extend((wheel == 0).then_some(BaseReport::Power(self.power)));
                }
            }
        }
    }
}

/// The request to each controller, for a serial line and for a CAN bus.
fn vesc_requests(
    command: MotorCommand,
    nodes: &[u8],
    erpm_per_rad_s: f32,
) -> Vec<(Request, VescCommand)> {
    let request = |wheel: usize| match command {
        MotorCommand::Release => (Request::SetCurrentMa(0), VescCommand::SetCurrentMa(0)),
        MotorCommand::Brake => (Request::SetRpm(0), VescCommand::SetRpm(0)),
        MotorCommand::Speeds { motor_speeds, .. } => {
            let erpm = (motor_speeds[wheel] * erpm_per_rad_s) as i32;
            (Request::SetRpm(erpm), VescCommand::SetRpm(erpm))
        }
    };
    (0..nodes.len()).map(request).collect()
}

/// Bytes on a serial line for one command to all motors.
fn command_bytes(device: &BaseDeviceConfig, wheel_count: usize) -> usize {
    let requests = || vesc_requests(MotorCommand::Brake, &device.nodes, 0.0).into_iter();
    match device.bus {
        Bus::Board => {
            let message = board_command(MotorCommand::Brake, wheel_count, device.send_twist);
            let sequence = 0;
            Packet { sequence, message }.encode().len()
        }
        Bus::VescUart => {
            let bytes =
                |request: Request, node| encode_for_node(request, node, device.uart_node).len();
            let drive = requests()
                .zip(&device.nodes)
                .map(|((request, _), node)| bytes(request, *node));
            let poll = device
                .nodes
                .iter()
                .map(|node| bytes(Request::GetValues, *node));
            drive.sum::<usize>() + poll.max().unwrap_or(0)
        }
        Bus::VescSlcan => {
            let mut bytes = Vec::new();
            for ((_, command), node) in requests().zip(&device.nodes) {
                slcan::encode(&command.encode(*node), &mut bytes);
            }
            bytes.len()
        }
        Bus::VescCan => 0,
    }
}

/// Commands for all motors that the line to a base carries in a second; `None` for a CAN interface.
pub(super) fn command_rate_max(device: &BaseDeviceConfig, wheel_count: usize) -> Option<f64> {
    let seconds = transmission_time(command_bytes(device, wheel_count), device.baud);
    (device.bus != Bus::VescCan).then_some(1.0 / seconds)
}

fn encode_for_node(request: Request, node: u8, uart_node: u8) -> Vec<u8> {
    if node == uart_node {
        request.encode()
    } else {
        request.encode_forwarded(node)
    }
}

fn wheel_index(nodes: &[u8], node: u8) -> Option<usize> {
    nodes.iter().position(|own| *own == node)
}

fn validity_ms(seconds: f64) -> u16 {
    (seconds.min(COMMAND_VALIDITY_MAX) * 1000.0).ceil() as u16
}

/// The board's message for a command. Brake and release are both speed zero: the board decides what zero means.
fn board_command(command: MotorCommand, wheel_count: usize, send_twist: bool) -> Message {
    let (speeds, twist, valid_for) = match command {
        MotorCommand::Speeds {
            motor_speeds,
            twist,
            valid_for,
        } => (motor_speeds, twist, valid_for),
        MotorCommand::Brake | MotorCommand::Release => Default::default(),
    };
    let valid_ms = if valid_for > 0.0 {
        validity_ms(valid_for)
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
    for (wire, speed) in speed_crad.iter_mut().zip(speeds).take(wheel_count) {
        *wire = (speed * 100.0).round() as i16;
    }
    Message::from(board::WheelCommand {
        valid_ms,
        wheels: wheel_count as u8,
        reserved: 0,
        speed_crad,
    })
}

/// False if a value is the smallest or largest of its type, as many broken sensors send it.
fn is_unsaturated(inertia: &board::Inertia) -> bool {
    let limits = [i16::MIN, i16::MAX];
    let mut values = inertia.acceleration_2mm.iter().chain(&inertia.rate_mrad);
    values.all(|value| !limits.contains(value))
}

fn decode_board_message(
    message: Message,
    clock: &mut DeviceClock,
    device: &BaseDeviceConfig,
    now: Stamp,
) -> Option<BaseReport> {
    Some(match message {
        Message::Encoders(encoders) => BaseReport::WheelCounts(
            encoders.count,
            clock.update_host_stamp(encoders.time_us, now),
        ),
        Message::Power(power) => BaseReport::Power(PowerReport {
            stamp: clock.update_host_stamp(power.time_us, now),
            battery_voltage: f32::from(power.battery_mv) * 1e-3,
            temperature_c: f32::from(power.temperature_ddeg) * 0.1,
            motor_current: power.current_ca.map(|current| f32::from(current) * 0.01),
            motor_fault: [0; 4],
        }),
        Message::Kicker(kicker) => BaseReport::Kicker(KickerReport {
            stamp: clock.update_host_stamp(kicker.time_us, now),
            capacitor_voltage: f32::from(kicker.charge_dv) * 0.1,
            ready: kicker.flags & 1 != 0,
            charging: kicker.flags & 2 != 0,
            charge_fault: kicker.flags & 4 != 0,
            ball_present: kicker.flags & 8 != 0,
            last_kick: kicker.last_kick,
        }),
        Message::Switches(switches) => BaseReport::Switches(SwitchReport {
            stamp: clock.update_host_stamp(switches.time_us, now),
            bumpers: switches.bumpers,
            emergency_stop: switches.flags & 1 != 0,
            command_stale: switches.flags & 2 != 0,
        }),
        Message::Inertia(inertia) if device.imu && is_unsaturated(&inertia) => {
            BaseReport::Imu(Imu {
                stamp: clock.update_host_stamp(inertia.time_us, now),
                specific_force: inertia
                    .acceleration_2mm
                    .map(|value| f32::from(value) * 2e-3),
                angular_velocity: inertia.rate_mrad.map(|value| f32::from(value) * 1e-3),
            })
        }
        Message::Heading(heading) if device.compass => BaseReport::Compass(Compass {
            stamp: clock.update_host_stamp(heading.time_us, now),
            heading: localize::frames::wrap_angle(
                f32::from(heading.heading_dmrad) * 1e-4 + device.north_deg.to_radians(),
            ),
            magnetic_field: None,
        }),
        _ => return None,
    })
}
