//! Aravis' fake camera on loopback: images arrive, also after the camera was switched off and on again.
#![cfg(feature = "aravis")]

#[expect(dead_code, reason = "this camera needs no serial port")]
mod pseudo_terminal;

use std::process::{Child, Command, Stdio};

use hw::config::CameraDeviceConfig;
use hw::{CameraDriver, DeviceEvent, EventQueue, HealthState};
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

#[test]
fn genicam_camera_streams_and_reconnects() {
    let Some(fake) = FakeGenICamCamera::start() else {
        // Continuous integration installs the tool: a test that is left out there proves nothing.
        assert!(
            std::env::var_os("MIRRORBALL_REQUIRE_TOOLS").is_none(),
            "arv-fake-gv-camera-0.8 (aravis-tools) is not installed"
        );
        eprintln!("skipped: arv-fake-gv-camera-0.8 (aravis-tools) is not installed");
        return;
    };
    let device = CameraDeviceConfig {
        device: "genicam:".to_owned(),
        rate_hz: 50.0,
        format: "GREY".to_owned(),
        exposure: Some(0.005),
        gain: Some(1),
        white_balance_k: None,
        stall: 1.0,
    };
    let queue = EventQueue::new(64);
    let camera = CameraDriver::start(&device, [256, 128], &queue).expect("started");
    let next_image = || {
        wait_for_event(&queue, "an image", |event| match event {
            DeviceEvent::Image(image) => Some(image),
            // The test's output then says why there is none.
            other => {
                eprintln!("{other:?}");
                None
            }
        })
    };
    let (first, second) = (next_image(), next_image());
    assert_eq!(
        (first.width_px, first.height_px, first.data.len()),
        (256, 128, 256 * 128)
    );
    assert!(second.stamp > first.stamp && second.sequence > first.sequence);
    drop(fake);
    wait_until("not running", || {
        (camera.health().state != HealthState::Running).then_some(())
    });
    let fake = FakeGenICamCamera::start().expect("started again");
    while queue.pop_timeout(std::time::Duration::ZERO).is_some() {}
    next_image();
    wait_until("running again", || {
        (camera.health().state == HealthState::Running).then_some(())
    });
    drop(fake);
}
