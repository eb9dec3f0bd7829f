//! How do images arrive from a camera? One thread per camera delivers the newest image and detects stalls and repeats.

#[cfg(feature = "aravis")]
mod genicam;
mod image;
mod jpeg;
mod settings;
mod socket;
mod stamp_validator;
mod sys;
mod v4l2;

use std::os::fd::AsFd;
use std::sync::{Arc, Mutex, PoisonError};

use localize::Stamp;

pub use image::{CapturedImage, Encoding, PooledBytes};
pub use settings::CameraSettings;

use crate::clock;
use crate::config::CameraDeviceConfig;
use crate::error::HwError;
use crate::event_queue::{DeviceEvent, EventQueue};
use crate::health::{HealthReport, HealthState};
use crate::monitor::Monitor;
use crate::worker::{POLL_PERIOD, StallDetector, Waker, Worker};
use image::{BufferPool, Capture};
use socket::ImageSocket;
use stamp_validator::StampValidator;
use v4l2::V4l2;
pub(crate) use v4l2::describe as describe_video_device;

/// A camera whose thread pushes each newest image into the event queue.
#[derive(Debug)]
pub struct CameraDriver {
    worker: Worker,
    monitor: Monitor,
    pending_settings: Arc<Mutex<Option<CameraSettings>>>,
}

/// The interface of a camera.
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

    /// Waits until an image may be ready; false if none came by the deadline or the waker was called.
    fn wait(&self, waker: &Waker, deadline: Stamp) -> bool {
        match self {
            CameraBackend::V4l2(camera) => waker.wait(Some(camera.as_fd()), deadline),
            CameraBackend::Socket(socket) => waker.wait(Some(socket.as_fd()), deadline),
            // Aravis has no file descriptor to poll; `capture` waits itself.
            #[cfg(feature = "aravis")]
            CameraBackend::GenICam(_) => true,
        }
    }

    fn apply_settings(&self, settings: &CameraSettings) -> Result<(), HwError> {
        match self {
            CameraBackend::V4l2(camera) => camera.apply_settings(settings),
            CameraBackend::Socket(socket) => socket.send_settings(settings),
            #[cfg(feature = "aravis")]
            CameraBackend::GenICam(camera) => camera.apply_settings(settings),
        }
    }

    /// Takes the newest complete image.
    fn capture(&mut self, pool: &BufferPool) -> Result<Capture, HwError> {
        match self {
            CameraBackend::V4l2(camera) => camera.capture(pool),
            CameraBackend::Socket(socket) => socket.receive(pool).map(|image| Capture {
                image: Some(image),
                damaged: 0,
            }),
            #[cfg(feature = "aravis")]
            CameraBackend::GenICam(camera) => camera.capture(pool),
        }
    }
}

#[cfg(feature = "aravis")]
fn open_genicam(
    name: &str,
    device: &CameraDeviceConfig,
    size_px: [u32; 2],
) -> Result<CameraBackend, HwError> {
    genicam::GenICam::open(name, device, size_px).map(CameraBackend::GenICam)
}

#[cfg(not(feature = "aravis"))]
fn open_genicam(
    _: &str,
    device: &CameraDeviceConfig,
    _: [u32; 2],
) -> Result<CameraBackend, HwError> {
    Err(HwError::Unsupported {
        device: device.device.clone(),
        reason: "GenICam cameras are not supported. Build with the feature aravis".to_owned(),
    })
}

impl CameraDriver {
    /// Starts the camera's thread, which opens the device as soon as it is present.
    ///
    /// `size_px`: columns and rows of the image. Images over a socket have the size that their sender chooses.
    pub fn start(
        device: &CameraDeviceConfig,
        size_px: [u32; 2],
        queue: &EventQueue,
    ) -> Result<Self, HwError> {
        let monitor = Monitor::new("camera", queue);
        let pending_settings = Arc::new(Mutex::new(None));
        let mut capture_loop = CaptureLoop {
            device: device.clone(),
            settings: None,
            pending_settings: Arc::clone(&pending_settings),
            pool: BufferPool::default(),
            monitor: monitor.clone(),
            queue: queue.clone(),
        };
        let open_config = device.clone();
        let worker = Worker::start(
            "camera",
            &monitor,
            move || CameraBackend::open(&open_config, size_px),
            move |backend, waker| capture_loop.run(backend, waker),
        )?;
        Ok(CameraDriver {
            worker,
            monitor,
            pending_settings,
        })
    }

