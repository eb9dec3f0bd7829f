//! What the devices measure, as a log: one cycle per image, with nothing computed from it.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Result, bail, ensure};
use hw::DeviceEvent;
use hw::camera::CapturedImage;
use hw::realtime::lower_priority;
use localize::{Field, Stamp};
use nalgebra::{Matrix3, Vector3};
use pipeline::log::{Header, LogConfig};
use pipeline::sample::SourceImage;
use pipeline::{Cycle, Inputs};

use super::counts::Counts;
use crate::run::log_rotation::LogRotation;
use crate::run::raw_image::raw_image;

/// Without an image for this time the samples are written without one, seconds.
const IMAGE_TIMEOUT: f64 = 0.5;

/// Writes the log. It survives a full disk and a killed process, as the log of a run does.
pub(super) struct LogRecorder {
    log: LogRotation,
    inputs: Inputs,
    /// Of a uniform distribution over the field.
    covariance: Matrix3<f32>,
    /// Time of the last cycle.
    last_cycle: Stamp,
    /// Without those of images, which the log counts itself.
    counts: Counts,
}

impl LogRecorder {
    /// Starts a log at `path`, which must not exist.
    pub(super) fn start(path: &Path, header: Header, field: &Field) -> Result<Self> {
        ensure!(
            !path.exists(),
            "{} exists: name another file",
            path.display()
        );
        let header = header.with_clock_offset_ns(hw::realtime_offset_ns());
        let (length, width) = (field.config.length, field.config.width);
        let sides = Vector3::new(length, width, std::f32::consts::TAU);
        Ok(LogRecorder {
            log: LogRotation::start(path, header, field, (&LogConfig::default(), lower_priority))?,
            inputs: Inputs::default(),
            covariance: Matrix3::from_diagonal(&sides.map(|side| side * side / 12.0)),
            last_cycle: hw::now(),
            counts: Counts::default(),
        })
    }

    /// Writes a sample. A disk that fails is reported, and the log goes on in another file when it has space.
    pub(super) fn write(&mut self, event: DeviceEvent) {
        match event {
            DeviceEvent::Image(image) if !image.repeated => return self.write_image(image),
            // An image that the camera repeats shows another time than its stamp.
            DeviceEvent::Image(_) => {}
            DeviceEvent::Odometry(sample) => {
                self.inputs.odometry.push(sample);
                self.counts.odometry += 1;
            }
            DeviceEvent::Imu(sample) => {
                self.inputs.imu.push(sample);
                self.counts.imu += 1;
            }
            DeviceEvent::Compass(sample) => {
                self.inputs.compass.push(sample);
                self.counts.compass += 1;
            }
            DeviceEvent::Command(command) => self.inputs.commands.push(command),
            DeviceEvent::Health(_)
            | DeviceEvent::Power(_)
            | DeviceEvent::Kicker(_)
            | DeviceEvent::Switches(_) => {}
        }
        let now = hw::now();
        if now - self.last_cycle > IMAGE_TIMEOUT {
            self.write_cycle(now, Some("no image from the camera".to_owned()));
        }
    }

    /// Writes a text message.
    pub(super) fn write_note(&self, text: &str) {
        self.log.write_note(hw::now(), text);
    }

    /// Completes the log; returns its files, too. Errors if there is none.
    pub(super) fn finish(mut self) -> Result<(Counts, Vec<PathBuf>)> {
        if !self.inputs.odometry.is_empty() || !self.inputs.imu.is_empty() {
            self.write_cycle(hw::now(), Some("the recording ended".to_owned()));
        }
        let finished = self.log.finish();
        if let Some(loss) = finished.loss() {
            bail!("{loss}");
        }
        if let Some(error) = finished.error {
            stderr_line!("mirrorball: {error}");
        }
        if let Some(gap) = finished.summary.gap() {
            stderr_line!("mirrorball: {gap}");
        }
        let counts = Counts {
            frames: finished.summary.images,
            images_dropped: finished.summary.images_dropped,
            ..self.counts
        };
        Ok((counts, finished.summary.files))
    }

    fn write_image(&mut self, image: CapturedImage) {
        let stamp = image.stamp;
        self.inputs.exposure_setting = image.setting;
        self.inputs.image = Some(SourceImage::Raw(raw_image(image)));
        self.write_cycle(stamp, None);
    }

    fn write_cycle(&mut self, stamp: Stamp, fault: Option<String>) {
        self.last_cycle = hw::now();
        let inputs = std::mem::take(&mut self.inputs);
        let mut cycle = Cycle::from_inputs(stamp, inputs, self.covariance);
        cycle.image_fault = fault;
        if let Some(message) = self.log.write_cycle(Arc::new(cycle)) {
            stderr_line!("mirrorball: {message}");
        }
    }
}
