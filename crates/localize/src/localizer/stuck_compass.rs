//! Does the compass repeat one reading although the robot turns? A unit that hangs does (docs/methods.md 9.2).
//!
//! Such a reading decides no field half: it was right once, and says nothing of a robot that was carried elsewhere since.

use crate::sample::{Compass, Imu, Odometry};
use crate::stamp::Stamp;

/// Turn over which even a coarse compass changes its reading, radians (15 degrees).
const REPEATED_TURN_MAX: f32 = 0.26;

/// The last reading, and how far the robot has turned since it first came.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct StuckCompass {
    /// Heading and magnetic field.
    reading: Option<(f32, Option<[f32; 2]>)>,
    /// Each source alone, radians. None without a sample.
    by_wheels: Option<f32>,
    by_gyro: Option<f32>,
    gyro_stamp: Option<Stamp>,
    is_stuck: bool,
}

impl StuckCompass {
    /// Adds a motion of the wheels.
    pub(super) fn add_odometry(&mut self, sample: &Odometry) {
        *self.by_wheels.get_or_insert(0.0) += sample.dtheta;
    }

    /// Adds a reading of the gyro with this bias about z, rad/s.
    pub(super) fn add_imu(&mut self, sample: &Imu, bias: f32) {
        if let Some(before) = self.gyro_stamp.replace(sample.stamp) {
            let seconds = before.seconds_until(sample.stamp) as f32;
            *self.by_gyro.get_or_insert(0.0) += (sample.angular_velocity[2] - bias) * seconds;
        }
    }

    /// Takes a reading. Does the compass hang?
    ///
    /// Wheels spin and a gyro drifts, so the robot has turned if all sources say so.
    pub(super) fn hangs_at(&mut self, sample: &Compass) -> bool {
        let reading = Some((sample.heading, sample.magnetic_field));
        if self.reading != reading {
            *self = StuckCompass {
                reading,
                gyro_stamp: self.gyro_stamp,
                ..StuckCompass::default()
            };
        }
        let turns = [self.by_wheels, self.by_gyro].into_iter().flatten();
        let least = turns.map(f32::abs).reduce(f32::min);
        self.is_stuck |= least.is_some_and(|turn| turn > REPEATED_TURN_MAX);
        self.is_stuck
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Half a second of turning, by the wheels and by the gyro, rad/s, with a reading of the compass each 10 ms.
    /// How many readings are of a compass that hangs?
    fn stuck_readings(wheels: f32, gyro: Option<f32>, reading: impl Fn(f32) -> f32) -> usize {
        let mut compass = StuckCompass::default();
        let readings = (0..50).filter(|&k| {
            let stamp = Stamp(k * 10_000_000);
            compass.add_odometry(&Odometry {
                stamp,
                dx: 0.0,
                dy: 0.0,
                dtheta: 0.01 * wheels,
                slip: 0.0,
            });
            if let Some(rate) = gyro {
                let imu = Imu {
                    stamp,
                    specific_force: [0.0, 0.0, 9.8],
                    angular_velocity: [0.0, 0.0, rate],
                };
                compass.add_imu(&imu, 0.0);
            }
            let heading = reading(0.01 * k as f32);
            compass.hangs_at(&Compass {
                stamp,
                heading,
                magnetic_field: None,
            })
        });
        readings.count()
    }

    #[test]
    fn compass_that_repeats_a_reading_in_a_turn_hangs_until_it_changes() {
        assert_eq!(stuck_readings(1.0, Some(1.0), |seconds| seconds), 0);
        let hanging = |seconds: f32| if seconds < 0.45 { 0.7 } else { 0.8 };
        let stuck = stuck_readings(1.0, Some(1.0), hanging);
        assert!((15..=20).contains(&stuck), "{stuck}");
        assert!(stuck_readings(1.0, None, hanging) >= 15);
    }

    #[test]
    fn compass_at_rest_may_repeat_although_wheels_spin_or_the_gyro_drifts() {
        assert_eq!(stuck_readings(3.0, Some(0.0), |_| 0.7), 0);
        assert_eq!(stuck_readings(0.0, Some(3.0), |_| 0.7), 0);
    }

    #[test]
    fn coarse_compass_does_not_hang() {
        let coarse = |seconds: f32| (seconds / 0.2).floor() * 0.2;
        assert_eq!(stuck_readings(1.0, Some(1.0), coarse), 0);
    }
}
