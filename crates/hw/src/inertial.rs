//! How does the robot turn and tilt? Inertial units and compasses on serial lines of their own.

use localize::Stamp;
use localize::frames::wrap_angle;
use localize::sample::{Compass, Imu};

use crate::clock;
use crate::config::{InertialDeviceConfig, InertialSensor};
use crate::error::HwError;
use crate::event_queue::{DeviceEvent, EventQueue};
use crate::health::{HealthReport, HealthState, Monitor};
use crate::serial::SerialPort;
use crate::wire::bno085::{self, Rvc};
use crate::wire::wit::{self, DataType, Wit};
use crate::wire::{DecoderStats, STANDARD_GRAVITY, StreamDecoder};
use crate::worker::{StallDetector, Waker, Worker};

/// Time between messages of a BNO085, seconds (its data sheet: 100 Hz).
const RVC_PERIOD: f32 = 0.01;
/// Longest step of a BNO085's index over which a turn is still a rate.
const RVC_INDEX_STEP_MAX: u8 = 10;
/// Longest wait before the thread looks at silence again, seconds.
const POLL_PERIOD: f64 = 0.05;

/// A sensor whose thread puts its readings into the inbox.
#[derive(Debug)]
pub struct InertialDriver {
    _worker: Worker,
    monitor: Monitor,
}

impl InertialDriver {
    /// Starts the sensor's thread, which opens the line now or whenever it appears; `name` is the device's in its health.
    pub fn start(
        name: &str,
        device: &InertialDeviceConfig,
        inbox: &EventQueue,
    ) -> Result<Self, HwError> {
        let monitor = Monitor::new(name, inbox);
        let (opened, served) = (device.clone(), device.clone());
        let (server_monitor, server_inbox) = (monitor.clone(), inbox.clone());
        let worker = Worker::start(
            name,
            &monitor,
            move || SerialPort::open(&opened.port, opened.baud),
            move |serial: &mut SerialPort, bell: &Waker| {
                run(serial, bell, &served, &server_monitor, &server_inbox)
            },
        )?;
        Ok(InertialDriver {
            _worker: worker,
            monitor,
        })
    }

    /// How the sensor is.
    pub fn health(&self) -> HealthReport {
        self.monitor.health(clock::now())
    }
}

fn run(
    serial: &SerialPort,
    bell: &Waker,
    device: &InertialDeviceConfig,
    monitor: &Monitor,
    inbox: &EventQueue,
) -> Result<(), HwError> {
    let mut watch = StallDetector::new(&device.port, device.stall);
    let mut reader = InertialDecoder::new(device);
    let mut buffer = [0; 1024];
    while !bell.stop_requested() {
        if bell.wait(
            Some(std::os::fd::AsFd::as_fd(serial)),
            clock::now() + POLL_PERIOD,
        ) {
            let arrival = clock::now();
            let bytes = serial.read(&mut buffer, arrival)?;
            let readings = reader.decode(&buffer[..bytes], arrival);
            let tally = reader.stats();
            monitor.set_decoder_stats(tally);
            let stuck = reader.constant_for(arrival) > device.stuck;
            for reading in readings {
                watch.on_message(arrival, tally.garbage_bytes);
                monitor.count_message(arrival);
                if !stuck {
                    inbox.push(reading);
                }
            }
            if stuck {
                let reason = "its readings do not change by a single bit".to_owned();
                monitor.set_state(HealthState::Stuck, Some(reason));
            } else if reader.is_saturated() {
                let reason = "its readings stand at the end of their range".to_owned();
                monitor.set_state(HealthState::Range, Some(reason));
            } else if monitor.health(arrival).last == Some(arrival) {
                monitor.set_state(HealthState::Running, None);
            }
        }
        watch.check(clock::now(), reader.stats().garbage_bytes)?;
    }
    Ok(())
}

