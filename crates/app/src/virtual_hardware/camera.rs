//! How is a camera simulated? A local socket that sends images in real time; a slow reader loses images.

use std::io::{Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Context, Result};
use hw::camera::Encoding;
use hw::wire::image_stream::{HEADER_BYTES, ImageHeader, SETTINGS_BYTES, SettingsMessage};
use localize::robot::ExposureSetting;

use super::timing::raise_thread_priority;

/// Longest time for a reader to take an image; then the connection is closed, so that it cannot block the thread.
const IO_TIMEOUT: Duration = Duration::from_millis(500);
/// Requested send buffer, bytes: an image of 480 × 480 pixels in three bytes each, with the system's overhead.
const SEND_BUFFER_BYTES: usize = 1 << 20;
/// Longest wait for a reader or an image: the latency of a stop.
const POLL_PERIOD: Duration = Duration::from_millis(20);

/// An image to send.
#[derive(Debug, Clone)]
pub(super) struct QueuedImage {
    /// Exposure time, CLOCK_MONOTONIC, nanoseconds.
    pub(super) stamp_ns: i64,
    /// Columns and rows.
    pub(super) size_px: [usize; 2],
    /// Exposure, seconds, and gain with which it was taken.
    pub(super) setting: ExposureSetting,
    /// Red, green, blue.
    pub(super) rgb: Arc<Vec<u8>>,
    /// Only this share of it is sent, and then nothing more.
    pub(super) truncated_to: Option<f32>,
}

/// The camera's socket and thread.
#[derive(Debug)]
pub(super) struct VirtualCamera {
    shared: Arc<CameraState>,
    thread: Option<JoinHandle<()>>,
    path: PathBuf,
}

#[derive(Debug, Default)]
struct CameraState {
    newest: Mutex<Option<QueuedImage>>,
    commanded_setting: Mutex<Option<ExposureSetting>>,
    image_queued: Condvar,
    unplugged: AtomicBool,
    stop_requested: AtomicBool,
}

impl VirtualCamera {
    /// Listens at `path`; sends images in the given encoding (RGB3 or YUYV).
    pub(super) fn start(path: &Path, encoding: Encoding) -> Result<Self> {
        let shared = Arc::new(CameraState::default());
        let (state, socket_path) = (Arc::clone(&shared), path.to_owned());
        // The first listener is created here, so that an invalid path is an error at once.
        let mut listener = Some(listen(path)?);
        let serve = move || {
            raise_thread_priority();
            let mut sequence = 0;
            while !state.stop_requested.load(Ordering::Relaxed) {
                if state.unplugged.load(Ordering::Relaxed) {
                    listener = None;
                    let _gone = std::fs::remove_file(&socket_path);
                    std::thread::sleep(POLL_PERIOD);
                    continue;
                }
                if listener.is_none() {
                    listener = listen(&socket_path).ok();
                }
                match listener.as_ref().map(UnixListener::accept) {
                    Some(Ok((peer, _))) => state.serve(peer, encoding, &mut sequence),
                    _ => std::thread::sleep(POLL_PERIOD),
                }
            }
        };
        let thread = std::thread::Builder::new()
            .name("camera".to_owned())
            .spawn(serve)?;
        Ok(VirtualCamera {
            shared,
            thread: Some(thread),
            path: path.to_owned(),
        })
    }

    /// Queues an image; an image that is still waiting is lost.
    pub(super) fn send(&self, image: QueuedImage) {
        *self.shared.newest() = Some(image);
        self.shared.image_queued.notify_all();
    }

    /// Exposure, seconds, and gain that a reader has set since the last call.
    pub(super) fn take_commanded_setting(&self) -> Option<ExposureSetting> {
        self.shared.commanded_setting().take()
    }

    /// Unplugs the camera, or plugs it in again.
    pub(super) fn set_unplugged(&self, unplugged: bool) {
        self.shared.unplugged.store(unplugged, Ordering::Relaxed);
    }
}

impl Drop for VirtualCamera {
    fn drop(&mut self) {
        self.shared.stop_requested.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A panic was reported when it happened.
            let _ended = thread.join();
        }
        let _gone = std::fs::remove_file(&self.path);
    }
}

fn listen(path: &Path) -> Result<UnixListener> {
    let _none = std::fs::remove_file(path);
    let listener =
        UnixListener::bind(path).with_context(|| format!("cannot listen at {}", path.display()))?;
    listener.set_nonblocking(true)?;
    Ok(listener)
}

