//! How do industrial cameras deliver images? GigE Vision and USB3 Vision through Aravis.

use aravis::{
    AcquisitionMode, Auto, BufferStatus, CameraExt, CameraExtManual, DeviceError, GvStreamOption,
    StreamExt, glib,
};
use localize::Stamp;
use localize::robot::ExposureSetting;

use super::buffer_pool::BufferPool;
use super::image::{Capture, CapturedImage, Encoding};
use super::settings::CameraSettings;
use crate::clock;
use crate::config::CameraDeviceConfig;
use crate::device_clock::DeviceClock;
use crate::error::HwError;

/// Buffers for received images.
const BUFFERS: usize = 4;
/// Longest wait for an image, µs.
const BUFFER_TIMEOUT_US: u64 = 50_000;

/// GenICam's name of a gain without a unit, which has whole numbers (Standard Features Naming Convention).
const GAIN_RAW: &str = "GainRaw";

/// GenICam's names of the encodings (Standard Features Naming Convention), in order of preference.
const PIXEL_FORMATS: [(&str, Encoding); 9] = [
    ("RGB8", Encoding::Rgb8),
    ("RGB8Packed", Encoding::Rgb8),
    ("BGR8", Encoding::Bgr8),
    ("YUV422_8", Encoding::Yuyv),
    ("BayerRG8", Encoding::BayerRggb),
    ("BayerGR8", Encoding::BayerGrbg),
    ("BayerGB8", Encoding::BayerGbrg),
    ("BayerBG8", Encoding::BayerBggr),
    ("Mono8", Encoding::Grey8),
];

/// A streaming GenICam camera.
#[derive(Debug)]
pub(super) struct GenICam {
    camera: aravis::Camera,
    stream: aravis::Stream,
    device: String,
    encoding: Encoding,
    width_px: usize,
    height_px: usize,
    clock: DeviceClock,
}

impl GenICam {
    /// Opens the camera called `name` (the first found if empty), configures it and starts streaming.
    pub(super) fn open(
        name: &str,
        device: &CameraDeviceConfig,
        size_px: [u32; 2],
    ) -> Result<Self, HwError> {
        let label = &device.device;
        let failed = |error: glib::Error| error_from_aravis(label, &error);
        let name = (!name.is_empty()).then_some(name);
        let camera = aravis::Camera::new(name).map_err(failed)?;
        let offered = camera
            .dup_available_pixel_formats_as_strings()
            .map_err(failed)?;
        let wanted = |encoding: Encoding| {
            device.format.is_empty() || device.format.as_bytes() == encoding.fourcc().to_le_bytes()
        };
        let choice = PIXEL_FORMATS
            .iter()
            .find(|(name, encoding)| wanted(*encoding) && offered.iter().any(|o| o == name));
        let Some((format, encoding)) = choice else {
            return Err(HwError::Unsupported {
                device: label.clone(),
                reason: format!(
                    "none of its formats is supported or configured: {}",
                    offered.join(" ")
                ),
            });
        };
        camera
            .set_pixel_format_from_string(format)
            .map_err(failed)?;
        let [width, height] = size_px.map(|size| size as i32);
        let (sensor_width, sensor_height) = camera.sensor_size().map_err(failed)?;
        if width > sensor_width || height > sensor_height {
            return Err(HwError::Unsupported {
                device: label.clone(),
                reason: format!(
                    "invalid image size: {width} × {height} (expected at most {sensor_width} × {sensor_height})"
                ),
            });
        }
        // The mirror is in the middle of the sensor. Odd offsets would change the order of a Bayer pattern.
        let offset = |sensor: i32, size: i32| ((sensor - size) / 2) & !1;
        let (x, y) = (offset(sensor_width, width), offset(sensor_height, height));
        camera.set_region(x, y, width, height).map_err(failed)?;
        camera
            .set_acquisition_mode(AcquisitionMode::Continuous)
            .map_err(failed)?;
        // The camera would wait for a trigger that another program left on. Cameras without triggers return an error.
        let _no_triggers = camera.clear_triggers();
        if camera.is_frame_rate_available().map_err(failed)? {
            camera
                .set_frame_rate(f64::from(device.rate_hz))
                .map_err(failed)?;
        }
        if camera.is_gv_device() {
            // As root Aravis uses a packet socket, which receives nothing on loopback and in containers; UDP always works.
            camera.gv_set_stream_options(GvStreamOption::PACKET_SOCKET_DISABLED);
        }
        let stream = camera.create_stream().map_err(failed)?;
        let payload = camera.payload().map_err(failed)? as usize;
        for _ in 0..BUFFERS {
            stream.push_buffer(aravis::Buffer::new_allocate(payload));
        }
        let genicam = GenICam {
            camera,
            stream,
            device: label.clone(),
            encoding: *encoding,
            width_px: size_px[0] as usize,
            height_px: size_px[1] as usize,
            clock: DeviceClock::default(),
        };
        genicam.apply_settings(&CameraSettings::from_config(device))?;
        genicam.camera.start_acquisition().map_err(failed)?;
        Ok(genicam)
    }

