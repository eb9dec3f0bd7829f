//! Experiment: how soon and how well is a ball in the air known, by one robot and by several?
//!
//! Equal seeds give equal scores. The ball moves by [`super::flying_ball`], whose drag and lift the estimators do not
//! know. Tilt, pose and clock errors last; some rays point anywhere.

use rand::rngs::Xoshiro256PlusPlus;
use rand::{Rng, RngExt, SeedableRng};
use serde::Serialize;

use super::flying_ball::{Flight, trajectory};
use crate::flight::{
    BallMotionMode, BallRay, FlightConfig, FlightTracker, RobotRay, predict_landing, triangulate,
};
use crate::math;
use crate::random::standard_normal;
use crate::stamp::Stamp;

/// Images per second.
const RATE: f64 = 30.0;
/// Height of the robots' mirrors, metres.
const HEIGHT: f64 = 0.8;
/// Time constant of the errors that last, seconds.
const CORRELATION_TIME: f64 = 0.5;

/// What one robot is shown, or how the ball moves for several.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BallMotion {
    /// It lies, rolls, or is kicked along the ground.
    Ground,
    /// It is kicked into the air and bounces.
    Flight,
    /// It rests at a height of 0.3 to 1.5 m.
    Held,
}

/// Settings of the experiment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AirExperiment {
    /// How the ball moves.
    pub motion: BallMotion,
    /// Number of robots that see it; 1 is the filter over time.
    pub robots: usize,
    /// The first robots of this number report wrong directions.
    pub faulty_robots: usize,
    /// Standard deviation of a ray, degrees.
    pub ray_std_deg: f32,
    /// Share of rays that point anywhere.
    pub outlier_share: f32,
    /// Speed of kicks, m/s.
    pub speed: f64,
    /// Does the ball's apparent size measure its distance?
    pub sized: bool,
}

impl Default for AirExperiment {
    fn default() -> Self {
        AirExperiment {
            motion: BallMotion::Flight,
            robots: 1,
            faulty_robots: 0,
            ray_std_deg: 0.25,
            outlier_share: 0.01,
            speed: 6.0,
            sized: true,
        }
    }
}

/// Standard deviations of lasting errors.
const TILT_STD_DEG: f32 = 0.15;
const POSITION_STD: f32 = 0.03;
const HEADING_STD: f32 = 0.008;
const CLOCK_STD: f32 = 0.003;
/// Errors of a distance by the apparent size, shares of it: lasting, and of each image.
const SIZE_BIAS: f32 = 0.1;
const SIZE_STD: f32 = 0.08;
/// Error of a faulty robot's directions, radians.
const FAULT: f32 = 0.3;

/// Sums over one or more seeds.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct AirScore {
    /// Scored images.
    pub images: usize,
    /// Those in which the ball was in the air by more than its radius.
    pub airborne: usize,
    /// Of these, called airborne.
    pub airborne_found: usize,
    /// Images of a ball on the ground that is called airborne.
    pub false_alarms: usize,
    /// Images of a ball on the ground.
    pub on_ground: usize,
    /// Sum of errors of the position, and number.
    pub error_sum: f64,
    /// Errors summed.
    pub errors: usize,
    /// Sum of the normalized estimation errors squared (3 is honest).
    pub nees_sum: f64,
    /// Sum of errors of the predicted landing point a quarter of a second ahead or more, and number.
    pub landing_sum: f64,
    /// Landings summed.
    pub landings: usize,
    /// Images with a faulty robot, and those in which it alone is named.
    pub faulty_images: usize,
    /// Images in which the faulty robot alone is named.
    pub faulty_named: usize,
}

impl AirScore {
    /// Mean error of the position, metres.
    pub fn error(&self) -> Option<f64> {
        (self.errors > 0).then(|| self.error_sum / self.errors as f64)
    }

    /// Mean normalized estimation error squared; 3 is honest.
    pub fn nees(&self) -> Option<f64> {
        (self.errors > 0).then(|| self.nees_sum / self.errors as f64)
    }

