//! The end of the carpet in the camera image, computed once per cycle: a cycle is drawn several times.

use std::f32::consts::TAU;

use localize::Stamp;
use pipeline::Cycle;

use crate::view::static_scene::StaticScene;

/// Pixels where the carpet ends, one for each ray that shows its end.
#[derive(Default)]
pub(crate) struct CarpetBoundary {
    /// Cycle and scene of the places.
    of: Option<(Stamp, *const StaticScene)>,
    places: Vec<[f32; 2]>,
}

impl CarpetBoundary {
    /// Finds the places of a cycle, if they are those of another one.
    pub(crate) fn update(&mut self, scene: &StaticScene, cycle: &Cycle) {
        let of = Some((cycle.stamp, std::ptr::from_ref(scene)));
        if self.of != of {
            self.of = of;
            let detections = cycle.detections.as_ref();
            let ends = detections.map_or(&[][..], |detections| &detections.carpet_end);
            self.places = boundary_places(scene, ends);
        }
    }

    /// The places of the last update, pixels.
    pub(crate) fn places(&self) -> &[[f32; 2]] {
        &self.places
    }
}

fn boundary_places(scene: &StaticScene, ends: &[f32]) -> Vec<[f32; 2]> {
    let Some(camera) = &scene.camera else {
        return Vec::new();
    };
    let [cu, cv] = camera.config.centre_px;
    let rim = camera.config.outer_radius_px;
    let rim = rim.unwrap_or(camera.map.width_px as f32 / 2.0);
    let place = |(ray, &end): (usize, &f32)| {
        let (sin, cos) = (TAU * ray as f32 / ends.len() as f32).sin_cos();
        // Outward from the mirror axis: the first pixel that shows ground beyond the boundary.
        (0..rim as usize).find_map(|step| {
            let at = [cu + step as f32 * cos, cv - step as f32 * sin];
            let inside = at[0] >= 0.0 && at[1] >= 0.0;
            let ground = inside.then(|| camera.map.at(at[0] as usize, at[1] as usize))??;
            (ground.distance() >= end).then_some(at)
        })
    };
    ends.iter().enumerate().filter_map(place).collect()
}
