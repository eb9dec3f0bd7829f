//! What did vision detect in an image? The image with the detections drawn into it.

use localize::robot::DEFAULT_VIEWPOINT_HEIGHT;
use pipeline::Cycle;
use pipeline::setup::Setup;
use vision::image::Image;
use vision::overlay::{self, FieldView};

/// Scale of the image under the marks, so that they do not hide what they mark.
const SCALE: usize = 2;

/// The cycle's image with line points, ball, robots, goals, and the field lines at the estimated pose and tilt. None
/// without an image.
pub(crate) fn draw_detections(cycle: &Cycle, setup: &Setup) -> Option<Image> {
    let (_, map) = setup.camera.as_ref()?;
    let mut image = overlay::upscale(&*cycle.inputs.image.as_ref()?.to_rgb()?, SCALE);
    if let Some(pose) = cycle.estimate.pose {
        let view = FieldView {
            map,
            tilt: cycle.estimate.tilt,
            viewpoint_height: setup.viewpoint_height.unwrap_or(DEFAULT_VIEWPOINT_HEIGHT),
            pose,
        };
        overlay::draw_field(&mut image, SCALE, view, &setup.field.markings);
    }
    if let Some(detections) = &cycle.detections {
        overlay::draw_detections(&mut image, SCALE, detections);
    }
    Some(image)
}
