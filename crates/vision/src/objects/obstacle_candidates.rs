//! Where could a robot or a person stand? A grid of foot points, judged in three steps: an edge above carpet that is no
//! line, the coarse network, the convolution network.
//!
//! An edge is a step of the logarithmic colours, so a dark robot on a dim carpet counts as much as on a bright one.

use std::f32::consts::TAU;

use localize::math;

use crate::colour::lookup_table::{ColourClass, ColourLookupTable};
use crate::config::ObjectDetectionConfig;
use crate::image::{ImageView, OUTSIDE};
use crate::objects::coarse_batch::{LANES, coarse_log_odds};
use crate::objects::network::{NETWORKS, softmax};
use crate::objects::own_parts::OwnParts;
use crate::objects::patch::{
    COARSE_SAMPLES, CoarsePixels, PatchFrame, PatchKind, coarse_pixels, logarithms,
    normalize_patch, obstacle_row_step, read_patch,
};
use crate::objects::view_angles::ViewAngles;
use crate::optics::image_polar::azimuth;

/// Spacing of the foot points across and along the view, metres seen from the viewpoint.
const STEP_ACROSS: f32 = 0.12;
const STEP_ALONG: f32 = 0.08;
/// Smallest distance of a foot point, metres.
const RANGE_MIN: f32 = 0.35;
/// Rows below and above the foot that an edge separates.
const EDGE_ROWS: [f32; 2] = [1.0, 2.2];
/// Row above the foot at which a line has ended.
const BEYOND_LINE_ROW: f32 = 4.0;
/// Smallest step of the mean logarithm across an edge, and that which remains beyond a line.
const EDGE_STEP_MIN: f32 = 0.25;
const BEYOND_LINE_STEP_MIN: f32 = 0.2;
/// Step between two pixels below which a place is not looked at further.
const PLAIN_STEP_MAX: f32 = 0.08;
/// Candidates whose pixels the convolution network judges, and their least log odds by the coarse network.
const CANDIDATES_MAX: usize = 56;
const LOG_ODDS_MIN: f32 = -1.5;
/// Candidates nearer than this are one: metres across, and across where they stand at one distance.
const SEPARATION_IN_LINE: f32 = 0.18;
const SEPARATION_ABREAST: f32 = 0.3;
/// Difference of distances up to which two candidates stand abreast, metres.
const ABREAST_RANGE: f32 = 0.35;

/// Places whose colours are read at a time.
const BATCH: usize = 64;

/// A foot point of the grid.
#[derive(Debug, Clone, Copy)]
struct FootPlace {
    range: f32,
    azimuth: f32,
    below: [[u16; 2]; 2],
    above: [[u16; 2]; 2],
    beyond_line: [u16; 2],
}

impl FootPlace {
    /// Not judged yet.
    fn candidate(&self) -> ObstacleCandidate {
        ObstacleCandidate {
            range: self.range,
            azimuth: self.azimuth,
            robot: 0.0,
            person: 0.0,
        }
    }
}

/// Places of one distance.
#[derive(Debug, Clone, Copy)]
struct GridRow {
    first: usize,
    count: usize,
}

/// The foot points at which obstacles are sought.
#[derive(Debug, Clone)]
pub(crate) struct ObstacleGrid {
    /// Row by row outward, evenly around the axis; None outside the image.
    places: Vec<Option<FootPlace>>,
    /// Of each place, the farther pixels above and below; apart, since most places are plain and need no others.
    far_pixels: Vec<[[u16; 2]; 2]>,
    /// Pixels of each place's coarse patch; apart, since few places come so far.
    coarse: Vec<CoarsePixels>,
    rows: Vec<GridRow>,
    angles: ViewAngles,
    own_parts: OwnParts,
    is_new_view: bool,
}

/// An obstacle as the networks see it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ObstacleCandidate {
    /// Distance of its foot, metres.
    pub(crate) range: f32,
    pub(crate) azimuth: f32,
    /// Probabilities of a robot and of a person by the convolution network.
    pub(crate) robot: f32,
    pub(crate) person: f32,
}

