//! What do IMU and compass measure? The true motion with bias, noise and magnetic distortion.

use localize::frames::wrap_angle;
use localize::random::standard_normal;
use localize::robot::{CompassModelConfig, ImuConfig, IronConfig};
use localize::sample::{Compass, Imu};
use localize::sensors::attitude::GRAVITY;
use localize::stamp::Stamp;
use rand_chacha::ChaCha8Rng;

use crate::render::level_from_body;

/// An inertial unit; its biases are drawn once, in `new`.
#[derive(Debug, Clone)]
pub(crate) struct ImuModel {
    acceleration_noise: f32,
    rate_noise: f32,
    acceleration_bias: [f32; 3],
    rate_bias: [f32; 3],
}

impl ImuModel {
    pub(crate) fn new(config: &ImuConfig, rng: &mut ChaCha8Rng) -> Self {
        let (acceleration, rate) = (config.acceleration_bias, config.rate_bias_deg.to_radians());
        ImuModel {
            acceleration_noise: config.acceleration_noise,
            rate_noise: config.rate_noise_deg.to_radians(),
            acceleration_bias: [0; 3].map(|_| acceleration * standard_normal(rng)),
            rate_bias: [0; 3].map(|_| rate * standard_normal(rng)),
        }
    }

    /// A reading for the mean true acceleration since the last one (level robot frame, m/s²), the true yaw rate (rad/s),
    /// and the body's tilt with its rate of change.
    pub(crate) fn read(
        &self,
        stamp: Stamp,
        acceleration: [f32; 2],
        rate: f32,
        ([a, b], tilt_rate): ([f32; 2], [f32; 2]),
        rng: &mut ChaCha8Rng,
    ) -> Imu {
        let level = [acceleration[0], acceleration[1], GRAVITY];
        // The unit is fixed to the body: the transpose turns level axes to its axes.
        let rotation = level_from_body(a, b);
        let force: [f32; 3] =
            std::array::from_fn(|axis| (0..3).map(|k| rotation[3 * k + axis] * level[k]).sum());
        // The vertical u changes by u × ω.
        let rates = [
            tilt_rate[1] + a * rate,
            b * rate - tilt_rate[0],
            rate * rotation[8],
        ];
        Imu {
            stamp,
            specific_force: std::array::from_fn(|axis| {
                force[axis]
                    + self.acceleration_bias[axis]
                    + self.acceleration_noise * standard_normal(rng)
            }),
            angular_velocity: std::array::from_fn(|axis| {
                rates[axis] + self.rate_bias[axis] + self.rate_noise * standard_normal(rng)
            }),
        }
    }
}

/// A compass whose bias is an Ornstein-Uhlenbeck process.
#[derive(Debug, Clone)]
pub(crate) struct CompassModel {
    noise: f32,
    bias_std: f32,
    bias_decay: f32,
    bias: f32,
    iron: Option<IronConfig>,
}

impl CompassModel {
    pub(crate) fn new(config: &CompassModelConfig, rng: &mut ChaCha8Rng) -> Self {
        let bias_std = config.bias_deg.to_radians();
        CompassModel {
            noise: config.noise_deg.to_radians(),
            bias_std,
            bias_decay: (-1.0 / (config.rate_hz * config.bias_time)).exp(),
            bias: bias_std * standard_normal(rng),
            iron: config.iron.clone(),
        }
    }

    /// A reading for a true heading, radians.
    pub(crate) fn read(&mut self, stamp: Stamp, heading: f32, rng: &mut ChaCha8Rng) -> Compass {
        let step_std = self.bias_std * (1.0 - self.bias_decay * self.bias_decay).sqrt();
        self.bias = self.bias_decay * self.bias + step_std * standard_normal(rng);
        let heading = wrap_angle(heading + self.bias + self.noise * standard_normal(rng));
        let Some(IronConfig { hard, soft }) = &self.iron else {
            return Compass {
                stamp,
                heading,
                magnetic_field: None,
            };
        };
        // North is along the field's x axis.
        let (sin, cos) = heading.sin_cos();
        let field = [0, 1].map(|k| soft[k][0] * cos - soft[k][1] * sin + hard[k]);
        Compass::from_magnetic_field(stamp, field)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn iron_calibration_corrects_magnetometer_headings() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let config = CompassModelConfig {
            noise_deg: 0.5,
            bias_deg: 0.0,
            iron: Some(IronConfig {
                hard: [0.5, -0.3],
                soft: [[1.1, 0.1], [0.1, 0.9]],
            }),
            ..CompassModelConfig::default()
        };
        let mut compass = CompassModel::new(&config, &mut rng);
        let readings: Vec<(f32, Compass)> = (0..300)
            .map(|k| wrap_angle(k as f32 * 0.1))
            .map(|heading| (heading, compass.read(Stamp(0), heading, &mut rng)))
            .collect();
        let fields: Vec<[f32; 2]> = readings
            .iter()
            .filter_map(|(_, compass)| compass.magnetic_field)
            .collect();
        let calibrated = localize::config::CompassConfig {
            calibration: Some(
                localize::sensors::compass_calibration::fit_calibration(&fields)
                    .expect("a full rotation")
                    .calibration,
            ),
            ..localize::config::CompassConfig::default()
        };
        let worst = |heading: &dyn Fn(&Compass) -> f32| {
            let errors = readings
                .iter()
                .map(|(truth, compass)| wrap_angle(heading(compass) - truth).abs());
            errors.fold(0.0_f32, f32::max).to_degrees()
        };
        assert!(worst(&|compass| compass.heading) > 25.0);
        assert!(worst(&|compass| calibrated.heading(compass).expect("undisturbed")) < 6.0);
        let near_steel = Compass::from_magnetic_field(Stamp(0), [3.0, 0.0]);
        assert_eq!(calibrated.heading(&near_steel), None);
    }

    #[test]
    fn compass_error_is_root_sum_square_of_noise_and_bias() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let config = CompassModelConfig {
            bias_time: 0.5,
            ..CompassModelConfig::default()
        };
        let mut compass = CompassModel::new(&config, &mut rng);
        let count = 20_000;
        let errors = (0..count).map(|_| compass.read(Stamp(0), 3.0, &mut rng).heading - 3.0);
        let square: f32 = errors.map(|error| wrap_angle(error).powi(2)).sum();
        let std_deg = (square / count as f32).sqrt().to_degrees();
        assert!((std_deg - 5f32.hypot(4.0)).abs() < 0.3, "{std_deg}");
    }
}
