//! What can be changed during a simulation? Robots and ball, light and view, faults and the camera's settings.

use localize::frames::{At, FieldFrame, Pose};
use localize::omni::Twist;

use super::Simulator;
use crate::behaviour::{is_kickable, kick_velocity};
use crate::image_sensor::ImageSensorConfig;
use crate::people::Person;
use crate::scenario::{BallKick, FaultKind};
use crate::sector::Sector;
use crate::world::{BallState, RobotState};

/// Angle of our robot's lofted kicks above the carpet, degrees.
const LOFT_DEG: f32 = 40.0;

impl Simulator {
    /// Overrides the scenario's path; `None` ends the override.
    pub fn set_command(&mut self, twist: Option<Twist>) {
        self.command_override = twist;
    }

    /// Angle of each wheel since the start, radians.
    pub fn wheel_angles(&self) -> impl Iterator<Item = f64> + '_ {
        self.world.wheel_angles()
    }

    /// Moves our robot to a pose, at rest.
    pub fn kidnap(&mut self, pose: Pose) {
        self.world.kidnap(pose);
        self.rocking.place(pose);
    }

    /// Moves another robot to a pose, at rest; `index` as in `SimTruth::others`.
    pub fn place_other(&mut self, index: usize, pose: Pose) {
        self.world.place_other(index, pose);
    }

    /// Starts or ends a sensor fault; `wheel` is used only by a stuck wheel.
    pub fn set_fault(&mut self, kind: FaultKind, wheel: usize, fails: bool) {
        let time = self.time();
        let inactive = |fault: &crate::scenario::Fault| fault.stop <= time || time < fault.start;
        self.scenario
            .faults
            .retain(|fault| fault.kind != kind || inactive(fault));
        if fails {
            self.scenario.faults.push(crate::scenario::Fault {
                kind,
                start: time,
                stop: f64::INFINITY,
                wheel,
            });
        }
    }

    /// Applies an impulse to our robot (N s, field frame).
    pub fn apply_impulse(&mut self, impulse: [f32; 2]) {
        self.world.apply_impulse(impulse);
    }

    /// Places the ball on the ground with a velocity (m/s, field frame).
    pub fn place_ball(&mut self, at: At<FieldFrame>, velocity: [f32; 2]) {
        self.world.place_ball(at, velocity);
    }

    /// Places the ball anywhere with a velocity, without spin.
    pub fn set_ball_state(&mut self, state: &BallState) {
        self.world.set_ball_state(state);
    }

    /// Our robot kicks the ball if it lies before it: `speed` in m/s, `lofted` 40° upwards. False if out of reach.
    pub fn kick(&mut self, speed: f32, lofted: bool) -> bool {
        let robot = self.world.robot();
        let reach = |ball: &BallState| is_kickable(ball, &robot);
        let Some(ball) = self.world.ball().filter(reach) else {
            return false;
        };
        let loft = if lofted { LOFT_DEG } else { 0.0 };
        let velocity = kick_velocity(speed, robot.pose.theta, loft.to_radians());
        self.world.set_ball_state(&BallState {
            velocity: [velocity[0], velocity[1]],
            vertical_velocity: velocity[2],
            ..ball
        });
        true
    }

    /// A kick of the scenario.
    pub(super) fn kick_from_scenario(&mut self, kick: &BallKick) {
        if let Some(ball) = self.world.ball() {
            self.world.set_ball_state(&kick.apply(ball));
        }
    }

    /// Copies the states of the other robots and of the ball from another simulation of the same game, in which another
    /// of our robots is simulated. `others` and `people`: in the order of `SimTruth`.
    pub fn synchronise_others(
        &mut self,
        others: &[RobotState],
        people: &[Person],
        ball: Option<BallState>,
    ) {
        self.people.set(people);
        for (index, state) in others.iter().enumerate() {
            self.world.set_other_state(index, state);
        }
        if let Some(ball) = ball {
            self.world.set_ball_state(&ball);
        }
    }

    /// Overrides the scenario's light level; `None` ends the override.
    pub fn set_light_level(&mut self, level: Option<f32>) {
        self.light_override = level;
    }

    /// Blackens a sector of the view (centre and full width, degrees); `None` ends it.
    pub fn set_occlusion(&mut self, sector: Option<Sector>) {
        self.occlusion_override = sector;
    }

    /// The camera's settings.
    pub fn image_sensor(&self) -> &ImageSensorConfig {
        &self.image_sensor
    }

    /// Changes the camera's settings from the next image on.
    pub fn set_image_sensor(&mut self, config: ImageSensorConfig) {
        self.image_sensor = config;
    }

    /// Changes the camera's exposure and gain from an image on; images are counted from 0, without dropped ones.
    ///
    /// Calls must be in the order of the images. An image in the past stands for the next one.
    pub fn schedule_exposure(&mut self, image: u64, exposure: f32, gain: f32) {
        let config = ImageSensorConfig {
            exposure,
            gain,
            ..self.image_sensor
        };
        self.pending_sensor_configs.push_back((image, config));
    }
}
