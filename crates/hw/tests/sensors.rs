//! Serial ports, inertial units and the camera socket: samples, faults, and their reports.

mod pseudo_terminal;

use std::io::{Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::time::Duration;

use hw::config::{CameraDeviceConfig, InertialDeviceConfig, InertialSensor};
use hw::wire::bno085::Rvc;
use hw::wire::image_stream::{ImageHeader, SETTINGS_BYTES, SettingsMessage};
use hw::wire::wit::{DataType, Wit};
use hw::{
    CameraDriver, DeviceEvent, EventQueue, HealthState, HwError, InertialDriver, SerialPort, camera,
};
use pseudo_terminal::{PseudoSerialPort, wait_for_event, wait_until};

#[test]
fn serial_port_is_transparent_to_all_byte_values() {
    let port = PseudoSerialPort::connected();
    let serial = SerialPort::open(&port.path_string(), 115_200).expect("open");
    let all: Vec<u8> = (0..=255).collect();
    port.send(&all);
    let mut received = Vec::new();
    wait_until("256 bytes", || {
        let mut buffer = [0; 64];
        let bytes = serial.read(&mut buffer, hw::now() + 0.01).expect("read");
        received.extend_from_slice(&buffer[..bytes]);
        (received.len() == 256).then_some(())
    });
    assert_eq!(received, all);
    serial.write(&all, hw::now() + 5.0).expect("written");
    let mut echoed = Vec::new();
    wait_until("256 bytes at the other end", || {
        echoed.extend(port.read());
        (echoed.len() == 256).then_some(())
    });
    assert_eq!(echoed, all);
    assert_eq!(serial.read(&mut [0; 8], hw::now()), Ok(0), "nothing more");
}

#[test]
fn busy_missing_stalled_and_disconnected_ports_are_distinguished() {
    let mut port = PseudoSerialPort::connected();
    let serial = SerialPort::open(&port.path_string(), 1_000_000).expect("open");
    let busy = SerialPort::open(&port.path_string(), 115_200);
    assert!(matches!(busy, Err(HwError::Busy { .. })), "{busy:?}");
    let full = wait_until("a full output buffer", || {
        serial.write(&[0; 4096], hw::now() + 0.01).err()
    });
    assert!(matches!(full, HwError::Stalled { .. }), "{full:?}");
    port.disconnect();
    let gone = wait_until("an error", || {
        serial.read(&mut [0; 8], hw::now() + 0.01).err()
    });
    assert!(matches!(gone, HwError::Disconnected { .. }), "{gone:?}");
    let missing = SerialPort::open(&port.path_string(), 115_200);
    assert!(
        matches!(missing, Err(HwError::Missing { .. })),
        "{missing:?}"
    );
    let file = SerialPort::open("/dev/null", 115_200).expect_err("an error");
    assert_eq!(file.to_string(), "/dev/null: not a serial port");
}

#[test]
fn stuck_imu_is_detected_and_recovers() {
    let port = PseudoSerialPort::connected();
    let queue = EventQueue::new(1024);
    let device = InertialDeviceConfig {
        sensor: InertialSensor::Bno085,
        port: port.path_string(),
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
    let imu = InertialDriver::start("imu", &device, &queue).expect("started");
    let mut message = Rvc::default();
    let mut send_message = |moving: bool| {
        message.index = message.index.wrapping_add(1);
        message.acceleration_mg[2] = 1000 + if moving { i16::from(message.index) } else { 0 };
        port.send(&message.encode());
        std::thread::sleep(Duration::from_millis(3));
    };
    for (moving, expected) in [
        (true, HealthState::Running),
        (false, HealthState::Stuck),
        (true, HealthState::Running),
    ] {
        wait_until(&format!("{expected:?}"), || {
            send_message(moving);
            (imu.health().state == expected).then_some(())
        });
    }
    wait_for_event(&queue, "a reading", |event| {
        matches!(event, DeviceEvent::Imu(_)).then_some(())
    });
}

#[test]
fn witmotion_with_only_wrong_checksums_sends_garbage_and_is_not_silent() {
    let port = PseudoSerialPort::connected();
    let device = InertialDeviceConfig {
        sensor: InertialSensor::Wit,
        port: port.path_string(),
        baud: 115_200,
        imu: true,
        compass: false,
        magnetometer: false,
        mount_deg: [0.0; 3],
        clockwise: false,
        north_deg: 0.0,
        stall: 0.3,
        stuck: 0.5,
    };
    let imu = InertialDriver::start("imu", &device, &EventQueue::new(64)).expect("started");
    let kinds = [
        DataType::Acceleration,
        DataType::AngularRate,
        DataType::Angle,
    ];
    let mut damage = 0;
    let state = wait_until("a fault", || {
        for kind in kinds {
            let raw = [12, 34, 56, 2500];
            let mut bytes = Wit { kind, raw }.encode();
            bytes[10] ^= damage;
            port.send(&bytes);
        }
        std::thread::sleep(Duration::from_millis(10));
        let state = imu.health().state;
        if state == HealthState::Running {
            damage = 1;
        }
        matches!(state, HealthState::Garbage | HealthState::Stalled).then_some(state)
    });
    assert_eq!(state, HealthState::Garbage);
}

/// A program that sends images.
struct FakeCamera {
    listener: UnixListener,
    peer: Option<UnixStream>,
    sequence: u32,
    /// 0: the camera does not report its settings.
    exposure_us: u32,
}

impl FakeCamera {
    fn encode_image(&mut self, level: u8) -> Vec<u8> {
        self.sequence += 1;
        let header = ImageHeader {
            fourcc: u32::from_le_bytes(*b"RGB3"),
            width_px: 8,
            height_px: 4,
            stride: 24,
            sequence: self.sequence,
            bytes: 96,
            stamp_ns: hw::now().0,
            exposure_us: self.exposure_us,
            gain_centi: 250,
        };
        [&header.encode()[..], &[level; 96]].concat()
    }

    fn accept(&mut self) -> SettingsMessage {
        let (mut peer, _) = self.listener.accept().expect("connected");
        let mut bytes = [0; SETTINGS_BYTES];
        peer.read_exact(&mut bytes).expect("settings");
        self.peer = Some(peer);
        SettingsMessage::decode(&bytes).expect("settings")
    }

    fn send(&mut self, bytes: &[u8]) {
        // The driver takes this program for stalled if the machine delays it, and connects again.
        if self
            .peer
            .as_mut()
            .expect("a peer")
            .write_all(bytes)
            .is_err()
        {
            self.accept();
        }
    }
}

fn camera_device(path: &std::path::Path) -> CameraDeviceConfig {
    CameraDeviceConfig {
        device: format!("unix:{}", path.display()),
        rate_hz: 30.0,
        format: String::new(),
        exposure: Some(0.01),
        gain: None,
        white_balance_k: None,
        // A loaded machine delays a thread by some tenths of a second.
        stall: 2.0,
    }
}

#[test]
fn camera_socket_delivers_images_and_reports_truncated_frozen_and_dropped_ones() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("camera");
    let queue = EventQueue::new(64);
    let camera = CameraDriver::start(&camera_device(&path), [8, 4], 0, &queue).expect("started");
    let state = |expected: HealthState| (camera.health().state == expected).then_some(());
    let mut sender = FakeCamera {
        listener: UnixListener::bind(&path).expect("bound"),
        peer: None,
        sequence: 0,
        exposure_us: 0,
    };
    let settings = sender.accept();
    assert_eq!((settings.exposure_us, settings.gain), (10_000, -1));
    let mut level = 0u8;
    let mut send_changed_image = |sender: &mut FakeCamera| {
        level = level.wrapping_add(1);
        let bytes = sender.encode_image(level);
        sender.send(&bytes);
        std::thread::sleep(Duration::from_millis(3));
    };
    wait_until("running", || {
        send_changed_image(&mut sender);
        state(HealthState::Running)
    });
    let image = wait_for_event(&queue, "an image", |event| match event {
        DeviceEvent::Image(image) => Some(image),
        _ => None,
    });
    assert_eq!(
        (image.width_px, image.height_px, image.data.len()),
        (8, 4, 96)
    );
    wait_until("dropped images", || {
        send_changed_image(&mut sender);
        (queue.drop_counts().images > 3).then_some(())
    });
    wait_until("stuck", || {
        let bytes = sender.encode_image(77);
        sender.send(&bytes);
        std::thread::sleep(Duration::from_millis(3));
        state(HealthState::Stuck)
    });
    wait_until("running again", || {
        send_changed_image(&mut sender);
        state(HealthState::Running)
    });
    // A truncated image, then nothing.
    let half = sender.encode_image(1);
    sender.send(&half[..60]);
    wait_until("stalled", || state(HealthState::Stalled));
    sender.accept();
    wait_until("running after the truncated image", || {
        send_changed_image(&mut sender);
        state(HealthState::Running)
    });
    camera.set_settings(camera::CameraSettings {
        gain: Some(7.0),
        ..camera::CameraSettings::default()
    });
    let mut bytes = [0; SETTINGS_BYTES];
    sender
        .peer
        .as_mut()
        .expect("a peer")
        .read_exact(&mut bytes)
        .expect("settings");
    assert_eq!(
        SettingsMessage::decode(&bytes).map(|settings| settings.gain),
        Some(7)
    );
    // A camera that reconnects gets its settings again.
    sender.peer = None;
    wait_until("absent", || state(HealthState::Absent));
    sender.accept();
    let mut bytes = [0; SETTINGS_BYTES];
    sender
        .peer
        .as_mut()
        .expect("a peer")
        .read_exact(&mut bytes)
        .expect("settings");
    assert_eq!(
        SettingsMessage::decode(&bytes).map(|settings| settings.gain),
        Some(7)
    );
    sender.send(b"this is no image, and certainly not the header of one");
    wait_until("garbage", || state(HealthState::Garbage));
    let reason = camera.health().reason.expect("a reason");
    assert!(
        reason.contains("docs/wire.md") && !reason.contains("baud"),
        "{reason}"
    );
}

#[test]
fn images_carry_the_setting_that_the_camera_reports_and_a_gain_has_fractions() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("camera");
    let queue = EventQueue::new(64);
    let camera = CameraDriver::start(&camera_device(&path), [8, 4], 0, &queue).expect("started");
    let mut sender = FakeCamera {
        listener: UnixListener::bind(&path).expect("bound"),
        peer: None,
        sequence: 0,
        exposure_us: 0,
    };
    sender.accept();
    let settings = |sender: &mut FakeCamera| {
        let mut bytes = [0; SETTINGS_BYTES];
        let peer = sender.peer.as_mut().expect("a peer");
        peer.read_exact(&mut bytes).expect("settings");
        SettingsMessage::decode(&bytes).expect("settings")
    };
    let next_setting = |sender: &mut FakeCamera, level| {
        let bytes = sender.encode_image(level);
        sender.send(&bytes);
        let image = wait_for_event(&queue, "an image", |event| match event {
            DeviceEvent::Image(image) => Some(image),
            _ => None,
        });
        image.setting
    };
    assert_eq!(next_setting(&mut sender, 1), None);
    let wanted = localize::robot::ExposureSetting {
        exposure: 0.004,
        gain: 2.5,
    };
    camera.set_exposure(wanted, 2);
    let sent = settings(&mut sender);
    assert_eq!(
        (sent.exposure_us, sent.gain, sent.gain_centi),
        (4000, 3, None)
    );
    // From the first image that reports its settings on, fractions are sent.
    sender.exposure_us = 4000;
    let reported = next_setting(&mut sender, 2).expect("a setting");
    assert!((reported.exposure - 0.004).abs() < 1e-7 && reported.gain == 2.5);
    assert_eq!(settings(&mut sender).gain_centi, Some(250));
}

