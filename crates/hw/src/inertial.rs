//! How does the robot turn and tilt? Inertial units and compasses on serial lines of their own.

use localize::Stamp;
use localize::frame::wrap_angle;
use localize::sample::{Compass, Imu};

use crate::clock;
use crate::config::{InertialDevice, Sensor};
use crate::error::HwError;
use crate::health::{Health, Monitor, State};
use crate::inbox::{Event, Inbox};
use crate::serial::Serial;
use crate::wire::bno085::{self, Rvc};
use crate::wire::wit::{self, Kind, Wit};
use crate::wire::{STANDARD_GRAVITY, Stream, Tally};
use crate::worker::{Bell, Watch, Worker};

/// Time between messages of a BNO085, seconds (its data sheet: 100 Hz).
const RVC_PERIOD: f32 = 0.01;
/// Longest step of a BNO085's index over which a turn is still a rate.
const RVC_STEPS_MAX: u8 = 10;
/// Longest wait before the thread looks at silence again, seconds.
const LOOK: f64 = 0.05;

/// A sensor whose thread puts its readings into the inbox.
#[derive(Debug)]
pub struct Inertial {
    _worker: Worker,
    monitor: Monitor,
}

impl Inertial {
    /// Starts the sensor's thread, which opens the line now or whenever it appears; `name` is the device's in its health.
    pub fn start(name: &str, device: &InertialDevice, inbox: &Inbox) -> Result<Self, HwError> {
        let monitor = Monitor::new(name, inbox);
        let (opened, served) = (device.clone(), device.clone());
        let (server_monitor, server_inbox) = (monitor.clone(), inbox.clone());
        let worker = Worker::start(
            name,
            &monitor,
            move || Serial::open(&opened.port, opened.baud),
            move |serial: &mut Serial, bell: &Bell| {
                serve(serial, bell, &served, &server_monitor, &server_inbox)
            },
        )?;
        Ok(Inertial {
            _worker: worker,
            monitor,
        })
    }

    /// How the sensor is.
    pub fn health(&self) -> Health {
        self.monitor.health(clock::now())
    }
}

fn serve(
    serial: &Serial,
    bell: &Bell,
    device: &InertialDevice,
    monitor: &Monitor,
    inbox: &Inbox,
) -> Result<(), HwError> {
    let mut watch = Watch::new(&device.port, device.stall);
    let mut reader = Reader::new(device);
    let mut buffer = [0; 1024];
    while !bell.stopped() {
        if bell.wait(Some(std::os::fd::AsFd::as_fd(serial)), clock::now() + LOOK) {
            let arrival = clock::now();
            let bytes = serial.read(&mut buffer, arrival)?;
            let readings = reader.read(&buffer[..bytes], arrival);
            let tally = reader.tally();
            monitor.tally(tally);
            let stuck = reader.same_for(arrival) > device.stuck;
            for reading in readings {
                watch.message(arrival, tally.garbage_bytes);
                monitor.message(arrival);
                if !stuck {
                    inbox.put(reading);
                }
            }
            if stuck {
                let reason = "its readings do not change by a single bit".to_owned();
                monitor.state(State::Stuck, Some(reason));
            } else if reader.is_out_of_range() {
                let reason = "its readings stand at the end of their range".to_owned();
                monitor.state(State::Range, Some(reason));
            } else if monitor.health(arrival).last == Some(arrival) {
                monitor.state(State::Running, None);
            }
        }
        watch.check(clock::now(), reader.tally().garbage_bytes)?;
    }
    Ok(())
}

/// Turns a sensor's bytes into readings in the robot's frame.
#[derive(Debug)]
pub struct Reader {
    decoder: Decoder,
    imu: bool,
    compass: bool,
    magnetometer: bool,
    robot_from_sensor: [[f32; 3]; 3],
    turn_sign: f32,
    north: f32,
    changed: Option<Stamp>,
    last_raw: [i16; 6],
    out_of_range: bool,
}

#[derive(Debug)]
enum Decoder {
    Bno085(Stream<Rvc>, Option<Rvc>),
    Wit(Stream<Wit>, [i16; 3]),
}

