//! What is known of one pixel: colour, class, ground point and field point.

use localize::{At, FieldFrame, RobotFrame};
use vision::image::{Image, rgb_to_yuv};

use super::birds_eye::{BIRDS_EYE_HALF_EXTENT, BIRDS_EYE_SIDE_PX};
use super::session::Session;

/// A pixel of the camera image.
#[derive(Debug, Clone, PartialEq)]
struct PixelColour {
    at: [usize; 2],
    rgb: [u8; 3],
    class: Option<String>,
}

/// What is known of the pixel under the pointer.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct PixelInfo {
    colour: Option<PixelColour>,
    /// Ground point in the robot frame, metres.
    pub(crate) ground: Option<At<RobotFrame>>,
    /// The same point on the field, metres.
    pub(crate) field: Option<At<FieldFrame>>,
}

impl PixelInfo {
    /// Looks up a point of the camera image, pixels.
    pub(crate) fn of_image(session: &Session, image: Option<&Image>, u: f32, v: f32) -> Self {
        if u < 0.0 || v < 0.0 {
            return PixelInfo::default();
        }
        let (u, v) = (u as usize, v as usize);
        let image = image.filter(|image| u < image.width_px && v < image.height_px);
        let colour = image.map(|image| PixelColour {
            at: [u, v],
            rgb: image.view().rgb(u, v),
            class: session.class_at(u, v).map(str::to_owned),
        });
        let camera = session
            .scene
            .as_ref()
            .and_then(|scene| scene.camera.as_ref());
        let ground = camera.and_then(|camera| camera.map.at(u, v));
        PixelInfo {
            colour,
            ground,
            field: session.to_field(ground),
        }
    }

    /// Looks up a point of the bird's-eye view, pixels.
    pub(crate) fn of_birds_eye(session: &Session, u: f32, v: f32) -> Self {
        let step = 2.0 * BIRDS_EYE_HALF_EXTENT / BIRDS_EYE_SIDE_PX as f32;
        let ground = Some(At::new(
            BIRDS_EYE_HALF_EXTENT - v * step,
            BIRDS_EYE_HALF_EXTENT - u * step,
        ));
        PixelInfo {
            colour: None,
            ground,
            field: session.to_field(ground),
        }
    }

    /// One line for the panel.
    pub(crate) fn text(&self) -> String {
        let mut parts = Vec::new();
        if let Some(PixelColour { at, rgb, class }) = &self.colour {
            let ([u, v], [y, cb, cr]) = (at, rgb_to_yuv(*rgb));
            parts.push(format!("({u}, {v})  YUV {y} {cb} {cr}  RGB {rgb:?}"));
            parts.extend(class.clone());
        }
        match self.ground {
            Some(ground) => parts.push(format!(
                "ground {:.2}, {:.2} m, {:.2} m away at {:.0}°",
                ground.x,
                ground.y,
                ground.distance(),
                ground.bearing().to_degrees()
            )),
            None => parts.push("no ground".to_owned()),
        }
        if let Some(at) = self.field {
            parts.push(format!("field {:.2}, {:.2} m", at.x, at.y));
        }
        parts.join("   ")
    }
}
