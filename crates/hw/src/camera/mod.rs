//! How do images reach the robot's eyes? A thread per camera: newest frame wins, silence and repetition are named.

#[cfg(feature = "aravis")]
mod genicam;
mod image;
mod jpeg;
mod socket;
mod stamp_validator;
mod sys;
mod v4l2;

use std::os::fd::AsFd;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use localize::Stamp;

pub use image::{CapturedImage, Encoding, PooledBytes};

use crate::clock;
use crate::config::CameraDeviceConfig;
use crate::error::HwError;
use crate::event_queue::{DeviceEvent, EventQueue};
use crate::health::{HealthReport, HealthState, Monitor};
use crate::worker::{StallDetector, Waker, Worker};
use image::BufferPool;
use socket::ImageSocket;
use stamp_validator::StampValidator;
use v4l2::V4l2;

/// How frames are taken; what is left out is left to the camera.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CameraSettings {
    /// Exposure, seconds.
    pub exposure: Option<f32>,
    /// Gain, the driver's own unit.
    pub gain: Option<i32>,
    /// White balance, kelvin.
    pub white_balance_k: Option<i32>,
}

impl CameraSettings {
    fn from_config(device: &CameraDeviceConfig) -> Self {
        CameraSettings {
            exposure: device.exposure,
            gain: device.gain,
            white_balance_k: device.white_balance_k,
        }
    }
}

/// A camera whose thread puts each newest frame into the inbox.
#[derive(Debug)]
pub struct CameraDriver {
    worker: Worker,
    monitor: Monitor,
    pending_settings: Arc<Mutex<Option<CameraSettings>>>,
}

/// Where frames come from.
#[derive(Debug)]
enum CameraBackend {
    V4l2(V4l2),
    Socket(ImageSocket),
    #[cfg(feature = "aravis")]
    GenICam(genicam::GenICam),
}

impl CameraBackend {
    fn open(device: &CameraDeviceConfig, size_px: [u32; 2]) -> Result<Self, HwError> {
        if let Some(path) = device.device.strip_prefix("unix:") {
            return ImageSocket::open(path, &CameraSettings::from_config(device))
                .map(CameraBackend::Socket);
        }
        if let Some(name) = device.device.strip_prefix("genicam:") {
            return open_genicam(name, device, size_px);
        }
        V4l2::open(device, size_px).map(CameraBackend::V4l2)
    }

    /// Waits until a frame may be there; false if none came by the deadline or the bell rang.
    fn wait(&self, bell: &Waker, deadline: Stamp) -> bool {
        match self {
            CameraBackend::V4l2(camera) => bell.wait(Some(camera.as_fd()), deadline),
            CameraBackend::Socket(socket) => bell.wait(Some(socket.as_fd()), deadline),
            // Has nothing that can be waited for together with the bell; `take` waits itself.
            #[cfg(feature = "aravis")]
            Source::GenICam(_) => true,
        }
    }

    fn apply_settings(&self, settings: &CameraSettings) -> Result<(), HwError> {
        match self {
            CameraBackend::V4l2(camera) => camera.apply_settings(settings),
            CameraBackend::Socket(socket) => socket.send_settings(settings),
            #[cfg(feature = "aravis")]
            Source::GenICam(camera) => camera.set(settings),
        }
    }

    /// The newest whole frame, and how many torn ones came before it.
    fn capture(&mut self, pool: &BufferPool) -> Result<(Option<CapturedImage>, u32), HwError> {
        match self {
            CameraBackend::V4l2(camera) => camera.capture(pool),
            CameraBackend::Socket(socket) => socket.receive(pool).map(|frame| (Some(frame), 0)),
            #[cfg(feature = "aravis")]
            Source::GenICam(camera) => camera.take(pool),
        }
    }
}

#[cfg(feature = "aravis")]
fn open_genicam(name: &str, device: &CameraDevice, size_px: [u32; 2]) -> Result<Source, HwError> {
    genicam::GenICam::open(name, device, size_px).map(Source::GenICam)
}

#[cfg(not(feature = "aravis"))]
fn open_genicam(
    _: &str,
    device: &CameraDeviceConfig,
    _: [u32; 2],
) -> Result<CameraBackend, HwError> {
    Err(HwError::Unsupported {
        device: device.device.clone(),
        reason: "this program was built without GenICam cameras (feature aravis)".to_owned(),
    })
}