impl ObstacleCandidate {
    /// Probability of an obstacle.
    pub(crate) fn probability(&self) -> f32 {
        self.robot + self.person
    }
}

impl ObstacleGrid {
    /// Places with `is_visible` false (own body, outside the mirror) are left out.
    pub(crate) fn new(
        angles: &ViewAngles,
        config: &ObjectDetectionConfig,
        size_px: [usize; 2],
        is_visible: impl Fn(usize, usize) -> bool,
    ) -> Self {
        let inside = |[u, v]: [f32; 2]| {
            let (u, v) = (u.round(), v.round());
            let inside = u >= 0.0 && v >= 0.0 && u < size_px[0] as f32 && v < size_px[1] as f32;
            inside.then_some([u as u16, v as u16])
        };
        let (mut places, mut rows) = (Vec::new(), Vec::new());
        let mut view_angle = angles.ground_angle(RANGE_MIN);
        let last = angles.ground_angle(config.robot_range_max.min(6.0));
        while view_angle <= last {
            let range = angles.ground_range(view_angle);
            let count = (TAU * range / STEP_ACROSS).ceil() as usize;
            rows.push(GridRow {
                first: places.len(),
                count,
            });
            let step = obstacle_row_step(range, angles.height);
            places.extend((0..count).map(|number| {
                let azimuth = TAU * number as f32 / count as f32;
                let at = |row: f32| inside(angles.position_px(view_angle + row * step, azimuth));
                let foot = at(0.0)?;
                if !is_visible(usize::from(foot[0]), usize::from(foot[1])) {
                    return None;
                }
                let above = [at(EDGE_ROWS[0])?, at(EDGE_ROWS[1])?];
                Some(FootPlace {
                    range,
                    azimuth,
                    below: [at(-EDGE_ROWS[0])?, at(-EDGE_ROWS[1])?],
                    above,
                    // Outside the image nothing contradicts.
                    beyond_line: at(BEYOND_LINE_ROW).unwrap_or(above[1]),
                })
            }));
            view_angle += STEP_ALONG / math::hypot(range, angles.height);
        }
        let coarse = |place: &Option<FootPlace>| {
            place.map_or([[0; 2]; COARSE_SAMPLES], |place| {
                let frame = PatchFrame::obstacle(place.range, place.azimuth, angles.height);
                coarse_pixels(angles, &frame, size_px)
            })
        };
        let far =
            |place: &Option<FootPlace>| place.map_or([OUTSIDE; 2], |it| [it.above[1], it.below[1]]);
        ObstacleGrid {
            own_parts: OwnParts::new(places.len()),
            far_pixels: places.iter().map(far).collect(),
            is_new_view: false,
            coarse: places.iter().map(coarse).collect(),
            places,
            rows,
            angles: angles.clone(),
        }
    }

