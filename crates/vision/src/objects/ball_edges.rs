//! Refines a ball's place: where its colour changes to that of its surroundings, along the view and across it.

use crate::image::ImageView;
use crate::objects::ball_candidates::BallCandidate;
use crate::objects::patch::logarithm;
use crate::objects::view_angles::ViewAngles;

/// Samples along a profile, and their spacing in ball radii: the profile ends at two radii.
const PROFILE_SAMPLES: usize = 21;
const PROFILE_STEP: f32 = 0.1;
/// Last samples of a profile, whose mean is the surroundings' difference from the ball.
const SURROUND_SAMPLES: usize = 4;
/// Smallest difference between ball and surroundings, mean of the logarithms.
const DIFFERENCE_MIN: f32 = 0.1;
/// Extent of a ball between opposite edges, radii; others are not the ball's own edges.
const EXTENT: std::ops::Range<f32> = 1.3..2.7;

/// Edges of a candidate, in ball radii from its centre.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct BallEdges {
    /// Displacement of the centre away from the robot, radii.
    pub(crate) away: f32,
    /// Displacement of the centre in azimuth, radii.
    pub(crate) aside: f32,
    /// Extent along the view and across it, radii; 2 where edges are hidden.
    pub(crate) extent: [f32; 2],
}

/// Finds the edges around a candidate.
pub(crate) fn find_ball_edges(
    image: &ImageView<'_>,
    angles: &ViewAngles,
    candidate: &BallCandidate,
) -> BallEdges {
    let colour = |away: f32, aside: f32| -> Option<[f32; 3]> {
        let [u, v] = angles.position_px(
            candidate.view_angle + away * candidate.ball.half_height,
            candidate.azimuth + aside * candidate.ball.half_width,
        );
        let (u, v) = (u.round(), v.round());
        let inside =
            u >= 0.0 && v >= 0.0 && u < image.width_px as f32 && v < image.height_px as f32;
        inside.then(|| image.rgb(u as usize, v as usize).map(logarithm))
    };
    let inner = [[0.0, 0.0], [0.4, 0.0], [-0.4, 0.0], [0.0, 0.4], [0.0, -0.4]];
    let inner: Vec<[f32; 3]> = inner
        .iter()
        .filter_map(|&[away, aside]| colour(away, aside))
        .collect();
    let count = inner.len().max(1) as f32;
    let ball: [f32; 3] =
        std::array::from_fn(|channel| inner.iter().map(|c| c[channel]).sum::<f32>() / count);
    // Distance from the centre to the edge in a direction, radii.
    let edge = |away: f32, aside: f32| -> Option<f32> {
        let mut differences = [0.0; PROFILE_SAMPLES];
        for (index, difference) in differences.iter_mut().enumerate() {
            let length = index as f32 * PROFILE_STEP;
            let here = colour(away * length, aside * length)?;
            *difference = (0..3).map(|i| (here[i] - ball[i]).abs()).sum::<f32>() / 3.0;
        }
        let outside = &differences[PROFILE_SAMPLES - SURROUND_SAMPLES..];
        let outside = outside.iter().sum::<f32>() / SURROUND_SAMPLES as f32;
        if outside < DIFFERENCE_MIN {
            return None;
        }
        let half = 0.5 * outside;
        let first = (1..PROFILE_SAMPLES).find(|&index| differences[index] >= half)?;
        let (before, after) = (differences[first - 1], differences[first]);
        let part = ((half - before) / (after - before).max(1e-3)).clamp(0.0, 1.0);
        Some((first as f32 - 1.0 + part) * PROFILE_STEP)
    };
    // The near edge alone is trusted if the far one is hidden or merges with what stands behind.
    let along = match (edge(-1.0, 0.0), edge(1.0, 0.0)) {
        (Some(near), Some(far)) if EXTENT.contains(&(near + far)) => {
            (0.5 * (far - near), near + far)
        }
        (Some(near), _) => (1.0 - near, 2.0),
        _ => (0.0, 2.0),
    };
    let across = match (edge(0.0, -1.0), edge(0.0, 1.0)) {
        (Some(right), Some(left)) if EXTENT.contains(&(right + left)) => {
            (0.5 * (left - right), right + left)
        }
        _ => (0.0, 2.0),
    };
    BallEdges {
        away: along.0.clamp(-0.8, 0.8),
        aside: across.0.clamp(-0.8, 0.8),
        extent: [along.1, across.1],
    }
}
