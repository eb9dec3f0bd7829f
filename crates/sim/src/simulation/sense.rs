//! What do the sensors say at this step? Each on its own clock, as its faults let it.

use localize::sample::VelocityCommand;
use localize::stamp::Stamp;

use super::{Image, Sample, Sim, Truth};
use crate::render::Scene;
use crate::scenario::FaultKind;

impl Sim {
    /// Reads every sensor whose time has come: motion first, then truth and image.
    pub(super) fn sense(&mut self) {
        let time = self.time();
        let stamp = self.stamp();
        if self.odometry.due(time) {
            self.sense_wheels(stamp);
        }
        if self.imu.as_mut().is_some_and(|(_, clock)| clock.due(time)) {
            self.sense_imu(stamp);
        }
        if self
            .compass
            .as_mut()
            .is_some_and(|(_, clock)| clock.due(time))
        {
            self.sense_compass(stamp);
        }
        if self.camera.due(time) {
            let truth = self.truth();
            let image = self.sense_image(&truth);
            self.ready.push_back(Sample::Truth(truth));
            self.ready.extend(image.map(Sample::Image));
        }
    }

    fn sense_wheels(&mut self, stamp: Stamp) {
        let stuck = self.failing(FaultKind::WheelStuck).map(|fault| fault.wheel);
        let odometry = self.world.count_wheels(stamp, stuck);
        self.ready.push_back(Sample::Command(VelocityCommand {
            stamp,
            twist: self.wanted,
        }));
        if self.failing(FaultKind::OdometrySilent).is_none() {
            self.ready.push_back(Sample::Odometry(odometry));
        }
    }

    fn sense_imu(&mut self, stamp: Stamp) {
        let ([x, y], count) = std::mem::take(&mut self.shaken);
        let robot = self.world.robot();
        let (sin, cos) = robot.pose.theta.sin_cos();
        let per = 1.0 / f64::from(count.max(1));
        let (x, y) = ((x * per) as f32, (y * per) as f32);
        let felt = [cos * x + sin * y, -sin * x + cos * y];
        let silent = self.failing(FaultKind::ImuSilent).is_some();
        if let Some((imu, _)) = &self.imu {
            let reading = imu.read(stamp, felt, robot.omega, &mut self.chance_sensors);
            if !silent {
                self.ready.push_back(Sample::Imu(reading));
            }
        }
    }

    fn sense_compass(&mut self, stamp: Stamp) {
        let heading = self.world.robot().pose.theta;
        let silent = self.failing(FaultKind::CompassSilent).is_some();
        let frozen = self.failing(FaultKind::CompassFrozen).is_some();
        let Some((compass, _)) = &mut self.compass else {
            return;
        };
        let mut reading = compass.read(stamp, heading, &mut self.chance_sensors);
        match (frozen, self.frozen_heading) {
            (true, Some(heading)) => reading.heading = heading,
            _ => self.frozen_heading = Some(reading.heading),
        }
        if !silent {
            self.ready.push_back(Sample::Compass(reading));
        }
    }

    fn sense_image(&mut self, truth: &Truth) -> Option<Image> {
        if !self.renders || self.failing(FaultKind::FramesDropped).is_some() {
            return None;
        }
        while let Some(&(_, film)) = self
            .films_to_come
            .front()
            .filter(|(from, _)| *from <= self.images)
        {
            self.film = film;
            self.films_to_come.pop_front();
        }
        self.images += 1;
        let (width_px, height_px) = self.renderer.size_px();
        let image = |rgb| Image {
            stamp: truth.stamp,
            width_px,
            height_px,
            rgb,
        };
        let frozen = self.failing(FaultKind::FramesFrozen).is_some();
        if let (true, Some(rgb)) = (frozen, &self.frozen_image) {
            return Some(image(rgb.clone()));
        }
        let time = truth.stamp.seconds();
        let level = self
            .light_level
            .unwrap_or_else(|| self.scenario.light.level_at(time));
        let occlusions: Vec<(f32, f32)> = self
            .scenario
            .occlusions
            .iter()
            .filter(|occlusion| occlusion.start <= time && time < occlusion.stop)
            .map(|occlusion| (occlusion.direction_deg, occlusion.width_deg))
            .chain(self.held_up)
            .map(|(direction_deg, width_deg)| (direction_deg.to_radians(), width_deg.to_radians()))
            .collect();
        let look = &self.scenario.ball;
        let scene = Scene {
            pose: truth.robot.pose,
            robots: &truth.others,
            ball: truth.ball.map(|ball| (ball.at, look.diameter, look.colour)),
            lamp: self.scenario.light.colour.map(|part| part * level),
            occlusions: &occlusions,
        };
        let mut rgb = Vec::new();
        self.renderer.render(&scene, &self.film, &mut rgb);
        self.frozen_image = frozen.then(|| rgb.clone());
        Some(image(rgb))
    }
}
