//! What do virtual VESCs do? One for each wheel: on a serial line with the others behind it, or on a CAN bus behind an adapter.

use hw::wire::vesc::{Request, RoutedRequest, Values, erpm_per_rad_s};
use hw::wire::vesc_can::{Addressed, VescCommand, VescStatus};
use hw::wire::{ParseStep, slcan};
use localize::Stamp;
use localize::omni::OmniKinematics;

use super::drive_command::DriveCommand;

/// Ids of the wheels' controllers; the first one is at the serial port.
pub(super) const NODES: [u8; 4] = [11, 12, 13, 14];
/// Without a command the controllers stop after so long, milliseconds: what `timeout` in their settings must be.
const TIMEOUT_MS: u16 = 100;

/// What a charged battery shows, 0.1 V, and cool transistors, 0.1 °C.
const BATTERY_DV: i16 = 252;
const TEMPERATURE_DDEG: i16 = 350;
/// First byte of a packet, and the bytes around its payload: start, length, checksum, stop.
const START: u8 = 2;
const PACKET_OVERHEAD_BYTES: usize = 5;

/// How the controllers are connected.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum VescBus {
    /// The first one's UART.
    Uart,
    /// A CAN bus behind an adapter, once its channel is open.
    Slcan { open: bool },
}

/// The controllers.
pub(super) struct VirtualVescs {
    omni: OmniKinematics,
    bus: VescBus,
    ticks_per_turn: f32,
    received: Vec<u8>,
    /// Commanded speed of each wheel, rad/s.
    speeds: [f32; 4],
    /// Tachometers, and the turns they stand for.
    counts: [i32; 4],
    wheel_angles: Vec<f64>,
    erpm: [i32; 4],
    last_report: Option<Stamp>,
    pub(super) drive_command: DriveCommand,
}

impl VirtualVescs {
    pub(super) fn new(omni: OmniKinematics, ticks_per_turn: f32, reach: VescBus) -> Self {
        VirtualVescs {
            omni,
            bus: reach,
            ticks_per_turn,
            received: Vec::new(),
            speeds: [0.0; 4],
            counts: [0; 4],
            wheel_angles: Vec::new(),
            erpm: [0; 4],
            last_report: None,
            drive_command: DriveCommand::default(),
        }
    }

    /// The port was unplugged or plugged in: partial messages are discarded, and an adapter's channel is closed.
    pub(super) fn on_reconnect(&mut self) {
        self.received.clear();
        self.drive_command.on_reconnect();
        if let VescBus::Slcan { open } = &mut self.bus {
            *open = false;
        }
    }

    /// Processes received bytes; returns the answers.
    pub(super) fn receive(&mut self, bytes: &[u8], now: Stamp) -> Vec<u8> {
        self.received.extend_from_slice(bytes);
        match self.bus {
            VescBus::Uart => self.receive_uart(now),
            VescBus::Slcan { .. } => self.receive_slcan(now),
        }
    }

    fn receive_uart(&mut self, now: Stamp) -> Vec<u8> {
        let mut answers = Vec::new();
        let received = std::mem::take(&mut self.received);
        let mut rest = received.as_slice();
        while let [first, more @ ..] = rest {
            if *first != START {
                rest = more;
                continue;
            }
            let length = more
                .first()
                .map(|length| usize::from(*length) + PACKET_OVERHEAD_BYTES);
            let Some(packet) = length.and_then(|length| rest.get(..length)) else {
                break;
            };
            let Some(RoutedRequest { node, request }) = Request::decode(packet) else {
                rest = more;
                continue;
            };
            rest = &rest[packet.len()..];
            let node = node.unwrap_or(NODES[0]);
            match request {
                Request::GetValues => answers.extend(self.encode_values(node)),
                Request::SetRpm(erpm) => self.set_wheel_speed(node, erpm, now),
                Request::SetCurrentMa(_) => self.set_wheel_speed(node, 0, now),
            }
        }
        self.received = rest.to_vec();
        answers
    }

