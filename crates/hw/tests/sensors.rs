//! Serial lines, inertial units and the camera's socket: what comes, what fails, and how it is told.

mod bench_top;

use std::io::{Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::time::Duration;

use bench_top::{Socket, event, until};
use hw::config::{CameraDevice, InertialDevice, Sensor};
use hw::wire::bno085::Rvc;
use hw::wire::frames::{FrameHeader, FrameSettings, SETTINGS_BYTES};
use hw::{Camera, Event, HwError, Inbox, Inertial, Serial, State, camera};

#[test]
fn a_serial_line_carries_every_byte_value_both_ways() {
    let socket = Socket::plugged();
    let serial = Serial::open(&socket.name(), 115_200).expect("open");
    let all: Vec<u8> = (0..=255).collect();
    socket.send(&all);
    let mut found = Vec::new();
    until("256 bytes", || {
        let mut buffer = [0; 64];
        let bytes = serial.read(&mut buffer, hw::now() + 0.01).expect("read");
        found.extend_from_slice(&buffer[..bytes]);
        (found.len() == 256).then_some(())
    });
    assert_eq!(found, all);
    serial.write(&all, hw::now() + 5.0).expect("written");
    let mut back = Vec::new();
    until("256 bytes back", || {
        back.extend(socket.received());
        (back.len() == 256).then_some(())
    });
    assert_eq!(back, all);
    assert_eq!(serial.read(&mut [0; 8], hw::now()), Ok(0), "nothing more");
}

#[test]
fn busy_missing_stuck_and_unplugged_lines_are_told_apart() {
    let mut socket = Socket::plugged();
    let serial = Serial::open(&socket.name(), 1_000_000).expect("open");
    let busy = Serial::open(&socket.name(), 115_200);
    assert!(matches!(busy, Err(HwError::Busy { .. })), "{busy:?}");
    let full = until("a full line", || {
        serial.write(&[0; 4096], hw::now() + 0.01).err()
    });
    assert!(matches!(full, HwError::Stalled { .. }), "{full:?}");
    socket.unplug();
    let gone = until("an error", || {
        serial.read(&mut [0; 8], hw::now() + 0.01).err()
    });
    assert!(matches!(gone, HwError::Unplugged { .. }), "{gone:?}");
    let missing = Serial::open(&socket.name(), 115_200);
    assert!(
        matches!(missing, Err(HwError::Missing { .. })),
        "{missing:?}"
    );
    let file = Serial::open("/dev/null", 115_200).expect_err("no line");
    assert_eq!(file.to_string(), "/dev/null: is no serial line");
}

#[test]
fn a_stuck_inertial_unit_is_named_and_taken_back() {
    let socket = Socket::plugged();
    let inbox = Inbox::new(1024);
    let device = InertialDevice {
        sensor: Sensor::Bno085,
        port: socket.name(),
        baud: 115_200,
        imu: true,
        compass: false,
        magnetometer: false,
        mount_deg: [0.0; 3],
        clockwise: false,
        north_deg: 0.0,
        stall: 0.3,
        stuck: 0.1,
    };
    let imu = Inertial::start("imu", &device, &inbox).expect("started");
    let mut message = Rvc::default();
    let mut say = |moving: bool| {
        message.index = message.index.wrapping_add(1);
        message.acceleration_mg[2] = 1000 + if moving { i16::from(message.index) } else { 0 };
        socket.send(&message.encode());
        std::thread::sleep(Duration::from_millis(3));
    };
    for (moving, wanted) in [
        (true, State::Running),
        (false, State::Stuck),
        (true, State::Running),
    ] {
        until(&format!("{wanted:?}"), || {
            say(moving);
            (imu.health().state == wanted).then_some(())
        });
    }
    event(&inbox, "a reading", |event| {
        matches!(event, Event::Imu(_)).then_some(())
    });
}

/// A program that sends frames.
struct Sender {
    listener: UnixListener,
    peer: Option<UnixStream>,
    sequence: u32,
}

impl Sender {
    fn frame(&mut self, level: u8) -> Vec<u8> {
        self.sequence += 1;
        let header = FrameHeader {
            fourcc: u32::from_le_bytes(*b"RGB3"),
            width_px: 8,
            height_px: 4,
            stride: 24,
            sequence: self.sequence,
            bytes: 96,
            stamp_ns: hw::now().0,
        };
        [&header.encode()[..], &[level; 96]].concat()
    }

    fn accept(&mut self) -> FrameSettings {
        let (mut peer, _) = self.listener.accept().expect("connected");
        let mut bytes = [0; SETTINGS_BYTES];
        peer.read_exact(&mut bytes).expect("settings");
        self.peer = Some(peer);
        FrameSettings::decode(&bytes).expect("settings")
    }

    fn send(&mut self, bytes: &[u8]) {
        // The driver may have hung up meanwhile; then the next accept tells.
        let _gone = self.peer.as_mut().expect("a peer").write_all(bytes);
    }
}

fn camera_device(path: &std::path::Path) -> CameraDevice {
    CameraDevice {
        device: format!("unix:{}", path.display()),
        rate_hz: 30.0,
        format: String::new(),
        exposure: Some(0.01),
        gain: None,
        white_balance_k: None,
        stall: 0.2,
    }
}

#[test]
fn frames_come_through_and_torn_frozen_and_lost_ones_are_told() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("camera");
    let inbox = Inbox::new(64);
    let camera = Camera::start(&camera_device(&path), [8, 4], &inbox).expect("started");
    let state = |wanted: State| (camera.health().state == wanted).then_some(());
    let mut sender = Sender {
        listener: UnixListener::bind(&path).expect("bound"),
        peer: None,
        sequence: 0,
    };
    let settings = sender.accept();
    assert_eq!((settings.exposure_us, settings.gain), (10_000, -1));
    let mut level = 0u8;
    let mut fresh = |sender: &mut Sender| {
        level = level.wrapping_add(1);
        let bytes = sender.frame(level);
        sender.send(&bytes);
        std::thread::sleep(Duration::from_millis(3));
    };
    until("running", || {
        fresh(&mut sender);
        state(State::Running)
    });
    let frame = event(&inbox, "a frame", |event| match event {
        Event::Frame(frame) => Some(frame),
        _ => None,
    });
    assert_eq!(
        (frame.width_px, frame.height_px, frame.data.len()),
        (8, 4, 96)
    );
    until("dropped frames", || {
        fresh(&mut sender);
        (inbox.dropped().frames > 3).then_some(())
    });
    until("stuck", || {
        let bytes = sender.frame(77);
        sender.send(&bytes);
        std::thread::sleep(Duration::from_millis(3));
        state(State::Stuck)
    });
    until("running again", || {
        fresh(&mut sender);
        state(State::Running)
    });
    // Half a frame, then nothing.
    let half = sender.frame(1);
    sender.send(&half[..60]);
    until("stalled", || state(State::Stalled));
    sender.accept();
    until("running after the half frame", || {
        fresh(&mut sender);
        state(State::Running)
    });
    camera.set(camera::Settings {
        gain: Some(7),
        ..camera::Settings::default()
    });
    let mut bytes = [0; SETTINGS_BYTES];
    sender
        .peer
        .as_mut()
        .expect("a peer")
        .read_exact(&mut bytes)
        .expect("settings");
    assert_eq!(
        FrameSettings::decode(&bytes).map(|settings| settings.gain),
        Some(7)
    );
    // A camera that was pulled out and put in again is set as it was.
    sender.peer = None;
    until("absent", || state(State::Absent));
    sender.accept();
    let mut bytes = [0; SETTINGS_BYTES];
    sender
        .peer
        .as_mut()
        .expect("a peer")
        .read_exact(&mut bytes)
        .expect("settings");
    assert_eq!(
        FrameSettings::decode(&bytes).map(|settings| settings.gain),
        Some(7)
    );
    sender.send(b"this is no frame, and certainly not the header of one");
    until("garbage", || state(State::Garbage));
}

