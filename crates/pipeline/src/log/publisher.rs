//! Which messages represent a cycle? The same ones in a log and in a live stream.

use anyhow::Result;
use localize::estimate::Mode;
use localize::{Field, Stamp};

use super::encoded_image::{EncodedImage, ImageCompression};
use super::header::Header;
use super::schema::robot_model::RobotModel;
use super::schema::{Level, SinkId, Topics, convert, image_annotations, scene, wire};
use crate::cycle::Cycle;
use crate::feed::DropCounts;
use crate::pose_error::PoseError;
use crate::sample::SourceImage;

/// Converts cycles to messages, and logs a note when the mode changes.
pub struct CyclePublisher {
    pub(super) topics: Topics,
    images: ImageCompression,
    jpeg_quality: u8,
    /// Wall-clock time at the zero of the stamps, nanoseconds.
    clock_offset_ns: i64,
    robot: RobotModel,
    /// Mode of the previous cycle.
    last_mode: Option<Mode>,
}

impl CyclePublisher {
    /// `jpeg_quality`: 1 to 100. `header`: of the run, with its clock and its camera.
    pub fn new(
        topics: Topics,
        images: ImageCompression,
        jpeg_quality: u8,
        header: &Header,
    ) -> Self {
        CyclePublisher {
            topics,
            images,
            jpeg_quality,
            clock_offset_ns: header.clock_offset_ns,
            robot: RobotModel::new(header.camera()),
            last_mode: None,
        }
    }

    /// Time of a message. The cycle itself keeps its stamps, so that a replay repeats their bits.
    pub fn message_time(&self, stamp: Stamp) -> Stamp {
        Stamp(stamp.0.saturating_add(self.clock_offset_ns))
    }

    /// Publishes the field's markings and the robot's model, for one viewer or for all.
    pub fn publish_scenery(&self, field: &Field, stamp: Stamp, viewer: Option<SinkId>) {
        let stamp = self.message_time(stamp);
        let (points, lines) = (
            scene::field_points(field, stamp),
            scene::field_scene(field, stamp),
        );
        self.topics.field_lines.log_to(&points, stamp, viewer);
        self.topics.scene.log_to(&lines, stamp, viewer);
        self.topics
            .scene
            .log_to(&self.robot.scene(stamp), stamp, viewer);
        self.publish_calibration(stamp, viewer);
    }

    /// Publishes the camera's intrinsics, if they are known, for one viewer or for all.
    fn publish_calibration(&self, stamp: Stamp, viewer: Option<SinkId>) {
        if let Some(calibration) = self.robot.calibration(stamp) {
            self.topics.calibration.log_to(&calibration, stamp, viewer);
        }
    }

    /// Publishes a cycle on all topics. Returns true if its image was published.
    pub fn publish_cycle(&mut self, index: u64, cycle: &Cycle) -> Result<bool> {
        let stamp = self.message_time(cycle.stamp);
        self.publish_inputs(cycle);
        let image = match &cycle.inputs.image {
            Some(image) if self.topics.has_image_sinks() => self.encode_image(image)?,
            _ => None,
        };
        let has_image = image.is_some();
        let image_name = image
            .as_ref()
            .map_or(ImageCompression::None, |image| image.compression)
            .name();
        if let Some(image) = image {
            self.topics.publish_image(image, stamp);
        }
        self.publish_results(cycle);
        self.log_state_changes(cycle);
        // Published last, so that a reader already has the image.
        self.topics
            .cycle
            .log_at(&convert::cycle_to_wire(index, cycle, image_name), stamp);
        Ok(has_image)
    }

    /// Encodes an image. PNG implies exact pixels, so images that RGB cannot hold exactly become JPEG.
    fn encode_image(&self, source: &SourceImage) -> Result<Option<EncodedImage>> {
        let mode = match self.images {
            ImageCompression::None => return Ok(None),
            ImageCompression::Png if !source.is_lossless_in_rgb() => ImageCompression::Jpeg,
            mode => mode,
        };
        match source.to_rgb() {
            Some(image) => EncodedImage::new(&image, mode, self.jpeg_quality),
            None => Ok(None),
        }
    }

    fn publish_inputs(&self, cycle: &Cycle) {
        for sample in &cycle.inputs.odometry {
            self.topics.odometry.log_at(
                &convert::odometry_to_wire(sample),
                self.message_time(sample.stamp),
            );
        }
        for sample in &cycle.inputs.imu {
            self.topics.imu.log_at(
                &convert::imu_to_wire(sample),
                self.message_time(sample.stamp),
            );
        }
        for sample in &cycle.inputs.compass {
            self.topics.compass.log_at(
                &convert::compass_to_wire(sample),
                self.message_time(sample.stamp),
            );
        }
        for sample in &cycle.inputs.commands {
            self.topics.command.log_at(
                &convert::command_to_wire(sample),
                self.message_time(sample.stamp),
            );
        }
        if let Some(truth) = &cycle.inputs.truth {
            let stamp = self.message_time(truth.stamp);
            self.topics
                .truth
                .log_at(&scene::pose_in_frame(truth.pose, stamp), stamp);
        }
    }

