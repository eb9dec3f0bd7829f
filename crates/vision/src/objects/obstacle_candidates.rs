//! Where could a robot or a person stand? A grid of foot points, judged in three steps: an edge above carpet that is no
//! line, the coarse network, the convolution networks.
//!
//! An edge is a step of the logarithmic colours, so a dark robot on a dim carpet counts as much as on a bright one.

use std::f32::consts::TAU;

use localize::math;

use crate::colour::lookup_table::ColourLookupTable;
use crate::config::ObjectDetectionConfig;
use crate::image::{ImageView, OUTSIDE};
use crate::objects::coarse_batch::{LANES, coarse_log_odds};
use crate::objects::foot_edges::{EdgePixels, FootEdges};
use crate::objects::network::{NETWORKS, softmax};
use crate::objects::own_parts::OwnParts;
use crate::objects::patch::{
    COARSE_SAMPLES, CoarsePixels, OBSTACLE_RANGE_MAX, PatchFrame, PatchKind, coarse_pixels,
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
/// Candidates whose pixels the convolution networks judge, and their least log odds by the coarse network.
const CANDIDATES_MAX: usize = 56;
const LOG_ODDS_MIN: f32 = -1.5;
/// The same for those that are farther than any of which the networks learned, their least probability, and the share of the
/// carpet's reach within which they stand. Walls and benches resemble obstacles there.
const FAR_CANDIDATES_MAX: usize = 16;
const FAR_LOG_ODDS_MIN: f32 = 1.0;
const FAR_PROBABILITY_MIN: f32 = 0.9;
const FAR_CARPET_SHARE: f32 = 0.9;
/// Candidates nearer than this are one: metres across, and across where they stand at one distance.
const SEPARATION_IN_LINE: f32 = 0.18;
const SEPARATION_ABREAST: f32 = 0.3;
/// Difference of distances up to which two candidates stand abreast, metres.
const ABREAST_RANGE: f32 = 0.35;

/// Places of one distance, evenly around the axis.
#[derive(Debug, Clone, Copy)]
struct GridRow {
    first: usize,
    count: usize,
    /// Distance of the foot points, metres; infinite if none is visible.
    range: f32,
}

/// The foot points at which obstacles are sought.
#[derive(Debug, Clone)]
pub(crate) struct ObstacleGrid {
    rows: Vec<GridRow>,
    edges: FootEdges,
    /// Pixels of each place's coarse patch.
    coarse: Vec<CoarsePixels>,
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
    /// Probabilities of a robot and of a person by the convolution networks.
    pub(crate) robot: f32,
    pub(crate) person: f32,
}

impl ObstacleCandidate {
    /// Not judged yet.
    fn at(range: f32, azimuth: f32) -> Self {
        ObstacleCandidate {
            range,
            azimuth,
            robot: 0.0,
            person: 0.0,
        }
    }

    /// True if it is farther than those of which the networks learned.
    fn is_far(&self) -> bool {
        self.range > OBSTACLE_RANGE_MAX
    }

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
        let (mut places, mut coarse, mut rows) = (Vec::new(), Vec::new(), Vec::new());
        let mut view_angle = angles.ground_angle(RANGE_MIN);
        let last = angles.ground_angle(config.robot_range_max);
        while view_angle <= last {
            let range = angles.ground_range(view_angle);
            // As far as the patches keep their angles, so do the steps.
            let patch_range = range.min(OBSTACLE_RANGE_MAX);
            let count = (TAU * patch_range / STEP_ACROSS).ceil() as usize;
            let step = obstacle_row_step(range, angles.height);
            let first = places.len();
            places.extend((0..count).map(|number| {
                let azimuth = azimuth_of_place(number, count);
                let at = |row: f32| inside(angles.position_px(view_angle + row * step, azimuth));
                let foot = at(0.0)?;
                if !is_visible(usize::from(foot[0]), usize::from(foot[1])) {
                    return None;
                }
                let above = [at(EDGE_ROWS[0])?, at(EDGE_ROWS[1])?];
                Some(EdgePixels {
                    above,
                    below: [at(-EDGE_ROWS[0])?, at(-EDGE_ROWS[1])?],
                    // Outside the image nothing contradicts.
                    beyond_line: at(BEYOND_LINE_ROW).unwrap_or(above[1]),
                })
            }));
            let row = &places[first..];
            coarse.extend(row.iter().enumerate().map(|(number, place)| {
                let frame =
                    PatchFrame::obstacle(range, azimuth_of_place(number, count), angles.height);
                place.map_or([OUTSIDE; COARSE_SAMPLES], |_| {
                    coarse_pixels(angles, &frame, size_px)
                })
            }));
            let visible = row.iter().any(Option::is_some);
            rows.push(GridRow {
                first,
                count,
                range: if visible { range } else { f32::INFINITY },
            });
            view_angle += STEP_ALONG / math::hypot(patch_range, angles.height);
        }
        ObstacleGrid {
            own_parts: OwnParts::new(places.len()),
            edges: FootEdges::new(&places),
            coarse,
            rows,
            angles: angles.clone(),
            is_new_view: false,
        }
    }

    /// Foot points that may show an obstacle, best first by the coarse network, at most [`CANDIDATES_MAX`] and
    /// [`FAR_CANDIDATES_MAX`].
    ///
    /// `is_hidden` says of an azimuth in turns and a distance in metres whether the robot's own body hides that ground: a
    /// rod that crosses a line looks like a leg. `carpet`: range to which the carpet reaches along each ray, metres.
    pub(crate) fn find_candidates(
        &mut self,
        image: &ImageView<'_>,
        table: &ColourLookupTable,
        carpet: &[f32],
        is_hidden: impl Fn(f32, f32) -> bool,
    ) -> Vec<ObstacleCandidate> {
        let mut steep = self.edges.find(image, table);
        let edges = &mut self.edges.steps;
        self.is_new_view = self
            .own_parts
            .add_image(edges.iter().map(|&edge| edge > 0.0));
        steep.retain(|&place| {
            let own = self.own_parts.is_own(place);
            if own {
                edges[place] = 0.0;
            }
            !own
        });
        let judged = self.steepest_places(&steep, carpet, is_hidden);
        let mut ranked: Vec<(f32, ObstacleCandidate)> = Vec::new();
        for places in judged.chunks(LANES) {
            let patches = places.iter().map(|&(place, _)| &self.coarse[place]);
            let network = &NETWORKS.obstacle_coarse;
            let odds = coarse_log_odds(network, PatchKind::Obstacle, image, patches);
            for (&(_, candidate), log_odds) in places.iter().zip(odds) {
                let least = match candidate.is_far() {
                    true => FAR_LOG_ODDS_MIN,
                    false => LOG_ODDS_MIN,
                };
                if log_odds >= least {
                    ranked.push((log_odds, candidate));
                }
            }
        }
        ranked.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut best: Vec<ObstacleCandidate> = Vec::new();
        let (mut near_count, mut far_count) = (0, 0);
        for (_, candidate) in ranked {
            let (count, most) = match candidate.is_far() {
                true => (&mut far_count, FAR_CANDIDATES_MAX),
                false => (&mut near_count, CANDIDATES_MAX),
            };
            if *count < most
                && best.iter().all(|other| {
                    across(other, &candidate) > 0.7 * SEPARATION_IN_LINE
                        || (other.range - candidate.range).abs() > 0.15 * candidate.range
                })
            {
                best.push(candidate);
                *count += 1;
            }
        }
        best
    }

    /// Of places with an edge, those where it is steepest along the view and across it, and all far ones on the carpet, whose
    /// edges lie close together; with their candidates.
    fn steepest_places(
        &self,
        steep: &[usize],
        carpet: &[f32],
        is_hidden: impl Fn(f32, f32) -> bool,
    ) -> Vec<(usize, ObstacleCandidate)> {
        let edges = &self.edges.steps;
        let mut steepest = Vec::new();
        let mut row = 0;
        for &place in steep {
            while place >= self.rows[row].first + self.rows[row].count {
                row += 1;
            }
            let GridRow {
                first,
                count,
                range,
            } = self.rows[row];
            let number = place - first;
            let turns = number as f32 / count as f32;
            let steeper = |row: Option<usize>| {
                let neighbour = row.and_then(|row| self.rows.get(row));
                neighbour.is_some_and(|row| {
                    let nearest = (turns * row.count as f32).round() as usize % row.count;
                    edges[row.first + nearest] > edges[place]
                })
            };
            if range > OBSTACLE_RANGE_MAX {
                let ray = (turns * carpet.len() as f32).round() as usize % carpet.len();
                if range > FAR_CARPET_SHARE * carpet[ray] {
                    continue;
                }
            } else {
                let before = if number == 0 { count - 1 } else { number - 1 };
                let after = if number + 1 == count { 0 } else { number + 1 };
                let beside = [before, after].map(|number| edges[first + number] > edges[place]);
                if beside != [false; 2] || steeper(row.checked_sub(1)) || steeper(Some(row + 1)) {
                    continue;
                }
            }
            if is_hidden(turns, range) {
                continue;
            }
            let azimuth = azimuth_of_place(number, count);
            steepest.push((place, ObstacleCandidate::at(range, azimuth)));
        }
        steepest
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
        candidates.retain(|candidate| {
            let least = match candidate.is_far() {
                true => FAR_PROBABILITY_MIN.max(probability_min),
                false => probability_min,
            };
            candidate.probability() >= least
        });
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
            let off = |row: &GridRow| (row.range - candidate.range).abs();
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

/// Azimuth of a place among those of its row, radians.
fn azimuth_of_place(number: usize, count: usize) -> f32 {
    TAU * number as f32 / count as f32
}

/// Distance across the view between two candidates, metres at the nearer one; far ones as if they stood where patches
/// keep their angles.
fn across(a: &ObstacleCandidate, b: &ObstacleCandidate) -> f32 {
    let range = a.range.min(b.range).min(OBSTACLE_RANGE_MAX);
    localize::frames::wrap_angle(a.azimuth - b.azimuth).abs() * range
}

/// True if two candidates are one obstacle, or one stands behind the other.
pub(crate) fn is_same(a: &ObstacleCandidate, b: &ObstacleCandidate) -> bool {
    let across = across(a, b);
    across < SEPARATION_IN_LINE
        || across < SEPARATION_ABREAST && (a.range - b.range).abs() < ABREAST_RANGE
}