/// Turns a sensor's bytes into readings in the robot's frame.
#[derive(Debug)]
pub struct InertialDecoder {
    decoder: SensorStream,
    imu: bool,
    compass: bool,
    magnetometer: bool,
    robot_from_sensor: [[f32; 3]; 3],
    yaw_sign: f32,
    heading_offset: f32,
    last_change: Option<Stamp>,
    last_raw: [i16; 6],
    saturated: bool,
}

#[derive(Debug)]
enum SensorStream {
    Bno085(StreamDecoder<Rvc>, Option<Rvc>),
    Wit(StreamDecoder<Wit>, [i16; 3]),
}

impl InertialDecoder {
    /// For a sensor, mounted as its configuration says.
    pub fn new(device: &InertialDeviceConfig) -> Self {
        InertialDecoder {
            decoder: match device.sensor {
                InertialSensor::Bno085 => SensorStream::Bno085(bno085::decoder(), None),
                InertialSensor::Wit => SensorStream::Wit(wit::decoder(), [0; 3]),
            },
            imu: device.imu,
            compass: device.compass,
            magnetometer: device.magnetometer,
            robot_from_sensor: rotation_from_rpy(device.mount_deg.map(f32::to_radians)),
            yaw_sign: if device.clockwise { -1.0 } else { 1.0 },
            heading_offset: device.north_deg.to_radians(),
            last_change: None,
            last_raw: [0; 6],
            saturated: false,
        }
    }

    /// The readings in bytes that arrived at `arrival`: [`Event::Imu`] and [`Event::Compass`].
    pub fn decode(&mut self, bytes: &[u8], arrival: Stamp) -> Vec<DeviceEvent> {
        let mut readings = Vec::new();
        match &mut self.decoder {
            SensorStream::Bno085(stream, _) => stream.extend(bytes),
            SensorStream::Wit(stream, _) => stream.extend(bytes),
        }
        while let Some(reading) = self.next_reading() {
            self.track_raw_values(reading.raw, arrival);
            let usable = self.imu && !self.saturated;
            if let Some((acceleration, rate)) = reading.imu.filter(|_| usable) {
                readings.push(DeviceEvent::Imu(Imu {
                    stamp: arrival,
                    acceleration: self.to_robot_frame(acceleration),
                    rate: self.to_robot_frame(rate),
                }));
            }
            if let Some(yaw) = reading.yaw.filter(|_| self.compass && !self.magnetometer) {
                readings.push(DeviceEvent::Compass(Compass {
                    stamp: arrival,
                    heading: wrap_angle(self.yaw_sign * yaw + self.heading_offset),
                    magnetic_field: None,
                }));
            }
            if let Some(field) = reading
                .magnetic_field
                .filter(|_| self.compass && self.magnetometer)
            {
                let [x, y, _] = self.to_robot_frame(field);
                readings.push(DeviceEvent::Compass(Compass::from_magnetic_field(
                    arrival,
                    [x, y],
                )));
            }
        }
        readings
    }

    /// Bytes without a message so far.
    pub fn stats(&self) -> DecoderStats {
        match &self.decoder {
            SensorStream::Bno085(stream, _) => stream.stats(),
            SensorStream::Wit(stream, _) => stream.stats(),
        }
    }

    /// For how many seconds the sensor has repeated its last inertial reading to the last bit.
    pub fn constant_for(&self, now: Stamp) -> f32 {
        self.last_change
            .map_or(0.0, |changed| (now - changed) as f32)
    }

    /// True while an inertial value is the least or greatest that the wire can carry: no measurement.
    pub fn is_saturated(&self) -> bool {
        self.saturated
    }

    fn next_reading(&mut self) -> Option<SensorReading> {
        match &mut self.decoder {
            SensorStream::Bno085(stream, before) => {
                let message = stream.next()?;
                let before = before.replace(message);
                Some(rvc_reading(message, before))
            }
            SensorStream::Wit(stream, acceleration) => {
                let message = stream.next()?;
                Some(wit_reading(message, acceleration))
            }
        }
    }

