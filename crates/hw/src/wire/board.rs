//! What do robot and base board exchange? The protocol of docs/wire.md; its C side is docs/mirrorball_base.h.
//!
//! A frame is COBS(payload ‖ CRC16 LE) 00. A payload is a fixed little-endian structure: version, type, a sequence number
//! per sender, the fields of the type. The messages here hold the transmitted integers, with units in the names.

use super::decoder::{DecodeError, ParseStep, StreamDecoder};
use super::{cobs, crc16};

/// Supported version of the protocol.
pub const VERSION: u8 = 1;
/// Bytes before the fields: version, type, sequence number.
const HEADER_BYTES: usize = 4;
/// Longest payload: COBS adds one byte to it, and every frame fits into a USB packet.
const PAYLOAD_MAX: usize = 60;
/// Longest frame without its closing zero: payload, checksum, one byte of COBS.
const FRAME_MAX: usize = PAYLOAD_MAX + 3;

/// A number or array with a little-endian encoding.
trait WireField: Sized {
    const BYTES: usize;
    fn write_le(&self, out: &mut Vec<u8>);
    /// `bytes` has at least `BYTES` bytes.
    fn read_le(bytes: &[u8]) -> Self;
}

macro_rules! number_fields {
    ($($number:ty),*) => {$(
        impl WireField for $number {
            const BYTES: usize = size_of::<$number>();
            fn write_le(&self, out: &mut Vec<u8>) {
                out.extend_from_slice(&self.to_le_bytes());
            }
            fn read_le(bytes: &[u8]) -> Self {
                let mut raw = [0; size_of::<$number>()];
                raw.copy_from_slice(&bytes[..size_of::<$number>()]);
                <$number>::from_le_bytes(raw)
            }
        }
    )*};
}
number_fields!(u8, u16, u32, i16);

impl<T: WireField, const N: usize> WireField for [T; N] {
    const BYTES: usize = N * T::BYTES;
    fn write_le(&self, out: &mut Vec<u8>) {
        for item in self {
            item.write_le(out);
        }
    }
    fn read_le(bytes: &[u8]) -> Self {
        std::array::from_fn(|index| T::read_le(&bytes[index * T::BYTES..]))
    }
}

