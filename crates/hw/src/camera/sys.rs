//! What is Linux' video interface? Structures and calls of linux/videodev2.h, and mapped buffers.
//!
//! All unsafe code of the cameras is here. A test compares the layouts with the kernel's header.

#![expect(
    unsafe_code,
    reason = "ioctl and mmap have no safe API; each call gets the structure that its number encodes"
)]

use std::os::fd::{AsFd, OwnedFd};
use std::ptr::NonNull;

use rustix::io::Result;
use rustix::ioctl::{Opcode, Updater, ioctl, opcode};
use rustix::mm::{MapFlags, ProtFlags, mmap, munmap};

/// Capture into single-plane buffers.
pub(super) const CAPTURE: u32 = 1;
/// Buffers allocated by the driver and mapped by us.
pub(super) const MEMORY_MMAP: u32 = 1;
/// Capability bits.
pub(super) const CAP_VIDEO_CAPTURE: u32 = 0x1;
pub(super) const CAP_STREAMING: u32 = 0x0400_0000;
pub(super) const CAP_DEVICE_CAPS: u32 = 0x8000_0000;
/// Buffer flags.
pub(super) const BUFFER_ERROR: u32 = 0x40;
pub(super) const TIMESTAMP_MASK: u32 = 0xE000;
pub(super) const TIMESTAMP_MONOTONIC: u32 = 0x2000;
/// Flags of controls that cannot be set.
pub(super) const CONTROL_DISABLED: u32 = 0x1;
pub(super) const CONTROL_READ_ONLY: u32 = 0x4;

/// struct v4l2_capability
#[repr(C)]
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Capability {
    pub(super) driver: [u8; 16],
    pub(super) card: [u8; 32],
    pub(super) bus_info: [u8; 32],
    pub(super) version: u32,
    pub(super) capabilities: u32,
    pub(super) device_caps: u32,
    pub(super) reserved: [u32; 3],
}

/// struct v4l2_fmtdesc
#[repr(C)]
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct FormatDescription {
    pub(super) index: u32,
    pub(super) kind: u32,
    pub(super) flags: u32,
    pub(super) description: [u8; 32],
    pub(super) fourcc: u32,
    pub(super) mbus_code: u32,
    pub(super) reserved: [u32; 3],
}

/// struct v4l2_format with its struct v4l2_pix_format
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub(super) struct Format {
    pub(super) kind: u32,
    pub(super) align: u32,
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) fourcc: u32,
    pub(super) field: u32,
    pub(super) bytes_per_line: u32,
    pub(super) size_image: u32,
    pub(super) rest: [u32; 44],
}

/// struct v4l2_streamparm with its struct v4l2_captureparm
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub(super) struct StreamParameters {
    pub(super) kind: u32,
    pub(super) capability: u32,
    pub(super) mode: u32,
    /// Seconds per frame: numerator and denominator.
    pub(super) period: [u32; 2],
    pub(super) rest: [u32; 46],
}

/// struct v4l2_requestbuffers
#[repr(C)]
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct BufferRequest {
    pub(super) count: u32,
    pub(super) kind: u32,
    pub(super) memory: u32,
    pub(super) capabilities: u32,
    pub(super) flags: u32,
}

/// struct v4l2_buffer
#[repr(C)]
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Buffer {
    pub(super) index: u32,
    pub(super) kind: u32,
    pub(super) bytes_used: u32,
    pub(super) flags: u32,
    pub(super) field: u32,
    pub(super) align: u32,
    pub(super) seconds: i64,
    pub(super) microseconds: i64,
    pub(super) timecode: [u32; 4],
    pub(super) sequence: u32,
    pub(super) memory: u32,
    pub(super) offset: u64,
    pub(super) length: u32,
    pub(super) reserved: [u32; 3],
}

/// struct v4l2_control
#[repr(C)]
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Control {
    pub(super) id: u32,
    pub(super) value: i32,
}

/// struct v4l2_queryctrl
#[repr(C)]
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct ControlRange {
    pub(super) id: u32,
    pub(super) kind: u32,
    pub(super) name: [u8; 32],
    pub(super) minimum: i32,
    pub(super) maximum: i32,
    pub(super) step: i32,
    pub(super) default: i32,
    pub(super) flags: u32,
    pub(super) reserved: [u32; 2],
}

const IOCTL_TYPE: u8 = b'V';

