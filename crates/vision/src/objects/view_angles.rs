//! Where does the image show a direction? The inverse of the ground map, in polar coordinates about the mirror's axis.
//!
//! A direction is an azimuth in the image and a view angle: the angle from straight down at the viewpoint, atan(range / H).
//! Beyond the map's last ground the radius is extrapolated, so that the upper part of an object near the horizon has pixels.

use std::f32::consts::TAU;

use localize::math;

use crate::optics::ground_map::GroundMap;
use crate::optics::image_polar::{nearest_pixel, wrap_turns};

/// Azimuths of the table.
const AZIMUTHS: usize = 360;
/// First view angle, step and number of view angles of the table, radians.
const ANGLE_FIRST: f32 = 10.0 * DEGREE;
const ANGLE_STEP: f32 = 0.5 * DEGREE;
const ANGLES: usize = 204;
const DEGREE: f32 = std::f32::consts::PI / 180.0;
/// Entries from which the slope beyond the map is taken.
const EXTRAPOLATION_ENTRIES: usize = 20;
/// Fewest entries of an azimuth that shows ground; others have no radius.
const ENTRIES_MIN: usize = 10;
/// Step along a ray while the table is built, pixels.
const RAY_STEP_PX: f32 = 0.5;

/// Image radius of each direction.
#[derive(Debug, Clone)]
pub(crate) struct ViewAngles {
    /// Height of the viewpoint above the ground, metres.
    pub(crate) height: f32,
    /// The mirror's axis in the image, pixels.
    pub(crate) centre_px: [f32; 2],
    /// Radius in pixels by azimuth and view angle; NaN where unknown.
    radius_px: Vec<f32>,
}

/// Radii along one azimuth, between two of the table.
pub(crate) struct Ray<'a> {
    before: &'a [f32],
    after: &'a [f32],
    across: f32,
}

impl Ray<'_> {
    /// Radius in pixels at a view angle; NaN if the image does not show it.
    #[inline]
    pub(crate) fn radius_px(&self, view_angle: f32) -> f32 {
        let place = (view_angle - ANGLE_FIRST) / ANGLE_STEP;
        let place = place.clamp(0.0, ANGLES as f32 - 1.001);
        let (lower, part) = (place as usize, place.fract());
        let along = |radii: &[f32]| radii[lower] + part * (radii[lower + 1] - radii[lower]);
        let (before, after) = (along(self.before), along(self.after));
        before + self.across * (after - before)
    }
}

impl ViewAngles {
    pub(crate) fn new(map: &GroundMap, centre_px: [f32; 2], height: f32) -> Self {
        let mut radius_px = Vec::with_capacity(AZIMUTHS * ANGLES);
        for index in 0..AZIMUTHS {
            let azimuth = math::sin_cos(TAU * index as f32 / AZIMUTHS as f32);
            radius_px.extend(radii_along(map, centre_px, height, azimuth));
        }
        ViewAngles {
            height,
            centre_px,
            radius_px,
        }
    }

    /// The radii along one azimuth.
    pub(crate) fn ray(&self, azimuth: f32) -> Ray<'_> {
        let turns = wrap_turns(azimuth / TAU) * AZIMUTHS as f32;
        let (before, across) = (turns as usize % AZIMUTHS, turns.fract());
        let after = (before + 1) % AZIMUTHS;
        let radii = |azimuth: usize| &self.radius_px[azimuth * ANGLES..(azimuth + 1) * ANGLES];
        Ray {
            before: radii(before),
            after: radii(after),
            across,
        }
    }

    /// Radius in pixels of a direction; NaN if the image does not show it.
    pub(crate) fn radius_px(&self, view_angle: f32, azimuth: f32) -> f32 {
        self.ray(azimuth).radius_px(view_angle)
    }

    /// Image position of a direction: column and row, pixels; NaN if the image does not show it.
    pub(crate) fn position_px(&self, view_angle: f32, azimuth: f32) -> [f32; 2] {
        let radius = self.radius_px(view_angle, azimuth);
        let (sin, cos) = math::sin_cos(azimuth);
        [
            self.centre_px[0] + radius * cos,
            self.centre_px[1] - radius * sin,
        ]
    }

    /// View angle of the ground at a distance, radians.
    pub(crate) fn ground_angle(&self, range: f32) -> f32 {
        math::atan2(range, self.height)
    }

    /// Distance of the ground at a view angle, metres; infinite at the horizon and above.
    pub(crate) fn ground_range(&self, view_angle: f32) -> f32 {
        if view_angle >= std::f32::consts::FRAC_PI_2 {
            f32::INFINITY
        } else {
            self.height * math::tan(view_angle)
        }
    }
}

/// Radius of each view angle along one azimuth (sine, cosine).
fn radii_along(map: &GroundMap, centre_px: [f32; 2], height: f32, azimuth: (f32, f32)) -> Vec<f32> {
    let diagonal = math::hypot(map.width_px as f32, map.height_px as f32);
    let mut radii = vec![f32::NAN; ANGLES];
    // View angle and radius of the previous ground pixel; angles are made monotone.
    let mut last: Option<(f32, f32)> = None;
    let mut next = 0;
    for step in 0..(diagonal / RAY_STEP_PX) as usize {
        let radius = step as f32 * RAY_STEP_PX;
        let [u, v] = nearest_pixel(centre_px, radius, azimuth);
        if u < 0.0 || v < 0.0 {
            continue;
        }
        let Some(ground) = map.at(u as usize, v as usize) else {
            continue;
        };
        let angle = math::atan2(ground.distance(), height);
        let (angle_before, radius_before) = last.unwrap_or((angle, radius));
        let angle = angle.max(angle_before);
        while next < ANGLES {
            let wanted = ANGLE_FIRST + ANGLE_STEP * next as f32;
            if wanted > angle {
                break;
            }
            if last.is_some() && wanted >= angle_before {
                let rise = (angle - angle_before).max(1e-6);
                radii[next] =
                    radius_before + (wanted - angle_before) / rise * (radius - radius_before);
            }
            next += 1;
        }
        last = Some((angle, radius));
    }
    extrapolate(&mut radii);
    radii
}

/// Continues the radii beyond the last known one with its slope; clears them if too few are known.
fn extrapolate(radii: &mut [f32]) {
    let known = radii.iter().filter(|radius| radius.is_finite()).count();
    let first = radii.iter().position(|radius| radius.is_finite());
    let last = radii.iter().rposition(|radius| radius.is_finite());
    let (Some(first), Some(last)) = (first, last) else {
        return;
    };
    if known < ENTRIES_MIN {
        radii.fill(f32::NAN);
        return;
    }
    let from = first.max(last.saturating_sub(EXTRAPOLATION_ENTRIES));
    let slope = (radii[last] - radii[from]) / (last - from).max(1) as f32;
    for index in last + 1..radii.len() {
        radii[index] = radii[last] + slope * (index - last) as f32;
    }
}
