//! Which images of a recording cannot be used? Of a frozen or dark camera none may judge the other sensors.

use std::collections::BTreeMap;

use rayon::prelude::*;
use vision::Image;
use vision::image_check::ImageCheck;

use crate::config::PipelineConfig;
use crate::image_faults::ImageFaults;
use crate::recording::{ImageLoader, RecordedData, RecordedSample, Recording};
use crate::setup::Setup;

/// Images that are decoded at a time.
const BATCH: usize = 32;

/// Faults of images by their index among the samples of a recording.
pub(super) type FaultsByIndex = BTreeMap<usize, String>;

/// Checks images of a recording as the pipeline does; `indices`: of the samples, in order. An image is compared with the one
/// checked before it.
pub(super) fn find_image_faults(
    recording: &Recording,
    setup: &Setup,
    config: &PipelineConfig,
    indices: &[usize],
) -> FaultsByIndex {
    let mut faults = FaultsByIndex::new();
    let Some((camera, map)) = &setup.camera else {
        return faults;
    };
    let samples = recording.remaining_samples();
    let motions = motions_before(samples);
    let mut check = ImageCheck::new(map, camera, config.vision.image_check.clone());
    let mut loader = ImageLoader::default();
    for batch in indices.chunks(BATCH) {
        let loaded: Vec<_> = batch
            .par_iter()
            .filter_map(|&index| {
                let RecordedData::Image(path) = &samples[index].data else {
                    return None;
                };
                Some((index, path, Image::load_with_orientation(path)))
            })
            .collect();
        for (index, path, image) in loaded {
            let fault = loader.accept(path, image).and_then(|image| {
                let view = image.view();
                let size = view.check(map.width_px, map.height_px);
                size.map_err(|error| error.to_string())?;
                let WheelMotion { path, heading } = motions[index];
                let fault = check.check(samples[index].stamp, &view, path);
                check.check_mounting(&view, heading);
                fault.map_or(Ok(()), |fault| Err(fault.to_string()))
            });
            if let Err(fault) = fault {
                faults.insert(index, fault);
            }
        }
    }
    faults
}

/// Motion of the wheels up to a sample.
#[derive(Clone, Copy, Default)]
struct WheelMotion {
    /// Metres.
    path: f64,
    /// From that at the start, radians. None before the first reading.
    heading: Option<f32>,
}

/// The motion before each sample.
fn motions_before(samples: &[RecordedSample]) -> Vec<WheelMotion> {
    let mut motion = WheelMotion::default();
    let motions = samples.iter().map(|sample| {
        if let RecordedData::Odometry(row) = &sample.data {
            motion.path += f64::from(row.path());
            motion.heading = Some(motion.heading.unwrap_or(0.0) + row.dtheta);
        }
        motion
    });
    motions.collect()
}

/// The faults with times and files; `checked`: indices of all images that were checked.
pub(super) fn summarize(
    recording: &Recording,
    checked: &[usize],
    faults: &FaultsByIndex,
) -> ImageFaults {
    let samples = recording.remaining_samples();
    let mut summary = ImageFaults::default();
    for index in checked {
        let sample = &samples[*index];
        let file = match &sample.data {
            RecordedData::Image(path) => Some(recording.relative(path)),
            _ => None,
        };
        let fault = faults.get(index).map(String::as_str);
        summary.add_image(sample.stamp, file, fault);
    }
    summary
}
