//! How do images arrive from a camera? One thread per camera delivers the newest image and detects stalls and repeats.

mod applied_setting_history;
mod buffer_pool;
#[cfg(feature = "aravis")]
mod genicam;
mod image;
mod jpeg;
mod settings;
mod socket;
mod stamp_validator;
mod sys;
mod v4l2;
mod v4l2_controls;

use std::os::fd::AsFd;
use std::sync::{Arc, Mutex, PoisonError};

use localize::Stamp;
use localize::robot::ExposureSetting;

pub use buffer_pool::PooledBytes;
pub use image::{CapturedImage, Encoding};
pub use settings::CameraSettings;

use crate::clock;
use crate::config::CameraDeviceConfig;
use crate::error::HwError;
use crate::event_queue::{DeviceEvent, EventQueue};
use crate::health::{HealthReport, HealthState};
use crate::monitor::Monitor;
use crate::worker::{POLL_PERIOD, PauseDetector, StallDetector, Waker, Worker, pause_reason};
use applied_setting_history::AppliedSettingHistory;
use buffer_pool::BufferPool;
use image::Capture;
use socket::ImageSocket;
use stamp_validator::StampValidator;
use v4l2::V4l2;
pub(crate) use v4l2::describe as describe_video_device;

/// A camera whose thread pushes each newest image into the event queue.
#[derive(Debug)]
pub struct CameraDriver {
    worker: Worker,
    monitor: Monitor,
    pending_settings: Arc<Mutex<Option<PendingSettings>>>,
    configured: CameraSettings,
}

