//! What does a viewer draw over the image? Line points, rejected candidates and the pose as text.

use foxglove::messages::{
    ImageAnnotations, Point2, PointsAnnotation, TextAnnotation, points_annotation,
};

use localize::Stamp;

use super::scene::color;
use super::timestamp;
use crate::cycle::Cycle;

const POINT: [f64; 4] = [1.0, 0.1, 0.6, 1.0];
const REFUSED: [f64; 4] = [1.0, 0.8, 0.0, 0.7];
const TEXT: [f64; 4] = [1.0, 1.0, 1.0, 1.0];

/// Line points and rejected candidates of a cycle's image; `stamp`: time of the message. None without an image.
pub(crate) fn image_annotations(cycle: &Cycle, stamp: Stamp) -> Option<ImageAnnotations> {
    let detections = cycle.detections.as_ref()?;
    let stamp = timestamp(stamp);
    // The origin of viewers is the corner of the first pixel, that of Mirrorball its centre.
    let point = |[u, v]: [f32; 2]| Point2 {
        x: f64::from(u) + 0.5,
        y: f64::from(v) + 0.5,
    };
    let dots = |points: Vec<Point2>, shade: [f64; 4], thickness: f64| PointsAnnotation {
        timestamp: stamp,
        r#type: points_annotation::Type::Points as i32,
        points,
        outline_color: color(shade),
        thickness,
        ..PointsAnnotation::default()
    };
    let estimate = &cycle.estimate;
    let place = estimate.pose.map_or_else(
        || "lost".to_owned(),
        |pose| {
            format!(
                "{:.2} {:.2} m  {:.0} deg",
                pose.x,
                pose.y,
                pose.theta.to_degrees()
            )
        },
    );
    let text = TextAnnotation {
        timestamp: stamp,
        position: Some(Point2 { x: 4.0, y: 16.0 }),
        text: format!("{place}  {} points", detections.line_points.len()),
        font_size: 12.0,
        text_color: color(TEXT),
        ..TextAnnotation::default()
    };
    Some(ImageAnnotations {
        timestamp: stamp,
        points: vec![
            dots(
                detections
                    .rejected_candidates
                    .iter()
                    .map(|run| point(run.position_px))
                    .collect(),
                REFUSED,
                2.0,
            ),
            dots(
                detections
                    .line_points
                    .iter()
                    .map(|detection| point(detection.position_px))
                    .collect(),
                POINT,
                3.0,
            ),
        ],
        texts: vec![text],
        ..ImageAnnotations::default()
    })
}
