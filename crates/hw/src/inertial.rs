//! How does the robot rotate and tilt? Inertial units and compasses on serial ports of their own.

use localize::Stamp;
use localize::frames::wrap_angle;
use localize::math;
use localize::robot::rotation_from_rpy;
use localize::sample::{Compass, Imu};

use crate::burst::spread_stamps;
use crate::clock;
use crate::config::{InertialDeviceConfig, InertialSensor};
use crate::error::HwError;
use crate::event_queue::{DeviceEvent, EventQueue};
use crate::health::{HealthReport, HealthState};
use crate::monitor::Monitor;
use crate::serial::SerialPort;
use crate::wire::bno085::{self, Rvc};
use crate::wire::wit::{self, DataType, Wit};
use crate::wire::{DecoderStats, STANDARD_GRAVITY, StreamDecoder};
use crate::worker::{POLL_PERIOD, PauseDetector, StallDetector, Waker, Worker, pause_reason};

/// Time between messages of a BNO085, seconds (its data sheet: 100 Hz).
const RVC_PERIOD: f32 = 0.01;
/// Longest step of a BNO085's index over which rates are computed.
const RVC_INDEX_STEP_MAX: u8 = 10;

/// A sensor whose thread pushes its readings into the event queue.
#[derive(Debug)]
pub struct InertialDriver {
    _worker: Worker,
    monitor: Monitor,
}

impl InertialDriver {
    /// Starts the sensor's thread, which opens the port as soon as it is present; `name` is the device in its health.
    pub fn start(
        name: &str,
        device: &InertialDeviceConfig,
        queue: &EventQueue,
    ) -> Result<Self, HwError> {
        let monitor = Monitor::new(name, queue);
        let (open_config, run_config) = (device.clone(), device.clone());
        let (thread_monitor, thread_queue) = (monitor.clone(), queue.clone());
        let worker = Worker::start(
            name,
            &monitor,
            move || SerialPort::open(&open_config.port, open_config.baud),
            move |serial: &mut SerialPort, waker: &Waker| {
                run(serial, waker, &run_config, &thread_monitor, &thread_queue)
            },
        )?;
        Ok(InertialDriver {
            _worker: worker,
            monitor,
        })
    }

    /// Health of the sensor.
    pub fn health(&self) -> HealthReport {
        self.monitor.health(clock::now())
    }
}

fn run(
    serial: &SerialPort,
    waker: &Waker,
    device: &InertialDeviceConfig,
    monitor: &Monitor,
    queue: &EventQueue,
) -> Result<(), HwError> {
    let mut stall_detector = StallDetector::new(&device.port, device.stall);
    let mut decoder = InertialDecoder::new(device);
    let mut pause_detector = PauseDetector::new(clock::now());
    let mut buffer = [0; 1024];
    while !waker.stop_requested() {
        let readable = waker.wait(
            Some(std::os::fd::AsFd::as_fd(serial)),
            clock::now() + POLL_PERIOD,
        );
        let arrival = clock::now();
        if let Some(pause) = pause_detector.check(arrival) {
            serial.discard_input()?;
            decoder.reset();
            monitor.report_event(pause_reason(pause));
            stall_detector.on_message(arrival, decoder.stats().garbage_bytes);
            continue;
        }
        if readable {
            let bytes = serial.read(&mut buffer, arrival)?;
            let readings = decoder.decode(&buffer[..bytes], arrival);
            let stats = decoder.stats();
            monitor.set_decoder_stats(stats);
            let stuck = decoder.constant_for(arrival) > device.stuck;
            for reading in readings {
                stall_detector.on_message(arrival, stats.garbage_bytes);
                monitor.count_message(arrival);
                if !stuck {
                    queue.push(reading);
                }
            }
            if stuck {
                let reason = "its readings repeat bit by bit".to_owned();
                monitor.set_state(HealthState::Stuck, Some(reason));
            } else if decoder.is_saturated() {
                let reason = "its readings are saturated".to_owned();
                monitor.set_state(HealthState::Range, Some(reason));
            } else if monitor.health(arrival).last == Some(arrival) {
                monitor.set_state(HealthState::Running, None);
            }
        }
        // By the time of the check for a pause: one that began since is no silence of the sensor.
        stall_detector.check(arrival, decoder.stats().garbage_bytes)?;
    }
    Ok(())
}

/// Decodes a sensor's bytes to readings in the robot frame.
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
    /// When the last reading arrived.
    last_arrival: Option<Stamp>,
}

#[derive(Debug)]
enum SensorStream {
    Bno085(StreamDecoder<Rvc>, Option<Rvc>),
    Wit(StreamDecoder<Wit>, [i16; 3]),
}

