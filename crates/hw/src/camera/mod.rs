//! How do images reach the robot's eyes? A thread per camera: newest frame wins, silence and repetition are named.

mod frame;
#[cfg(feature = "aravis")]
mod genicam;
mod jpeg;
mod socket;
mod stamps;
mod sys;
mod v4l2;

use std::os::fd::AsFd;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use localize::Stamp;

pub use frame::{CameraFrame, Encoding, FrameBytes};

use crate::clock;
use crate::config::CameraDevice;
use crate::error::HwError;
use crate::health::{Health, Monitor, State};
use crate::inbox::{Event, Inbox};
use crate::worker::{Bell, Watch, Worker};
use frame::Pool;
use socket::FrameSocket;
use stamps::Stamps;
use v4l2::V4l2;

/// How frames are taken; what is left out is left to the camera.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Settings {
    /// Exposure, seconds.
    pub exposure: Option<f32>,
    /// Gain, the driver's own unit.
    pub gain: Option<i32>,
    /// White balance, kelvin.
    pub white_balance_k: Option<i32>,
}

impl Settings {
    fn of(device: &CameraDevice) -> Self {
        Settings {
            exposure: device.exposure,
            gain: device.gain,
            white_balance_k: device.white_balance_k,
        }
    }
}

/// A camera whose thread puts each newest frame into the inbox.
#[derive(Debug)]
pub struct Camera {
    worker: Worker,
    monitor: Monitor,
    wanted: Arc<Mutex<Option<Settings>>>,
}

/// Where frames come from.
#[derive(Debug)]
enum Source {
    V4l2(V4l2),
    Socket(FrameSocket),
    #[cfg(feature = "aravis")]
    GenICam(genicam::GenICam),
}

impl Source {
    fn open(device: &CameraDevice, size_px: [u32; 2]) -> Result<Self, HwError> {
        if let Some(path) = device.device.strip_prefix("unix:") {
            return FrameSocket::open(path, &Settings::of(device)).map(Source::Socket);
        }
        if let Some(name) = device.device.strip_prefix("genicam:") {
            return open_genicam(name, device, size_px);
        }
        V4l2::open(device, size_px).map(Source::V4l2)
    }

    /// Waits until a frame may be there; false if none came by the deadline or the bell rang.
    fn wait(&self, bell: &Bell, deadline: Stamp) -> bool {
        match self {
            Source::V4l2(camera) => bell.wait(Some(camera.as_fd()), deadline),
            Source::Socket(socket) => bell.wait(Some(socket.as_fd()), deadline),
            // Has nothing that can be waited for together with the bell; `take` waits itself.
            #[cfg(feature = "aravis")]
            Source::GenICam(_) => true,
        }
    }

    fn set(&self, settings: &Settings) -> Result<(), HwError> {
        match self {
            Source::V4l2(camera) => camera.set(settings),
            Source::Socket(socket) => socket.set(settings),
            #[cfg(feature = "aravis")]
            Source::GenICam(camera) => camera.set(settings),
        }
    }