    /// Applies settings to the following images.
    pub fn set_settings(&self, settings: CameraSettings) {
        *self
            .pending_settings
            .lock()
            .unwrap_or_else(PoisonError::into_inner) = Some(settings);
        self.worker.wake();
    }

    /// Health of the camera.
    pub fn health(&self) -> HealthReport {
        self.monitor.health(clock::now())
    }
}

/// Bytes that are compared to detect a repeated image; sensor noise changes some of any hundred.
const COMPARED_BYTES: usize = 4096;

struct CaptureLoop {
    device: CameraDeviceConfig,
    /// The last settings that were applied; a replugged camera gets them again.
    settings: Option<CameraSettings>,
    pending_settings: Arc<Mutex<Option<CameraSettings>>>,
    pool: BufferPool,
    monitor: Monitor,
    queue: EventQueue,
}

impl CaptureLoop {
    fn run(&mut self, backend: &mut CameraBackend, waker: &Waker) -> Result<(), HwError> {
        let mut stall_detector = StallDetector::new(&self.device.device, self.device.stall);
        let mut repeat_detector = RepeatDetector::default();
        let mut stamp_validator = StampValidator::default();
        if let Some(settings) = &self.settings {
            backend.apply_settings(settings)?;
        }
        while !waker.stop_requested() {
            let ready = backend.wait(waker, clock::now() + POLL_PERIOD);
            let pending = self
                .pending_settings
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .take();
            if let Some(settings) = pending {
                backend.apply_settings(&settings)?;
                self.settings = Some(settings);
            }
            if ready {
                let capture = backend.capture(&self.pool)?;
                (0..capture.damaged).for_each(|_| self.monitor.count_damaged());
                let now = clock::now();
                if let Some(image) = capture.image {
                    let unchanged_since = repeat_detector.unchanged_since(&image, now);
                    stall_detector.on_message(now, 0);
                    let Some(mut image) = image.decompress(&self.pool) else {
                        self.monitor.count_damaged();
                        continue;
                    };
                    let validated = stamp_validator.validate(image.stamp, now);
                    image.stamp = validated.stamp;
                    image.repeated = unchanged_since < now;
                    self.monitor.count_message(now);
                    self.update_health(unchanged_since, validated.from_camera, now);
                    self.queue.push(DeviceEvent::Image(image));
                }
            }
            stall_detector.check(clock::now(), 0)?;
        }
        Ok(())
    }

    fn update_health(&self, unchanged_since: Stamp, stamp_from_camera: bool, now: Stamp) {
        if now - unchanged_since > f64::from(self.device.stall) {
            let reason = "its images repeat bit by bit".to_owned();
            self.monitor.set_state(HealthState::Stuck, Some(reason));
        } else if !stamp_from_camera {
            let reason = "its stamps are implausible: images are stamped at arrival".to_owned();
            self.monitor.set_state(HealthState::Clock, Some(reason));
        } else {
            self.monitor.set_state(HealthState::Running, None);
        }
    }
}

/// Detects a camera that repeats one image.
#[derive(Debug, Default)]
struct RepeatDetector {
    sample: Vec<u8>,
    first_seen: Stamp,
}

impl RepeatDetector {
    /// Arrival of the first image that equals this one without another in between.
    fn unchanged_since(&mut self, image: &CapturedImage, now: Stamp) -> Stamp {
        let step = (image.data.len() / COMPARED_BYTES).max(1);
        let sample = || image.data.iter().step_by(step);
        if !sample().eq(self.sample.iter()) {
            self.sample.clear();
            self.sample.extend(sample());
            self.first_seen = now;
        }
        self.first_seen
    }
}