    /// Foot points that may show an obstacle, best first by the coarse network, at most [`CANDIDATES_MAX`].
    ///
    /// `is_hidden` says of an azimuth in turns and a distance in metres whether the robot's own body hides that ground: a
    /// rod that crosses a line looks like a leg.
    pub(crate) fn find_candidates(
        &mut self,
        image: &ImageView<'_>,
        table: &ColourLookupTable,
        is_hidden: impl Fn(f32, f32) -> bool,
    ) -> Vec<ObstacleCandidate> {
        let mut edges = self.edge_steps(image, table);
        self.is_new_view = self
            .own_parts
            .add_image(edges.iter().map(|&edge| edge > 0.0));
        for (place, edge) in edges.iter_mut().enumerate() {
            if self.own_parts.is_own(place) {
                *edge = 0.0;
            }
        }
        let mut judged: Vec<usize> = Vec::new();
        for (row, grid_row) in self.rows.iter().enumerate() {
            for number in 0..grid_row.count {
                let index = grid_row.first + number;
                let Some(place) = self.places[index].as_ref().filter(|_| edges[index] > 0.0) else {
                    continue;
                };
                // Only the steepest place of an edge, along the view and across it.
                let turns = number as f32 / grid_row.count as f32;
                let steeper = |row: Option<usize>| {
                    let neighbour = row.and_then(|row| self.rows.get(row));
                    neighbour.is_some_and(|row| {
                        let nearest = (turns * row.count as f32).round() as usize % row.count;
                        edges[row.first + nearest] > edges[index]
                    })
                };
                let beside = [number + 1, number + grid_row.count - 1]
                    .map(|number| edges[grid_row.first + number % grid_row.count]);
                if steeper(row.checked_sub(1))
                    || steeper(Some(row + 1))
                    || beside.iter().any(|&edge| edge > edges[index])
                {
                    continue;
                }
                if is_hidden(turns, place.range) {
                    continue;
                }
                judged.push(index);
            }
        }
        let mut ranked: Vec<(f32, ObstacleCandidate)> = Vec::new();
        for indices in judged.chunks(LANES) {
            let patches: Vec<&CoarsePixels> =
                indices.iter().map(|&index| &self.coarse[index]).collect();
            let network = &NETWORKS.obstacle_coarse;
            let odds = coarse_log_odds(network, PatchKind::Obstacle, image, &patches);
            for (&index, log_odds) in indices.iter().zip(odds) {
                if let Some(place) = self.places[index].filter(|_| log_odds >= LOG_ODDS_MIN) {
                    ranked.push((log_odds, place.candidate()));
                }
            }
        }
        ranked.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut best: Vec<ObstacleCandidate> = Vec::new();
        for (_, candidate) in ranked {
            if best.len() == CANDIDATES_MAX {
                break;
            }
            if best.iter().all(|other| {
                across(other, &candidate) > 0.7 * SEPARATION_IN_LINE
                    || (other.range - candidate.range).abs() > 0.15 * candidate.range
            }) {
                best.push(candidate);
            }
        }
        best
    }

    /// Step of the colours at each place; 0 where there is no edge above carpet.
    fn edge_steps(&self, image: &ImageView<'_>, table: &ColourLookupTable) -> Vec<f32> {
        let logarithms = logarithms();
        let mut edges = vec![0.0; self.places.len()];
        let batches = edges.chunks_mut(BATCH).zip(self.places.chunks(BATCH));
        for ((edges, places), far) in batches.zip(self.far_pixels.chunks(BATCH)) {
            let mut colours = [[0u32; 2]; BATCH];
            let colours = &mut colours[..far.len()];
            image.read_rgb(far.as_flattened(), colours.as_flattened_mut());
            for ((edge, place), colours) in edges.iter_mut().zip(places).zip(colours) {
                let [above, below] = colours.map(|colour| log_colour(logarithms, colour));
                // Most places are plain: one pair of pixels shows it.
                if log_step(above, below) >= PLAIN_STEP_MAX
                    && let Some(place) = place
                {
                    *edge = edge_step(image, table, logarithms, place, [above, below]);
                }
            }
        }
        edges
    }

    /// Judges candidates by their pixels; the best of each group remain, best first.
    pub(crate) fn judge(
        &self,
        image: &ImageView<'_>,
        mut candidates: Vec<ObstacleCandidate>,
        probability_min: f32,
    ) -> Vec<ObstacleCandidate> {
        for candidate in &mut candidates {
            *candidate = self.judge_at(image, candidate.range, candidate.azimuth);
        }
        candidates.retain(|candidate| candidate.probability() >= probability_min);
        candidates.sort_by(|a, b| b.probability().total_cmp(&a.probability()));
        let mut best: Vec<ObstacleCandidate> = Vec::new();
        for candidate in candidates {
            if best.iter().all(|other| !is_same(other, &candidate)) {
                best.push(candidate);
            }
        }
        best
    }

    /// Judges an obstacle whose foot is at a distance (metres) and azimuth.
    pub(crate) fn judge_at(
        &self,
        image: &ImageView<'_>,
        range: f32,
        azimuth: f32,
    ) -> ObstacleCandidate {
        let frame = PatchFrame::obstacle(range, azimuth, self.angles.height);
        let colours = read_patch(image, &self.angles, &frame);
        let outputs = NETWORKS
            .obstacle
            .evaluate(&normalize_patch(PatchKind::Obstacle, &colours));
        let [_, robot, person] = softmax(outputs);
        ObstacleCandidate {
            range,
            azimuth,
            robot,
            person,
        }
    }

