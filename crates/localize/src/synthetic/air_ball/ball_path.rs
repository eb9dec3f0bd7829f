//! Where the ball truly is: at rest, rolling, held or kicked into the air, by a generator of its own.

use rand::{Rng, RngExt};

use super::settings::{AirExperiment, BallMotion, RATE};
use crate::math;
use crate::synthetic::flying_ball::{Flight, trajectory};

/// True positions of the centre, and the number of the image in which it leaves the ground.
pub(super) struct TruePath {
    /// Ten positions per image, so that clock errors shift them.
    fine: Vec<[f64; 3]>,
    pub(super) kick: usize,
}

const FINE: usize = 10;

impl TruePath {
    pub(super) fn new(trial: &AirExperiment, rng: &mut impl Rng) -> Self {
        let mut unit = || f64::from(rng.random::<f32>());
        let direction = std::f64::consts::TAU * unit();
        let range = 1.5 + 3.0 * unit();
        let bearing = std::f64::consts::TAU * unit();
        let start = [range * math::cos(bearing), range * math::sin(bearing), 0.11];
        let images = 60;
        let fine_rate = RATE * FINE as f64;
        let (kick, at, level, up) = match trial.motion {
            BallMotion::Held => (
                0,
                [start[0] * 0.4, start[1] * 0.4, 0.3 + 1.2 * unit()],
                0.0,
                0.0,
            ),
            BallMotion::Ground => (15, start, trial.speed * unit(), 0.0),
            BallMotion::Carried => (15, start, 1.2 * unit(), 0.0),
            BallMotion::Flight => {
                let loft = (25.0 + 25.0 * unit()).to_radians();
                (
                    15,
                    start,
                    trial.speed * math::cos(loft),
                    trial.speed * math::sin(loft),
                )
            }
        };
        let flight = Flight {
            at,
            velocity: [
                level * math::cos(direction),
                level * math::sin(direction),
                up,
            ],
            drag: 0.008 + 0.016 * unit(),
            lift: 0.01 * unit(),
            ..Flight::default()
        };
        let mut fine = vec![at; kick * FINE];
        match trial.motion {
            BallMotion::Flight => {
                fine.extend(trajectory(&flight, (images - kick) * FINE, fine_rate));
            }
            BallMotion::Held => fine.resize(images * FINE, at),
            BallMotion::Carried => {
                let (height, duration) = (0.3 + 0.7 * unit(), 0.8 + 0.7 * unit());
                for step in 0..(images - kick) * FINE {
                    let time = step as f64 / fine_rate;
                    // As hands move: without a jump of the acceleration. Who lifts it begins to walk meanwhile.
                    let part = (time / duration).min(1.0);
                    let lifted = part.powi(3) * (10.0 - 15.0 * part + 6.0 * part * part);
                    let gone = level * (time - duration * (part - 0.5 * part * part));
                    let [x, y, z] = at;
                    fine.push([
                        x + gone * math::cos(direction),
                        y + gone * math::sin(direction),
                        z + height * lifted,
                    ]);
                }
            }
            BallMotion::Ground => {
                let deceleration = 0.2 + 0.5 * unit();
                for step in 0..(images - kick) * FINE {
                    let time = (step as f64 / fine_rate).min(level / deceleration);
                    let gone = level * time - 0.5 * deceleration * time * time;
                    let [x, y, z] = at;
                    fine.push([
                        x + gone * math::cos(direction),
                        y + gone * math::sin(direction),
                        z,
                    ]);
                }
            }
        }
        TruePath { fine, kick }
    }

    pub(super) fn images(&self) -> usize {
        self.fine.len() / FINE
    }

    /// Position at an image, `late` seconds later.
    pub(super) fn at(&self, image: usize, late: f32) -> [f64; 3] {
        let shift = (f64::from(late) * RATE * FINE as f64).round() as i64;
        let step = (image * FINE) as i64 + shift;
        self.fine[step.clamp(0, self.fine.len() as i64 - 1) as usize]
    }

    /// First contact with the ground after the kick, if the path has one.
    pub(super) fn first_landing(&self) -> Option<(usize, [f64; 3])> {
        let from = self.kick * FINE + 2;
        let lands = |step: &usize| self.fine[*step][2] < 0.12;
        let step = (from + FINE..self.fine.len()).find(lands)?;
        Some((step / FINE, self.fine[step]))
    }
}