#[test]
fn event_queue_drops_the_oldest_samples_when_full() {
    let queue = EventQueue::new(2);
    let compass = |at| {
        DeviceEvent::Compass(localize::sample::Compass {
            stamp: localize::Stamp(at),
            heading: 0.0,
            magnetic_field: None,
        })
    };
    (0..5).for_each(|at| queue.push(compass(at)));
    assert_eq!(queue.pop_timeout(Duration::ZERO), Some(compass(3)));
    assert_eq!(queue.pop_timeout(Duration::ZERO), Some(compass(4)));
    assert_eq!(queue.pop_timeout(Duration::ZERO), None);
    assert_eq!(queue.drop_counts().samples, 3);
}

#[test]
fn image_header_with_a_flipped_bit_is_rejected() {
    let header = ImageHeader {
        fourcc: 1,
        width_px: 640,
        height_px: 480,
        stride: 640,
        sequence: 9,
        bytes: 307_200,
        stamp_ns: -5,
        exposure_us: 1234,
        gain_centi: -300,
    };
    let bytes = header.encode();
    assert_eq!(ImageHeader::decode(&bytes), Some(header));
    for bit in 0..bytes.len() * 8 {
        let mut flipped = bytes;
        flipped[bit / 8] ^= 1 << (bit % 8);
        assert_eq!(ImageHeader::decode(&flipped), None, "bit {bit}");
    }
}
