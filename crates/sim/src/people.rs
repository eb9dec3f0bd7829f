//! Where do people walk? A referee on the field, others beside it; they step back from robots.

use std::f32::consts::TAU;

use localize::field::Field;
use localize::frames::{Pose, wrap_angle};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

/// `[people]` of a scenario.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PeopleConfig {
    /// Number of people, 0 to 20.
    pub count: usize,
    /// Probability that a person's next destination is on the field and not beside it, 0 to 1.
    pub on_field: f32,
    /// Walking speed, m/s, 0 to 3.
    pub speed: f32,
}

impl Default for PeopleConfig {
    fn default() -> Self {
        PeopleConfig {
            count: 2,
            on_field: 0.15,
            speed: 1.1,
        }
    }
}

impl PeopleConfig {
    pub(crate) fn check(&self) -> Result<(), (String, String)> {
        for (key, value, most) in [
            ("count", self.count as f32, 20.0),
            ("on_field", self.on_field, 1.0),
            ("speed", self.speed, 3.0),
        ] {
            if !(0.0..=most).contains(&value) {
                return Err((
                    key.to_owned(),
                    format!("invalid value: {value} (expected 0 to {most})"),
                ));
            }
        }
        Ok(())
    }
}

/// A person on or beside the field.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Person {
    /// Position and walking direction, field frame.
    pub pose: Pose,
    /// Colours of trousers and shirt, sRGB.
    pub colours: [[u8; 3]; 2],
    /// Phase of the gait, radians.
    phase: f32,
    /// True while the person walks.
    walks: bool,
}

impl Person {
    /// Distance of the front foot ahead of the body, metres.
    pub(crate) fn stride(&self) -> f32 {
        if self.walks {
            STRIDE * self.phase.sin()
        } else {
            0.02
        }
    }
}

/// Largest distance of a foot from the body, metres, and length of a full cycle of the gait.
const STRIDE: f32 = 0.3;
const GAIT_LENGTH: f32 = 1.4;
/// Distance from a robot at which people step back, metres, and speed at which they do, m/s.
const ROBOT_DISTANCE: f32 = 1.0;
const STEP_BACK_SPEED: f32 = 2.5;
/// Shortest and longest pause at a destination, seconds.
const PAUSE: [f32; 2] = [0.5, 6.0];
/// Distance from a destination at which it is reached, metres.
const ARRIVED: f32 = 0.1;
/// Distance of destinations beside the field from the outer lines, metres.
const BESIDE: [f32; 2] = [0.3, 1.2];

/// Everyone, with their destinations.
pub(crate) struct People {
    config: PeopleConfig,
    half: [f32; 2],
    people: Vec<Person>,
    destinations: Vec<[f32; 2]>,
    pauses: Vec<f32>,
}

impl People {
    pub(crate) fn new(field: &Field, config: PeopleConfig, rng: &mut ChaCha8Rng) -> Self {
        let mut people = People {
            config,
            half: [field.length / 2.0, field.width / 2.0],
            people: Vec::new(),
            destinations: Vec::new(),
            pauses: vec![0.0; config.count],
        };
        const CLOTHES: [[u8; 3]; 6] = [
            [34, 36, 44],
            [46, 58, 92],
            [24, 24, 26],
            [110, 104, 92],
            [170, 45, 45],
            [205, 205, 200],
        ];
        for _ in 0..config.count {
            let [x, y] = people.place_beside(rng);
            let colours = [4, 6].map(|count| CLOTHES[rng.random_range(0..count)]);
            people.people.push(Person {
                pose: Pose::new(x, y, TAU * rng.random::<f32>()),
                colours,
                phase: TAU * rng.random::<f32>(),
                walks: false,
            });
            let destination = people.destination(rng);
            people.destinations.push(destination);
        }
        people
    }

    /// Everyone now.
    pub(crate) fn all(&self) -> &[Person] {
        &self.people
    }

