//! What did vision detect in an image? The image with the detections drawn into it.

use localize::Field;
use vision::GroundMap;
use vision::image::Image;
use vision::overlay;

use pipeline::Cycle;

/// Scale of the image under the marks, so that they do not hide what they mark.
const SCALE: usize = 2;

/// The cycle's image with line points, ball, robots, goals, and the field lines at the estimated pose. None without an
/// image.
pub(crate) fn draw_detections(cycle: &Cycle, field: &Field, map: &GroundMap) -> Option<Image> {
    let mut image = overlay::upscale(&*cycle.inputs.image.as_ref()?.to_rgb()?, SCALE);
    if let Some(pose) = cycle.estimate.pose {
        overlay::draw_field(&mut image, SCALE, map, pose, &field.markings);
    }
    if let Some(detections) = &cycle.detections {
        overlay::draw_detections(&mut image, SCALE, detections);
    }
    Some(image)
}