impl Reader {
    /// For a sensor, mounted as its configuration says.
    pub fn new(device: &InertialDevice) -> Self {
        Reader {
            decoder: match device.sensor {
                Sensor::Bno085 => Decoder::Bno085(bno085::stream(), None),
                Sensor::Wit => Decoder::Wit(wit::stream(), [0; 3]),
            },
            imu: device.imu,
            compass: device.compass,
            magnetometer: device.magnetometer,
            robot_from_sensor: rotation(device.mount_deg.map(f32::to_radians)),
            turn_sign: if device.clockwise { -1.0 } else { 1.0 },
            north: device.north_deg.to_radians(),
            changed: None,
            last_raw: [0; 6],
            out_of_range: false,
        }
    }

    /// The readings in bytes that arrived at `arrival`: [`Event::Imu`] and [`Event::Compass`].
    pub fn read(&mut self, bytes: &[u8], arrival: Stamp) -> Vec<Event> {
        let mut readings = Vec::new();
        match &mut self.decoder {
            Decoder::Bno085(stream, _) => stream.extend(bytes),
            Decoder::Wit(stream, _) => stream.extend(bytes),
        }
        while let Some(reading) = self.next_reading() {
            self.notice(reading.raw, arrival);
            let usable = self.imu && !self.out_of_range;
            if let Some((acceleration, rate)) = reading.inertia.filter(|_| usable) {
                readings.push(Event::Imu(Imu {
                    stamp: arrival,
                    acceleration: self.in_robot(acceleration),
                    rate: self.in_robot(rate),
                }));
            }
            if let Some(yaw) = reading.yaw.filter(|_| self.compass && !self.magnetometer) {
                readings.push(Event::Compass(Compass {
                    stamp: arrival,
                    heading: wrap_angle(self.turn_sign * yaw + self.north),
                    magnetic_field: None,
                }));
            }
            if let Some(field) = reading.field.filter(|_| self.compass && self.magnetometer) {
                let [x, y, _] = self.in_robot(field);
                readings.push(Event::Compass(Compass::from_magnetic_field(
                    arrival,
                    [x, y],
                )));
            }
        }
        readings
    }

    /// Bytes without a message so far.
    pub fn tally(&self) -> Tally {
        match &self.decoder {
            Decoder::Bno085(stream, _) => stream.tally(),
            Decoder::Wit(stream, _) => stream.tally(),
        }
    }

    /// For how many seconds the sensor has repeated its last inertial reading to the last bit.
    pub fn same_for(&self, now: Stamp) -> f32 {
        self.changed.map_or(0.0, |changed| (now - changed) as f32)
    }

    /// True while an inertial value is the least or greatest that the wire can carry: no measurement.
    pub fn is_out_of_range(&self) -> bool {
        self.out_of_range
    }

    fn next_reading(&mut self) -> Option<Reading> {
        match &mut self.decoder {
            Decoder::Bno085(stream, before) => {
                let message = stream.next()?;
                let before = before.replace(message);
                Some(rvc_reading(message, before))
            }
            Decoder::Wit(stream, acceleration) => {
                let message = stream.next()?;
                Some(wit_reading(message, acceleration))
            }
        }
    }

    /// Keeps when the raw inertial values last changed.
    fn notice(&mut self, raw: Option<[i16; 6]>, arrival: Stamp) {
        if let Some(raw) = raw
            && (self.changed.is_none() || raw != self.last_raw)
        {
            self.changed = Some(arrival);
            self.last_raw = raw;
        }
        if let Some(raw) = raw {
            self.out_of_range = raw.contains(&i16::MIN) || raw.contains(&i16::MAX);
        }
    }

    fn in_robot(&self, vector: [f32; 3]) -> [f32; 3] {
        self.robot_from_sensor
            .map(|row| row[0] * vector[0] + row[1] * vector[1] + row[2] * vector[2])
    }
}

/// What one message says, in the sensor's frame.
#[derive(Debug, Default)]
struct Reading {
    /// Values that no living sensor repeats for long.
    raw: Option<[i16; 6]>,
    /// Specific force (m/s²) and rate of turn (rad/s).
    inertia: Option<([f32; 3], [f32; 3])>,
    /// Yaw, radians.
    yaw: Option<f32>,
    /// Magnetic field, the sensor's own unit.
    field: Option<[f32; 3]>,
}