    /// Copies everyone's pose and gait from another simulation of the same game.
    pub(crate) fn set(&mut self, people: &[Person]) {
        for (own, other) in self.people.iter_mut().zip(people) {
            *own = *other;
        }
    }

    /// Lets everyone walk for `step` seconds; `robots` are the poses of all robots.
    pub(crate) fn step(&mut self, step: f32, robots: &[Pose], rng: &mut ChaCha8Rng) {
        for index in 0..self.people.len() {
            let person = &mut self.people[index];
            let nearest = robots
                .iter()
                .map(|robot| [person.pose.x - robot.x, person.pose.y - robot.y])
                .min_by(|a, b| a[0].hypot(a[1]).total_cmp(&b[0].hypot(b[1])));
            let retreat = nearest.filter(|by| by[0].hypot(by[1]) < ROBOT_DISTANCE);
            let [to_x, to_y] = self.destinations[index];
            let (dx, dy) = (to_x - person.pose.x, to_y - person.pose.y);
            let speed = match retreat {
                Some(_) => STEP_BACK_SPEED,
                None if self.pauses[index] > 0.0 => 0.0,
                None => self.config.speed,
            };
            let [dx, dy] = retreat.unwrap_or([dx, dy]);
            let distance = dx.hypot(dy).max(1e-6);
            person.walks = speed > 0.0;
            let moved = speed * step;
            let theta = dy.atan2(dx);
            if person.walks {
                person.pose = Pose::new(
                    person.pose.x + moved * dx / distance,
                    person.pose.y + moved * dy / distance,
                    theta,
                );
            }
            person.phase = wrap_angle(person.phase + TAU * moved / GAIT_LENGTH);
            self.pauses[index] -= step;
            if retreat.is_none() && person.walks && distance < ARRIVED {
                let pause = PAUSE[0] + (PAUSE[1] - PAUSE[0]) * rng.random::<f32>();
                self.pauses[index] = pause;
                self.destinations[index] = self.destination(rng);
            }
        }
    }

    fn destination(&self, rng: &mut ChaCha8Rng) -> [f32; 2] {
        if rng.random::<f32>() < self.config.on_field {
            return self
                .half
                .map(|half| half * (2.0 * rng.random::<f32>() - 1.0));
        }
        self.place_beside(rng)
    }

    /// A random place beside the field's lines.
    fn place_beside(&self, rng: &mut ChaCha8Rng) -> [f32; 2] {
        let [half_x, half_y] = self.half;
        let out = BESIDE[0] + (BESIDE[1] - BESIDE[0]) * rng.random::<f32>();
        let part = 2.0 * rng.random::<f32>() - 1.0;
        let side = if rng.random::<bool>() { 1.0 } else { -1.0 };
        if rng.random::<f32>() < half_x / (half_x + half_y) {
            [half_x * part, side * (half_y + out)]
        } else {
            [side * (half_x + out), half_y * part]
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn people_walk_and_keep_their_distance_from_a_robot() {
        let text = include_str!("../../../config/fields/msl_18x12.toml");
        let field = Field::new(toml::from_str(text).expect("a field")).expect("a field");
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let config = PeopleConfig {
            count: 4,
            on_field: 1.0,
            ..PeopleConfig::default()
        };
        let mut people = People::new(&field, config, &mut rng);
        let start: Vec<Pose> = people.all().iter().map(|person| person.pose).collect();
        let mut walked = 0.0f32;
        for step in 0..60_000 {
            // A robot that drives up and down the field at 2 m/s.
            let x = 8.0 * (step as f32 * 0.0005).sin();
            let robot = Pose::new(x, 0.3, 0.0);
            people.step(0.002, &[robot], &mut rng);
            for (person, start) in people.all().iter().zip(&start) {
                walked = walked.max(person.pose.origin().distance_to(start.origin()));
                if step > 1000 {
                    let distance = person.pose.origin().distance_to(robot.origin());
                    assert!(distance > 0.5, "{distance}");
                }
            }
        }
        assert!(walked > 3.0, "{walked}");
    }
}