    /// Keeps when the raw inertial values last changed.
    fn track_raw_values(&mut self, raw: Option<[i16; 6]>, arrival: Stamp) {
        if let Some(raw) = raw
            && (self.last_change.is_none() || raw != self.last_raw)
        {
            self.last_change = Some(arrival);
            self.last_raw = raw;
        }
        if let Some(raw) = raw {
            self.saturated = raw.contains(&i16::MIN) || raw.contains(&i16::MAX);
        }
    }

    fn to_robot_frame(&self, vector: [f32; 3]) -> [f32; 3] {
        self.robot_from_sensor
            .map(|row| row[0] * vector[0] + row[1] * vector[1] + row[2] * vector[2])
    }
}

/// What one message says, in the sensor's frame.
#[derive(Debug, Default)]
struct SensorReading {
    /// Values that no living sensor repeats for long.
    raw: Option<[i16; 6]>,
    /// Specific force (m/s²) and rate of turn (rad/s).
    imu: Option<([f32; 3], [f32; 3])>,
    /// Yaw, radians.
    yaw: Option<f32>,
    /// Magnetic field, the sensor's own unit.
    magnetic_field: Option<[f32; 3]>,
}

/// A BNO085 tells no rates: they are the change of its attitude since the message before.
///
/// Body rates from yaw ψ, pitch θ, roll φ (turned in this order): p = φ̇ − ψ̇ sin θ, q = θ̇ cos φ + ψ̇ sin φ cos θ,
/// r = −θ̇ sin φ + ψ̇ cos φ cos θ.
fn rvc_reading(message: Rvc, before: Option<Rvc>) -> SensorReading {
    let radians = |cdeg: i16| (f32::from(cdeg) * 0.01).to_radians();
    let [ax, ay, az] = message.acceleration_mg;
    let (yaw, pitch, roll) = (message.yaw_cdeg, message.pitch_cdeg, message.roll_cdeg);
    let mut reading = SensorReading {
        raw: Some([yaw, pitch, roll, ax, ay, az]),
        imu: None,
        yaw: Some(radians(yaw)),
        magnetic_field: None,
    };
    let Some(before) = before else {
        return reading;
    };
    let steps = message.index.wrapping_sub(before.index);
    if !(1..=RVC_INDEX_STEP_MAX).contains(&steps) {
        return reading;
    }
    let rate = |now: i16, then: i16| {
        wrap_angle(radians(now) - radians(then)) / (f32::from(steps) * RVC_PERIOD)
    };
    let turn = rate(yaw, before.yaw_cdeg);
    let nod = rate(pitch, before.pitch_cdeg);
    let lean = rate(roll, before.roll_cdeg);
    let (sin_pitch, cos_pitch) = radians(pitch).sin_cos();
    let (sin_roll, cos_roll) = radians(roll).sin_cos();
    let acceleration = message
        .acceleration_mg
        .map(|mg| f32::from(mg) * 1e-3 * STANDARD_GRAVITY);
    let rates = [
        lean - turn * sin_pitch,
        nod * cos_roll + turn * sin_roll * cos_pitch,
        turn * cos_roll * cos_pitch - nod * sin_roll,
    ];
    reading.imu = Some((acceleration, rates));
    reading
}

/// A WitMotion sends acceleration, rate, angle one after the other: the rate completes an inertial reading.
fn wit_reading(message: Wit, acceleration: &mut [i16; 3]) -> SensorReading {
    let [x, y, z, _] = message.raw;
    match message.kind {
        DataType::Acceleration => {
            *acceleration = [x, y, z];
            SensorReading::default()
        }
        DataType::AngularRate => {
            let [ax, ay, az] = *acceleration;
            let force = Wit {
                kind: DataType::Acceleration,
                raw: [ax, ay, az, 0],
            };
            SensorReading {
                raw: Some([x, y, z, ax, ay, az]),
                imu: Some((force.si(), message.si())),
                yaw: None,
                magnetic_field: None,
            }
        }
        DataType::Angle => SensorReading {
            yaw: Some(message.si()[2]),
            ..SensorReading::default()
        },
        DataType::MagneticField => SensorReading {
            magnetic_field: Some(message.si()),
            ..SensorReading::default()
        },
        DataType::Other(_) => SensorReading::default(),
    }
}

