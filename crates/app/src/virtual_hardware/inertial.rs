//! What do the virtual IMUs send? The simulator's samples in the formats of a WitMotion and a BNO085.

use hw::wire::STANDARD_GRAVITY;
use hw::wire::bno085::Rvc;
use hw::wire::wit::{DataType, Wit};
use localize::frames::wrap_angle;
use localize::sample::{Compass, Imu};

/// State of the encoded sensors.
#[derive(Debug, Default)]
pub(super) struct ImuEncoder {
    /// Yaw that the BNO085 has integrated since the start, radians.
    bno085_yaw: f32,
    index: u8,
    last: Option<localize::Stamp>,
}

/// Fault of an IMU sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ImuFault {
    None,
    /// Every value is at the end of its range.
    Saturated,
}

impl ImuEncoder {
    /// Attitude message of a WitMotion.
    pub(super) fn encode_wit_angle(compass: &Compass) -> Vec<u8> {
        let yaw = wrap_angle(compass.heading) / std::f32::consts::PI * 32_768.0;
        let raw = [0, 0, yaw.round() as i16, 0];
        let kind = DataType::Angle;
        Wit { kind, raw }.encode().to_vec()
    }

    /// Acceleration and rate messages of a WitMotion.
    pub(super) fn encode_wit_imu(imu: &Imu, fault: ImuFault) -> Vec<u8> {
        let raw = |values: [f32; 3], full_scale: f32| {
            let scaled = values.map(|value| (value / full_scale * 32_768.0).round() as i16);
            match fault {
                ImuFault::None => [scaled[0], scaled[1], scaled[2], 0],
                ImuFault::Saturated => [i16::MIN; 4],
            }
        };
        [
            (
                DataType::Acceleration,
                raw(imu.specific_force, DataType::Acceleration.full_scale()),
            ),
            (
                DataType::AngularRate,
                raw(imu.angular_velocity, DataType::AngularRate.full_scale()),
            ),
        ]
        .into_iter()
        .flat_map(|(kind, raw)| Wit { kind, raw }.encode())
        .collect()
    }

    /// Message of a BNO085.
    pub(super) fn encode_bno085(&mut self, imu: &Imu) -> Vec<u8> {
        let elapsed = self
            .last
            .replace(imu.stamp)
            .map_or(0.0, |last| imu.stamp - last);
        self.bno085_yaw = wrap_angle(self.bno085_yaw + imu.angular_velocity[2] * elapsed as f32);
        self.index = self.index.wrapping_add(1);
        Rvc {
            index: self.index,
            yaw_cdeg: (self.bno085_yaw.to_degrees() * 100.0).round() as i16,
            pitch_cdeg: 0,
            roll_cdeg: 0,
            acceleration_mg: imu
                .specific_force
                .map(|value| (value / STANDARD_GRAVITY * 1000.0).round() as i16),
        }
        .encode()
        .to_vec()
    }
}