impl CameraState {
    fn newest(&self) -> MutexGuard<'_, Option<QueuedImage>> {
        self.newest.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn commanded_setting(&self) -> MutexGuard<'_, Option<ExposureSetting>> {
        let setting = self.commanded_setting.lock();
        setting.unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes over the settings that a reader sent. Automatic values leave the camera as it is.
    fn obey(&self, bytes: &[u8; SETTINGS_BYTES]) {
        let Some(settings) = SettingsMessage::decode(bytes) else {
            return;
        };
        let gain = match settings.gain_centi {
            Some(gain_centi) => gain_centi as f32 * 0.01,
            None => settings.gain as f32,
        };
        if settings.exposure_us > 0 && gain > 0.0 {
            *self.commanded_setting() = Some(ExposureSetting {
                exposure: settings.exposure_us as f32 * 1e-6,
                gain,
            });
        }
    }

    /// Sends images to one reader until it is gone or the camera is unplugged.
    fn serve(&self, mut peer: UnixStream, encoding: Encoding, sequence: &mut u32) {
        // A whole image should fit, or sender and reader alternate. The system may allow less.
        let _less = socket2::SockRef::from(&peer).set_send_buffer_size(SEND_BUFFER_BYTES);
        let ready = peer
            .set_nonblocking(false)
            .and_then(|()| peer.set_read_timeout(Some(IO_TIMEOUT)))
            .and_then(|()| peer.set_write_timeout(Some(IO_TIMEOUT)));
        // A reader first sends the camera settings.
        let mut settings = [0; SETTINGS_BYTES];
        if ready.is_err() || peer.read_exact(&mut settings).is_err() {
            return;
        }
        self.obey(&settings);
        let mut bytes = Vec::new();
        let mut pending_settings = Vec::new();
        loop {
            receive_settings(&peer, &mut pending_settings, |message| self.obey(message));
            let (mut newest, _) = self
                .image_queued
                .wait_timeout_while(self.newest(), POLL_PERIOD, |newest| newest.is_none())
                .unwrap_or_else(PoisonError::into_inner);
            let image = newest.take();
            drop(newest);
            if self.stop_requested.load(Ordering::Relaxed) || self.unplugged.load(Ordering::Relaxed)
            {
                return;
            }
            let Some(image) = image else { continue };
            *sequence = sequence.wrapping_add(1);
            let pixels = encode(&image, encoding, &mut bytes);
            let pixels = match image.truncated_to {
                Some(share) => &pixels[..(pixels.len() as f32 * share) as usize],
                None => pixels,
            };
            let header = header(&image, encoding, *sequence);
            if peer.write_all(&header).is_err() || peer.write_all(pixels).is_err() {
                return;
            }
            if image.truncated_to.is_some() {
                // Nothing more is sent until the reader closes the connection.
                let mut nothing = [0; 16];
                while !self.stop_requested.load(Ordering::Relaxed) {
                    match peer.read(&mut nothing) {
                        Ok(1..) => {}
                        Ok(0) | Err(_) => return,
                    }
                }
            }
        }
    }
}

/// Reads the settings that a reader has sent; `pending` holds an incomplete message.
fn receive_settings(
    peer: &UnixStream,
    pending: &mut Vec<u8>,
    mut obey: impl FnMut(&[u8; SETTINGS_BYTES]),
) {
    let mut bytes = [0; SETTINGS_BYTES];
    while let Ok((length @ 1.., _)) =
        rustix::net::recv(peer, &mut bytes[..], rustix::net::RecvFlags::DONTWAIT)
    {
        pending.extend_from_slice(&bytes[..length]);
        while let Some((message, rest)) = pending.split_first_chunk::<SETTINGS_BYTES>() {
            obey(message);
            *pending = rest.to_vec();
        }
    }
}

/// Header of an image.
fn header(image: &QueuedImage, encoding: Encoding, sequence: u32) -> [u8; HEADER_BYTES] {
    let [width_px, height_px] = image.size_px;
    let stride = encoding.row_bytes(width_px);
    let header = ImageHeader {
        fourcc: encoding.fourcc(),
        width_px: width_px as u32,
        height_px: height_px as u32,
        stride: stride as u32,
        sequence,
        bytes: (stride * height_px) as u32,
        stamp_ns: image.stamp_ns,
        exposure_us: (image.setting.exposure * 1e6).round() as u32,
        gain_centi: (image.setting.gain * 100.0).round() as i16,
    };
    header.encode()
}

/// Pixels of an image; `yuyv` is the buffer for a conversion.
fn encode<'a>(image: &'a QueuedImage, encoding: Encoding, yuyv: &'a mut Vec<u8>) -> &'a [u8] {
    if encoding != Encoding::Yuyv {
        return &image.rgb;
    }
    yuyv.clear();
    for pair in image.rgb.chunks_exact(6) {
        let [a, b] =
            [0, 3].map(|at| vision::image::rgb_to_yuv([pair[at], pair[at + 1], pair[at + 2]]));
        let mean = |a: u8, b: u8| ((u16::from(a) + u16::from(b)) / 2) as u8;
        yuyv.extend_from_slice(&[a[0], mean(a[1], b[1]), b[0], mean(a[2], b[2])]);
    }
    yuyv
}