    fn receive_slcan(&mut self, now: Stamp) -> Vec<u8> {
        let mut answers = Vec::new();
        while let Some(end) = self.received.iter().position(|byte| *byte == b'\r') {
            let line: Vec<u8> = self.received.drain(..=end).collect();
            let VescBus::Slcan { open } = &mut self.bus else {
                break;
            };
            match (line[0], slcan::parse(&line)) {
                (b'C', _) => *open = false,
                (b'O', _) => *open = true,
                (b'S' | b'\r', _) => {}
                (_, ParseStep::Message(_, slcan::SlcanMessage::Frame(frame))) if *open => {
                    if let Some(Addressed { node, message }) = VescCommand::decode(&frame) {
                        let erpm = match message {
                            VescCommand::SetRpm(erpm) => erpm,
                            VescCommand::SetCurrentMa(_) => 0,
                        };
                        self.set_wheel_speed(node, erpm, now);
                    }
                    // An extended frame went out (LAWICEL, CANUSB manual).
                    answers.push(b'Z');
                }
                _ => {
                    answers.push(7);
                    continue;
                }
            }
            answers.push(b'\r');
        }
        answers
    }

    /// Sets a wheel's speed. The command of the last wheel completes a round.
    fn set_wheel_speed(&mut self, node: u8, erpm: i32, now: Stamp) {
        let wheels = self.omni.wheel_count();
        let Some(wheel) = NODES[..wheels].iter().position(|own| *own == node) else {
            return;
        };
        self.speeds[wheel] = erpm as f32 / erpm_per_rad_s(self.ticks_per_turn);
        if wheel + 1 == wheels {
            let speeds = &self.speeds[..wheels];
            let (twist, _) = self.omni.twist(speeds);
            let drives = speeds.iter().any(|speed| *speed != 0.0);
            self.drive_command.set(twist, drives, TIMEOUT_MS, now);
        }
    }

    /// Follows the wheels, whose turns are radians since the start; what is said by itself (CAN).
    pub(super) fn encode_status(&mut self, turned: &[f64], offset: u32, stamp: Stamp) -> Vec<u8> {
        let elapsed = self.last_report.replace(stamp).map(|said| stamp - said);
        for (wheel, turned) in turned.iter().enumerate().take(self.omni.wheel_count()) {
            let ticks = turned / std::f64::consts::TAU * f64::from(self.ticks_per_turn);
            self.counts[wheel] = (ticks.floor() as i64 as u32).wrapping_add(offset) as i32;
            let before = self.wheel_angles.get(wheel).copied().unwrap_or(*turned);
            let speed = elapsed.map_or(0.0, |elapsed| (turned - before) / elapsed.max(1e-3));
            self.erpm[wheel] = (speed as f32 * erpm_per_rad_s(self.ticks_per_turn)) as i32;
        }
        self.wheel_angles = turned.to_vec();
        let mut lines = Vec::new();
        if self.bus != (VescBus::Slcan { open: true }) {
            return lines;
        }
        for (wheel, node) in NODES.into_iter().enumerate().take(self.omni.wheel_count()) {
            let motion = VescStatus::Motion {
                erpm: self.erpm[wheel],
                current_da: 0,
                duty_permille: 0,
            };
            let heat = VescStatus::Temperature {
                temperature_ddeg: TEMPERATURE_DDEG,
            };
            let position = VescStatus::Position {
                tachometer: self.counts[wheel],
                voltage_dv: BATTERY_DV,
            };
            for status in [motion, heat, position] {
                slcan::encode(&status.encode(node), &mut lines);
            }
        }
        lines
    }

    fn encode_values(&self, node: u8) -> Vec<u8> {
        let wheels = &NODES[..self.omni.wheel_count()];
        let Some(wheel) = wheels.iter().position(|own| *own == node) else {
            return Vec::new();
        };
        let values = Values {
            node,
            erpm: self.erpm[wheel],
            tachometer: self.counts[wheel],
            voltage_dv: BATTERY_DV,
            temperature_ddeg: TEMPERATURE_DDEG,
            ..Values::default()
        };
        values.encode()
    }
}
