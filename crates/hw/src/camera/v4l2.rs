//! How does Linux deliver images? A video device that streams into mapped buffers.

use std::os::fd::{AsFd, BorrowedFd, OwnedFd};

use localize::Stamp;
use localize::robot::ExposureSetting;
use rustix::fs::{Mode, OFlags, open};
use rustix::io::Errno;

use super::buffer_pool::BufferPool;
use super::image::{Capture, CapturedImage, Encoding};
use super::settings::CameraSettings;
use super::sys;
use super::v4l2_controls::{
    EXPOSURE_ABSOLUTE, GAIN, control_sequence, setting_from_values, value_in_range,
};
use crate::clock;
use crate::config::CameraDeviceConfig;
use crate::error::HwError;

/// Buffers in the driver: one being filled, one next, two spare for a delayed thread.
const BUFFERS: u32 = 4;

/// A streaming video device.
#[derive(Debug)]
pub(super) struct V4l2 {
    fd: OwnedFd,
    path: String,
    buffers: Vec<sys::MappedBuffer>,
    encoding: Encoding,
    width_px: usize,
    height_px: usize,
    stride: usize,
}

/// Name, bus and formats of a video device.
pub(crate) fn describe(path: &str) -> Result<String, HwError> {
    let fd = open_device(path)?;
    let capability = query_capture_capability(&fd, path)?;
    let offered = formats(&fd).into_iter().map(|code| {
        String::from_utf8_lossy(&code.to_le_bytes())
            .trim()
            .to_owned()
    });
    let formats: Vec<_> = offered.collect();
    Ok(format!(
        "{} ({}): {}",
        string_from_c(&capability.card),
        string_from_c(&capability.bus_info),
        formats.join(" ")
    ))
}

impl V4l2 {
    /// Opens and configures a device for images of `size_px` (columns, rows) and starts streaming.
    pub(super) fn open(device: &CameraDeviceConfig, size_px: [u32; 2]) -> Result<Self, HwError> {
        let path = device.device.clone();
        let failed = |action| {
            let path = path.clone();
            move |source| HwError::from_errno(&path, action, source)
        };
        let unsupported = |reason: String| HwError::Unsupported {
            device: path.clone(),
            reason,
        };
        let fd = open_device(&path)?;
        query_capture_capability(&fd, &path)?;
        let offered = formats(&fd);
        let Some(encoding) = Encoding::choose(&device.format, &offered) else {
            let names: Vec<_> = offered
                .iter()
                .map(|code| String::from_utf8_lossy(&code.to_le_bytes()).into_owned())
                .collect();
            let expected = names.join(" ");
            let reason = if device.format.is_empty() {
                format!("none of its formats is supported: {expected}")
            } else {
                let format = &device.format;
                format!("unsupported format: {format} (expected one of {expected})")
            };
            return Err(unsupported(reason));
        };
        let mut format = requested_format(size_px, encoding);
        sys::set_format(&fd, &mut format).map_err(failed("set the format of"))?;
        if (format.width, format.height, format.fourcc)
            != (size_px[0], size_px[1], encoding.fourcc())
        {
            return Err(unsupported(format!(
                "unsupported image size in {encoding:?}: {} × {} (nearest: {} × {}). Change [camera] in robot.toml",
                size_px[0], size_px[1], format.width, format.height
            )));
        }
        // Cameras with a single rate refuse this.
        let mut parameters = requested_rate(device.rate_hz);
        let _fixed_rate = sys::set_parameters(&fd, &mut parameters);
        let mut request = sys::BufferRequest {
            count: BUFFERS,
            kind: sys::CAPTURE,
            memory: sys::MEMORY_MMAP,
            ..sys::BufferRequest::default()
        };
        sys::request_buffers(&fd, &mut request).map_err(failed("request buffers of"))?;
        let mut buffers = Vec::new();
        for index in 0..request.count {
            let mut buffer = buffer(index);
            sys::query_buffer(&fd, &mut buffer).map_err(failed("query a buffer of"))?;
            buffers.push(sys::MappedBuffer::new(&fd, &buffer).map_err(failed("map a buffer of"))?);
            sys::queue(&fd, &mut buffer).map_err(failed("queue a buffer of"))?;
        }
        let camera = V4l2 {
            fd,
            path: path.clone(),
            buffers,
            encoding,
            width_px: size_px[0] as usize,
            height_px: size_px[1] as usize,
            stride: (format.bytes_per_line as usize).max(encoding.row_bytes(size_px[0] as usize)),
        };
        camera.apply_settings(&CameraSettings::from_config(device))?;
        let mut kind = sys::CAPTURE;
        sys::stream_on(&camera.fd, &mut kind).map_err(failed("start streaming of"))?;
        Ok(camera)
    }