/// Settings for the following images.
#[derive(Debug, Clone, Copy)]
struct PendingSettings {
    settings: CameraSettings,
    /// Number of images from a command to the first one with it.
    delay_frames: u64,
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
        #[cfg(feature = "aravis")]
        if let Some(name) = device.device.strip_prefix("genicam:") {
            return genicam::GenICam::open(name, device, size_px).map(CameraBackend::GenICam);
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

    /// Exposure and gain that the device reports. `None` if it does not, or if its images carry them.
    fn applied_setting(&self) -> Option<ExposureSetting> {
        match self {
            CameraBackend::V4l2(camera) => camera.applied_setting(),
            CameraBackend::Socket(_) => None,
            #[cfg(feature = "aravis")]
            CameraBackend::GenICam(camera) => camera.applied_setting(),
        }
    }

    /// Discards the images that wait for this program. An error if the device is to be opened anew.
    fn discard_waiting(&mut self, waker: &Waker, pool: &BufferPool) -> Result<(), HwError> {
        let until = clock::now() + DISCARD_TIME_MAX;
        match self {
            CameraBackend::Socket(socket) => {
                let waits = || waker.wait(Some(socket.as_fd()), clock::now());
                while waits() && clock::now() < until && !waker.stop_requested() {
                    socket.receive(pool)?;
                }
                Ok(())
            }
            // A capture takes all.
            CameraBackend::V4l2(camera) => camera.capture(pool).map(drop),
            #[cfg(feature = "aravis")]
            CameraBackend::GenICam(camera) => camera.capture(pool).map(drop),
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

impl CameraDriver {
    /// Starts the camera's thread, which opens the device as soon as it is present. Fails for an invalid configuration.
    ///
    /// `size_px`: columns and rows of the image. Images over a socket have the size that their sender chooses.
    /// `queued_images`: images that consumers may queue at once, as a log does; memory is reserved for them.
    pub fn start(
        device: &CameraDeviceConfig,
        size_px: [u32; 2],
        queued_images: usize,
        queue: &EventQueue,
    ) -> Result<Self, HwError> {
        device.check()?;
        let monitor = Monitor::new("camera", queue);
        let pending_settings = Arc::new(Mutex::new(None));
        let mut capture_loop = CaptureLoop {
            device: device.clone(),
            settings: None,
            in_force: AppliedSettingHistory::default(),
            pending_settings: Arc::clone(&pending_settings),
            pool: BufferPool::new(queued_images),
            monitor: monitor.clone(),
            queue: queue.clone(),
            resumed: None,
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
            configured: CameraSettings::from_config(device),
        })
    }

    /// Applies settings to the following images.
    pub fn set_settings(&self, settings: CameraSettings) {
        self.push_settings(settings, 1);
    }

    /// Sets exposure (seconds) and gain (unit of the driver) of the following images; `delay_frames`: number of images
    /// from a command to the first one exposed with it.
    ///
    /// The device limits and rounds them. [`CapturedImage::setting`] has what is in force.
    pub fn set_exposure(&self, setting: ExposureSetting, delay_frames: u64) {
        self.push_settings(self.configured.with_exposure(setting), delay_frames);
    }

    fn push_settings(&self, settings: CameraSettings, delay_frames: u64) {
        *self
            .pending_settings
            .lock()
            .unwrap_or_else(PoisonError::into_inner) = Some(PendingSettings {
            settings,
            delay_frames,
        });
        self.worker.wake();
    }

    /// Health of the camera.
    pub fn health(&self) -> HealthReport {
        self.monitor.health(clock::now())
    }
}

/// Longest time in which a sender's images are discarded without their stamps, seconds: some send whenever the last one was taken.
const DISCARD_TIME_MAX: f64 = 0.1;
/// Time after a pause in which images that were taken before its end may come from a sender that waited, seconds. Later such a stamp is
/// one of another clock.
const STALE_TIME: f64 = 0.5;
/// Bytes that are compared to detect a repeated image; sensor noise changes some of any hundred.
const COMPARED_BYTES: usize = 4096;

struct CaptureLoop {
    device: CameraDeviceConfig,
    /// The last settings that were applied; a replugged camera gets them again.
    settings: Option<PendingSettings>,
    in_force: AppliedSettingHistory,
    pending_settings: Arc<Mutex<Option<PendingSettings>>>,
    pool: BufferPool,
    monitor: Monitor,
    queue: EventQueue,
    /// End of the last pause of this program.
    resumed: Option<Stamp>,
}

impl CaptureLoop {
    fn run(&mut self, backend: &mut CameraBackend, waker: &Waker) -> Result<(), HwError> {
        let mut stall_detector = StallDetector::new(&self.device.device, self.device.stall);
        let mut repeat_detector = RepeatDetector::default();
        let mut stamp_validator = StampValidator::default();
        self.in_force = AppliedSettingHistory::new(backend.applied_setting());
        if let Some(pending) = self.settings {
            self.apply_settings(backend, pending)?;
        }
        let mut pause_detector = PauseDetector::new(clock::now());
        while !waker.stop_requested() {
            let ready = backend.wait(waker, clock::now() + POLL_PERIOD);
            let capture = ready.then(|| backend.capture(&self.pool));
            let now = clock::now();
            if let Some(pause) = pause_detector.check(now) {
                self.monitor.report_event(pause_reason(pause));
                let is_alive = capture.is_none_or(|capture| capture.is_ok())
                    && backend.discard_waiting(waker, &self.pool).is_ok();
                let resumed = clock::now();
                self.resumed = Some(resumed);
                self.queue.discard_image();
                if !is_alive {
                    // A sender gives up a reader that takes nothing, which is no fault of the camera: it is opened anew.
                    return Ok(());
                }
                stall_detector.on_message(resumed, 0);
                repeat_detector = RepeatDetector::default();
                continue;
            }
            let capture = capture.transpose()?;
            let pending = self
                .pending_settings
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .take();
            if let Some(pending) = pending {
                self.apply_settings(backend, pending)?;
            }
            if let Some(capture) = capture {
                (0..capture.damaged).for_each(|_| self.monitor.count_damaged());
                if let Some(image) = capture.image {
                    if self.is_stale(&image, now) {
                        stall_detector.on_message(now, 0);
                        continue;
                    }
                    let unchanged_since = repeat_detector.unchanged_since(&image, now);
                    stall_detector.on_message(now, 0);
                    let Some(mut image) = image.decompress(&self.pool) else {
                        self.monitor.count_damaged();
                        continue;
                    };
                    self.pool.reserve(image.data.len());
                    let validated = stamp_validator.validate(image.stamp, now);
                    image.stamp = validated.stamp;
                    image.repeated = unchanged_since < now;
                    image.setting = image.setting.or(self.in_force.at(image.stamp));
                    self.monitor.count_message(now);
                    self.update_health(unchanged_since, validated.from_camera, now);
                    self.queue.push(DeviceEvent::Image(image));
                }
            }
            // By the time of the check for a pause: one that began since is no silence of the camera.
            stall_detector.check(now, 0)?;
        }
        Ok(())
    }

    /// Was the image taken before the end of the last pause? Its stamp says so, unless it is one of another clock.
    fn is_stale(&self, image: &CapturedImage, now: Stamp) -> bool {
        self.resumed
            .is_some_and(|resumed| image.stamp < resumed && now - resumed < STALE_TIME)
    }

    /// Applies settings. A device that refuses them keeps its own and streams on; that is reported.
    fn apply_settings(
        &mut self,
        backend: &CameraBackend,
        pending: PendingSettings,
    ) -> Result<(), HwError> {
        self.settings = Some(pending);
        match backend.apply_settings(&pending.settings) {
            Err(HwError::Unsupported { reason, .. }) => self.monitor.report_event(reason),
            result => result?,
        }
        // An image that is being exposed or read out now was started with the settings before.
        let frames = pending.delay_frames.saturating_sub(2) as f64;
        let from = clock::now() + frames / f64::from(self.device.rate_hz.max(1.0));
        self.in_force.change(from, backend.applied_setting());
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
