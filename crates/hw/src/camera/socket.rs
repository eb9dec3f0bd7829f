//! How do images arrive from another program? Over a local stream socket, from the simulator or a separate driver.

use std::cell::Cell;
use std::io::{ErrorKind, Read, Write};
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::net::UnixStream;
use std::time::Duration;

use localize::Stamp;
use localize::robot::ExposureSetting;

use super::buffer_pool::BufferPool;
use super::image::{CapturedImage, Encoding};
use super::settings::CameraSettings;
use crate::error::HwError;
use crate::wire::image_stream::{HEADER_BYTES, ImageHeader, SettingsMessage};

/// Timeout of reads within an image, and of writes.
const IO_TIMEOUT: Duration = Duration::from_millis(250);

/// A connection to a program that sends images.
#[derive(Debug)]
pub(super) struct ImageSocket {
    stream: UnixStream,
    path: String,
    settings: Cell<CameraSettings>,
    /// The other program reports exposure and gain of its images, and understands fractions of a gain.
    reports_settings: Cell<bool>,
}

impl ImageSocket {
    /// Connects to the socket at `path`, on which the other program listens, and sends the settings.
    pub(super) fn open(path: &str, settings: &CameraSettings) -> Result<Self, HwError> {
        let device = || format!("unix:{path}");
        let connection = UnixStream::connect(path).and_then(|stream| {
            stream.set_read_timeout(Some(IO_TIMEOUT))?;
            stream.set_write_timeout(Some(IO_TIMEOUT))?;
            Ok(stream)
        });
        let stream = connection.map_err(|source| match source.kind() {
            // A socket without a listener counts as missing.
            ErrorKind::NotFound | ErrorKind::ConnectionRefused => {
                HwError::Missing { device: device() }
            }
            ErrorKind::PermissionDenied => HwError::PermissionDenied { device: device() },
            _ => HwError::Unsupported {
                device: device(),
                reason: source.to_string(),
            },
        })?;
        let socket = ImageSocket {
            stream,
            path: device(),
            settings: Cell::new(*settings),
            reports_settings: Cell::new(false),
        };
        socket.send_settings(settings)?;
        Ok(socket)
    }

    /// Sends camera settings to the other program.
    pub(super) fn send_settings(&self, settings: &CameraSettings) -> Result<(), HwError> {
        self.settings.set(*settings);
        let gain_centi = settings.gain.map(|gain| (gain * 100.0).round() as i32);
        let message = SettingsMessage {
            exposure_us: settings
                .exposure
                .map_or(-1, |seconds| (seconds * 1e6).round() as i32),
            gain: settings.gain.map_or(-1, |gain| gain.round() as i32),
            gain_centi: gain_centi.filter(|_| self.reports_settings.get()),
            white_balance_k: settings.white_balance_k.unwrap_or(-1),
        };
        (&self.stream)
            .write_all(&message.encode())
            .map_err(|source| self.io_error(&source))
    }

    /// Reads one image, of which at least the first byte has arrived.
    pub(super) fn receive(&self, pool: &BufferPool) -> Result<CapturedImage, HwError> {
        let mut bytes = [0; HEADER_BYTES];
        self.read(&mut bytes)?;
        let garbage = || HwError::Garbage {
            device: self.path.clone(),
        };
        let header = ImageHeader::decode(&bytes).ok_or_else(garbage)?;
        let encoding = Encoding::from_fourcc(header.fourcc).ok_or_else(garbage)?;
        let [width_px, height_px, stride] =
            [header.width_px, header.height_px, header.stride].map(|size| size as usize);
        let length_min = encoding.image_bytes(width_px, height_px, stride);
        let length = header.bytes as usize;
        if !(1..=8192).contains(&width_px)
            || !(1..=8192).contains(&height_px)
            || stride < encoding.row_bytes(width_px)
            || length < length_min
        {
            return Err(garbage());
        }
        let data = pool.fill(|bytes| {
            bytes.resize(length, 0);
            self.read(bytes)
        })?;
        let setting = (header.exposure_us > 0).then(|| ExposureSetting {
            exposure: header.exposure_us as f32 * 1e-6,
            gain: f32::from(header.gain_centi) * 0.01,
        });
        if setting.is_some() && !self.reports_settings.replace(true) {
            // The first settings were sent with a rounded gain.
            self.send_settings(&self.settings.get())?;
        }
        Ok(CapturedImage {
            stamp: Stamp(header.stamp_ns),
            sequence: header.sequence,
            width_px,
            height_px,
            encoding,
            stride,
            repeated: false,
            setting,
            data,
        })
    }

    fn read(&self, bytes: &mut [u8]) -> Result<(), HwError> {
        (&self.stream)
            .read_exact(bytes)
            .map_err(|source| self.io_error(&source))
    }

    fn io_error(&self, source: &std::io::Error) -> HwError {
        let device = self.path.clone();
        match source.kind() {
            ErrorKind::WouldBlock | ErrorKind::TimedOut => HwError::Stalled {
                device,
                reason: "an image is incomplete".to_owned(),
            },
            _ => HwError::Disconnected { device },
        }
    }
}

impl AsFd for ImageSocket {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.stream.as_fd()
    }
}
