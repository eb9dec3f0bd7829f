//! Which messages does a cycle become? The same for a log and for whoever watches live.

use anyhow::Result;
use localize::estimate::Mode;
use localize::{Field, Stamp};

use super::encoded_image::{EncodedImage, ImageCompression};
use super::schema::{Level, Topics, convert, image_annotations, scene, wire};
use crate::cycle::Cycle;
use crate::feed::DropCounts;
use crate::sample::SourceImage;

/// Turns cycles into messages, and remembers what it said last.
pub struct CyclePublisher {
    pub(super) topics: Topics,
    images: ImageCompression,
    jpeg_quality: u8,
    /// Of the cycle before.
    last_mode: Option<Mode>,
}

impl CyclePublisher {
    /// `jpeg_quality`: 1 to 100, of JPEG images.
    pub fn new(topics: Topics, images: ImageCompression, jpeg_quality: u8) -> Self {
        CyclePublisher {
            topics,
            images,
            jpeg_quality,
            last_mode: None,
        }
    }

    /// The field, for viewers to draw.
    pub fn publish_field(&self, field: &Field, stamp: Stamp) {
        let (points, lines) = (
            scene::field_points(field, stamp),
            scene::field_scene(field, stamp),
        );
        self.topics.field_lines.log_at(&points, stamp);
        self.topics.scene.log_at(&lines, stamp);
    }

    /// A cycle on all its topics; says whether its image was among them.
    pub fn publish_cycle(&mut self, index: u64, cycle: &Cycle) -> Result<bool> {
        let stamp = cycle.stamp;
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
        // Last, so that whoever reads it has its image already.
        self.topics
            .cycle
            .log_at(&convert::cycle_to_wire(index, cycle, image_name), stamp);
        Ok(has_image)
    }

    /// The image as viewers get it; one that PNG would not keep exactly is not called exact, and becomes JPEG.
    fn encode_image(&self, picture: &SourceImage) -> Result<Option<EncodedImage>> {
        let mode = match self.images {
            ImageCompression::None => return Ok(None),
            ImageCompression::Png if !picture.is_lossless_in_rgb() => ImageCompression::Jpeg,
            mode => mode,
        };
        match picture.to_rgb() {
            Some(image) => EncodedImage::new(&image, mode, self.jpeg_quality),
            None => Ok(None),
        }
    }

    fn publish_inputs(&self, cycle: &Cycle) {
        for sample in &cycle.inputs.odometry {
            self.topics
                .odometry
                .log_at(&convert::odometry_to_wire(sample), sample.stamp);
        }
        for sample in &cycle.inputs.imu {
            self.topics
                .imu
                .log_at(&convert::imu_to_wire(sample), sample.stamp);
        }
        for sample in &cycle.inputs.compass {
            self.topics
                .compass
                .log_at(&convert::compass_to_wire(sample), sample.stamp);
        }
        for sample in &cycle.inputs.commands {
            self.topics
                .command
                .log_at(&convert::command_to_wire(sample), sample.stamp);
        }
        if let Some(truth) = &cycle.inputs.truth {
            self.topics
                .truth
                .log_at(&scene::pose_in_frame(truth.pose, truth.stamp), truth.stamp);
        }
    }

    fn publish_results(&self, cycle: &Cycle) {
        let (topics, stamp, estimate) = (&self.topics, cycle.stamp, &cycle.estimate);
        if let Some(annotations) = image_annotations::image_annotations(cycle) {
            topics.annotations.log_at(&annotations, stamp);
        }
        if let Some(seen) = &cycle.detections {
            let sensors = wire::Sensors {
                line_points: seen.line_points.len() as u32,
                refused: seen.rejected_candidates.len() as u32,
                carpet_share: seen.carpet_share,
                colours_learned: seen.colours_learned,
                carpet_end: seen.carpet_end.clone(),
                windows: convert::windows_to_wire(&seen.virtual_sensors),
                exposure: cycle.exposure.as_ref().map(convert::exposure_to_wire),
            };
            topics.sensors.log_at(&sensors, stamp);
            if let Some(ball) = &seen.ball {
                topics.ball.log_at(&convert::ball_to_wire(ball), stamp);
            }
            // Also when there are none: else a viewer would go on showing those that left.
            let robots = seen.robots.iter().map(convert::robot_to_wire).collect();
            topics.robots.log_at(&wire::Robots { robots }, stamp);
        }
        topics
            .line_points
            .log_at(&scene::line_points(&cycle.line_points, stamp), stamp);
        if let Some(pose) = estimate.pose {
            topics
                .pose
                .log_at(&scene::pose_in_frame(pose, stamp), stamp);
            topics
                .transforms
                .log_at(&scene::robot_transform(pose, stamp), stamp);
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
        topics.scene.log_at(&scene::cycle_scene(cycle), stamp);
    }

    /// A line for people about what was lost, and to whom.
    pub fn log_dropped(&self, whose: &str, dropped: DropCounts, stamp: Stamp) {
        if !dropped.is_zero() {
            let DropCounts { images, cycles } = dropped;
            let text = format!("{whose} is slow: dropped {images} images, {cycles} cycles");
            self.topics.log_message(stamp, Level::Warning, text);
        }
    }

    /// A line for people about what went wrong here.
    pub fn log_error(&self, fault: &str, stamp: Stamp) {
        self.topics
            .log_message(stamp, Level::Error, fault.to_owned());
    }

    /// A line for people when the robot gets lost, finds itself, or cannot use a frame.
    fn log_state_changes(&mut self, cycle: &Cycle) {
        let (stamp, estimate) = (cycle.stamp, &cycle.estimate);
        if let Some(fault) = &cycle.fault {
            self.topics
                .log_message(stamp, Level::Warning, format!("frame not used: {fault}"));
        }
        if cycle.exposure.is_some_and(|reading| reading.warning) {
            let text = "the light changed, and this camera's exposure cannot be controlled";
            self.topics
                .log_message(stamp, Level::Warning, text.to_owned());
        }
        if self.last_mode.replace(estimate.mode) != Some(estimate.mode) {
            let level = match estimate.mode {
                Mode::Lost => Level::Warning,
                Mode::Tracking | Mode::Global => Level::Info,
            };
            self.topics
                .log_message(stamp, level, convert::mode_and_reason(estimate));
        }
    }
}
