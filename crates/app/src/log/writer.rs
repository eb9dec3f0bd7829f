//! Which messages does a cycle become? The thread that turns waiting cycles into a log's topics, and flushes them.

use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use localize::estimate::Mode;
use localize::{Field, Stamp};

use super::LogConfig;
use super::header::Header;
use super::picture::{Encoded, ImageMode};
use super::queue::{Dropped, Queue};
use super::record::Written;
use super::schema::{ABOUT, Level, Sink, annotate, convert, scene, wire};
use crate::cycle::Cycle;

/// The thread's side of a recorder.
pub(super) struct Writer {
    sink: Sink,
    images: ImageMode,
    jpeg_quality: u8,
    period: Duration,
    /// Until it is drawn, at the first cycle's time.
    field_scene: Option<Field>,
    /// Of the cycle before.
    mode: Option<Mode>,
    written: Written,
}

impl Writer {
    /// Starts a log with its header.
    pub(super) fn begin(
        path: &Path,
        header: &Header,
        field: &Field,
        config: &LogConfig,
    ) -> Result<Self> {
        if !(1..=100).contains(&config.jpeg_quality) {
            bail!(
                "[log] jpeg_quality = {}: must be 1 to 100",
                config.jpeg_quality
            );
        }
        let period = Duration::try_from_secs_f32(config.flush_period).with_context(|| {
            format!(
                "[log] flush_period = {}: must be seconds",
                config.flush_period
            )
        })?;
        let sink = Sink::create(path)?;
        let header = Header {
            images: config.images,
            ..header.clone()
        };
        sink.metadata(ABOUT, header.metadata())?;
        let mut files = header.files;
        if !files.contains_key("field.toml") {
            files.insert(
                "field.toml".to_owned(),
                toml::to_string(&field.config)?.into_bytes(),
            );
        }
        for (name, content) in &files {
            sink.attach(name, content)?;
        }
        sink.flush()?;
        Ok(Writer {
            sink,
            images: config.images,
            jpeg_quality: config.jpeg_quality,
            period,
            field_scene: Some(field.clone()),
            mode: None,
            written: Written::default(),
        })
    }

    /// Writes what the queue holds until it is closed.
    pub(super) fn run(&mut self, queue: &Queue) -> Result<()> {
        let mut flushed = Instant::now();
        while let Some(((index, cycle), dropped)) = queue.pop() {
            self.cycle(index, &cycle)?;
            self.tell_dropped(dropped, cycle.stamp);
            if flushed.elapsed() >= self.period {
                self.sink.flush()?;
                flushed = Instant::now();
            }
        }
        Ok(())
    }

    /// Writes index and summary.
    pub(super) fn close(self) -> Result<Written> {
        self.sink.close()?;
        Ok(self.written)
    }

    fn cycle(&mut self, index: u64, cycle: &Cycle) -> Result<()> {
        let stamp = cycle.stamp;
        if let Some(field) = self.field_scene.take() {
            self.sink
                .field_lines
                .log_at(&scene::field_points(&field, stamp), stamp);
            self.sink
                .scene
                .log_at(&scene::field_scene(&field, stamp), stamp);
        }
        self.inputs(cycle);
        let image = match &cycle.inputs.image {
            Some(image) => Encoded::new(image, self.images, self.jpeg_quality)?,
            None => None,
        };
        let image_name = image
            .as_ref()
            .map_or(ImageMode::None, |image| image.mode)
            .name();
        if let Some(image) = image {
            self.sink.picture(image, stamp);
            self.written.images += 1;
        }
        self.findings(cycle);
        self.tell_change(cycle);
        // Last, so that whoever reads it has its image already.
        self.sink
            .cycle
            .log_at(&convert::cycle_to_wire(index, cycle, image_name), stamp);
        self.written.cycles += 1;
        Ok(())
    }

    fn inputs(&self, cycle: &Cycle) {
        for sample in &cycle.inputs.odometry {
            self.sink
                .odometry
                .log_at(&convert::odometry_to_wire(sample), sample.stamp);
        }
        for sample in &cycle.inputs.imu {
            self.sink
                .imu
                .log_at(&convert::imu_to_wire(sample), sample.stamp);
        }
        for sample in &cycle.inputs.compass {
            self.sink
                .compass
                .log_at(&convert::compass_to_wire(sample), sample.stamp);
        }
        for sample in &cycle.inputs.commands {
            self.sink
                .command
                .log_at(&convert::command_to_wire(sample), sample.stamp);
        }
        if let Some(truth) = &cycle.inputs.truth {
            self.sink
                .truth
                .log_at(&scene::pose_in_frame(truth.pose, truth.stamp), truth.stamp);
        }
    }

    fn findings(&self, cycle: &Cycle) {
        let (sink, stamp, estimate) = (&self.sink, cycle.stamp, &cycle.estimate);
        if let Some(annotations) = annotate::annotations(cycle) {
            sink.annotations.log_at(&annotations, stamp);
        }
        if let Some(seen) = &cycle.seen {
            let sensors = wire::Sensors {
                line_points: seen.line_points.len() as u32,
                refused: seen.refused.len() as u32,
                carpet_share: seen.carpet_share,
                colours_learned: seen.learned,
            };
            sink.sensors.log_at(&sensors, stamp);
            if let Some(ball) = &seen.ball {
                sink.ball.log_at(&convert::ball_to_wire(ball), stamp);
            }
            // Also when there are none: else a viewer would go on showing those that left.
            let robots = seen.robots.iter().map(convert::robot_to_wire).collect();
            sink.robots.log_at(&wire::Robots { robots }, stamp);
        }
        sink.line_points
            .log_at(&scene::line_points(&cycle.points, stamp), stamp);
        if let Some(pose) = estimate.pose {
            sink.pose.log_at(&scene::pose_in_frame(pose, stamp), stamp);
            sink.frames.log_at(&scene::robot_frame(pose, stamp), stamp);
        }
        if !estimate.runners_up.is_empty() {
            let poses = estimate.runners_up.iter().map(|other| other.pose);
            sink.particles
                .log_at(&scene::poses_in_frame(poses, stamp), stamp);
        }
        sink.scene.log_at(&scene::cycle_scene(cycle), stamp);
    }

    fn tell_dropped(&mut self, dropped: Dropped, stamp: Stamp) {
        if dropped.none() {
            return;
        }
        let Dropped { images, cycles } = dropped;
        self.written.dropped.images += images;
        self.written.dropped.cycles += cycles;
        let text = format!("the disk is slow: dropped {images} images, {cycles} cycles");
        self.sink.note(stamp, Level::Warning, text);
    }

    /// A line for people when the robot gets lost, finds itself, or cannot use a frame.
    fn tell_change(&mut self, cycle: &Cycle) {
        let (stamp, estimate) = (cycle.stamp, &cycle.estimate);
        if let Some(fault) = &cycle.fault {
            self.sink
                .note(stamp, Level::Warning, format!("frame not used: {fault}"));
        }
        if self.mode.replace(estimate.mode) != Some(estimate.mode) {
            let level = match estimate.mode {
                Mode::Lost => Level::Warning,
                Mode::Tracking | Mode::Global => Level::Info,
            };
            self.sink
                .note(stamp, level, convert::mode_and_reason(estimate));
        }
    }
}