#[test]
fn the_queue_keeps_the_newest_of_a_bounded_number_and_hands_samples_out_before_a_frame() {
    let inbox = Inbox::new(2);
    let compass = |at| {
        Event::Compass(localize::sample::Compass {
            stamp: localize::Stamp(at),
            heading: 0.0,
            magnetic_field: None,
        })
    };
    (0..5).for_each(|at| inbox.put(compass(at)));
    assert_eq!(inbox.take(Duration::ZERO), Some(compass(3)));
    assert_eq!(inbox.take(Duration::ZERO), Some(compass(4)));
    assert_eq!(inbox.take(Duration::ZERO), None);
    assert_eq!(inbox.dropped().samples, 3);
}

#[test]
fn a_frame_header_with_a_flipped_bit_is_refused() {
    let header = FrameHeader {
        fourcc: 1,
        width_px: 640,
        height_px: 480,
        stride: 640,
        sequence: 9,
        bytes: 307_200,
        stamp_ns: -5,
    };
    let bytes = header.encode();
    assert_eq!(FrameHeader::decode(&bytes), Some(header));
    for bit in 0..bytes.len() * 8 {
        let mut flipped = bytes;
        flipped[bit / 8] ^= 1 << (bit % 8);
        assert_eq!(FrameHeader::decode(&flipped), None, "bit {bit}");
    }
}
