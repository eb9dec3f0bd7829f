//! How does the robot's body tilt? It rocks on its wheels with its accelerations, and the floor is uneven.

use std::f32::consts::{PI, TAU};

use localize::frames::Pose;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

/// `[rocking]` of a scenario: tilt of the body, which its camera and its inertial unit share. Zeros keep it upright.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RockingConfig {
    /// Tilt under a constant acceleration, degrees per m/s², 0 to 5. The body leans back while it accelerates.
    pub tilt_per_acceleration_deg: f32,
    /// Natural frequency of the body on its wheels, Hz, 0.3 to 20.
    pub frequency_hz: f32,
    /// Damping ratio, 0 to 5; 1 is critical.
    pub damping: f32,
    /// Standard deviation of the floor's slope along each axis, degrees, 0 to 10.
    pub floor_slope_deg: f32,
    /// Shortest wavelength of the floor's slope, metres, 0.2 to 100.
    pub floor_wavelength: f32,
}

impl Default for RockingConfig {
    fn default() -> Self {
        // Photographs of league robots show a tilt that differs by 0.45° from place to place.
        RockingConfig {
            tilt_per_acceleration_deg: 0.25,
            frequency_hz: 4.0,
            damping: 0.25,
            floor_slope_deg: 0.3,
            floor_wavelength: 2.0,
        }
    }
}

impl RockingConfig {
    /// A body that stays upright.
    pub fn upright() -> Self {
        RockingConfig {
            tilt_per_acceleration_deg: 0.0,
            floor_slope_deg: 0.0,
            ..RockingConfig::default()
        }
    }

    pub(crate) fn check(&self) -> Result<(), (String, String)> {
        for (key, value, [least, most]) in [
            (
                "tilt_per_acceleration_deg",
                self.tilt_per_acceleration_deg,
                [0.0, 5.0],
            ),
            ("frequency_hz", self.frequency_hz, [0.3, 20.0]),
            ("damping", self.damping, [0.0, 5.0]),
            ("floor_slope_deg", self.floor_slope_deg, [0.0, 10.0]),
            ("floor_wavelength", self.floor_wavelength, [0.2, 100.0]),
        ] {
            if !(least <= value && value <= most) {
                return Err((
                    key.to_owned(),
                    format!("invalid value: {value} (expected {least} to {most})"),
                ));
            }
        }
        Ok(())
    }
}

/// Accelerations beyond this come from the physics' time step: a real push takes longer, m/s².
const ACCELERATION_MAX: f32 = 12.0;
/// Waves of the floor's slope along each axis.
const WAVES: usize = 6;

/// A wave of the floor's slope: wave vector (1/m) and phase.
#[derive(Debug, Clone, Copy)]
struct Wave {
    vector: [f32; 2],
    phase: f32,
}

/// Tilt of the body: a damped spring under each axis, on a floor of sine waves.
#[derive(Debug, Clone)]
pub(crate) struct Rocking {
    config: RockingConfig,
    floor: [[Wave; WAVES]; 2],
    angle: [f32; 2],
    rate: [f32; 2],
    tilt: [f32; 2],
    tilt_rate: [f32; 2],
}

impl Rocking {
    pub(crate) fn new(config: RockingConfig, start: Pose, rng: &mut ChaCha8Rng) -> Self {
        let mut wave = || {
            let length = config.floor_wavelength * (1.0 + 2.0 * rng.random::<f32>());
            let (sin, cos) = (TAU * rng.random::<f32>() - PI).sin_cos();
            Wave {
                vector: [cos * TAU / length, sin * TAU / length],
                phase: TAU * rng.random::<f32>(),
            }
        };
        let floor = [0; 2].map(|_| [0; WAVES].map(|_| wave()));
        let mut rocking = Rocking {
            config,
            floor,
            angle: [0.0; 2],
            rate: [0.0; 2],
            tilt: [0.0; 2],
            tilt_rate: [0.0; 2],
        };
        rocking.tilt = rocking.floor_tilt(start);
        rocking
    }

