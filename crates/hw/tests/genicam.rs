//! Aravis' own fake camera on loopback: frames come, and a camera that was switched off and on again comes back.
#![cfg(feature = "aravis")]

#[expect(dead_code, reason = "this camera needs no serial line")]
mod pseudo_terminal;

use std::process::{Child, Command, Stdio};

use hw::config::CameraDevice;
use hw::{Camera, Event, Inbox, State};
use pseudo_terminal::{event, until};

/// The fake camera, switched on until it is dropped.
struct FakeGenICamCamera(Child);

impl Fake {
    /// `None` where Aravis' tools are not installed.
    fn start() -> Option<Self> {
        Command::new("arv-fake-gv-camera-0.8")
            .args(["-i", "127.0.0.1"])
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .ok()
            .map(Fake)
    }
}

impl Drop for Fake {
    fn drop(&mut self) {
        self.0.kill().expect("killed");
        self.0.wait().expect("ended");
    }
}

#[test]
fn genicam_camera_streams_and_reconnects() {
    let Some(fake) = Fake::switch_on() else {
        eprintln!("skipped: arv-fake-gv-camera-0.8 (aravis-tools) is not installed");
        return;
    };
    let device = CameraDevice {
        device: "genicam:".to_owned(),
        rate_hz: 50.0,
        format: "GREY".to_owned(),
        exposure: Some(0.005),
        gain: Some(1),
        white_balance_k: None,
        stall: 1.0,
    };
    let inbox = Inbox::new(64);
    let camera = Camera::start(&device, [256, 128], &inbox).expect("started");
    let frame = || {
        event(&inbox, "a frame", |event| match event {
            Event::Frame(frame) => Some(frame),
            // Why there is none stands in the test's output.
            other => {
                eprintln!("{other:?}");
                None
            }
        })
    };
    let (first, second) = (frame(), frame());
    assert_eq!(
        (first.width_px, first.height_px, first.data.len()),
        (256, 128, 256 * 128)
    );
    assert!(second.stamp > first.stamp && second.sequence > first.sequence);
    drop(fake);
    until("the word that it is gone", || {
        (camera.health().state != State::Running).then_some(())
    });
    let fake = Fake::switch_on().expect("as before");
    while inbox.take(std::time::Duration::ZERO).is_some() {}
    frame();
    until("running again", || {
        (camera.health().state == State::Running).then_some(())
    });
    drop(fake);
}