    /// Sets exposure, gain and white balance; values that are `None` become automatic.
    pub(super) fn apply_settings(&self, settings: &CameraSettings) -> Result<(), HwError> {
        for control in control_sequence(settings) {
            if let (Err(source), Some(name)) = (
                self.set_control(control.id, control.value),
                control.required_as,
            ) {
                let reason = format!("cannot set its {name}: {source}");
                let device = self.path.clone();
                return Err(HwError::Unsupported { device, reason });
            }
        }
        Ok(())
    }

    /// Exposure and gain that the device reports. `None` if it has no such controls.
    pub(super) fn applied_setting(&self) -> Option<ExposureSetting> {
        let get = |id| {
            let mut control = sys::Control { id, value: 0 };
            let result = sys::get_control(&self.fd, &mut control);
            result.ok().map(|()| control.value)
        };
        setting_from_values(get(EXPOSURE_ABSOLUTE), get(GAIN))
    }

    fn set_control(&self, id: u32, value: i32) -> Result<(), Errno> {
        let mut range = sys::ControlRange {
            id,
            ..sys::ControlRange::default()
        };
        sys::query_control(&self.fd, &mut range)?;
        let value = value_in_range(value, &range).ok_or(Errno::INVAL)?;
        sys::set_control(&self.fd, &mut sys::Control { id, value })
    }

    /// Takes the newest complete image that is ready.
    pub(super) fn capture(&self, pool: &BufferPool) -> Result<Capture, HwError> {
        let mut capture = Capture {
            image: None,
            damaged: 0,
        };
        for _ in 0..self.buffers.len() {
            let mut buffer = buffer(0);
            match sys::dequeue(&self.fd, &mut buffer) {
                Ok(()) => {}
                Err(Errno::AGAIN) => break,
                Err(source) => {
                    return Err(HwError::from_errno(
                        &self.path,
                        "dequeue a buffer of",
                        source,
                    ));
                }
            }
            match self.copy_image(&buffer, pool) {
                Some(image) => capture.image = Some(image),
                None => capture.damaged += 1,
            }
            sys::queue(&self.fd, &mut buffer)
                .map_err(|source| HwError::from_errno(&self.path, "queue a buffer of", source))?;
        }
        Ok(capture)
    }

    fn copy_image(&self, buffer: &sys::Buffer, pool: &BufferPool) -> Option<CapturedImage> {
        let used = buffer.bytes_used as usize;
        let length_min = self
            .encoding
            .image_bytes(self.width_px, self.height_px, self.stride);
        if buffer.flags & sys::BUFFER_ERROR != 0 || used < length_min {
            return None;
        }
        let mapping = self.buffers.get(buffer.index as usize)?;
        let copy = |bytes: &mut Vec<u8>| {
            bytes.clear();
            mapping.copy_to(used, bytes);
            Ok::<(), ()>(())
        };
        Some(CapturedImage {
            stamp: buffer_stamp(buffer, clock::now()),
            sequence: buffer.sequence,
            width_px: self.width_px,
            height_px: self.height_px,
            encoding: self.encoding,
            stride: self.stride,
            repeated: false,
            setting: None,
            data: pool.fill(copy).ok()?,
        })
    }
}

impl AsFd for V4l2 {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.fd.as_fd()
    }
}

impl Drop for V4l2 {
    fn drop(&mut self) {
        // Fails for an unplugged camera, which needs no stop.
        let _gone = sys::stream_off(&self.fd, &mut sys::CAPTURE.clone());
    }
}

fn open_device(path: &str) -> Result<OwnedFd, HwError> {
    let flags = OFlags::RDWR | OFlags::NONBLOCK | OFlags::CLOEXEC;
    open(path, flags, Mode::empty()).map_err(|source| HwError::from_errno(path, "open", source))
}