    fn publish_results(&self, cycle: &Cycle) {
        let (topics, estimate) = (&self.topics, &cycle.estimate);
        let stamp = self.message_time(cycle.stamp);
        if let Some(annotations) = image_annotations::image_annotations(cycle, stamp) {
            topics.annotations.log_at(&annotations, stamp);
        }
        if let Some(detections) = &cycle.detections {
            let sensors = wire::Sensors {
                line_points: detections.line_points.len() as u32,
                refused: detections.rejected_candidates.len() as u32,
                carpet_share: detections.carpet_share,
                colours_learned: detections.colours_learned,
                carpet_end: detections.carpet_end.clone(),
                windows: convert::windows_to_wire(&detections.virtual_sensors),
                exposure: cycle.exposure.as_ref().map(convert::exposure_to_wire),
            };
            topics.sensors.log_at(&sensors, stamp);
            if let Some(ball) = &detections.ball {
                topics.ball.log_at(&convert::ball_to_wire(ball), stamp);
            }
            // An empty list is sent as well. Otherwise a viewer would keep showing the last robots.
            let robots = detections
                .robots
                .iter()
                .map(convert::robot_to_wire)
                .collect();
            topics.robots.log_at(&wire::Robots { robots }, stamp);
        }
        topics
            .line_points
            .log_at(&scene::line_points(&cycle.line_points, stamp), stamp);
        if let Some(pose) = estimate.pose {
            topics
                .pose
                .log_at(&scene::pose_in_frame(pose, stamp), stamp);
        }
        let transforms = self.robot.transforms(estimate.pose, stamp);
        if !transforms.transforms.is_empty() {
            topics.transforms.log_at(&transforms, stamp);
        }
        if let Some(error) = PoseError::of(cycle) {
            topics
                .pose_error
                .log_at(&convert::pose_error_to_wire(&error), stamp);
        }
        if let Some(map) = &estimate.map_correction {
            topics
                .map_correction
                .log_at(&convert::map_correction_to_wire(map), stamp);
        }
        if !estimate.runners_up.is_empty() {
            let poses = estimate.runners_up.iter().map(|other| other.pose);
            topics
                .particles
                .log_at(&scene::poses_in_frame(poses, stamp), stamp);
        }
        if !cycle.team.teammates.is_empty() {
            topics
                .team
                .log_at(&convert::team_to_wire(&cycle.team), stamp);
        }
        topics
            .scene
            .log_at(&scene::cycle_scene(cycle, stamp), stamp);
    }

    /// Logs a warning about dropped cycles. `consumer`: name of the slow consumer.
    pub fn log_dropped(&self, consumer: &str, dropped: DropCounts, stamp: Stamp) {
        if !dropped.is_zero() {
            let DropCounts { images, cycles } = dropped;
            let text = format!("{consumer} is slow: dropped {images} images, {cycles} cycles");
            self.log_message(stamp, Level::Warning, text);
        }
    }

    /// Logs an error.
    pub fn log_error(&self, error: &str, stamp: Stamp) {
        self.log_message(stamp, Level::Error, error.to_owned());
    }

    /// Logs a line of text.
    pub(super) fn log_message(&self, stamp: Stamp, level: Level, text: String) {
        self.topics
            .log_message(self.message_time(stamp), level, text);
    }

    /// Logs changes of the mode, unusable images and uncontrolled light changes.
    fn log_state_changes(&mut self, cycle: &Cycle) {
        let (stamp, estimate) = (cycle.stamp, &cycle.estimate);
        if let Some(fault) = &cycle.image_fault {
            self.log_message(stamp, Level::Warning, format!("frame not used: {fault}"));
        }
        if cycle
            .exposure
            .is_some_and(|status| status.uncontrolled_light_change)
        {
            let text = "the light changed, and this camera's exposure cannot be controlled";
            self.log_message(stamp, Level::Warning, text.to_owned());
        }
        if self.last_mode.replace(estimate.mode) != Some(estimate.mode) {
            let level = match estimate.mode {
                Mode::Lost => Level::Warning,
                Mode::Tracking | Mode::Global => Level::Info,
            };
            self.log_message(stamp, level, convert::mode_and_reason(estimate));
        }
    }
}