    /// True if the last image showed another view than those before.
    pub(crate) fn is_new_view(&self) -> bool {
        self.is_new_view
    }

    /// True if the grid's place at a foot belongs to the robot itself. A foot nearer than the grid has no place.
    pub(crate) fn is_own_part(&self, candidate: &ObstacleCandidate) -> bool {
        if candidate.range < RANGE_MIN {
            return false;
        }
        let turns = (candidate.azimuth / TAU).rem_euclid(1.0);
        let nearest = self.rows.iter().min_by(|a, b| {
            let off = |row: &GridRow| {
                let place = self.places[row.first..row.first + row.count]
                    .iter()
                    .flatten();
                let range = place.map(|place| place.range).next();
                range.map_or(f32::INFINITY, |range| (range - candidate.range).abs())
            };
            off(a).total_cmp(&off(b))
        });
        nearest.is_some_and(|row| {
            let number = (turns * row.count as f32).round() as usize % row.count;
            self.own_parts.is_own(row.first + number)
        })
    }

    /// The place of an obstacle detected otherwise, by its foot's distance and image position.
    pub(crate) fn azimuth_of(&self, position_px: [f32; 2]) -> f32 {
        azimuth(self.angles.centre_px, position_px)
    }

    /// Image position of a candidate's foot, pixels.
    pub(crate) fn foot_px(&self, candidate: &ObstacleCandidate) -> [f32; 2] {
        let view_angle = self.angles.ground_angle(candidate.range);
        self.angles.position_px(view_angle, candidate.azimuth)
    }
}

/// Logarithms of a colour whose red is in the lowest byte.
#[inline(always)]
fn log_colour(logarithms: &[f32; 256], colour: u32) -> [f32; 3] {
    let [r, g, b, _] = colour.to_le_bytes();
    [r, g, b].map(|level| logarithms[usize::from(level)])
}

/// Mean difference of two logarithmic colours.
#[inline(always)]
fn log_step(a: [f32; 3], b: [f32; 3]) -> f32 {
    ((a[0] - b[0]).abs() + (a[1] - b[1]).abs() + (a[2] - b[2]).abs()) / 3.0
}

/// Step of the logarithmic colours across an edge above carpet; 0 if there is none or it is a line's. `far`: the colours
/// of the farther pixels above and below.
fn edge_step(
    image: &ImageView<'_>,
    table: &ColourLookupTable,
    logarithms: &[f32; 256],
    place: &FootPlace,
    [far_above, far_below]: [[f32; 3]; 2],
) -> f32 {
    let mut read = [0; 3];
    image.read_rgb(
        &[place.above[0], place.below[0], place.beyond_line],
        &mut read,
    );
    let [near_above, near_below, beyond_line] = read.map(|colour| log_colour(logarithms, colour));
    let mean = |a: [f32; 3], b: [f32; 3]| [0, 1, 2].map(|channel| (a[channel] + b[channel]) / 2.0);
    let below = mean(near_below, far_below);
    let edge = log_step(mean(near_above, far_above), below);
    let is_carpet = |[u, v]: [u16; 2]| {
        let native = image.native_channels(usize::from(u), usize::from(v));
        table.class(native) == ColourClass::CARPET
    };
    if edge < EDGE_STEP_MIN
        || log_step(beyond_line, below) < BEYOND_LINE_STEP_MIN
        || !place.below.iter().any(|&pixel| is_carpet(pixel))
    {
        return 0.0;
    }
    edge
}

/// Distance across the view between two candidates, metres at the nearer one.
fn across(a: &ObstacleCandidate, b: &ObstacleCandidate) -> f32 {
    localize::frames::wrap_angle(a.azimuth - b.azimuth).abs() * a.range.min(b.range)
}

/// True if two candidates are one obstacle, or one stands behind the other.
pub(crate) fn is_same(a: &ObstacleCandidate, b: &ObstacleCandidate) -> bool {
    let across = across(a, b);
    across < SEPARATION_IN_LINE
        || across < SEPARATION_ABREAST && (a.range - b.range).abs() < ABREAST_RANGE
}
