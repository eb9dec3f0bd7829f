//! What would a camera above the robot see? Image pixels of the ground, through the map as the run has corrected it.

use std::sync::Arc;

use eframe::egui::{Color32, ColorImage};
use localize::frames::{At, RobotFrame};
use localize::map_correction::MapCorrectionEstimate;
use vision::image::Image;

use super::palette;
use super::static_scene::{CameraModel, StaticScene};

/// Half the side of the bird's-eye view, metres: covers about half the field around the robot.
pub(crate) const BIRDS_EYE_HALF_EXTENT: f32 = 6.0;
/// Side of the bird's-eye view, pixels of 2 cm.
pub(crate) const BIRDS_EYE_SIDE_PX: usize = 600;
/// Pixels between two places where the correction is computed. It is smooth between them.
const NODE_SPACING_PX: usize = 25;
const NODES: usize = BIRDS_EYE_SIDE_PX / NODE_SPACING_PX + 1;
/// A smaller change of the correction moves nothing by a pixel, metres.
const SHIFT_CHANGE_MIN: f32 = 0.005;

/// The image pixel of each pixel of the view, for one scene and correction.
#[derive(Default)]
pub(super) struct BirdsEye {
    scene: Option<Arc<StaticScene>>,
    /// From a ground point to the point that the given map shows there, at the nodes, metres.
    shifts: Vec<[f32; 2]>,
    pixels: Vec<u32>,
}

impl BirdsEye {
    /// Renders an image; `correction`: what the run learned about its map by then.
    pub(super) fn render(
        &mut self,
        scene: &Arc<StaticScene>,
        image: &Image,
        correction: Option<&MapCorrectionEstimate>,
    ) -> ColorImage {
        if let Some(camera) = &scene.camera {
            let known = self.scene.as_ref().is_some_and(|of| Arc::ptr_eq(of, scene));
            let shifts = shifts(camera, correction);
            if !known || differ(&shifts, &self.shifts) {
                self.pixels = pixels(camera, &shifts);
                (self.scene, self.shifts) = (Some(scene.clone()), shifts);
            }
        }
        let colour = |&pixel: &u32| {
            let at = 3 * pixel as usize;
            image.rgb.get(at..at + 3).map_or(palette::FLOOR, |rgb| {
                Color32::from_rgb(rgb[0], rgb[1], rgb[2])
            })
        };
        let mut colours: Vec<Color32> = self.pixels.iter().map(colour).collect();
        colours.resize(BIRDS_EYE_SIDE_PX * BIRDS_EYE_SIDE_PX, palette::FLOOR);
        ColorImage::new([BIRDS_EYE_SIDE_PX, BIRDS_EYE_SIDE_PX], colours)
    }
}

/// The ground point of a place in the view. The robot's x axis (forward) points up, its y axis to the left.
fn ground(row: f32, column: f32) -> [f32; 2] {
    let step = 2.0 * BIRDS_EYE_HALF_EXTENT / BIRDS_EYE_SIDE_PX as f32;
    [row, column].map(|place| BIRDS_EYE_HALF_EXTENT - place * step)
}

fn shifts(camera: &CameraModel, correction: Option<&MapCorrectionEstimate>) -> Vec<[f32; 2]> {
    let Some(prepared) = camera.prepare_correction(correction) else {
        return vec![[0.0; 2]; NODES * NODES];
    };
    let node = |index: usize| (index * NODE_SPACING_PX) as f32;
    let shift = |k: usize| {
        let [x, y] = ground(node(k / NODES), node(k % NODES));
        let [u, v] = super::static_scene::invert_displacement(&prepared, [x, y]);
        [u - x, v - y]
    };
    (0..NODES * NODES).map(shift).collect()
}

fn differ(a: &[[f32; 2]], b: &[[f32; 2]]) -> bool {
    let far = |(a, b): (&[f32; 2], &[f32; 2])| (a[0] - b[0]).hypot(a[1] - b[1]) > SHIFT_CHANGE_MIN;
    a.len() != b.len() || a.iter().zip(b).any(far)
}

/// The shift between the nodes, bilinear.
fn interpolate(shifts: &[[f32; 2]], row: f32, column: f32) -> [f32; 2] {
    let place = [row, column].map(|place| place / NODE_SPACING_PX as f32);
    let [i, j] = place.map(|place| (place as usize).min(NODES - 2));
    let [s, t] = [place[0] - i as f32, place[1] - j as f32];
    [0, 1].map(|k| {
        let at = |i: usize, j: usize| shifts[i * NODES + j][k];
        let (near, far) = (
            at(i, j) + t * (at(i, j + 1) - at(i, j)),
            at(i + 1, j) + t * (at(i + 1, j + 1) - at(i + 1, j)),
        );
        near + s * (far - near)
    })
}

fn pixels(camera: &CameraModel, shifts: &[[f32; 2]]) -> Vec<u32> {
    let mut pixels = Vec::with_capacity(BIRDS_EYE_SIDE_PX * BIRDS_EYE_SIDE_PX);
    for row in 0..BIRDS_EYE_SIDE_PX {
        for column in 0..BIRDS_EYE_SIDE_PX {
            let (row, column) = (row as f32 + 0.5, column as f32 + 0.5);
            let ([x, y], [dx, dy]) = (ground(row, column), interpolate(shifts, row, column));
            let given = At::<RobotFrame>::new(x + dx, y + dy);
            let pixel = camera.inverse.project(&camera.map, given);
            pixels.push(pixel.map_or(u32::MAX, |[u, v]| {
                v.round() as u32 * camera.map.width_px as u32 + u.round() as u32
            }));
        }
    }
    pixels
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use localize::map_correction::{TermEstimate, TermKind};
    use pipeline::setup::Setup;

    use super::*;

    #[test]
    fn birds_eye_view_follows_the_corrected_map() {
        let robot = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/robots/default.toml");
        let scene = StaticScene::new(Setup::load(&robot, None).expect("a robot"));
        let camera = scene.camera.as_ref().expect("a camera");
        let tilted = MapCorrectionEstimate {
            terms: vec![TermEstimate {
                kind: TermKind::MirrorTiltX,
                value: 0.02,
                std: 0.0,
            }],
            displacement_at_3_m: 0.1,
            ..MapCorrectionEstimate::default()
        };
        let prepared = camera.prepare_correction(Some(&tilted)).expect("in use");
        let shifts = shifts(camera, Some(&tilted));
        assert!(differ(&shifts, &[[0.0; 2]; NODES * NODES]));
        for (row, column) in [(150.5, 310.5), (240.5, 480.5), (420.5, 200.5)] {
            let ([x, y], [dx, dy]) = (ground(row, column), interpolate(&shifts, row, column));
            // What the given map calls this point, the correction puts where the view shows it.
            let [u, v] = prepared.displace([x + dx, y + dy]).at;
            assert!((u - x).hypot(v - y) < 0.02, "({x}, {y}): ({u}, {v})");
            assert!(dx.hypot(dy) > 0.02, "({x}, {y}) is not moved");
        }
    }
}