    /// Sets exposure and gain. White balance is done in vision, since these cameras send raw colours.
    pub(super) fn apply_settings(&self, settings: &CameraSettings) -> Result<(), HwError> {
        let failed = |error: glib::Error| error_from_aravis(&self.device, &error);
        let camera = &self.camera;
        // A camera without an automatic mode returns an error, which does not matter.
        let _no_automatic = camera.set_exposure_time_auto(auto_mode(settings.exposure.is_none()));
        let _no_automatic = camera.set_gain_auto(auto_mode(settings.gain.is_none()));
        // A value outside the limits would be an error. The limits may depend on the frame rate, so they are read again.
        if let Some(seconds) = settings.exposure {
            let (least, most) = camera.exposure_time_bounds().map_err(failed)?;
            let microseconds = (f64::from(seconds) * 1e6).max(least).min(most);
            camera.set_exposure_time(microseconds).map_err(failed)?;
        }
        if let Some(gain) = settings.gain {
            let bounds = camera.gain_bounds().map_err(failed)?;
            // A gain in decibels has no such feature. Aravis would cut the decimals of a raw one.
            let step = camera.integer_increment(GAIN_RAW).unwrap_or(0);
            let gain = nearest_gain(f64::from(gain), bounds, step as f64);
            camera.set_gain(gain).map_err(failed)?;
        }
        Ok(())
    }

    /// Exposure and gain that the camera reports. `None` if it does not.
    pub(super) fn applied_setting(&self) -> Option<ExposureSetting> {
        Some(ExposureSetting {
            exposure: (self.camera.exposure_time().ok()? * 1e-6) as f32,
            gain: self.camera.gain().ok()? as f32,
        })
    }

    /// Waits up to the timeout for an image and takes the newest complete one.
    pub(super) fn capture(&mut self, pool: &BufferPool) -> Result<Capture, HwError> {
        let mut capture = Capture {
            image: None,
            damaged: 0,
        };
        let mut next = self.stream.timeout_pop_buffer(BUFFER_TIMEOUT_US);
        while let Some(buffer) = next {
            match self.copy_image(&buffer, pool) {
                Some(image) => capture.image = Some(image),
                None => capture.damaged += 1,
            }
            self.stream.push_buffer(buffer);
            next = self.stream.try_pop_buffer();
        }
        Ok(capture)
    }

    fn copy_image(&mut self, buffer: &aravis::Buffer, pool: &BufferPool) -> Option<CapturedImage> {
        if buffer.status() != BufferStatus::Success {
            return None;
        }
        let arrival = clock::now();
        let stride = self.encoding.row_bytes(self.width_px);
        let image = bytes_of(buffer);
        if image.len()
            < self
                .encoding
                .image_bytes(self.width_px, self.height_px, stride)
        {
            return None;
        }
        let copy = |bytes: &mut Vec<u8>| {
            bytes.clear();
            bytes.extend_from_slice(image);
            Ok::<(), ()>(())
        };
        Some(CapturedImage {
            stamp: self.host_stamp(buffer.timestamp(), arrival),
            sequence: buffer.frame_id() as u32,
            width_px: self.width_px,
            height_px: self.height_px,
            encoding: self.encoding,
            stride,
            repeated: false,
            setting: None,
            data: pool.fill(copy).ok()?,
        })
    }

    /// Host time at the camera's time (ns), which is 0 for a camera without a clock.
    fn host_stamp(&mut self, camera_ns: u64, arrival: Stamp) -> Stamp {
        if camera_ns == 0 {
            return arrival;
        }
        self.clock
            .update_host_stamp((camera_ns / 1000) as u32, arrival)
    }
}

impl Drop for GenICam {
    fn drop(&mut self) {
        // Fails for an unplugged camera, which needs no stop.
        let _gone = self.camera.stop_acquisition();
    }
}

/// The received bytes of a buffer.
#[expect(
    unsafe_code,
    reason = "Aravis returns a pointer and a length; newer versions make a copy, which is not needed"
)]
fn bytes_of(buffer: &aravis::Buffer) -> &[u8] {
    let (start, length) = buffer.data();
    if start.is_null() {
        return &[];
    }
    // SAFETY: the buffer was popped from the stream, so nothing writes to it, and it owns its memory.
    unsafe { std::slice::from_raw_parts(start, length) }
}

/// The gain within `bounds` that is nearest to `gain` in whole steps above the lower bound. A step of 0 is none.
fn nearest_gain(gain: f64, (least, most): (f64, f64), step: f64) -> f64 {
    let gain = gain.min(most).max(least);
    if step <= 0.0 {
        return gain;
    }
    let steps_max = ((most - least) / step).floor();
    least + ((gain - least) / step).round().min(steps_max) * step
}

fn auto_mode(on: bool) -> Auto {
    if on { Auto::Continuous } else { Auto::Off }
}

/// The error for one of Aravis.
fn error_from_aravis(device: &str, error: &glib::Error) -> HwError {
    let device = device.to_owned();
    match error.kind::<DeviceError>() {
        Some(DeviceError::NotFound) => HwError::Missing { device },
        Some(DeviceError::NotController) => HwError::Busy { device },
        Some(DeviceError::NotConnected | DeviceError::Timeout | DeviceError::TransferError) => {
            HwError::Disconnected { device }
        }
        _ => HwError::Unsupported {
            device,
            reason: error.message().to_owned(),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gain_is_within_bounds_and_on_steps() {
        for (gain, step, expected) in [
            (3.4, 1.0, 3.0),
            (3.6, 1.0, 4.0),
            (99.0, 1.0, 10.0),
            (-1.0, 1.0, 0.0),
            (3.4, 4.0, 4.0),
            // The last step below the upper bound.
            (10.0, 4.0, 8.0),
            (3.4, 0.0, 3.4),
            (99.0, 0.0, 10.0),
        ] {
            assert_eq!(nearest_gain(gain, (0.0, 10.0), step), expected, "{gain}");
        }
        assert_eq!(nearest_gain(9.0, (5.0, 30.0), 6.0), 11.0);
    }
}