/// Capabilities of the device; an error if it cannot stream images.
fn query_capture_capability(fd: &OwnedFd, path: &str) -> Result<sys::Capability, HwError> {
    let mut capability = sys::Capability::default();
    let unsupported = |reason: &str| HwError::Unsupported {
        device: path.to_owned(),
        reason: reason.to_owned(),
    };
    match sys::query_capability(fd, &mut capability) {
        Ok(()) => {}
        Err(Errno::NOTTY | Errno::INVAL) => return Err(unsupported("not a video device")),
        Err(source) => return Err(HwError::from_errno(path, "query", source)),
    }
    // A device with several nodes (image, metadata) has the capabilities of this node here.
    let capabilities = if capability.capabilities & sys::CAP_DEVICE_CAPS != 0 {
        capability.device_caps
    } else {
        capability.capabilities
    };
    if capabilities & sys::CAP_VIDEO_CAPTURE == 0 || capabilities & sys::CAP_STREAMING == 0 {
        return Err(unsupported("does not stream images. Try the next number"));
    }
    Ok(capability)
}

/// Codes of all formats that the device offers.
fn formats(fd: &OwnedFd) -> Vec<u32> {
    let description = |index| {
        let mut description = sys::FormatDescription {
            index,
            kind: sys::CAPTURE,
            ..sys::FormatDescription::default()
        };
        let result = sys::enumerate_formats(fd, &mut description);
        result.ok().map(|()| description.fourcc)
    };
    // The kernel returns an error after the last one; no camera has 64.
    (0..64).map_while(description).collect()
}

fn requested_format(size_px: [u32; 2], encoding: Encoding) -> sys::Format {
    sys::Format {
        kind: sys::CAPTURE,
        align: 0,
        width: size_px[0],
        height: size_px[1],
        fourcc: encoding.fourcc(),
        // V4L2_FIELD_NONE: whole frames, no half ones interlaced.
        field: 1,
        bytes_per_line: 0,
        size_image: 0,
        rest: [0; 44],
    }
}

fn requested_rate(rate_hz: f32) -> sys::StreamParameters {
    sys::StreamParameters {
        kind: sys::CAPTURE,
        capability: 0,
        mode: 0,
        period: [1000, (rate_hz * 1000.0).round() as u32],
        rest: [0; 46],
    }
}

fn buffer(index: u32) -> sys::Buffer {
    sys::Buffer {
        index,
        kind: sys::CAPTURE,
        memory: sys::MEMORY_MMAP,
        ..sys::Buffer::default()
    }
}

/// The driver's stamp if it is of CLOCK_MONOTONIC, else the arrival.
fn buffer_stamp(buffer: &sys::Buffer, arrival: Stamp) -> Stamp {
    if buffer.flags & sys::TIMESTAMP_MASK != sys::TIMESTAMP_MONOTONIC {
        return arrival;
    }
    Stamp(buffer.seconds * 1_000_000_000 + buffer.microseconds * 1000)
}

/// A zero-terminated string of the kernel.
fn string_from_c(bytes: &[u8]) -> String {
    let length = bytes
        .iter()
        .position(|byte| *byte == 0)
        .unwrap_or(bytes.len());
    String::from_utf8_lossy(&bytes[..length]).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn driver_timestamp_is_used_only_if_monotonic() {
        let mut buffer = sys::Buffer {
            flags: sys::TIMESTAMP_MONOTONIC,
            seconds: 12,
            microseconds: 345_678,
            ..sys::Buffer::default()
        };
        let arrival = Stamp(20_000_000_000);
        assert_eq!(buffer_stamp(&buffer, arrival), Stamp(12_345_678_000));
        buffer.flags = 0;
        assert_eq!(buffer_stamp(&buffer, arrival), arrival);
    }

    #[test]
    fn non_camera_devices_are_rejected_with_a_reason() {
        let device = |path: &str| CameraDeviceConfig {
            device: path.to_owned(),
            rate_hz: 30.0,
            format: String::new(),
            exposure: None,
            gain: None,
            white_balance_k: None,
            stall: 0.5,
        };
        let missing =
            V4l2::open(&device("/dev/video_that_is_not_there"), [640, 480]).expect_err("missing");
        assert!(missing.to_string().contains("missing"), "{missing}");
        let null = V4l2::open(&device("/dev/null"), [640, 480]).expect_err("not a camera");
        assert_eq!(null.to_string(), "/dev/null: not a video device");
    }
}
