//! Where exactly is a ball? A disc of its known size, laid where its pixels differ most from those around it.
//!
//! Pixels are compared by their chromaticity first: shading darkens the lower half of a ball, and its shadow the floor.

use std::ops::Range;
use std::sync::LazyLock;

use localize::math;

use crate::image::{ImageView, OUTSIDE};
use crate::objects::ball_candidates::BallCandidate;
use crate::objects::patch::{COLUMNS, Directions, logarithms, pixels_at};
use crate::objects::view_angles::ViewAngles;

/// Samples of the window's side, and their spacing in ball radii: the window spans 4.8 radii.
const SIDE: usize = 25;
const STEP: f32 = 0.2;
/// Largest displacement of the disc, samples: the grid's places and the networks are less than a radius off.
const SHIFT_MAX: i32 = 5;
/// Radii of the disc and of the ring around it, ball radii. Between them lies the blurred edge.
const DISC: f32 = 0.9;
const RING: Range<f32> = 1.1..1.5;
/// Radius around the candidate's centre whose mean is the ball's colour, ball radii.
const CORE: f32 = 0.5;
/// Distance of the floor before the ball from the candidate's centre, ball radii.
const FLOOR: Range<f32> = 1.7..2.4;
/// Weight of a difference of brightness relative to one of chromaticity.
const BRIGHTNESS_WEIGHT: f32 = 0.3;

/// Displacement of a ball's centre from its candidate, ball radii.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct BallFit {
    /// Away from the robot.
    pub(crate) away: f32,
    /// In azimuth.
    pub(crate) aside: f32,
}

/// Number of shifts in each direction, and room for them in vector registers.
const SHIFTS: usize = 2 * SHIFT_MAX as usize + 1;
const ROOM: usize = 16;

/// A colour: chromaticity (logarithms without their mean) and weighted brightness.
type Colour = [f32; 4];

/// Channels of the window's colours, row by row.
type Window = [[f32; SIDE * SIDE]; 4];

/// Share of the ball's colour in each sample; room at the end, where sums of shifted rows read beyond it.
type Shares = [f32; SIDE * SIDE + ROOM];

/// Lays the disc around a candidate; no displacement where the image ends.
pub(crate) fn fit_ball(
    image: &ImageView<'_>,
    angles: &ViewAngles,
    candidate: &BallCandidate,
) -> BallFit {
    let Some(window) = read_window(image, angles, candidate) else {
        return BallFit {
            away: 0.0,
            aside: 0.0,
        };
    };
    let contrasts = TEMPLATE.contrasts(&ball_shares(&window));
    let contrast = |[down, right]: [i32; 2]| {
        contrasts[(down + SHIFT_MAX) as usize][(right + SHIFT_MAX) as usize]
    };
    // Every second place first, then the neighbours of the best.
    let mut best = ([0, 0], contrast([0, 0]));
    let coarse = (-SHIFT_MAX..=SHIFT_MAX).step_by(2);
    for down in coarse.clone() {
        for right in coarse.clone() {
            best = better(best, [down, right], contrast);
        }
    }
    let [down, right] = best.0;
    for next_down in (down - 1).max(-SHIFT_MAX)..=(down + 1).min(SHIFT_MAX) {
        for next_right in (right - 1).max(-SHIFT_MAX)..=(right + 1).min(SHIFT_MAX) {
            best = better(best, [next_down, next_right], contrast);
        }
    }
    let ([down, right], here) = best;
    let between = |shift: i32, at: &dyn Fn(i32) -> f32| {
        let inner = shift.abs() < SHIFT_MAX;
        let vertex = inner.then(|| parabola_vertex([at(shift - 1), here, at(shift + 1)]));
        STEP * (shift as f32 + vertex.unwrap_or(0.0))
    };
    BallFit {
        away: between(down, &|down| contrast([down, right])),
        aside: between(right, &|right| contrast([down, right])),
    }
}

/// The better of the best place so far and another one.
fn better(
    best: ([i32; 2], f32),
    place: [i32; 2],
    contrast: impl Fn([i32; 2]) -> f32,
) -> ([i32; 2], f32) {
    let here = contrast(place);
    if here > best.1 { (place, here) } else { best }
}

/// 1 on the ball, 0 on the floor.
fn ball_shares(window: &Window) -> Shares {
    let (ball, floor) = (mean(window, &TEMPLATE.core), mean(window, &TEMPLATE.floor));
    let mut shares = [0.0; SIDE * SIDE + ROOM];
    for (place, share) in shares.iter_mut().take(SIDE * SIDE).enumerate() {
        let colour = [0, 1, 2, 3].map(|channel: usize| window[channel][place]);
        let (to_ball, to_floor) = (distance(colour, ball), distance(colour, floor));
        let sum = to_floor + to_ball;
        // Not `max`, whose care for numbers that are none takes more instructions.
        *share = to_floor / if sum > 1e-3 { sum } else { 1e-3 };
    }
    shares
}

/// Samples about the window's middle, as indices of the window.
struct Template {
    disc: Vec<usize>,
    ring: Vec<usize>,
    /// Those whose means are the colours of ball and floor.
    core: Vec<usize>,
    floor: Vec<usize>,
}

static TEMPLATE: LazyLock<Template> = LazyLock::new(|| {
    let select = |selects: &dyn Fn(f32, f32) -> bool| {
        let places =
            (0..SIDE * SIDE).filter(|&place| selects(offset(place / SIDE), offset(place % SIDE)));
        places.collect()
    };
    let within = |radii: Range<f32>| {
        select(&|away, aside| {
            let squared = away * away + aside * aside;
            (radii.start * radii.start..radii.end * radii.end).contains(&squared)
        })
    };
    Template {
        disc: within(0.0..DISC),
        ring: within(RING),
        core: within(0.0..CORE),
        floor: select(&|away, aside| {
            away < -aside.abs() && FLOOR.contains(&(away * away + aside * aside).sqrt())
        }),
    }
});

