//! Refines an obstacle's foot and measures its width: where the colours step from floor to obstacle.

use localize::math;

use crate::image::ImageView;
use crate::objects::obstacle_candidates::ObstacleCandidate;
use crate::objects::patch::{logarithm, obstacle_row_step};
use crate::objects::view_angles::ViewAngles;

/// Samples of the profile across the foot, and their spacing in rows of the patch.
const PROFILE_SAMPLES: usize = 25;
const PROFILE_STEP: f32 = 0.25;
/// Samples at both ends whose means are floor and obstacle.
const END_SAMPLES: usize = 6;
/// Smallest step from floor to obstacle, mean of the logarithms.
const STEP_MIN: f32 = 0.1;
/// Row above the foot at which the width is measured, and step across, metres.
const WIDTH_ROW: f32 = 1.5;
const WIDTH_STEP: f32 = 0.03;
/// Largest half width, steps.
const WIDTH_STEPS_MAX: usize = 20;

/// Distance of the foot, metres: the candidate's own where no step is found.
pub(crate) fn refine_foot(
    image: &ImageView<'_>,
    angles: &ViewAngles,
    candidate: &ObstacleCandidate,
) -> f32 {
    let view_angle = angles.ground_angle(candidate.range);
    let step = PROFILE_STEP * obstacle_row_step(candidate.range, angles.height);
    let middle = (PROFILE_SAMPLES / 2) as f32;
    let angle = |place: f32| view_angle + (place - middle) * step;
    let mut profile = [[0.0f32; 3]; PROFILE_SAMPLES];
    for (index, colour) in profile.iter_mut().enumerate() {
        match colour_at(image, angles, angle(index as f32), candidate.azimuth) {
            Some(logs) => *colour = logs,
            None => return candidate.range,
        }
    }
    let mean = |samples: &[[f32; 3]]| -> [f32; 3] {
        std::array::from_fn(|i| samples.iter().map(|c| c[i]).sum::<f32>() / samples.len() as f32)
    };
    let floor = mean(&profile[..END_SAMPLES]);
    let obstacle = mean(&profile[PROFILE_SAMPLES - END_SAMPLES..]);
    let full = difference(floor, obstacle);
    if full < STEP_MIN {
        return candidate.range;
    }
    // Outward, the first sample from which on the obstacle's colour prevails.
    let share = |colour: [f32; 3]| {
        let (to_floor, to_obstacle) = (difference(colour, floor), difference(colour, obstacle));
        to_floor / (to_floor + to_obstacle).max(1e-3)
    };
    let Some(last) = profile.iter().rposition(|&colour| share(colour) < 0.5) else {
        return candidate.range;
    };
    if last + 1 >= PROFILE_SAMPLES {
        return candidate.range;
    }
    let (before, after) = (share(profile[last]), share(profile[last + 1]));
    let part = ((0.5 - before) / (after - before).max(1e-3)).clamp(0.0, 1.0);
    angles.ground_range(angle(last as f32 + part))
}

/// Width above the foot, metres.
pub(crate) fn measure_width(
    image: &ImageView<'_>,
    angles: &ViewAngles,
    candidate: &ObstacleCandidate,
) -> f32 {
    let range = candidate.range;
    let row_step = obstacle_row_step(range, angles.height);
    let foot = angles.ground_angle(range);
    let floor = colour_at(
        image,
        angles,
        foot - WIDTH_ROW * row_step,
        candidate.azimuth,
    );
    let body = colour_at(
        image,
        angles,
        foot + WIDTH_ROW * row_step,
        candidate.azimuth,
    );
    let (Some(floor), Some(body)) = (floor, body) else {
        return WIDTH_STEP;
    };
    let steps = |side: f32| {
        (1..=WIDTH_STEPS_MAX)
            .take_while(|&step| {
                let aside = math::atan2(side * step as f32 * WIDTH_STEP, range);
                let here = colour_at(
                    image,
                    angles,
                    foot + WIDTH_ROW * row_step,
                    candidate.azimuth + aside,
                );
                here.is_some_and(|here| difference(here, body) < difference(here, floor))
            })
            .count()
    };
    (1 + steps(1.0) + steps(-1.0)) as f32 * WIDTH_STEP
}

fn colour_at(
    image: &ImageView<'_>,
    angles: &ViewAngles,
    view_angle: f32,
    azimuth: f32,
) -> Option<[f32; 3]> {
    let [u, v] = angles.position_px(view_angle, azimuth).map(|at| at.round());
    let inside = u >= 0.0 && v >= 0.0 && u < image.width_px as f32 && v < image.height_px as f32;
    inside.then(|| image.rgb(u as usize, v as usize).map(logarithm))
}

fn difference(a: [f32; 3], b: [f32; 3]) -> f32 {
    ((a[0] - b[0]).abs() + (a[1] - b[1]).abs() + (a[2] - b[2]).abs()) / 3.0
}