/// Rz(yaw)·Ry(pitch)·Rx(roll), rows.
fn rotation_from_rpy([roll, pitch, yaw]: [f32; 3]) -> [[f32; 3]; 3] {
    let (sr, cr) = roll.sin_cos();
    let (sp, cp) = pitch.sin_cos();
    let (sy, cy) = yaw.sin_cos();
    [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn device(sensor: InertialSensor) -> InertialDeviceConfig {
        InertialDeviceConfig {
            sensor,
            port: String::new(),
            baud: 115_200,
            imu: true,
            compass: true,
            magnetometer: false,
            mount_deg: [0.0; 3],
            clockwise: false,
            north_deg: 0.0,
            stall: 0.5,
            stuck: 0.5,
        }
    }

    #[test]
    fn bno085_yaw_rate_is_correct_across_wraparound_and_a_lost_message() {
        let mut reader = InertialDecoder::new(&device(InertialSensor::Bno085));
        let mut rates = Vec::new();
        // 90°/s: 0.9° a message, from 179° on, every fourth lost.
        for step in (0..20).filter(|step| step % 4 != 3) {
            let yaw = (17_900 + 90 * step + 18_000) % 36_000 - 18_000;
            let message = Rvc {
                index: 250u8.wrapping_add(step as u8),
                yaw_cdeg: yaw as i16,
                acceleration_mg: [0, 0, 1000],
                ..Rvc::default()
            };
            for event in reader.decode(&message.encode(), Stamp(i64::from(step))) {
                if let DeviceEvent::Imu(imu) = event {
                    rates.push(imu.rate[2]);
                    assert!((imu.acceleration[2] - 9.806_65).abs() < 1e-4);
                }
            }
        }
        assert_eq!(rates.len(), 14);
        assert!(
            rates
                .iter()
                .all(|rate| (rate.to_degrees() - 90.0).abs() < 0.01)
        );
    }

    #[test]
    fn mounting_rotation_transforms_readings_to_the_robot_frame() {
        let mut sideways = device(InertialSensor::Wit);
        // The sensor's x axis points to the robot's left, its y axis backwards.
        sideways.mount_deg = [0.0, 0.0, 90.0];
        sideways.clockwise = true;
        sideways.north_deg = 10.0;
        let mut reader = InertialDecoder::new(&sideways);
        let part = |kind, raw| Wit { kind, raw }.encode();
        let bytes = [
            part(DataType::Acceleration, [2048, 0, 0, 0]),
            part(DataType::AngularRate, [0, 1638, 0, 0]),
            part(DataType::Angle, [0, 0, 8192, 0]),
        ]
        .concat();
        let readings = reader.decode(&bytes, Stamp(5));
        let [DeviceEvent::Imu(imu), DeviceEvent::Compass(compass)] = readings[..] else {
            panic!("{readings:?}");
        };
        assert!((imu.acceleration[1] - 9.806_65).abs() < 1e-3 && imu.acceleration[0].abs() < 1e-3);
        assert!(
            (imu.rate[0].to_degrees() + 99.976).abs() < 0.01,
            "{:?}",
            imu.rate
        );
        assert!((compass.heading.to_degrees() + 35.0).abs() < 0.01);
    }

    #[test]
    fn constant_readings_are_timed_and_reset_on_change() {
        let mut reader = InertialDecoder::new(&device(InertialSensor::Bno085));
        let mut message = Rvc::default();
        for step in 0..100 {
            message.index = step;
            reader.decode(&message.encode(), Stamp(i64::from(step) * 10_000_000));
        }
        assert!((reader.constant_for(Stamp(990_000_000)) - 0.99).abs() < 1e-3);
        message.roll_cdeg = 1;
        reader.decode(&message.encode(), Stamp(1_000_000_000));
        assert_eq!(reader.constant_for(Stamp(1_000_000_000)), 0.0);
    }
}
