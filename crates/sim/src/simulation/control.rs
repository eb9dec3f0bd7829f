//! What may whoever watches change while it runs? Robots and ball, light and view, faults and the camera's settings.

use localize::frames::{At, FieldFrame, Pose};
use localize::omni::Twist;

use super::Sim;
use crate::image_sensor::FilmConfig;
use crate::scenario::FaultKind;
use crate::world::{BallState, RobotState};

impl Sim {
    /// Takes over from the scenario's path; `None` gives it back.
    pub fn set_command(&mut self, twist: Option<Twist>) {
        self.command_override = twist;
    }

    /// How far each wheel has turned since the start, radians: what encoders count.
    pub fn wheel_angles(&self) -> impl Iterator<Item = f64> + '_ {
        self.world.wheel_angles()
    }

    /// Puts our robot elsewhere, standing.
    pub fn kidnap(&mut self, pose: Pose) {
        self.world.kidnap(pose);
    }

    /// Puts another robot elsewhere, standing; they are numbered as in [`Truth::others`].
    pub fn place_other(&mut self, index: usize, pose: Pose) {
        self.world.place_other(index, pose);
    }

    /// Makes a sensor fail from now on, or work again; `wheel` matters to a stuck wheel alone.
    pub fn set_fault(&mut self, kind: FaultKind, wheel: usize, fails: bool) {
        let time = self.time();
        let over = |fault: &crate::scenario::Fault| fault.stop <= time || time < fault.start;
        self.scenario
            .faults
            .retain(|fault| fault.kind != kind || over(fault));
        if fails {
            self.scenario.faults.push(crate::scenario::Fault {
                kind,
                start: time,
                stop: f64::INFINITY,
                wheel,
            });
        }
    }

    /// Hits our robot with an impulse (N s, field frame).
    pub fn apply_impulse(&mut self, impulse: [f32; 2]) {
        self.world.apply_impulse(impulse);
    }

    /// Puts the ball somewhere with a velocity (m/s, field frame).
    pub fn place_ball(&mut self, at: At<FieldFrame>, velocity: [f32; 2]) {
        self.world.place_ball(at, velocity);
    }

    /// Moves the other robots, and the ball where there is one, to where they are in another world that is run beside
    /// this one: several of our robots share a field. `others`: in the order of [`Truth::others`].
    pub fn synchronise_others(&mut self, others: &[RobotState], ball: Option<BallState>) {
        for (index, state) in others.iter().enumerate() {
            self.world.set_other_state(index, state);
        }
        if let Some(ball) = ball {
            self.world.place_ball(ball.at, ball.velocity);
        }
    }

    /// Sets the light's level by hand; `None` gives it back to the scenario.
    pub fn set_light_level(&mut self, level: Option<f32>) {
        self.light_override = level;
    }

    /// Hangs something black in the view until further notice: middle and whole width, degrees; `None` takes it away.
    pub fn set_occlusion(&mut self, sector_deg: Option<(f32, f32)>) {
        self.occlusion_override = sector_deg;
    }

    /// The camera's settings.
    pub fn image_sensor(&self) -> &FilmConfig {
        &self.image_sensor
    }

    /// Changes the camera's settings from the next image on.
    pub fn set_image_sensor(&mut self, film: FilmConfig) {
        self.image_sensor = film;
    }

    /// Changes the camera's exposure and gain from an image on, counted from 0 (those that were dropped not).
    ///
    /// Must be called before that image is taken, in the order of the images; one that is past means the next.
    pub fn schedule_exposure(&mut self, image: u64, exposure: f32, gain: f32) {
        let film = FilmConfig {
            exposure,
            gain,
            ..self.image_sensor
        };
        self.pending_sensor_configs.push_back((image, film));
    }
}