    /// Mean error of the landing point, metres.
    pub fn landing_error(&self) -> Option<f64> {
        (self.landings > 0).then(|| self.landing_sum / self.landings as f64)
    }

    fn add_error(&mut self, state: &crate::flight::BallMotionState, truth: [f64; 3]) {
        let off = nalgebra::Vector3::from_fn(|axis, _| state.state[axis] - truth[axis]);
        let covariance = state.covariance.fixed_view::<3, 3>(0, 0).into_owned();
        // What the kind of motion fixes has no variance of its own: a millimetre.
        let covariance = covariance + nalgebra::Matrix3::identity() * 1e-6;
        if let Some(inverse) = covariance.try_inverse() {
            self.nees_sum += (off.transpose() * inverse * off).x;
            self.error_sum += off.norm();
            self.errors += 1;
        }
    }
}

/// Errors of a robot that last, in units of their standard deviations.
struct LastingErrors([f32; 6]);

impl LastingErrors {
    fn new(rng: &mut impl Rng) -> Self {
        LastingErrors(std::array::from_fn(|_| standard_normal(rng)))
    }

    fn step(&mut self, rng: &mut impl Rng) {
        let decay = math::exp(-1.0 / (RATE * CORRELATION_TIME)) as f32;
        // The clock's error stays.
        for value in &mut self.0[..5] {
            *value = decay * *value + (1.0 - decay * decay).sqrt() * standard_normal(rng);
        }
    }
}

/// True positions of the centre, and the number of the image in which it leaves the ground.
struct TruePath {
    /// Ten positions per image, so that clock errors shift them.
    fine: Vec<[f64; 3]>,
    kick: usize,
}

const FINE: usize = 10;

