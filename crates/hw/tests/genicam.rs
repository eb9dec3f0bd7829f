//! Aravis' fake camera on loopback: images arrive, also after the camera was switched off and on again, and have the
//! exposure and gain that were set.
#![cfg(feature = "aravis")]

#[expect(dead_code, reason = "this camera needs no serial port")]
mod pseudo_terminal;

use std::process::{Child, Command, Stdio};
use std::sync::{Mutex, PoisonError};

use hw::camera::CapturedImage;
use hw::config::CameraDeviceConfig;
use hw::{CameraDriver, DeviceEvent, EventQueue, HealthState};
use localize::math::log10;
use localize::robot::ExposureSetting;
use pseudo_terminal::{wait_for_event, wait_until};

/// The fake camera, which runs until it is dropped.
struct FakeGenICamCamera(Child);

impl FakeGenICamCamera {
    /// `None` if Aravis' tools are not installed.
    fn start() -> Option<Self> {
        Command::new("arv-fake-gv-camera-0.8")
            .args(["-i", "127.0.0.1"])
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .ok()
            .map(FakeGenICamCamera)
    }
}

impl Drop for FakeGenICamCamera {
    fn drop(&mut self) {
        self.0.kill().expect("killed");
        self.0.wait().expect("ended");
    }
}

/// Columns (whole periods of the camera's ramp) and rows.
const SIZE_PX: [u32; 2] = [510, 128];

/// The fake camera's port is fixed, so that only one can run at a time.
static CAMERA_PORT: Mutex<()> = Mutex::new(());

/// The fake camera. None, after a message, where it is not installed and not required.
fn fake_camera() -> Option<FakeGenICamCamera> {
    let fake = FakeGenICamCamera::start();
    if fake.is_none() {
        // Continuous integration installs the tool: a test that is left out there proves nothing.
        assert!(
            std::env::var_os("MIRRORBALL_REQUIRE_TOOLS").is_none(),
            "arv-fake-gv-camera-0.8 (aravis-tools) is not installed"
        );
        eprintln!("skipped: arv-fake-gv-camera-0.8 (aravis-tools) is not installed");
    }
    fake
}

fn grey_camera() -> CameraDeviceConfig {
    CameraDeviceConfig {
        device: "genicam:".to_owned(),
        rate_hz: 50.0,
        format: "GREY".to_owned(),
        exposure: Some(0.005),
        gain: Some(1),
        white_balance_k: None,
        stall: 1.0,
    }
}

fn next_image(queue: &EventQueue) -> CapturedImage {
    wait_for_event(queue, "an image", |event| match event {
        DeviceEvent::Image(image) => Some(image),
        // The test's output then says why there is none.
        other => {
            eprintln!("{other:?}");
            None
        }
    })
}

#[test]
fn genicam_camera_streams_and_reconnects() {
    let _alone = CAMERA_PORT.lock().unwrap_or_else(PoisonError::into_inner);
    let Some(fake) = fake_camera() else {
        return;
    };
    let queue = EventQueue::new(64);
    let camera = CameraDriver::start(&grey_camera(), SIZE_PX, 0, &queue).expect("started");
    let (first, second) = (next_image(&queue), next_image(&queue));
    assert_eq!(
        (first.width_px, first.height_px, first.data.len()),
        (510, 128, 510 * 128)
    );
    assert!(second.stamp > first.stamp && second.sequence > first.sequence);
    let setting = ExposureSetting {
        exposure: 0.02,
        gain: 0.0,
    };
    camera.set_exposure(setting, 2);
    drop(fake);
    wait_until("not running", || {
        (camera.health().state != HealthState::Running).then_some(())
    });
    let fake = FakeGenICamCamera::start().expect("started again");
    while queue.pop_timeout(std::time::Duration::ZERO).is_some() {}
    // It gets the last setting again.
    let found = (0..100).map(|_| next_image(&queue)).find(|image| {
        let expected = expected_brightness(setting);
        (brightness(image) - expected).abs() < 0.02 * expected
    });
    assert!(found.is_some(), "the setting was lost");
    wait_until("running again", || {
        (camera.health().state == HealthState::Running).then_some(())
    });
    drop(fake);
}

/// Mean grey value. The fake camera draws a ramp of 0 to 254 at 10 ms and gain 0.
fn brightness(image: &CapturedImage) -> f64 {
    let sum: u64 = image.data.iter().map(|value| u64::from(*value)).sum();
    sum as f64 / image.data.len() as f64
}

/// The fake camera's pixels at an exposure and gain: its ramp times 1 + gain + log10(exposure / 10 ms), cut at 0 and 255.
fn expected_brightness(setting: ExposureSetting) -> f64 {
    let scale = 1.0 + f64::from(setting.gain) + log10(f64::from(setting.exposure) / 0.01);
    let values = (0..255).map(|value| (f64::from(value) * scale).clamp(0.0, 255.0).floor());
    values.sum::<f64>() / 255.0
}

#[test]
fn images_have_the_exposure_and_gain_that_are_stated_to_be_in_force() {
    let _alone = CAMERA_PORT.lock().unwrap_or_else(PoisonError::into_inner);
    let Some(fake) = fake_camera() else {
        return;
    };
    let queue = EventQueue::new(64);
    let camera = CameraDriver::start(&grey_camera(), SIZE_PX, 0, &queue).expect("started");
    let setting = |exposure, gain| ExposureSetting { exposure, gain };
    // The camera's own description has 10 µs to 10 s and gains of 0 to 10 in whole numbers.
    for (wanted, in_force) in [
        // From the configuration.
        (None, setting(0.005, 1.0)),
        (Some(setting(0.004, 0.0)), setting(0.004, 0.0)),
        (Some(setting(0.002, 0.6)), setting(0.002, 1.0)),
        (Some(setting(0.000_123, 1.4)), setting(0.000_123, 1.0)),
        (Some(setting(0.0, -3.0)), setting(1e-5, 0.0)),
        (Some(setting(1e6, 1e6)), setting(10.0, 10.0)),
        (Some(setting(0.01, 0.0)), setting(0.01, 0.0)),
    ] {
        if let Some(wanted) = wanted {
            camera.set_exposure(wanted, 2);
        }
        let is_stated = |image: &CapturedImage| {
            let stated = image.setting.expect("the camera reports its setting");
            // The camera has whole microseconds.
            let error = (stated.exposure - in_force.exposure).abs();
            error < 1.1e-6 && stated.gain == in_force.gain
        };
        let mut stated = None;
        let found = (0..500).map(|_| next_image(&queue)).any(|image| {
            stated = image.setting;
            is_stated(&image)
        });
        assert!(found, "{stated:?} instead of {in_force:?}");
        // The statement is a prediction from the time of the command: an image or two later it must be true.
        drop(next_image(&queue));
        let later = next_image(&queue);
        assert!(is_stated(&later), "{:?}", later.setting);
        let (measured, expected) = (brightness(&later), expected_brightness(in_force));
        assert!(
            (measured - expected).abs() < 0.02 * expected + 1.0,
            "{in_force:?}: brightness {measured} instead of {expected}"
        );
    }
    drop(fake);
}