/// A BNO085 tells no rates: they are the change of its attitude since the message before.
///
/// Body rates from yaw ψ, pitch θ, roll φ (turned in this order): p = φ̇ − ψ̇ sin θ, q = θ̇ cos φ + ψ̇ sin φ cos θ,
/// r = −θ̇ sin φ + ψ̇ cos φ cos θ.
fn rvc_reading(message: Rvc, before: Option<Rvc>) -> Reading {
    let radians = |cdeg: i16| (f32::from(cdeg) * 0.01).to_radians();
    let [ax, ay, az] = message.acceleration_mg;
    let (yaw, pitch, roll) = (message.yaw_cdeg, message.pitch_cdeg, message.roll_cdeg);
    let mut reading = Reading {
        raw: Some([yaw, pitch, roll, ax, ay, az]),
        inertia: None,
        yaw: Some(radians(yaw)),
        field: None,
    };
    let Some(before) = before else {
        return reading;
    };
    let steps = message.index.wrapping_sub(before.index);
    if !(1..=RVC_STEPS_MAX).contains(&steps) {
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
    reading.inertia = Some((acceleration, rates));
    reading
}

/// A WitMotion sends acceleration, rate, angle one after the other: the rate completes an inertial reading.
fn wit_reading(message: Wit, acceleration: &mut [i16; 3]) -> Reading {
    let [x, y, z, _] = message.raw;
    match message.kind {
        Kind::Acceleration => {
            *acceleration = [x, y, z];
            Reading::default()
        }
        Kind::Rate => {
            let [ax, ay, az] = *acceleration;
            let force = Wit {
                kind: Kind::Acceleration,
                raw: [ax, ay, az, 0],
            };
            Reading {
                raw: Some([x, y, z, ax, ay, az]),
                inertia: Some((force.si(), message.si())),
                yaw: None,
                field: None,
            }
        }
        Kind::Angle => Reading {
            yaw: Some(message.si()[2]),
            ..Reading::default()
        },
        Kind::Field => Reading {
            field: Some(message.si()),
            ..Reading::default()
        },
        Kind::Other(_) => Reading::default(),
    }
}

/// Rz(yaw)·Ry(pitch)·Rx(roll), rows.
fn rotation([roll, pitch, yaw]: [f32; 3]) -> [[f32; 3]; 3] {
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

    fn device(sensor: Sensor) -> InertialDevice {
        InertialDevice {
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
    fn a_turning_bno085_gives_its_rate_across_the_half_turn_and_a_lost_message() {
        let mut reader = Reader::new(&device(Sensor::Bno085));
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
            for event in reader.read(&message.encode(), Stamp(i64::from(step))) {
                if let Event::Imu(imu) = event {
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
    fn a_sensor_on_its_side_is_turned_into_the_robot_s_frame() {
        let mut sideways = device(Sensor::Wit);
        // The sensor's x axis points to the robot's left, its y axis backwards.
        sideways.mount_deg = [0.0, 0.0, 90.0];
        sideways.clockwise = true;
        sideways.north_deg = 10.0;
        let mut reader = Reader::new(&sideways);
        let part = |kind, raw| Wit { kind, raw }.encode();
        let bytes = [
            part(Kind::Acceleration, [2048, 0, 0, 0]),
            part(Kind::Rate, [0, 1638, 0, 0]),
            part(Kind::Angle, [0, 0, 8192, 0]),
        ]
        .concat();
        let readings = reader.read(&bytes, Stamp(5));
        let [Event::Imu(imu), Event::Compass(compass)] = readings[..] else {
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
    fn a_sensor_that_repeats_itself_is_noticed_and_forgiven() {
        let mut reader = Reader::new(&device(Sensor::Bno085));
        let mut message = Rvc::default();
        for step in 0..100 {
            message.index = step;
            reader.read(&message.encode(), Stamp(i64::from(step) * 10_000_000));
        }
        assert!((reader.same_for(Stamp(990_000_000)) - 0.99).abs() < 1e-3);
        message.roll_cdeg = 1;
        reader.read(&message.encode(), Stamp(1_000_000_000));
        assert_eq!(reader.same_for(Stamp(1_000_000_000)), 0.0);
    }
}
