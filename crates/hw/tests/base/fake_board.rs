//! A simulated base board behind a pseudo terminal, and the configuration of the base that drives it.

use hw::config::{BaseDeviceConfig, Bus};
use hw::wire::board::{Encoders, Message, Packet, WheelCommand};
use hw::wire::{StreamDecoder, board};

use crate::pseudo_terminal::PseudoSerialPort;

/// A device with three wheels, the third with a reversed motor.
pub(crate) fn device(bus: Bus, port: String) -> BaseDeviceConfig {
    BaseDeviceConfig {
        bus,
        port,
        baud: 115_200,
        can_bit_rate: 500_000,
        nodes: match bus {
            Bus::Board => Vec::new(),
            _ => vec![11, 12, 13],
        },
        uart_node: 11,
        reversed: vec![false, false, true],
        send_twist: false,
        rate_hz: 200.0,
        command_age_max: 0.1,
        brake_time: 0.05,
        stall: 0.3,
        imu: true,
        compass: true,
        north_deg: 0.0,
    }
}

/// A simulated base board.
pub(crate) struct FakeBoard {
    pub(crate) port: PseudoSerialPort,
    pub(crate) commands: StreamDecoder<Packet>,
    sequence: u16,
}

impl FakeBoard {
    pub(crate) fn new(port: PseudoSerialPort) -> Self {
        FakeBoard {
            port,
            commands: board::decoder(),
            sequence: 0,
        }
    }

    pub(crate) fn send(&mut self, message: impl Into<Message>) {
        self.sequence += 1;
        let packet = Packet {
            sequence: self.sequence,
            message: message.into(),
        };
        self.port.send(&packet.encode());
    }

    pub(crate) fn send_counts(&mut self, count: u32) {
        let time_us = (hw::now().0 / 1000) as u32;
        let count = [count, count, 0u32.wrapping_sub(count), 0];
        self.send(Encoders { time_us, count });
    }

    pub(crate) fn received_messages(&mut self) -> Vec<Message> {
        self.commands.extend(&self.port.read());
        self.commands
            .by_ref()
            .map(|packet| packet.message)
            .collect()
    }

    /// The wheel commands received since the last call.
    pub(crate) fn received_wheel_commands(&mut self) -> Vec<WheelCommand> {
        let messages = self.received_messages().into_iter();
        messages
            .filter_map(|message| match message {
                Message::WheelCommand(command) => Some(command),
                _ => None,
            })
            .collect()
    }
}

pub(crate) fn short_deadline() -> localize::Stamp {
    hw::now() + 0.08
}
