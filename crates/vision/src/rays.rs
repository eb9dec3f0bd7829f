//! How far does the carpet reach in each direction, and what ends it? Rays from the mirror's axis to its rim.

use std::f32::consts::TAU;

use crate::camera::CameraConfig;
use crate::colours::Class;
use crate::config::ObjectConfig;
use crate::ground_map::GroundMap;

/// A sample of a ray.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct RaySample {
    pub(crate) u: u16,
    pub(crate) v: u16,
    /// Where the ground would be, robot frame, metres; not a number above the horizon.
    pub(crate) ground: [f32; 2],
    /// Its distance, metres; infinite above the horizon.
    pub(crate) range: f32,
}

/// The rays' samples, ray by ray, outward.
#[derive(Debug, Clone)]
pub(crate) struct Rays {
    pub(crate) samples: Vec<RaySample>,
    /// Where each ray starts in `samples`, and one past the last.
    pub(crate) starts: Vec<usize>,
    /// What was read, one a sample.
    pub(crate) classes: Vec<Class>,
}

/// What one ray shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct RaySight {
    /// Distance of the last carpet before something else, metres; infinite where nothing ends it or none is seen.
    pub(crate) end: f32,
    /// First sample beyond that.
    pub(crate) beyond: usize,
    /// Was any carpet seen?
    pub(crate) carpet: bool,
}

/// Carpet begins again where so many of the last five samples are carpet; fewer are noise on something dark.
const RECENT: u32 = 0b1_1111;
const MOST: u32 = 4;

impl Rays {
    pub(crate) fn new(
        map: &GroundMap,
        camera: &CameraConfig,
        mask: Option<&[bool]>,
        range_min: f32,
        config: &ObjectConfig,
    ) -> Self {
        let [cu, cv] = camera.centre_px;
        let (width, height) = (map.width_px as f32, map.height_px as f32);
        let (mut samples, mut starts) = (Vec::new(), vec![0]);
        for ray in 0..config.rays {
            let (sin, cos) = (TAU * ray as f32 / config.rays as f32).sin_cos();
            for step in (0..).step_by(config.ray_step_px) {
                let (u, v) = (
                    (cu + step as f32 * cos).round(),
                    (cv - step as f32 * sin).round(),
                );
                let inside = u >= 0.0 && v >= 0.0 && u < width && v < height;
                if !(inside && camera.sees_mirror(u, v)) {
                    break;
                }
                let (column, row) = (u as usize, v as usize);
                if mask.is_some_and(|mask| !mask[row * map.width_px + column]) {
                    continue;
                }
                let ground = map.at(column, row);
                let range = ground.map_or(f32::INFINITY, |at| at.distance());
                // Without ground before the first ground there is the robot itself.
                if range < range_min || ground.is_none() && samples.len() == starts[ray] {
                    continue;
                }
                samples.push(RaySample {
                    u: column as u16,
                    v: row as u16,
                    ground: ground.map_or([f32::NAN; 2], |at| [at.x, at.y]),
                    range,
                });
            }
            starts.push(samples.len());
        }
        Rays {
            classes: vec![Class::OTHER; samples.len()],
            samples,
            starts,
        }
    }

    pub(crate) fn count(&self) -> usize {
        self.starts.len() - 1
    }

    /// Follows each ray to the carpet's end.
    ///
    /// A cable, a shadow or a ball is passed over: only what covers more of the ground than `gap_max` plus `gap_share`
    /// of its distance ends the carpet. White counts a quarter, since a line may point at the robot. A ray whose
    /// nearest samples are covered (own body, a rod) starts where its first carpet is.
    pub(crate) fn sights(&self, config: &ObjectConfig) -> Vec<RaySight> {
        (0..self.count())
            .map(|ray| self.sight(self.starts[ray]..self.starts[ray + 1], config))
            .collect()
    }

    fn sight(&self, ray: std::ops::Range<usize>, config: &ObjectConfig) -> RaySight {
        let mut last_carpet: Option<usize> = None;
        let mut gap = 0.0;
        let mut before = 0.0;
        let mut recent = 0u32;
        for index in ray.clone() {
            let range = self.samples[index].range;
            let step = range - before;
            before = range;
            recent = recent << 1 | u32::from(self.classes[index] == Class::CARPET);
            let carpet = (recent & RECENT).count_ones();
            if self.classes[index] == Class::CARPET
                && (carpet >= MOST || gap == 0.0 && last_carpet.is_some())
            {
                last_carpet = Some(index);
                gap = 0.0;
                continue;
            }
            let Some(last) = last_carpet else { continue };
            gap += if self.classes[index] == Class::WHITE {
                0.25 * step
            } else {
                step
            };
            let until = self.samples[last].range;
            if gap > config.gap_max + config.gap_share * until {
                return RaySight {
                    end: until,
                    beyond: last + 1,
                    carpet: true,
                };
            }
        }
        RaySight {
            end: f32::INFINITY,
            beyond: ray.end,
            carpet: last_carpet.is_some(),
        }
    }
}