impl CameraDriver {
    /// Starts the camera's thread, which opens the device now or whenever it appears; `size_px` is columns and rows of the
    /// wanted image. A socket's images have the size that their sender gives them.
    pub fn start(
        device: &CameraDeviceConfig,
        size_px: [u32; 2],
        inbox: &EventQueue,
    ) -> Result<Self, HwError> {
        let monitor = Monitor::new("camera", inbox);
        let wanted = Arc::new(Mutex::new(None));
        let mut server = CaptureLoop {
            device: device.clone(),
            // A camera that is plugged in again gets what was set last.
            settings: None,
            pending_settings: Arc::clone(&wanted),
            pool: BufferPool::default(),
            monitor: monitor.clone(),
            inbox: inbox.clone(),
        };
        let opened = device.clone();
        let worker = Worker::start(
            "camera",
            &monitor,
            move || CameraBackend::open(&opened, size_px),
            move |source, bell| server.run(source, bell),
        )?;
        Ok(CameraDriver {
            worker,
            monitor,
            pending_settings: wanted,
        })
    }

    /// Has the following frames taken with these settings.
    pub fn set_settings(&self, settings: CameraSettings) {
        *self
            .pending_settings
            .lock()
            .unwrap_or_else(PoisonError::into_inner) = Some(settings);
        self.worker.wake();
    }

    /// How the camera is.
    pub fn health(&self) -> HealthReport {
        self.monitor.health(clock::now())
    }
}

/// Longest wait before a thread looks at silence again, seconds.
const POLL_PERIOD: f64 = 0.05;
/// Bytes compared to tell one frame from the next; the noise of a sensor shows in any hundred.
const COMPARED_BYTES: usize = 4096;

struct CaptureLoop {
    device: CameraDeviceConfig,
    settings: Option<CameraSettings>,
    pending_settings: Arc<Mutex<Option<CameraSettings>>>,
    pool: BufferPool,
    monitor: Monitor,
    inbox: EventQueue,
}

impl CaptureLoop {
    fn run(&mut self, source: &mut CameraBackend, bell: &Waker) -> Result<(), HwError> {
        let mut watch = StallDetector::new(&self.device.device, self.device.stall);
        let mut repeated = RepeatDetector::default();
        let mut stamps = StampValidator::default();
        if let Some(settings) = &self.settings {
            source.apply_settings(settings)?;
        }
        while !bell.stop_requested() {
            let ready = source.wait(bell, clock::now() + POLL_PERIOD);
            let wanted = self
                .pending_settings
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .take();
            if let Some(settings) = wanted {
                source.apply_settings(&settings)?;
                self.settings = Some(settings);
            }
            if ready {
                let (frame, torn) = source.capture(&self.pool)?;
                (0..torn).for_each(|_| self.monitor.count_damaged());
                let now = clock::now();
                let same_since = frame
                    .as_ref()
                    .map(|frame| repeated.unchanged_since(frame, now));
                if let (Some(frame), Some(same_since)) = (frame, same_since) {
                    watch.on_message(now, 0);
                    let Some(mut frame) = frame.decompress(&self.pool) else {
                        self.monitor.count_damaged();
                        continue;
                    };
                    let (stamp, own_stamp) = stamps.validate(frame.stamp, now);
                    frame.stamp = stamp;
                    frame.repeated = same_since < now;
                    self.monitor.count_message(now);
                    self.update_health(same_since, own_stamp, now);
                    self.inbox.push(DeviceEvent::Image(frame));
                }
            }
            watch.check(clock::now(), 0)?;
        }
        Ok(())
    }

    fn update_health(&self, same_since: Stamp, own_stamp: bool, now: Stamp) {
        if now - same_since > f64::from(self.device.stall) {
            let reason = "the image does not change by a single bit".to_owned();
            self.monitor.set_state(HealthState::Stuck, Some(reason));
        } else if !own_stamp {
            let reason = "its stamps cannot be true: frames are stamped as they arrive".to_owned();
            self.monitor.set_state(HealthState::Clock, Some(reason));
        } else {
            self.monitor.set_state(HealthState::Running, None);
        }
    }
}

/// Since when has the image been the same?
#[derive(Debug, Default)]
struct RepeatDetector {
    sample: Vec<u8>,
    first_seen: Stamp,
}

impl RepeatDetector {
    fn unchanged_since(&mut self, frame: &CapturedImage, now: Stamp) -> Stamp {
        let step = (frame.data.len() / COMPARED_BYTES).max(1);
        let sample = || frame.data.iter().step_by(step);
        if !sample().eq(self.sample.iter()) {
            self.sample.clear();
            self.sample.extend(sample());
            self.first_seen = now;
        }
        self.first_seen
    }
}

/// The video devices of this machine: path, and what it is or why it cannot be used.
pub fn list() -> Vec<(String, Result<String, HwError>)> {
    let Ok(entries) = std::fs::read_dir(Path::new("/dev")) else {
        return Vec::new();
    };
    let numbers = entries.flatten().filter_map(|entry| {
        let name = entry.file_name();
        name.to_str()?.strip_prefix("video")?.parse::<u32>().ok()
    });
    let mut numbers: Vec<_> = numbers.collect();
    numbers.sort_unstable();
    let described = numbers.into_iter().map(|number| {
        let path = format!("/dev/video{number}");
        let what = v4l2::describe(&path);
        (path, what)
    });
    described.collect()
}
