//! What is a CAN frame? Classic CAN 2.0: up to eight bytes and an identifier of 11 or 29 bits.

/// One frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct CanFrame {
    /// Identifier, right-aligned.
    pub id: u32,
    /// True for an identifier of 29 bits, false for 11.
    pub extended: bool,
    /// True for a remote frame, which requests data and contains none.
    pub remote: bool,
    len: u8,
    data: [u8; 8],
}

/// Bits of an identifier of either width.
const ID_MASKS: [u32; 2] = [0x7FF, 0x1FFF_FFFF];
/// Flags above the identifier in Linux' `can_id` (linux/can.h).
const EXTENDED_FLAG: u32 = 1 << 31;
const REMOTE_FLAG: u32 = 1 << 30;
const ERROR_FLAG: u32 = 1 << 29;

impl CanFrame {
    /// A data frame; `None` for more than eight bytes or an identifier out of range.
    pub fn new(id: u32, extended: bool, data: &[u8]) -> Option<Self> {
        let mut frame = CanFrame {
            id,
            extended,
            remote: false,
            len: u8::try_from(data.len()).ok()?,
            data: [0; 8],
        };
        frame.data.get_mut(..data.len())?.copy_from_slice(data);
        (id <= ID_MASKS[usize::from(extended)]).then_some(frame)
    }

    /// A data frame with an identifier of 29 bits; excess bits and bytes are cut off.
    pub(crate) fn extended(id: u32, data: &[u8]) -> Self {
        let mut frame = CanFrame {
            id: id & ID_MASKS[1],
            extended: true,
            remote: false,
            len: data.len().min(8) as u8,
            data: [0; 8],
        };
        for (place, byte) in frame.data.iter_mut().zip(data) {
            *place = *byte;
        }
        frame
    }

    /// A remote frame that requests `len` bytes; `None` as in [`CanFrame::new`].
    pub fn remote(id: u32, extended: bool, len: usize) -> Option<Self> {
        let frame = CanFrame::new(id, extended, [0; 8].get(..len)?)?;
        Some(CanFrame {
            remote: true,
            ..frame
        })
    }

    /// Data bytes; zeros in a remote frame.
    pub fn data(&self) -> &[u8] {
        &self.data[..usize::from(self.len)]
    }

    /// As Linux' `struct can_frame`, native byte order.
    pub fn to_socketcan(&self) -> [u8; 16] {
        let flags = if self.extended { EXTENDED_FLAG } else { 0 }
            | if self.remote { REMOTE_FLAG } else { 0 };
        let mut bytes = [0; 16];
        bytes[..4].copy_from_slice(&(self.id | flags).to_ne_bytes());
        bytes[4] = self.len;
        bytes[8..].copy_from_slice(&self.data);
        bytes
    }

    /// From Linux' `struct can_frame`; `None` for an error frame or a length above eight.
    pub fn from_socketcan(bytes: &[u8; 16]) -> Option<Self> {
        let word = u32::from_ne_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
        let extended = word & EXTENDED_FLAG != 0;
        let id = word & ID_MASKS[usize::from(extended)];
        if word & ERROR_FLAG != 0 {
            return None;
        }
        let len = usize::from(bytes[4]);
        if word & REMOTE_FLAG != 0 {
            return CanFrame::remote(id, extended, len);
        }
        CanFrame::new(id, extended, bytes[8..].get(..len)?)
    }
}