/// Declares a structure per message, and the enumeration of all messages with its encoder and decoder.
macro_rules! messages {
    ($(
        $(#[$doc:meta])*
        $name:ident = $kind:literal { $( $(#[$field_doc:meta])* $field:ident : $type:ty, )* }
    )*) => {
        $(
            $(#[$doc])*
            #[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
            pub struct $name { $( $(#[$field_doc])* pub $field: $type, )* }

            impl From<$name> for Message {
                fn from(message: $name) -> Self {
                    Message::$name(message)
                }
            }
        )*

        /// Any message.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub enum Message { $( $(#[$doc])* $name($name), )* }

        impl Message {
            /// The type byte.
            pub fn type_byte(&self) -> u8 {
                match self { $( Message::$name(_) => $kind, )* }
            }

            fn write_fields(&self, out: &mut Vec<u8>) {
                match self { $( Message::$name(message) => { $( message.$field.write_le(out); )* } )* }
            }

            /// Decodes the fields of a type from exactly its number of bytes.
            fn read_fields(kind: u8, bytes: &[u8]) -> Result<Self, DecodeError> {
                match kind {
                    $( $kind => {
                        if bytes.len() != 0 $( + <$type>::BYTES )* {
                            return Err(DecodeError::Length);
                        }
                        let mut rest = bytes;
                        $( let $field = <$type>::read_le(rest); rest = &rest[<$type>::BYTES..]; )*
                        debug_assert!(rest.is_empty());
                        Ok(Message::$name($name { $( $field, )* }))
                    } )*
                    _ => Err(DecodeError::UnknownType(kind)),
                }
            }
        }
    };
}

messages! {
    /// Robot to board: speeds of the wheels.
    WheelCommand = 0x01 {
        /// Validity after arrival; then the board stops the wheels.
        valid_ms: u16,
        /// Number of wheels; a board with another number rejects the command.
        wheels: u8,
        /// Zero.
        reserved: u8,
        /// Speed of each wheel, 0.01 rad/s; equal positive speeds turn the robot counter-clockwise.
        speed_crad: [i16; 4],
    }
    /// Robot to board: velocity of the robot, for boards that know their wheel geometry.
    TwistCommand = 0x02 {
        /// As in `WheelCommand`.
        valid_ms: u16,
        /// Forward, mm/s.
        forward_mm: i16,
        /// To the left, mm/s.
        left_mm: i16,
        /// Counter-clockwise, mrad/s.
        turn_mrad: i16,
    }
    /// Robot to board: kick once.
    KickCommand = 0x03 {
        /// Time after arrival until which the kick may be carried out.
        valid_ms: u16,
        /// Speed of the ball, mm/s.
        speed_mm: u16,
        /// 0 along the ground, 1 lofted.
        lofted: u8,
        /// Zero.
        reserved: u8,
    }
    /// Robot to board: speeds of the dribbling wheels.
    DribbleCommand = 0x04 {
        /// As in `WheelCommand`.
        valid_ms: u16,
        /// Speed of the left wheel, 0.1 rad/s; positive pulls the ball in.
        left_drad: i16,
        /// Speed of the right wheel, 0.1 rad/s.
        right_drad: i16,
    }
    /// Board to robot: counters of the wheels, all read at the same time.
    Encoders = 0x81 {
        /// Clock of the board, wrapping.
        time_us: u32,
        /// Ticks of each wheel since power-on, wrapping at 2³²; a positive speed counts up.
        count: [u32; 4],
    }
    /// Board to robot: battery and motors.
    Power = 0x82 {
        /// Clock of the board, wrapping.
        time_us: u32,
        /// Battery, mV.
        battery_mv: u16,
        /// Hottest motor driver, 0.1 °C.
        temperature_ddeg: i16,
        /// Current of each motor, 0.01 A.
        current_ca: [i16; 4],
    }
    /// Board to robot: the kicker.
    Kicker = 0x83 {
        /// Clock of the board, wrapping.
        time_us: u32,
        /// Voltage of the capacitor, 0.1 V.
        charge_dv: u16,
        /// Bits: 0 ready, 1 charging, 2 broken, 3 ball in front of the kicker.
        flags: u8,
        /// Zero.
        reserved: u8,
        /// Sequence number of the last kick command that was carried out.
        last_kick: u16,
    }
    /// Board to robot: bumpers, and what stops the robot.
    Switches = 0x84 {
        /// Clock of the board, wrapping.
        time_us: u32,
        /// One bit per pressed bumper, counter-clockwise from the front.
        bumpers: u8,
        /// Bits: 0 emergency stop pressed, 1 wheels stopped because the last command expired.
        flags: u8,
    }
    /// Board to robot: the inertial unit, robot axes.
    Inertia = 0x85 {
        /// Clock of the board, wrapping.
        time_us: u32,
        /// Specific force along x, y, z, 2 mm/s².
        acceleration_2mm: [i16; 3],
        /// Angular rate about x, y, z, mrad/s.
        rate_mrad: [i16; 3],
    }
    /// Board to robot: the compass.
    Heading = 0x86 {
        /// Clock of the board, wrapping.
        time_us: u32,
        /// Direction of the robot's x axis, counter-clockwise from magnetic north, 0.1 mrad in ±π.
        heading_dmrad: i16,
    }
}

/// A message with its sequence number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Packet {
    /// Counter of the sender, wrapping.
    pub sequence: u16,
    /// The message.
    pub message: Message,
}

impl Packet {
    /// The frame, closing zero included.
    pub fn encode(&self) -> Vec<u8> {
        let mut payload = vec![VERSION, self.message.type_byte()];
        self.sequence.write_le(&mut payload);
        self.message.write_fields(&mut payload);
        let checksum = crc16(&payload);
        checksum.write_le(&mut payload);
        let mut frame = Vec::with_capacity(payload.len() + 2);
        cobs::encode(&payload, &mut frame);
        frame.push(0);
        frame
    }
}

/// A decoder, for either direction.
pub fn decoder() -> StreamDecoder<Packet> {
    StreamDecoder::new(parse)
}

/// Classifies the front of `bytes`.
pub fn parse(bytes: &[u8]) -> ParseStep<Packet> {
    let front = &bytes[..bytes.len().min(FRAME_MAX + 1)];
    let Some(length) = front.iter().position(|byte| *byte == 0) else {
        if front.len() <= FRAME_MAX {
            return ParseStep::Incomplete;
        }
        return ParseStep::Skip(front.len(), Some(DecodeError::Length));
    };
    if length == 0 {
        return ParseStep::Skip(1, None);
    }
    match decode_packet(&bytes[..length]) {
        Ok(packet) => ParseStep::Message(length + 1, packet),
        Err(fault) => ParseStep::Skip(length + 1, Some(fault)),
    }
}

fn decode_packet(frame: &[u8]) -> Result<Packet, DecodeError> {
    let mut buffer = [0; FRAME_MAX];
    // A frame that COBS cannot decode was damaged in transmission, like one with a wrong checksum.
    let length = cobs::decode(frame, &mut buffer).ok_or(DecodeError::Checksum)?;
    let Some((payload, checksum)) = buffer[..length].split_last_chunk::<2>() else {
        return Err(DecodeError::Length);
    };
    if u16::from_le_bytes(*checksum) != crc16(payload) {
        return Err(DecodeError::Checksum);
    }
    if payload.len() < HEADER_BYTES {
        return Err(DecodeError::Length);
    }
    if payload[0] != VERSION {
        return Err(DecodeError::UnsupportedVersion(payload[0]));
    }
    Ok(Packet {
        sequence: u16::read_le(&payload[2..]),
        message: Message::read_fields(payload[1], &payload[HEADER_BYTES..])?,
    })
}
