//! What does the virtual base board do? It sends encoder counts and status, and drives only on a fresh command.

use hw::wire::StreamDecoder;
use hw::wire::board::{self, Encoders, Heading, Inertia, Kicker, Message, Packet, Power, Switches};
use localize::Stamp;
use localize::omni::{OmniKinematics, Twist};
use localize::sample::{Compass, Imu};

use super::drive_command::DriveCommand;

/// Time between reports of battery, kicker and switches, seconds.
const STATUS_PERIOD: f64 = 0.1;
/// Voltages of a charged battery and capacitor.
const BATTERY_MV: u16 = 25_200;
const CAPACITOR_DV: u16 = 2_400;

/// A kick that was commanded.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ReceivedKick {
    /// m/s.
    pub(super) speed: f32,
    pub(super) lofted: bool,
}

/// The board's firmware.
pub(super) struct VirtualBoard {
    omni: OmniKinematics,
    ticks_per_turn: f32,
    decoder: StreamDecoder<Packet>,
    sequence: u16,
    pub(super) drive_command: DriveCommand,
    last_kick: u16,
    pending_kick: Option<ReceivedKick>,
    /// Counts at the last restart.
    count_offset: [u32; 4],
    next_status: f64,
}

impl VirtualBoard {
    pub(super) fn new(omni: OmniKinematics, ticks_per_turn: f32) -> Self {
        VirtualBoard {
            omni,
            ticks_per_turn,
            decoder: board::decoder(),
            sequence: 0,
            drive_command: DriveCommand::default(),
            last_kick: 0,
            pending_kick: None,
            count_offset: [0; 4],
            next_status: 0.0,
        }
    }

    /// The port was unplugged or plugged in: partial messages are discarded.
    pub(super) fn on_reconnect(&mut self) {
        self.decoder.reset();
        self.drive_command.on_reconnect();
    }

    /// Takes the last kick, so that it is carried out once.
    pub(super) fn take_kick(&mut self) -> Option<ReceivedKick> {
        self.pending_kick.take()
    }

    /// Processes received bytes.
    pub(super) fn receive(&mut self, bytes: &[u8], now: Stamp) {
        self.decoder.extend(bytes);
        for packet in self.decoder.by_ref() {
            match packet.message {
                Message::WheelCommand(command) => {
                    let speeds = command.speed_crad.map(|speed| f32::from(speed) * 0.01);
                    if usize::from(command.wheels) == self.omni.wheel_count() {
                        let (twist, _) = self.omni.twist(&speeds[..self.omni.wheel_count()]);
                        let drives = command.speed_crad != [0; 4];
                        self.drive_command.set(twist, drives, command.valid_ms, now);
                    }
                }
                Message::TwistCommand(command) => {
                    let [x, y, theta] = [command.forward_mm, command.left_mm, command.turn_mrad]
                        .map(|value| f32::from(value) * 1e-3);
                    let twist = Twist { x, y, theta };
                    self.drive_command
                        .set(twist, twist != Twist::default(), command.valid_ms, now);
                }
                Message::KickCommand(kick) => {
                    self.last_kick = packet.sequence;
                    self.pending_kick = Some(ReceivedKick {
                        speed: f32::from(kick.speed_mm) * 1e-3,
                        lofted: kick.lofted != 0,
                    });
                    self.drive_command.stats.kicks += 1;
                }
                _ => {}
            }
        }
    }

    /// Message of the encoders, and of battery, kicker and switches when they are due.
    pub(super) fn encode_status(
        &mut self,
        time: f64,
        time_us: u32,
        wheel_angles: &[f64],
        offset: u32,
        restarted: bool,
    ) -> Vec<u8> {
        let mut count = [0; 4];
        for (count, wheel_angle) in count.iter_mut().zip(wheel_angles) {
            let ticks = wheel_angle / std::f64::consts::TAU * f64::from(self.ticks_per_turn);
            *count = (ticks.floor() as i64 as u32).wrapping_add(offset);
        }
        if restarted {
            self.count_offset = count;
        }
        for (count, zero) in count.iter_mut().zip(self.count_offset) {
            *count = count.wrapping_sub(zero);
        }
        let mut bytes = self.encode(Encoders { time_us, count });
        if time >= self.next_status {
            self.next_status = time + STATUS_PERIOD;
            bytes.extend(self.encode(Power {
                time_us,
                battery_mv: BATTERY_MV,
                temperature_ddeg: 350,
                current_ca: [0; 4],
            }));
            bytes.extend(self.encode(Kicker {
                time_us,
                charge_dv: CAPACITOR_DV,
                flags: 1,
                reserved: 0,
                last_kick: self.last_kick,
            }));
            bytes.extend(self.encode(Switches {
                time_us,
                bumpers: 0,
                flags: u8::from(self.drive_command.is_expired()) << 1,
            }));
        }
        bytes
    }

    /// Message of the IMU.
    pub(super) fn encode_imu(&mut self, imu: &Imu, time_us: u32) -> Vec<u8> {
        self.encode(Inertia {
            time_us,
            acceleration_2mm: imu
                .specific_force
                .map(|value| (value * 500.0).round() as i16),
            rate_mrad: imu
                .angular_velocity
                .map(|value| (value * 1000.0).round() as i16),
        })
    }

    /// Message of the compass.
    pub(super) fn encode_heading(&mut self, compass: &Compass, time_us: u32) -> Vec<u8> {
        self.encode(Heading {
            time_us,
            heading_dmrad: (compass.heading * 1e4).round() as i16,
        })
    }

    fn encode(&mut self, message: impl Into<Message>) -> Vec<u8> {
        self.sequence = self.sequence.wrapping_add(1);
        Packet {
            sequence: self.sequence,
            message: message.into(),
        }
        .encode()
    }
}
