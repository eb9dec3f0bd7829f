//! Do two halves of the images give the same map? Only then do the images decide it. Where no image shows a line, both halves continue
//! the map alike, and their agreement says nothing.

use localize::Field;
use localize::math;
use localize::robot::CameraConfig;

use crate::calibrate::Disagreement;
use crate::calibrate::lines::{IMAGES_MIN, LinesCalibration, NamedImage, refine_map};
use crate::calibrate::map_alignment::{PlanarTransform, ground_pairs};
use crate::config::VisionConfig;
use crate::optics::ground_map::GroundMap;

/// Fits both halves of the used images separately and compares their maps.
pub(super) fn compare_halves(
    camera: &CameraConfig,
    start: &GroundMap,
    field: &Field,
    images: &[NamedImage],
    vision_config: &VisionConfig,
    calibration: &LinesCalibration,
) -> Option<Disagreement> {
    let used = calibration.used(images);
    let half = |first: usize| -> Option<GroundMap> {
        let images: Vec<NamedImage> = used
            .iter()
            .skip(first)
            .step_by(2)
            .map(|&i| i.clone())
            .collect();
        let found = refine_map(camera, start, field, &images, vision_config);
        Some(found.ok()?.map)
    };
    if used.len() < 2 * IMAGES_MIN {
        return None;
    }
    let (even, odd) = rayon::join(|| half(0), || half(1));
    let (even, odd) = (even?, odd?);
    let transform = PlanarTransform::between(&even, &odd);
    let apart: Vec<(f64, f64)> = ground_pairs(&even, &odd)
        .map(|[p, q]| {
            let moved = transform.apply(p);
            (
                math::hypot(p[0], p[1]),
                math::hypot(moved[0] - q[0], moved[1] - q[1]),
            )
        })
        .collect();
    let median = |from: f64, to: f64| {
        let mut values: Vec<f64> = apart
            .iter()
            .filter(|(range, _)| (from..to).contains(range) && *range < calibration.reach)
            .map(|(_, distance)| *distance)
            .collect();
        values.sort_by(f64::total_cmp);
        values.get(values.len() / 2).copied().unwrap_or(f64::NAN) as f32
    };
    Some(Disagreement {
        near: median(0.0, 3.0),
        far: median(3.0, 5.0),
    })
}