    /// The newest whole frame, and how many torn ones came before it.
    fn take(&mut self, pool: &Pool) -> Result<(Option<CameraFrame>, u32), HwError> {
        match self {
            Source::V4l2(camera) => camera.take(pool),
            Source::Socket(socket) => socket.take(pool).map(|frame| (Some(frame), 0)),
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
fn open_genicam(_: &str, device: &CameraDevice, _: [u32; 2]) -> Result<Source, HwError> {
    Err(HwError::Unfit {
        device: device.device.clone(),
        reason: "this program was built without GenICam cameras (feature aravis)".to_owned(),
    })
}

impl Camera {
    /// Starts the camera's thread, which opens the device now or whenever it appears; `size_px` is columns and rows of the
    /// wanted image. A socket's images have the size that their sender gives them.
    pub fn start(device: &CameraDevice, size_px: [u32; 2], inbox: &Inbox) -> Result<Self, HwError> {
        let monitor = Monitor::new("camera", inbox);
        let wanted = Arc::new(Mutex::new(None));
        let mut server = Server {
            device: device.clone(),
            // A camera that is plugged in again gets what was set last.
            settings: None,
            wanted: Arc::clone(&wanted),
            pool: Pool::default(),
            monitor: monitor.clone(),
            inbox: inbox.clone(),
        };
        let opened = device.clone();
        let worker = Worker::start(
            "camera",
            &monitor,
            move || Source::open(&opened, size_px),
            move |source, bell| server.serve(source, bell),
        )?;
        Ok(Camera {
            worker,
            monitor,
            wanted,
        })
    }

    /// Has the following frames taken with these settings.
    pub fn set(&self, settings: Settings) {
        *self.wanted.lock().unwrap_or_else(PoisonError::into_inner) = Some(settings);
        self.worker.ring();
    }

    /// How the camera is.
    pub fn health(&self) -> Health {
        self.monitor.health(clock::now())
    }
}

/// Longest wait before a thread looks at silence again, seconds.
const LOOK: f64 = 0.05;
/// Bytes compared to tell one frame from the next; the noise of a sensor shows in any hundred.
const COMPARED: usize = 4096;

struct Server {
    device: CameraDevice,
    settings: Option<Settings>,
    wanted: Arc<Mutex<Option<Settings>>>,
    pool: Pool,
    monitor: Monitor,
    inbox: Inbox,
}

impl Server {
    fn serve(&mut self, source: &mut Source, bell: &Bell) -> Result<(), HwError> {
        let mut watch = Watch::new(&self.device.device, self.device.stall);
        let mut repeated = Repeated::default();
        let mut stamps = Stamps::default();
        if let Some(settings) = &self.settings {
            source.set(settings)?;
        }
        while !bell.stopped() {
            let ready = source.wait(bell, clock::now() + LOOK);
            let wanted = self
                .wanted
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .take();
            if let Some(settings) = wanted {
                source.set(&settings)?;
                self.settings = Some(settings);
            }
            if ready {
                let (frame, torn) = source.take(&self.pool)?;
                (0..torn).for_each(|_| self.monitor.torn());
                let now = clock::now();
                let same_since = frame.as_ref().map(|frame| repeated.since(frame, now));
                if let (Some(frame), Some(same_since)) = (frame, same_since) {
                    watch.message(now, 0);
                    let Some(mut frame) = frame.unpacked(&self.pool) else {
                        self.monitor.torn();
                        continue;
                    };
                    let (stamp, own_stamp) = stamps.judge(frame.stamp, now);
                    frame.stamp = stamp;
                    frame.repeated = same_since < now;
                    self.monitor.message(now);
                    self.judge(same_since, own_stamp, now);
                    self.inbox.put(Event::Frame(frame));
                }
            }
            watch.check(clock::now(), 0)?;
        }
        Ok(())
    }

    fn judge(&self, same_since: Stamp, own_stamp: bool, now: Stamp) {
        if now - same_since > f64::from(self.device.stall) {
            let reason = "the image does not change by a single bit".to_owned();
            self.monitor.state(State::Stuck, Some(reason));
        } else if !own_stamp {
            let reason = "its stamps cannot be true: frames are stamped as they arrive".to_owned();
            self.monitor.state(State::Clock, Some(reason));
        } else {
            self.monitor.state(State::Running, None);
        }
    }
}

/// Since when has the image been the same?
#[derive(Debug, Default)]
struct Repeated {
    sample: Vec<u8>,
    since: Stamp,
}

impl Repeated {
    fn since(&mut self, frame: &CameraFrame, now: Stamp) -> Stamp {
        let step = (frame.data.len() / COMPARED).max(1);
        let sample = || frame.data.iter().step_by(step);
        if !sample().eq(self.sample.iter()) {
            self.sample.clear();
            self.sample.extend(sample());
            self.since = now;
        }
        self.since
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
