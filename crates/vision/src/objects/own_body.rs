//! How far does the robot's own body hide the floor in each direction? What hides it in every view is the robot itself.
//!
//! Only when this is known can something that touches the robot be distinguished from it: both begin where the image begins.

use crate::objects::radial_scan::RadialScan;
use crate::optics::image_polar::wrap_turns;

/// Views after which the body is known.
const VIEWS_MIN: u32 = 8;
/// Share of the views in which the body hides a sample.
const OWN_SHARE: f32 = 0.5;

/// Counts of the views in which each sample of the rays is hidden from the robot on.
#[derive(Debug, Clone)]
pub(crate) struct OwnBody {
    counts: Vec<u32>,
    views: u32,
    /// Of each ray, what the body hides. Empty while the body is not known.
    hidden: Vec<HiddenGround>,
}

/// What the body hides along a ray.
#[derive(Debug, Clone, Copy)]
struct HiddenGround {
    /// One past its last sample.
    end: usize,
    /// Range of its last sample, metres; negative if there is none.
    range: f32,
}

impl OwnBody {
    pub(crate) fn new(rays: &RadialScan) -> Self {
        OwnBody {
            counts: vec![0; rays.samples.len()],
            views: 0,
            hidden: Vec::new(),
        }
    }

    /// Takes an image that shows another view than those before.
    pub(crate) fn add_view(&mut self, rays: &RadialScan) {
        self.views += 1;
        for ray in 0..rays.count() {
            let start = rays.starts[ray];
            for count in &mut self.counts[start..rays.hidden_end(ray, start)] {
                *count += 1;
            }
        }
        if self.views >= VIEWS_MIN {
            self.hidden.clear();
            self.hidden
                .extend(rays.starts.array_windows().map(|&[start, end]| {
                    let hidden = self.counts[start..end]
                        .iter()
                        .take_while(|&&count| count as f32 >= OWN_SHARE * self.views as f32);
                    let samples = start..start + hidden.count();
                    let last = rays.ranges[samples.clone()].last();
                    HiddenGround {
                        end: samples.end,
                        range: last.copied().unwrap_or(f32::NEG_INFINITY),
                    }
                }));
        }
    }

    /// True if the body is known to hide the ground at a distance (metres) in the direction of an azimuth (turns).
    pub(crate) fn hides(&self, turns: f32, range: f32) -> bool {
        let count = self.hidden.len();
        let ray = (wrap_turns(turns) * count as f32).round() as usize;
        // The last half of a ray's angle belongs to the first ray.
        let hidden = self.hidden.get(ray).or(self.hidden.first());
        hidden.is_some_and(|hidden| hidden.range >= range)
    }

    /// The first sample of a ray that the body does not hide. None while the body is not known.
    pub(crate) fn end(&self, ray: usize) -> Option<usize> {
        self.hidden.get(ray).map(|hidden| hidden.end)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::colour::lookup_table::ColourClass;
    use crate::config::ObjectDetectionConfig;
    use crate::objects::carpet_end::find_carpet_ends;
    use crate::objects::ray_obstacles::find_ray_obstacles;
    use crate::optics::ground_map::GroundMap;
    use localize::robot::CameraConfig;

    const SIDE: usize = 201;

    /// Rays of a mirror that shows two centimetres of ground in each pixel.
    fn rays() -> RadialScan {
        let axis = (SIDE / 2) as f32;
        let at = |pixel: usize| (pixel as f32 - axis) * 0.02;
        let map = GroundMap {
            width_px: SIDE,
            height_px: SIDE,
            x: (0..SIDE * SIDE).map(|i| at(i % SIDE)).collect(),
            y: (0..SIDE * SIDE).map(|i| -at(i / SIDE)).collect(),
        };
        let camera = CameraConfig {
            width_px: SIDE,
            height_px: SIDE,
            focal_px: None,
            centre_px: [axis, axis],
            height: None,
            forward_deg: 0.0,
            flipped: false,
            outer_radius_px: Some(axis),
        };
        RadialScan::new(&map, &camera, None, 0.2, &ObjectDetectionConfig::default())
    }

    /// Shows carpet, but for a body that reaches to 0.5 m in a quarter of the rays, and a robot to 1.2 m about `robot`.
    fn show(rays: &mut RadialScan, robot: Option<usize>) {
        let count = rays.count();
        for ray in 0..count {
            let away = |other: usize| (ray + count - other) % count;
            let near = |other: usize| away(other).min(count - away(other));
            let hidden = match robot {
                Some(robot) if near(robot) <= count / 16 => 1.2,
                _ if near(0) <= count / 8 => 0.5,
                _ => 0.0,
            };
            for sample in rays.starts[ray]..rays.starts[ray + 1] {
                let is_hidden = rays.samples[sample].range < hidden;
                rays.classes[sample] = match is_hidden {
                    true => ColourClass::OTHER,
                    false => ColourClass::CARPET,
                };
            }
        }
    }

    /// Rays with something that touches the robot and is known not to be its body.
    fn touching(rays: &RadialScan, body: &OwnBody) -> Vec<usize> {
        let config = ObjectDetectionConfig::default();
        let ends = find_carpet_ends(rays, &config);
        let obstacles = find_ray_obstacles(rays, &ends, body, &config);
        let is_other = |ray: &usize| obstacles[*ray].is_some_and(|found| found.beyond_own_body);
        (0..rays.count()).filter(is_other).collect()
    }

    #[test]
    fn a_robot_that_touches_is_told_from_the_own_body_once_that_is_known() {
        let mut rays = rays();
        let mut body = OwnBody::new(&rays);
        let (count, robot) = (rays.count(), rays.count() / 2);
        show(&mut rays, Some(robot));
        assert!(touching(&rays, &body).is_empty(), "nothing is known yet");
        for view in 0..VIEWS_MIN as usize {
            // Something passes in half of the views.
            let passing = (view % 2 == 0).then_some(count / 4 + view * count / 16);
            show(&mut rays, passing);
            body.add_view(&rays);
        }
        show(&mut rays, None);
        assert!(touching(&rays, &body).is_empty(), "the body alone");
        assert!(body.hides(0.0, 0.4) && !body.hides(0.0, 0.6));
        assert!(!body.hides(0.5, 0.4));
        show(&mut rays, Some(robot));
        let found = touching(&rays, &body);
        assert_eq!(found.len(), 2 * (count / 16) + 1);
        assert!(found.contains(&robot) && !found.contains(&0));
    }
}