    /// x and y components of the vertical in the frame of a robot that stands without rocking.
    fn floor_tilt(&self, pose: Pose) -> [f32; 2] {
        let size = self.config.floor_slope_deg.to_radians() * (2.0 / WAVES as f32).sqrt();
        let [slope_x, slope_y] = self.floor.map(|waves| {
            let heights = waves
                .map(|wave| (wave.vector[0] * pose.x + wave.vector[1] * pose.y + wave.phase).sin());
            size * heights.iter().sum::<f32>()
        });
        let (sin, cos) = pose.theta.sin_cos();
        [cos * slope_x + sin * slope_y, cos * slope_y - sin * slope_x]
    }

    /// Advances by `step` seconds under an acceleration (robot frame, m/s²).
    pub(crate) fn step(&mut self, acceleration: [f32; 2], pose: Pose, step: f32) {
        let natural = TAU * self.config.frequency_hz;
        let per = self.config.tilt_per_acceleration_deg.to_radians();
        let size = acceleration[0].hypot(acceleration[1]);
        let limit = ACCELERATION_MAX / size.max(ACCELERATION_MAX);
        for (k, acceleration) in acceleration.into_iter().enumerate() {
            // The top stays behind, so that the vertical leans forward in the body's frame.
            let target = per * limit * acceleration;
            let pull = natural * natural * (target - self.angle[k]);
            // Implicit in the damping, which is then stable for any ratio.
            self.rate[k] =
                (self.rate[k] + step * pull) / (1.0 + 2.0 * self.config.damping * natural * step);
            self.angle[k] += step * self.rate[k];
        }
        let floor = self.floor_tilt(pose);
        for (k, floor) in floor.into_iter().enumerate() {
            let tilt = self.angle[k] + floor;
            self.tilt_rate[k] = (tilt - self.tilt[k]) / step;
            self.tilt[k] = tilt;
        }
    }

    /// Puts the robot to another place, at rest.
    pub(crate) fn place(&mut self, pose: Pose) {
        (self.angle, self.rate, self.tilt_rate) = ([0.0; 2], [0.0; 2], [0.0; 2]);
        self.tilt = self.floor_tilt(pose);
    }

    /// x and y components of the vertical in the robot frame.
    pub(crate) fn tilt(&self) -> [f32; 2] {
        self.tilt
    }

    /// Their rates of change, 1/s.
    pub(crate) fn tilt_rate(&self) -> [f32; 2] {
        self.tilt_rate
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    fn rocking(config: RockingConfig) -> Rocking {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        Rocking::new(config, Pose::new(0.0, 0.0, 0.0), &mut rng)
    }

    #[test]
    fn constant_acceleration_tilts_by_the_static_tilt_after_overshooting() {
        let mut body = rocking(RockingConfig {
            floor_slope_deg: 0.0,
            ..RockingConfig::default()
        });
        let mut most = 0.0f32;
        for _ in 0..2000 {
            body.step([2.0, -1.0], Pose::new(0.0, 0.0, 0.0), 0.002);
            most = most.max(body.tilt()[0]);
        }
        let [x, y] = body.tilt().map(f32::to_degrees);
        assert!((x - 0.5).abs() < 0.01 && (y + 0.25).abs() < 0.01, "{x} {y}");
        // Damping 0.25 overshoots by exp(-π·0.25/√(1 - 0.25²)) = 44 %.
        let overshoot = most.to_degrees() / 0.5 - 1.0;
        assert!((overshoot - 0.44).abs() < 0.06, "{overshoot}");
    }

    #[test]
    fn floor_slope_has_its_standard_deviation_and_turns_with_the_robot() {
        let body = rocking(RockingConfig::default());
        let mut square = 0.0;
        let count = 60;
        for i in 0..count {
            for j in 0..count {
                let pose = Pose::new(i as f32 * 0.9, j as f32 * 0.9, 0.0);
                let [x, y] = body.floor_tilt(pose);
                square += x * x + y * y;
                let turned = body.floor_tilt(Pose::new(pose.x, pose.y, PI / 2.0));
                assert!((turned[0] - y).abs() < 1e-5 && (turned[1] + x).abs() < 1e-5);
            }
        }
        let std_deg = (square / (2 * count * count) as f32).sqrt().to_degrees();
        assert!((std_deg - 0.3).abs() < 0.05, "{std_deg}");
    }
}
