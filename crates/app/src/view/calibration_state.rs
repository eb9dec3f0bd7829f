//! State of the calibration: painted labels, images for the mask, and the running map calibration.

use std::path::PathBuf;
use std::sync::Arc;

use anyhow::{Context, Result};
use localize::Stamp;
use pipeline::Cycle;
use vision::calibrate::calibrate_mask;
use vision::image::Image;

use super::brush::Brush;
use super::calibration_job::{CalibrationJob, CalibrationMethod, MapCalibration};
use super::source::decoded_cycle::rgb_image;
use super::static_scene::StaticScene;
use super::status_message::StatusMessage;

/// Images for the mask at most; when exceeded, every other one is dropped.
const MASK_IMAGES: usize = 60;

/// Everything that the user calibrates in the window.
#[derive(Default)]
pub(crate) struct CalibrationState {
    /// The brush with its labels and its mask.
    pub(crate) brush: Brush,
    /// Collect the shown images for the mask.
    pub(crate) collecting: bool,
    /// Images collected for the mask.
    pub(crate) mask_images: Vec<Image>,
    /// Result of the last map calibration.
    pub(crate) result: Option<MapCalibration>,
    /// Outcome of the last action.
    pub(crate) message: Option<StatusMessage>,
    last_collected: Option<Stamp>,
    job: Option<CalibrationJob>,
}

impl CalibrationState {
    /// Starts a map calibration from the images in `dir`; the map is written to `out`.
    pub(crate) fn start_map(&mut self, method: CalibrationMethod, dir: PathBuf, out: PathBuf) {
        match CalibrationJob::start(method, dir, out) {
            Ok(job) => self.job = Some(job),
            Err(error) => self.message = Some(StatusMessage::from_result(Err(error))),
        }
    }

    /// True while a map calibration runs.
    pub(crate) fn is_running(&self) -> bool {
        self.job.is_some()
    }

    /// Takes the result of a map calibration that has ended.
    pub(crate) fn poll_job(&mut self) {
        let Some(result) = self.job.as_ref().and_then(CalibrationJob::poll) else {
            return;
        };
        self.job = None;
        let result = result.map(|calibration| {
            let text = format!("wrote map {}", calibration.0.map.display());
            self.result = Some(calibration);
            text
        });
        self.message = Some(StatusMessage::from_result(result));
    }

    /// Adds the shown image while collecting; halves the images when there are too many.
    pub(crate) fn collect_mask_image(&mut self, shown: &Cycle) {
        if !self.collecting || self.last_collected == Some(shown.stamp) {
            return;
        }
        self.last_collected = Some(shown.stamp);
        self.mask_images
            .extend(rgb_image(shown).map(|image| Image::clone(image)));
        if self.mask_images.len() > MASK_IMAGES {
            let mut number = 0;
            self.mask_images.retain(|_| {
                number += 1;
                number % 2 == 1
            });
        }
    }

    /// Finds the pixels that do not change in the collected images, and takes them as the mask.
    pub(crate) fn compute_mask(&mut self, scene: Option<&StaticScene>) {
        let mask = self.find_mask(scene).map(|mask| {
            let masked = mask.iter().filter(|&&visible| !visible).count();
            (self.brush.mask, self.brush.dirty) = (Some(mask), true);
            format!("{masked} pixels masked")
        });
        self.message = Some(StatusMessage::from_result(mask));
    }

    fn find_mask(&self, scene: Option<&StaticScene>) -> Result<Vec<bool>> {
        let camera = scene.and_then(|scene| scene.camera.as_ref());
        let camera = camera.context("no camera")?;
        Ok(calibrate_mask(&camera.config, &self.mask_images)?)
    }

    /// Painting starts from the robot's own mask.
    pub(crate) fn begin_mask(&mut self, own_mask: Option<&Arc<Vec<bool>>>) {
        if self.brush.mask.is_none() {
            self.brush.mask = own_mask.map(|mask| Vec::clone(mask));
        }
    }
}