impl TruePath {
    fn new(trial: &AirExperiment, rng: &mut impl Rng) -> Self {
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

    fn images(&self) -> usize {
        self.fine.len() / FINE
    }

    /// Position at an image, `late` seconds later.
    fn at(&self, image: usize, late: f32) -> [f64; 3] {
        let shift = (f64::from(late) * RATE * FINE as f64).round() as i64;
        let step = (image * FINE) as i64 + shift;
        self.fine[step.clamp(0, self.fine.len() as i64 - 1) as usize]
    }

    /// First contact with the ground after the kick, if the path has one.
    fn first_landing(&self) -> Option<(usize, [f64; 3])> {
        let from = self.kick * FINE + 2;
        let lands = |step: &usize| self.fine[*step][2] < 0.12;
        let step = (from + FINE..self.fine.len()).find(lands)?;
        Some((step / FINE, self.fine[step]))
    }
}

struct Observer {
    at: [f64; 2],
    errors: LastingErrors,
    /// True over measured distance, by the size.
    size_scale: f32,
}

impl Observer {
    /// The ray as this robot believes it: in the field frame by its erroneous pose, or by its true one.
    fn ray(
        &self,
        ball: [f64; 3],
        stamp: Stamp,
        trial: &AirExperiment,
        with_pose_error: bool,
        rng: &mut impl Rng,
    ) -> BallRay {
        let offset = [ball[0] - self.at[0], ball[1] - self.at[1], ball[2] - HEIGHT];
        let level = math::hypot(offset[0], offset[1]);
        let azimuth = math::atan2(offset[1], offset[0]) as f32;
        let elevation = math::atan2(offset[2], level) as f32;
        let std = trial.ray_std_deg.to_radians();
        let [tilt_x, tilt_y, x, y, heading, _] = self.errors.0;
        let tilt = TILT_STD_DEG.to_radians();
        let (sin, cos) = math::sin_cos(azimuth);
        // A tilt raises the view on one side and turns it sideways in proportion to the elevation.
        let raised = tilt * (tilt_x * cos + tilt_y * sin);
        let aside = tilt * (tilt_y * cos - tilt_x * sin) * math::tan(elevation);
        let (mut azimuth, mut elevation) = (
            azimuth + aside + std * standard_normal(rng),
            elevation + raised + std * standard_normal(rng),
        );
        if rng.random::<f32>() < trial.outlier_share {
            azimuth += 2.0 * rng.random::<f32>() - 1.0;
            elevation -= 0.5 * rng.random::<f32>();
        }
        let wrong = if with_pose_error { 1.0 } else { 0.0 };
        BallRay {
            stamp,
            origin: [
                self.at[0] as f32 + wrong * POSITION_STD * x,
                self.at[1] as f32 + wrong * POSITION_STD * y,
                HEIGHT as f32,
            ],
            azimuth: azimuth + wrong * HEADING_STD * heading,
            elevation,
            azimuth_std: std,
            elevation_std: std,
            distance: trial.sized.then(|| {
                let distance = math::hypot(level, offset[2]) as f32;
                let measured = distance * self.size_scale * (1.0 + SIZE_STD * standard_normal(rng));
                [measured.max(0.2), 0.1 * measured.max(0.2)]
            }),
        }
    }
}

/// Runs one seed.
pub fn evaluate_air_ball(seed: u64, trial: &AirExperiment) -> AirScore {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
    let path = TruePath::new(trial, &mut rng);
    if trial.robots <= 1 {
        evaluate_one(&path, trial, &mut rng)
    } else {
        evaluate_team(&path, trial, &mut rng)
    }
}

fn evaluate_one(path: &TruePath, trial: &AirExperiment, rng: &mut impl Rng) -> AirScore {
    let config = FlightConfig::default();
    let mut observer = Observer {
        at: [0.0, 0.0],
        errors: LastingErrors::new(rng),
        size_scale: 1.0 + SIZE_BIAS * standard_normal(rng),
    };
    let mut tracker = FlightTracker::new(config.clone());
    let mut score = AirScore::default();
    let landing = path.first_landing();
    for image in 0..path.images() {
        observer.errors.step(rng);
        let stamp = Stamp::from_seconds(image as f64 / RATE);
        let truth = path.at(image, 0.0);
        // One mirror sees no ball above its horizon.
        if truth[2] > HEIGHT - 0.05 || rng.random::<f32>() < 0.05 {
            continue;
        }
        let ray = observer.ray(truth, stamp, trial, false, rng);
        let Some(tracked) = tracker.update(&ray) else {
            continue;
        };
        score.images += 1;
        let (high, called) = (truth[2] > 0.22, tracked.airborne_probability > 0.5);
        if high {
            score.airborne += 1;
            score.airborne_found += usize::from(called);
        } else if truth[2] < 0.111 {
            score.on_ground += 1;
            score.false_alarms += usize::from(called);
        }
        let called_path = if called {
            tracked.flight
        } else {
            tracked.ground
        };
        let Some(state) = called_path else {
            continue;
        };
        if high && called {
            score.add_error(&state, truth);
            if let (Some((end, at)), Some(predicted)) = (landing, predict_landing(&state, &config))
                && image + 8 <= end
            {
                let [x, y] = predicted.at.map(f64::from);
                score.landing_sum += math::hypot(x - at[0], y - at[1]);
                score.landings += 1;
            }
        }
    }
    score
}

fn evaluate_team(path: &TruePath, trial: &AirExperiment, rng: &mut impl Rng) -> AirScore {
    let config = FlightConfig::default();
    let turn = std::f64::consts::TAU * f64::from(rng.random::<f32>());
    let mut observers: Vec<Observer> = (0..trial.robots)
        .map(|robot| {
            let angle = turn
                + std::f64::consts::TAU * robot as f64 / trial.robots as f64
                + 0.5 * f64::from(rng.random::<f32>());
            let range = 3.0 + f64::from(rng.random::<f32>());
            Observer {
                at: [range * math::cos(angle), range * math::sin(angle)],
                errors: LastingErrors::new(rng),
                size_scale: 1.0 + SIZE_BIAS * standard_normal(rng),
            }
        })
        .collect();
    let mut rays: Vec<RobotRay> = Vec::new();
    let mut score = AirScore::default();
    for image in 0..path.images() {
        let stamp = Stamp::from_seconds(image as f64 / RATE);
        let truth = path.at(image, 0.0);
        for (number, observer) in observers.iter_mut().enumerate() {
            observer.errors.step(rng);
            // The own ray comes with each image, those of team-mates with every second one, and a fifth is lost.
            let heard = number == 0 || image % 2 == number % 2 && rng.random::<f32>() > 0.2;
            if !heard {
                continue;
            }
            let late = CLOCK_STD * observer.errors.0[5];
            let seen = path.at(image, late);
            let mut ray = observer.ray(seen, stamp, trial, true, rng);
            if number < trial.faulty_robots {
                ray.azimuth += FAULT;
                ray.elevation -= 0.5 * FAULT;
            }
            rays.push(RobotRay {
                robot: number as u32 + 1,
                ray,
                pose_std: [POSITION_STD, HEADING_STD],
            });
        }
        let since = stamp.0 - 300_000_000;
        rays.retain(|ray| ray.ray.stamp.0 > since);
        if image < 8 {
            continue;
        }
        score.images += 1;
        score.faulty_images += usize::from(trial.faulty_robots > 0);
        let Some(found) = triangulate(&rays, &config) else {
            continue;
        };
        let expected: Vec<u32> = (1..=trial.faulty_robots as u32).collect();
        score.faulty_named += usize::from(trial.faulty_robots > 0 && found.outliers == expected);
        let (high, called) = (truth[2] > 0.22, found.mode != BallMotionMode::Ground);
        if high {
            score.airborne += 1;
            score.airborne_found += usize::from(called);
        } else if truth[2] < 0.111 {
            score.on_ground += 1;
            score.false_alarms += usize::from(called);
        }
        if high {
            score.add_error(&found.state, truth);
        }
    }
    score
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sum(trial: &AirExperiment, seeds: u64) -> AirScore {
        let mut sum = AirScore::default();
        for seed in 0..seeds {
            let score = evaluate_air_ball(seed, trial);
            sum.images += score.images;
            sum.airborne += score.airborne;
            sum.airborne_found += score.airborne_found;
            sum.false_alarms += score.false_alarms;
            sum.on_ground += score.on_ground;
            sum.error_sum += score.error_sum;
            sum.errors += score.errors;
            sum.nees_sum += score.nees_sum;
            sum.landing_sum += score.landing_sum;
            sum.landings += score.landings;
            sum.faulty_images += score.faulty_images;
            sum.faulty_named += score.faulty_named;
        }
        sum
    }

    #[test]
    fn one_robot_tells_flight_from_ground() {
        let flight = sum(&AirExperiment::default(), 40);
        let ground = sum(
            &AirExperiment {
                motion: BallMotion::Ground,
                ..AirExperiment::default()
            },
            40,
        );
        assert!(
            5 * flight.airborne_found > 3 * flight.airborne,
            "{flight:?}"
        );
        assert!(50 * ground.false_alarms < ground.on_ground, "{ground:?}");
    }

    #[test]
    fn three_robots_find_a_ball_in_the_air() {
        for (motion, error_max) in [(BallMotion::Held, 0.13), (BallMotion::Flight, 0.2)] {
            let trial = AirExperiment {
                motion,
                robots: 3,
                ..AirExperiment::default()
            };
            let score = sum(&trial, 40);
            assert!(
                score.error().is_some_and(|error| error < error_max),
                "{score:?}"
            );
        }
    }

    #[test]
    fn covariance_of_a_held_ball_is_honest() {
        let trial = AirExperiment {
            motion: BallMotion::Held,
            robots: 3,
            ..AirExperiment::default()
        };
        let nees = sum(&trial, 40).nees().expect("errors");
        assert!((1.0..6.0).contains(&nees), "{nees}");
    }

    #[test]
    fn one_faulty_robot_of_three_is_named() {
        let trial = AirExperiment {
            motion: BallMotion::Held,
            robots: 3,
            faulty_robots: 1,
            ..AirExperiment::default()
        };
        let score = sum(&trial, 20);
        assert!(
            10 * score.faulty_named > 8 * score.faulty_images,
            "{score:?}"
        );
    }
}