impl InertialDecoder {
    /// A decoder for a sensor model and its mounting.
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
            last_arrival: None,
        }
    }

    /// The readings in bytes that arrived at `arrival`: [`DeviceEvent::Imu`] and [`DeviceEvent::Compass`]. Several of a
    /// kind have waited for their reader, and are spread over the time since the previous ones.
    pub fn decode(&mut self, bytes: &[u8], arrival: Stamp) -> Vec<DeviceEvent> {
        let mut readings = Vec::new();
        match &mut self.decoder {
            SensorStream::Bno085(stream, _) => stream.extend(bytes),
            SensorStream::Wit(stream, _) => stream.extend(bytes),
        }
        while let Some(reading) = self.next_reading() {
            self.track_raw_values(reading.raw, arrival);
            let usable = self.imu && !self.saturated;
            if let Some(imu) = reading.imu.filter(|_| usable) {
                readings.push(DeviceEvent::Imu(Imu {
                    stamp: arrival,
                    specific_force: self.to_robot_frame(imu.acceleration),
                    angular_velocity: self.to_robot_frame(imu.rate),
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
        if !readings.is_empty() {
            let previous = self.last_arrival.replace(arrival);
            spread_stamps(&mut readings, previous, arrival);
        }
        readings
    }

    /// Discards an incomplete message, after a gap in the input. How long the readings were constant is unknown then.
    fn reset(&mut self) {
        self.last_arrival = None;
        self.last_change = None;
        match &mut self.decoder {
            SensorStream::Bno085(stream, before) => {
                stream.reset();
                *before = None;
            }
            SensorStream::Wit(stream, _) => stream.reset(),
        }
    }

    /// Counts of the decoder so far.
    pub fn stats(&self) -> DecoderStats {
        match &self.decoder {
            SensorStream::Bno085(stream, _) => stream.stats(),
            SensorStream::Wit(stream, _) => stream.stats(),
        }
    }

    /// Seconds for which the inertial reading has been bitwise constant.
    pub fn constant_for(&self, now: Stamp) -> f32 {
        self.last_change
            .map_or(0.0, |changed| (now - changed) as f32)
    }

    /// True while an inertial value is the smallest or largest of its type, which is not a measurement.
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

    /// Records when the raw inertial values last changed, and whether they are saturated.
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

/// Content of one message, sensor frame.
#[derive(Debug, Default)]
struct SensorReading {
    /// Raw inertial values; noise changes them all the time unless the sensor is stuck.
    raw: Option<[i16; 6]>,
    imu: Option<ImuValues>,
    /// Yaw, radians.
    yaw: Option<f32>,
    /// Magnetic field, unit of the sensor.
    magnetic_field: Option<[f32; 3]>,
}

/// One inertial measurement, sensor frame.
#[derive(Debug, Clone, Copy)]
struct ImuValues {
    /// Specific force, m/s².
    acceleration: [f32; 3],
    /// Angular rate, rad/s.
    rate: [f32; 3],
}

/// The reading of a BNO085, which sends no rates: they are differences of its attitude to the previous message.
///
/// Body rates from yaw ψ, pitch θ, roll φ (rotations in this order): p = φ̇ − ψ̇ sin θ, q = θ̇ cos φ + ψ̇ sin φ cos θ,
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
    let yaw_rate = rate(yaw, before.yaw_cdeg);
    let pitch_rate = rate(pitch, before.pitch_cdeg);
    let roll_rate = rate(roll, before.roll_cdeg);
    let (sin_pitch, cos_pitch) = math::sin_cos(radians(pitch));
    let (sin_roll, cos_roll) = math::sin_cos(radians(roll));
    let acceleration = message
        .acceleration_mg
        .map(|mg| f32::from(mg) * 1e-3 * STANDARD_GRAVITY);
    let rate = [
        roll_rate - yaw_rate * sin_pitch,
        pitch_rate * cos_roll + yaw_rate * sin_roll * cos_pitch,
        yaw_rate * cos_roll * cos_pitch - pitch_rate * sin_roll,
    ];
    reading.imu = Some(ImuValues { acceleration, rate });
    reading
}

/// The reading of a WitMotion, which sends acceleration, rate and angle in turn: the rate completes an inertial reading.
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
                imu: Some(ImuValues {
                    acceleration: force.si(),
                    rate: message.si(),
                }),
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
        let mut decoder = InertialDecoder::new(&device(InertialSensor::Bno085));
        let mut rates = Vec::new();
        // 90°/s: 0.9° per message, starting at 179°; every fourth message is lost.
        for step in (0..20).filter(|step| step % 4 != 3) {
            let yaw = (17_900 + 90 * step + 18_000) % 36_000 - 18_000;
            let message = Rvc {
                index: 250u8.wrapping_add(step as u8),
                yaw_cdeg: yaw as i16,
                acceleration_mg: [0, 0, 1000],
                ..Rvc::default()
            };
            for event in decoder.decode(&message.encode(), Stamp(i64::from(step))) {
                if let DeviceEvent::Imu(imu) = event {
                    rates.push(imu.angular_velocity[2]);
                    assert!((imu.specific_force[2] - 9.806_65).abs() < 1e-4);
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
        // The sensor's x axis points to the robot's left, its y axis to the back.
        sideways.mount_deg = [0.0, 0.0, 90.0];
        sideways.clockwise = true;
        sideways.north_deg = 10.0;
        let mut decoder = InertialDecoder::new(&sideways);
        let message = |kind, raw| Wit { kind, raw }.encode();
        let bytes = [
            message(DataType::Acceleration, [2048, 0, 0, 0]),
            message(DataType::AngularRate, [0, 1638, 0, 0]),
            message(DataType::Angle, [0, 0, 8192, 0]),
        ]
        .concat();
        let readings = decoder.decode(&bytes, Stamp(5));
        let [DeviceEvent::Imu(imu), DeviceEvent::Compass(compass)] = readings[..] else {
            panic!("{readings:?}");
        };
        assert!(
            (imu.specific_force[1] - 9.806_65).abs() < 1e-3 && imu.specific_force[0].abs() < 1e-3
        );
        assert!(
            (imu.angular_velocity[0].to_degrees() + 99.976).abs() < 0.01,
            "{:?}",
            imu.angular_velocity
        );
        assert!((compass.heading.to_degrees() + 35.0).abs() < 0.01);
    }

    #[test]
    fn constant_readings_are_timed_and_reset_on_change() {
        let mut decoder = InertialDecoder::new(&device(InertialSensor::Bno085));
        let mut message = Rvc::default();
        for step in 0..100 {
            message.index = step;
            decoder.decode(&message.encode(), Stamp(i64::from(step) * 10_000_000));
        }
        assert!((decoder.constant_for(Stamp(990_000_000)) - 0.99).abs() < 1e-3);
        message.roll_cdeg = 1;
        decoder.decode(&message.encode(), Stamp(1_000_000_000));
        assert_eq!(decoder.constant_for(Stamp(1_000_000_000)), 0.0);
    }

    #[test]
    fn readings_are_not_constant_over_a_gap_in_the_input() {
        for sensor in [InertialSensor::Bno085, InertialSensor::Wit] {
            let mut decoder = InertialDecoder::new(&device(sensor));
            let (first, rest) = match sensor {
                InertialSensor::Bno085 => (Rvc::default().encode().to_vec(), Vec::new()),
                InertialSensor::Wit => {
                    let message = |kind| Wit { kind, raw: [0; 4] }.encode().to_vec();
                    (
                        message(DataType::Acceleration),
                        message(DataType::AngularRate),
                    )
                }
            };
            decoder.decode(&[&first[..], &rest].concat(), Stamp(0));
            decoder.reset();
            let resumed = Stamp(10_000_000_000);
            // A part of a reading, as it may come first.
            decoder.decode(&first, resumed);
            assert_eq!(decoder.constant_for(resumed), 0.0, "{sensor:?}");
            decoder.decode(&rest, resumed);
            assert_eq!(decoder.constant_for(resumed), 0.0, "{sensor:?}");
        }
    }

    #[test]
    fn readings_that_waited_for_a_starved_reader_have_the_times_at_which_they_were_sent() {
        for sensor in [InertialSensor::Bno085, InertialSensor::Wit] {
            let mut decoder = InertialDecoder::new(&device(sensor));
            let (mut sent, mut stamps) = (0u8, Vec::new());
            // 100 Hz; the reader comes after 10, 40, 70, 100, 10, ... ms.
            let mut now = Stamp(0);
            for pause in (0..30).map(|round| 1 + 3 * (round % 4)) {
                let mut bytes = Vec::new();
                for _ in 0..pause {
                    bytes.extend(match sensor {
                        InertialSensor::Bno085 => Rvc {
                            index: sent,
                            ..Rvc::default()
                        }
                        .encode()
                        .to_vec(),
                        InertialSensor::Wit => [DataType::Acceleration, DataType::AngularRate]
                            .map(|kind| Wit { kind, raw: [0; 4] }.encode())
                            .concat(),
                    });
                    sent = sent.wrapping_add(1);
                }
                now = Stamp(now.0 + pause * 10_000_000);
                for event in decoder.decode(&bytes, now) {
                    if let DeviceEvent::Imu(imu) = event {
                        stamps.push(imu.stamp);
                    }
                }
            }
            assert_eq!(
                stamps.len(),
                159 - usize::from(sensor == InertialSensor::Bno085)
            );
            let steps = stamps.windows(2).map(|pair| pair[1].0 - pair[0].0);
            assert!(steps.clone().all(|step| step == 10_000_000), "{sensor:?}");
        }
    }
}