macro_rules! calls {
    ($( $(#[$doc:meta])* $name:ident: $direction:ident $number:literal $structure:ty; )*) => {
        $(
            $(#[$doc])*
            pub(super) fn $name(fd: &OwnedFd, value: &mut $structure) -> Result<()> {
                const OPCODE: Opcode = opcode::$direction::<$structure>(IOCTL_TYPE, $number);
                // SAFETY: the number encodes the size of the structure; the kernel reads and writes no more than that and
                // keeps no pointer to it; every bit pattern is a valid value.
                unsafe { ioctl(fd.as_fd(), Updater::<OPCODE, $structure>::new(value)) }
            }
        )*

        /// Name, number and structure size of each call, for comparison with the kernel's.
        #[cfg(test)]
        const CALLS: &[(&str, Opcode, usize)] = &[
            $( (stringify!($name), opcode::$direction::<$structure>(IOCTL_TYPE, $number), size_of::<$structure>()), )*
        ];
    };
}

calls! {
    /// VIDIOC_QUERYCAP
    query_capability: read 0 Capability;
    /// VIDIOC_ENUM_FMT
    enumerate_formats: read_write 2 FormatDescription;
    /// VIDIOC_S_FMT
    set_format: read_write 5 Format;
    /// VIDIOC_REQBUFS
    request_buffers: read_write 8 BufferRequest;
    /// VIDIOC_QUERYBUF
    query_buffer: read_write 9 Buffer;
    /// VIDIOC_QBUF
    queue: read_write 15 Buffer;
    /// VIDIOC_DQBUF
    dequeue: read_write 17 Buffer;
    /// VIDIOC_STREAMON
    stream_on: write 18 u32;
    /// VIDIOC_STREAMOFF
    stream_off: write 19 u32;
    /// VIDIOC_S_PARM
    set_parameters: read_write 22 StreamParameters;
    /// VIDIOC_G_CTRL
    get_control: read_write 27 Control;
    /// VIDIOC_S_CTRL
    set_control: read_write 28 Control;
    /// VIDIOC_QUERYCTRL
    query_control: read_write 36 ControlRange;
}

/// A buffer of the driver, mapped for reading.
#[derive(Debug)]
pub(super) struct MappedBuffer {
    start: NonNull<u8>,
    length: usize,
}

// SAFETY: the memory belongs to this mapping alone and is not bound to a thread.
unsafe impl Send for MappedBuffer {}

impl MappedBuffer {
    /// Maps a buffer that `query_buffer` described.
    pub(super) fn new(fd: &OwnedFd, buffer: &Buffer) -> Result<Self> {
        let length = buffer.length as usize;
        // SAFETY: a new mapping at an address that the kernel chooses changes no memory of ours.
        let start = unsafe {
            mmap(
                std::ptr::null_mut(),
                length,
                ProtFlags::READ,
                MapFlags::SHARED,
                fd,
                buffer.offset & 0xFFFF_FFFF,
            )
        }?;
        let start = NonNull::new(start.cast()).ok_or(rustix::io::Errno::NOMEM)?;
        Ok(MappedBuffer { start, length })
    }

    /// Appends the first `used` bytes to `out`.
    ///
    /// Call it between dequeue and queue, while the driver does not write to the buffer.
    pub(super) fn copy_to(&self, used: usize, out: &mut Vec<u8>) {
        // SAFETY: start and length describe a readable mapping that lives as long as self. If a faulty driver writes
        // meanwhile, the copied bytes are still valid values.
        let bytes =
            unsafe { std::slice::from_raw_parts(self.start.as_ptr(), used.min(self.length)) };
        out.extend_from_slice(bytes);
    }
}

impl Drop for MappedBuffer {
    fn drop(&mut self) {
        // SAFETY: no reference into the mapping exists, and it is unmapped once. An error could only mean that it is
        // unmapped already.
        let _gone = unsafe { munmap(self.start.as_ptr().cast(), self.length) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fmt::Write;
    use std::mem::offset_of;

    /// Layout by the kernel's header, printed by a C program.
    fn kernel_layout() -> String {
        let folder = tempfile::tempdir().expect("a folder");
        let program = folder.path().join("layout");
        let source = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/c/video_layout.c");
        let compiled = std::process::Command::new("cc")
            .args(["-Wall", "-Werror", "-o"])
            .arg(&program)
            .arg(source)
            .output()
            .expect("cc runs");
        let diagnostics = String::from_utf8_lossy(&compiled.stderr);
        assert!(compiled.status.success(), "{diagnostics}");
        let output = std::process::Command::new(program).output().expect("runs");
        String::from_utf8(output.stdout).expect("text")
    }

    #[test]
    fn structures_and_ioctls_match_the_kernel_header() {
        let mut layout = String::new();
        for (name, number, size) in CALLS {
            writeln!(layout, "{name} {number:#x} {size}").expect("text");
        }
        for (name, offset) in [
            (
                "capability.device_caps",
                offset_of!(Capability, device_caps),
            ),
            ("format.width", offset_of!(Format, width)),
            ("format.bytes_per_line", offset_of!(Format, bytes_per_line)),
            ("format.size_image", offset_of!(Format, size_image)),
            ("parameters.period", offset_of!(StreamParameters, period)),
            ("description.fourcc", offset_of!(FormatDescription, fourcc)),
            ("buffer.flags", offset_of!(Buffer, flags)),
            ("buffer.seconds", offset_of!(Buffer, seconds)),
            ("buffer.microseconds", offset_of!(Buffer, microseconds)),
            ("buffer.sequence", offset_of!(Buffer, sequence)),
            ("buffer.memory", offset_of!(Buffer, memory)),
            ("buffer.offset", offset_of!(Buffer, offset)),
            ("buffer.length", offset_of!(Buffer, length)),
            ("range.minimum", offset_of!(ControlRange, minimum)),
            ("range.step", offset_of!(ControlRange, step)),
            ("range.flags", offset_of!(ControlRange, flags)),
        ] {
            writeln!(layout, "{name} {offset}").expect("text");
        }
        for constant in [
            CAPTURE,
            MEMORY_MMAP,
            CAP_VIDEO_CAPTURE,
            CAP_STREAMING,
            CAP_DEVICE_CAPS,
            BUFFER_ERROR,
            TIMESTAMP_MASK,
            TIMESTAMP_MONOTONIC,
            CONTROL_DISABLED,
            CONTROL_READ_ONLY,
            super::super::v4l2_controls::EXPOSURE_AUTO,
            super::super::v4l2_controls::EXPOSURE_AUTO_PRIORITY,
            super::super::v4l2_controls::EXPOSURE_ABSOLUTE,
            super::super::v4l2_controls::AUTOGAIN,
            super::super::v4l2_controls::GAIN,
            super::super::v4l2_controls::AUTO_WHITE_BALANCE,
            super::super::v4l2_controls::WHITE_BALANCE_TEMPERATURE,
        ] {
            writeln!(layout, "{constant:#x}").expect("text");
        }
        assert_eq!(layout, kernel_layout());
    }
}