impl Template {
    /// Mean share of the ball in the disc minus that in the ring, by displacement down and right; of the columns beyond
    /// [`SHIFTS`] none is meant.
    fn contrasts(&self, shares: &Shares) -> [[f32; ROOM]; SHIFTS] {
        let (disc, ring) = (
            shifted_sums(shares, &self.disc),
            shifted_sums(shares, &self.ring),
        );
        let counts = [&self.disc, &self.ring].map(|places| places.len() as f32);
        std::array::from_fn(|down| {
            std::array::from_fn(|right| {
                disc[down][right] / counts[0] - ring[down][right] / counts[1]
            })
        })
    }
}

/// Sums of the shares at some places, displaced by each number of samples down and right.
///
/// All displacements to the right at once, so that additions to one sum need not wait for each other.
fn shifted_sums(shares: &Shares, places: &[usize]) -> [[f32; ROOM]; SHIFTS] {
    const FIRST: usize = SHIFT_MAX as usize * (SIDE + 1);
    std::array::from_fn(|down| {
        let mut sums = [0.0; ROOM];
        for &place in places {
            let start = place + down * SIDE - FIRST;
            for (sum, share) in sums.iter_mut().zip(&shares[start..start + ROOM]) {
                *sum += share;
            }
        }
        sums
    })
}

/// Displacement of a sample from the window's middle, ball radii.
fn offset(index: usize) -> f32 {
    (index as f32 - (SIDE / 2) as f32) * STEP
}

/// Colours around a candidate, row by row: rows lead away from the robot, columns lie in azimuth. None if a sample is
/// outside the image.
fn read_window(
    image: &ImageView<'_>,
    angles: &ViewAngles,
    candidate: &BallCandidate,
) -> Option<Window> {
    let mut window = [[0.0; SIDE * SIDE]; 4];
    let ray = angles.ray(candidate.azimuth);
    // The last column again where no more are left.
    let directions = Directions::<{ SIDE.next_multiple_of(COLUMNS) }>::new(|column| {
        let aside = offset(column.min(SIDE - 1)) * candidate.ball.half_width;
        math::sin_cos(candidate.azimuth + aside)
    });
    let size_px = [image.width_px, image.height_px];
    let logarithms = logarithms();
    for row in 0..SIDE {
        let radius = ray.radius_px(candidate.view_angle + offset(row) * candidate.ball.half_height);
        let pixels = pixels_at(angles.centre_px, size_px, radius, &directions);
        if pixels.contains(&OUTSIDE) {
            return None;
        }
        let mut read = [0; SIDE];
        image.read_rgb(&pixels[..SIDE], &mut read);
        for (place, rgb) in (row * SIDE..).zip(read) {
            let [r, g, b, _] = rgb.to_le_bytes();
            let logs = [r, g, b].map(|level| logarithms[usize::from(level)]);
            let brightness = (logs[0] + logs[1] + logs[2]) / 3.0;
            let [r, g, b] = logs.map(|log| log - brightness);
            let colour = [r, g, b, BRIGHTNESS_WEIGHT * brightness];
            for (channel, value) in window.iter_mut().zip(colour) {
                channel[place] = value;
            }
        }
    }
    Some(window)
}

/// Mean colour of some samples.
fn mean(window: &Window, places: &[usize]) -> Colour {
    let count = places.len() as f32;
    [0, 1, 2, 3].map(|channel: usize| {
        let values = places.iter().map(|&place| window[channel][place]);
        values.fold(0.0, |sum, value| sum + value) / count
    })
}

#[inline(always)]
fn distance(a: Colour, b: Colour) -> f32 {
    let squares = a.into_iter().zip(b).map(|(a, b)| (a - b) * (a - b));
    squares.fold(0.0, |sum, square| sum + square).sqrt()
}

/// Place of the maximum of a parabola through three values, from the middle one, steps.
fn parabola_vertex([before, here, after]: [f32; 3]) -> f32 {
    let curvature = before - 2.0 * here + after;
    if curvature >= -1e-6 {
        return 0.0;
    }
    (0.5 * (before - after) / curvature).clamp(-0.5, 0.5)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn contrast_is_largest_where_a_blurred_disc_lies() {
        let shares: Shares = std::array::from_fn(|place| {
            let (away, aside) = (offset(place / SIDE) - 0.5, offset(place % SIDE) + 0.3);
            // Blurred by a fifth of the radius.
            ((1.1 - (away * away + aside * aside).sqrt()) / 0.2).clamp(0.0, 1.0)
        });
        let contrasts = TEMPLATE.contrasts(&shares);
        let best = (0..SHIFTS)
            .flat_map(|down| (0..SHIFTS).map(move |right| [down, right]))
            .max_by(|a, b| {
                let contrast = |place: &[usize; 2]| contrasts[place[0]][place[1]];
                contrast(a).total_cmp(&contrast(b))
            })
            .expect("places");
        let [away, aside] = best.map(|shift| STEP * (shift as i32 - SHIFT_MAX) as f32);
        assert!(
            (away - 0.5).abs() <= 0.11 && (aside + 0.3).abs() <= 0.11,
            "{away} {aside}"
        );
    }

    #[test]
    fn vertex_of_a_parabola() {
        let value = |x: f32| 3.0 - (x - 0.3) * (x - 0.3);
        assert!((parabola_vertex([value(-1.0), value(0.0), value(1.0)]) - 0.3).abs() < 1e-5);
    }
}
