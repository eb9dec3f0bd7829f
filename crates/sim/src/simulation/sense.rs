//! Which samples are due at this step? Each sensor has its own rate and faults.

use localize::sample::VelocityCommand;
use localize::stamp::Stamp;

use super::{SimImage, SimSample, SimTruth, Simulator};
use crate::render::{Scene, SceneBall};
use crate::scenario::{FaultKind, Occlusion};
use crate::sector::Sector;

impl Simulator {
    /// Samples every sensor that is due: motion first, then true state and image.
    pub(super) fn sample_sensors(&mut self) {
        let time = self.time();
        let stamp = self.stamp();
        if self.odometry_timer.take_due(time) {
            self.sample_odometry(stamp);
        }
        if self
            .imu
            .as_mut()
            .is_some_and(|(_, clock)| clock.take_due(time))
        {
            self.sample_imu(stamp);
        }
        if self
            .compass
            .as_mut()
            .is_some_and(|(_, clock)| clock.take_due(time))
        {
            self.sample_compass(stamp);
        }
        if self.camera_timer.take_due(time) {
            let truth = self.truth();
            let image = self.sample_image(&truth);
            self.pending_samples.push_back(SimSample::Truth(truth));
            self.pending_samples.extend(image.map(SimSample::Image));
        }
    }

    fn sample_odometry(&mut self, stamp: Stamp) {
        let stuck = self
            .active_fault(FaultKind::WheelStuck)
            .map(|fault| fault.wheel);
        let odometry = self.world.read_encoders(stamp, stuck);
        self.pending_samples
            .push_back(SimSample::Command(VelocityCommand {
                stamp,
                twist: self.command,
            }));
        if self.active_fault(FaultKind::OdometrySilent).is_none() {
            self.pending_samples
                .push_back(SimSample::Odometry(odometry));
        }
    }

    fn sample_imu(&mut self, stamp: Stamp) {
        let ([x, y], count) = std::mem::take(&mut self.acceleration_sum);
        let robot = self.world.robot();
        let (sin, cos) = robot.pose.theta.sin_cos();
        let per_step = 1.0 / f64::from(count.max(1));
        let (x, y) = ((x * per_step) as f32, (y * per_step) as f32);
        let acceleration = [cos * x + sin * y, -sin * x + cos * y];
        let silent = self.active_fault(FaultKind::ImuSilent).is_some();
        if let Some((imu, _)) = &self.imu {
            let tilt = (self.rocking.tilt(), self.rocking.tilt_rate());
            let reading = imu.read(
                stamp,
                acceleration,
                robot.yaw_rate,
                tilt,
                &mut self.sensor_rng,
            );
            if !silent {
                self.pending_samples.push_back(SimSample::Imu(reading));
            }
        }
    }

    fn sample_compass(&mut self, stamp: Stamp) {
        let heading = self.world.robot().pose.theta;
        let silent = self.active_fault(FaultKind::CompassSilent).is_some();
        let frozen = self.active_fault(FaultKind::CompassFrozen).is_some();
        let Some((compass, _)) = &mut self.compass else {
            return;
        };
        let mut reading = compass.read(stamp, heading, &mut self.sensor_rng);
        match (frozen, self.frozen_heading) {
            (true, Some(heading)) => reading.heading = heading,
            _ => self.frozen_heading = Some(reading.heading),
        }
        if !silent {
            self.pending_samples.push_back(SimSample::Compass(reading));
        }
    }

    fn sample_image(&mut self, truth: &SimTruth) -> Option<SimImage> {
        if !self.renders_images || self.active_fault(FaultKind::FramesDropped).is_some() {
            return None;
        }
        while let Some(&(_, config)) = self
            .pending_sensor_configs
            .front()
            .filter(|(from, _)| *from <= self.images)
        {
            self.image_sensor = config;
            self.pending_sensor_configs.pop_front();
        }
        self.images += 1;
        let (width_px, height_px) = self.renderer.size_px();
        let image = |rgb| SimImage {
            stamp: truth.stamp,
            width_px,
            height_px,
            rgb,
        };
        let frozen = self.active_fault(FaultKind::FramesFrozen).is_some();
        if let (true, Some(rgb)) = (frozen, &self.frozen_image) {
            return Some(image(rgb.clone()));
        }
        let time = truth.stamp.seconds();
        let level = self
            .light_override
            .unwrap_or_else(|| self.scenario.light.level_at(time));
        let occluded_sectors: Vec<Sector> = self
            .scenario
            .occlusions
            .iter()
            .filter(|occlusion| occlusion.start <= time && time < occlusion.stop)
            .map(Occlusion::sector)
            .chain(self.occlusion_override)
            .collect();
        let ball = &self.scenario.ball;
        let scene = Scene {
            pose: truth.robot.pose,
            motion: self.camera_motion(),
            robots: &truth.others,
            people: &truth.people,
            ball: truth.ball.map(|state| SceneBall {
                at: state.at,
                height: state.height,
                diameter: ball.diameter,
                colour: ball.colour,
            }),
            light_colour: self.scenario.light.colour.map(|part| part * level),
            occluded_sectors: &occluded_sectors,
        };
        let mut rgb = Vec::new();
        self.renderer.render(&scene, &self.image_sensor, &mut rgb);
        self.frozen_image = frozen.then(|| rgb.clone());
        Some(image(rgb))
    }
}
