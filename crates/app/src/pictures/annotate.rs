//! What did the robot see in this image? The image with everything found drawn into it.

use localize::Field;
use vision::GroundMap;
use vision::image::Image;
use vision::overlay;

use pipeline::Cycle;

/// Marks are drawn into the image enlarged this many times, so that they do not hide what they mark.
const ENLARGED: usize = 2;

/// The cycle's image with line points, ball, robots, goals and the field's lines at the estimated pose; none without
/// an image.
pub fn draw_detections(cycle: &Cycle, field: &Field, map: &GroundMap) -> Option<Image> {
    let mut image = overlay::upscale(&*cycle.inputs.image.as_ref()?.to_rgb()?, ENLARGED);
    if let Some(pose) = cycle.estimate.pose {
        overlay::draw_field(&mut image, ENLARGED, map, pose, &field.markings);
    }
    if let Some(seen) = &cycle.detections {
        overlay::draw_detections(&mut image, ENLARGED, seen);
    }
    Some(image)
}
