//! The field's lines in the camera image, computed once per cycle: a cycle is drawn several times.

use localize::Stamp;
use pipeline::Cycle;

use crate::view::static_scene::{StaticScene, View};

/// Lines of the markings, pixels.
#[derive(Default)]
pub(crate) struct ProjectedMarkings {
    /// Cycle and scene of the lines.
    of: Option<(Stamp, *const StaticScene)>,
    lines: Vec<Vec<[f32; 2]>>,
}

impl ProjectedMarkings {
    /// Projects the markings at the estimated pose of a cycle, if they are those of another one.
    pub(crate) fn update(&mut self, scene: &StaticScene, cycle: &Cycle) {
        let of = Some((cycle.stamp, std::ptr::from_ref(scene)));
        if self.of == of {
            return;
        }
        self.of = of;
        let estimate = &cycle.estimate;
        self.lines = estimate.pose.map_or(Vec::new(), |pose| {
            scene.project_markings(View {
                pose,
                tilt: estimate.tilt,
                correction: estimate.map_correction.as_ref(),
            })
        });
    }

    /// The lines of the last update.
    pub(crate) fn lines(&self) -> &[Vec<[f32; 2]>] {
        &self.lines
    }
}
