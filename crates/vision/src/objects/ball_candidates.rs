//! Where could a ball lie? A grid of places in steps of two thirds of a ball's radius, judged in four steps: something
//! else than carpet within reach, as large as a ball with carpet before it, the coarse network, the convolution
//! networks.
//!
//! The ball's colour plays no part. Few of several thousand places pass the first two steps, which read classes alone.

use std::f32::consts::TAU;

use localize::math;

use crate::colour::lookup_table::{ColourClass, ColourLookupTable};
use crate::config::ObjectDetectionConfig;
use crate::image::{ImageView, OUTSIDE};
use crate::objects::ball::{ends_before, rays_beside_ball};
use crate::objects::coarse_batch::{LANES, coarse_log_odds};
use crate::objects::network::{NETWORKS, logistic};
use crate::objects::patch::{
    BallAngles, CoarsePixels, INNER, PatchFrame, PatchKind, coarse_pixels, floor_pixels,
    inner_pixels, normalize_patch, read_patch,
};
use crate::objects::view_angles::ViewAngles;
use crate::optics::image_polar::azimuth;

/// Step of the grid, ball radii.
const GRID_STEP: f32 = 0.7;
/// Distances of a ball, metres: nearer ones touch the robot, farther ones are a few pixels wide.
const RANGE_MIN: f32 = 0.3;
const RANGE_MAX: f32 = 6.5;
/// Fewest samples of the floor before and beside a ball that are carpet; a robot, a line or the own body may take others.
const FLOOR_CARPET_MIN: usize = 6;
/// Fewest of four samples at 0.85 radii around the centre that are not carpet. Lines are narrower than a ball.
const INNER_OTHERS_MIN: usize = 2;
/// Candidates whose pixels the convolution networks judge, and their least log odds by the coarse network.
const CANDIDATES_MAX: usize = 24;
const LOG_ODDS_MIN: f32 = 1.0;
/// Largest view angle of a ball, radians: far beyond the carpet.
const VIEW_ANGLE_MAX: f32 = 1.5;
/// Two candidates nearer than this are one, ball radii.
const SEPARATION: f32 = 1.5;

/// Places whose pixels are classified at a time.
const BATCH: usize = 64;

/// A place of the grid.
#[derive(Debug, Clone, Copy)]
struct GridPlace {
    view_angle: f32,
    azimuth: f32,
    ball: BallAngles,
}

impl GridPlace {
    /// Not judged yet.
    fn candidate(&self) -> BallCandidate {
        BallCandidate {
            view_angle: self.view_angle,
            azimuth: self.azimuth,
            ball: self.ball,
            probability: 0.0,
        }
    }
}

/// What tells whether a place is within reach.
#[derive(Debug, Clone, Copy)]
struct PlaceGround {
    /// Distance of the contact point, metres.
    range: f32,
    /// Rays beside the ball.
    rays: [u16; 2],
}

impl PlaceGround {
    /// True if ranges along the rays end before the place.
    fn is_beyond(&self, ranges: &[f32]) -> bool {
        ends_before(ranges, self.rays.map(usize::from), self.range)
    }
}

/// The places at which balls are sought.
///
/// Few places pass each step of the search, so each array holds what one step reads.
#[derive(Debug, Clone)]
pub(crate) struct BallGrid {
    ground: Vec<PlaceGround>,
    centres: Vec<[u16; 2]>,
    inner: Vec<[[u16; 2]; INNER]>,
    coarse: Vec<CoarsePixels>,
    places: Vec<GridPlace>,
    angles: ViewAngles,
    ball_radius: f32,
}

/// A ball as the networks see it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct BallCandidate {
    pub(crate) view_angle: f32,
    pub(crate) azimuth: f32,
    pub(crate) ball: BallAngles,
    /// Probability by the convolution networks.
    pub(crate) probability: f32,
}

impl BallGrid {
    /// Places with `is_visible` false (own body, outside the mirror) are left out.
    pub(crate) fn new(
        angles: &ViewAngles,
        config: &ObjectDetectionConfig,
        size_px: [usize; 2],
        is_visible: impl Fn(usize, usize) -> bool,
    ) -> Self {
        let mut grid = BallGrid {
            ground: Vec::new(),
            centres: Vec::new(),
            inner: Vec::new(),
            coarse: Vec::new(),
            places: Vec::new(),
            angles: angles.clone(),
            ball_radius: config.ball_radius,
        };
        let centre_height = config.viewpoint_height - config.ball_radius;
        let inside = |[u, v]: [f32; 2]| {
            let (u, v) = (u.round(), v.round());
            let inside = u >= 0.0 && v >= 0.0 && u < size_px[0] as f32 && v < size_px[1] as f32;
            inside.then_some([u as u16, v as u16])
        };
        let mut view_angle = math::atan2(RANGE_MIN, centre_height);
        let last = math::atan2(config.ball_range_max.min(RANGE_MAX), centre_height);
        while view_angle <= last {
            let range = centre_height * math::tan(view_angle);
            let ball = BallAngles::at(range, config.ball_radius, config.viewpoint_height);
            let count = (TAU / (GRID_STEP * ball.half_width)).ceil() as usize;
            for number in 0..count {
                let azimuth = TAU * number as f32 / count as f32;
                let Some(pixel) = inside(angles.position_px(view_angle, azimuth)) else {
                    continue;
                };
                if !is_visible(usize::from(pixel[0]), usize::from(pixel[1])) {
                    continue;
                }
                let frame = PatchFrame::ball(view_angle, azimuth, ball);
                let coarse = coarse_pixels(angles, &frame, size_px);
                let turns = azimuth / TAU;
                let rays = rays_beside_ball(turns, range, config.ball_radius, config.ray_count);
                grid.ground.push(PlaceGround {
                    range,
                    rays: rays.map(|ray| ray as u16),
                });
                grid.centres.push(pixel);
                grid.inner.push(inner_pixels(&coarse));
                grid.coarse.push(coarse);
                grid.places.push(GridPlace {
                    view_angle,
                    azimuth,
                    ball,
                });
            }
            view_angle += GRID_STEP * ball.half_height;
        }
        grid
    }

    /// Places that may show a ball, best first by the coarse network, at most [`CANDIDATES_MAX`].
    ///
    /// `carpet_end`: range of the carpet's boundary along each ray, metres. `reach`: likewise to where a ball may lie, beyond
    /// it; places before it come first.
    pub(crate) fn find_candidates(
        &self,
        image: &ImageView<'_>,
        tables: PlaceTables<'_>,
        carpet_end: &[f32],
        reach: &[f32],
    ) -> Vec<BallCandidate> {
        let judged = self.find_places(image, tables, reach);
        let mut ranked: Vec<(bool, f32, BallCandidate)> = Vec::new();
        for places in judged.chunks(LANES) {
            let patches = places.iter().map(|&place| &self.coarse[place as usize]);
            let network = &NETWORKS.ball_coarse;
            let odds = coarse_log_odds(network, PatchKind::Ball, image, patches);
            for (&place, log_odds) in places.iter().zip(odds) {
                if log_odds >= LOG_ODDS_MIN {
                    let place = place as usize;
                    let beyond = self.ground[place].is_beyond(carpet_end);
                    ranked.push((beyond, log_odds, self.places[place].candidate()));
                }
            }
        }
        ranked.sort_by(|a, b| a.0.cmp(&b.0).then(b.1.total_cmp(&a.1)));
        let mut best: Vec<BallCandidate> = Vec::new();
        for (_, _, candidate) in ranked {
            if best.len() == CANDIDATES_MAX {
                break;
            }
            if best.iter().all(|other| separation(other, &candidate) > 1.0) {
                best.push(candidate);
            }
        }
        best
    }

    /// Places within reach that show something else than carpet, as large as a ball, with carpet before it.
    fn find_places(
        &self,
        image: &ImageView<'_>,
        tables: PlaceTables<'_>,
        reach: &[f32],
    ) -> Vec<u32> {
        let mut found: Vec<u32> = Vec::with_capacity(self.ground.len());
        found.extend(
            (0..)
                .zip(&self.ground)
                .filter_map(|(place, ground)| (!ground.is_beyond(reach)).then_some(place)),
        );
        let classes = |table| PlaceClasses { image, table };
        let (ball, floor) = (classes(tables.ball), classes(tables.floor));
        ball.retain(
            &mut found,
            |place| [self.centres[place]],
            |counts| counts.carpet == 0,
        );
        ball.retain(
            &mut found,
            |place| self.inner[place],
            |counts| counts.other >= INNER_OTHERS_MIN,
        );
        floor.retain(
            &mut found,
            |place| floor_pixels(&self.coarse[place]),
            |counts| counts.carpet >= FLOOR_CARPET_MIN,
        );
        found
    }

    /// Judges candidates by their pixels; the best of each group remain, best first.
    pub(crate) fn judge(
        &self,
        image: &ImageView<'_>,
        mut candidates: Vec<BallCandidate>,
        probability_min: f32,
    ) -> Vec<BallCandidate> {
        for candidate in &mut candidates {
            candidate.probability = self.probability(image, candidate);
        }
        candidates.retain(|candidate| candidate.probability >= probability_min);
        candidates.sort_by(|a, b| b.probability.total_cmp(&a.probability));
        let mut best: Vec<BallCandidate> = Vec::new();
        for candidate in candidates {
            if best
                .iter()
                .all(|other| separation(other, &candidate) > SEPARATION)
            {
                best.push(candidate);
            }
        }
        best
    }

    /// Probability of a ball at a place by the convolution networks.
    pub(crate) fn probability(&self, image: &ImageView<'_>, candidate: &BallCandidate) -> f32 {
        let frame = PatchFrame::ball(candidate.view_angle, candidate.azimuth, candidate.ball);
        let colours = read_patch(image, &self.angles, &frame);
        let [log_odds] = NETWORKS
            .ball
            .evaluate(&normalize_patch(PatchKind::Ball, &colours));
        logistic(log_odds)
    }

    /// A candidate displaced away from the robot and in azimuth, ball radii.
    pub(crate) fn displaced(
        &self,
        candidate: &BallCandidate,
        away: f32,
        aside: f32,
    ) -> BallCandidate {
        let view_angle = candidate.view_angle + away * candidate.ball.half_height;
        let height = self.angles.height;
        let range = (height - self.ball_radius) * math::tan(view_angle.min(VIEW_ANGLE_MAX));
        BallCandidate {
            view_angle,
            azimuth: candidate.azimuth + aside * candidate.ball.half_width,
            ball: BallAngles::at(range, self.ball_radius, height),
            probability: candidate.probability,
        }
    }

    /// The candidate of a ball detected otherwise, by its contact point's distance and its image position.
    pub(crate) fn candidate_at(&self, range: f32, position_px: [f32; 2]) -> BallCandidate {
        let height = self.angles.height;
        BallCandidate {
            view_angle: math::atan2(range, height - self.ball_radius),
            azimuth: azimuth(self.angles.centre_px, position_px),
            ball: BallAngles::at(range, self.ball_radius, height),
            probability: 0.0,
        }
    }
}

/// Counts of classes among the pixels of a place; those outside the image count as neither.
struct ClassCounts {
    carpet: usize,
    other: usize,
}

impl ClassCounts {
    fn of<const N: usize>(pixels: &[[u16; 2]; N], classes: &[ColourClass; N]) -> Self {
        let (mut inside, mut carpet) = (0, 0);
        for (&pixel, &class) in pixels.iter().zip(classes) {
            let is_inside = pixel != OUTSIDE;
            inside += usize::from(is_inside);
            carpet += usize::from(is_inside & (class == ColourClass::CARPET));
        }
        ClassCounts {
            carpet,
            other: inside - carpet,
        }
    }
}

/// What is carpet about a ball, and what in it.
#[derive(Clone, Copy)]
pub(crate) struct PlaceTables<'a> {
    pub(crate) floor: &'a ColourLookupTable,
    pub(crate) ball: &'a ColourLookupTable,
}

/// Classes of pixels about the places of a grid.
struct PlaceClasses<'a> {
    image: &'a ImageView<'a>,
    table: &'a ColourLookupTable,
}

impl PlaceClasses<'_> {
    /// Keeps the places whose pixels satisfy a condition.
    fn retain<const N: usize>(
        &self,
        places: &mut Vec<u32>,
        pixels_of: impl Fn(usize) -> [[u16; 2]; N],
        keeps: impl Fn(ClassCounts) -> bool,
    ) {
        let mut kept = 0;
        for start in (0..places.len()).step_by(BATCH) {
            let batch = start..places.len().min(start + BATCH);
            let mut pixels = [[OUTSIDE; N]; BATCH];
            let pixels = &mut pixels[..batch.len()];
            for (pixels, &place) in pixels.iter_mut().zip(&places[batch.clone()]) {
                *pixels = pixels_of(place as usize);
            }
            let mut cells = [[0u32; N]; BATCH];
            let cells = cells[..batch.len()].as_flattened_mut();
            self.image.read_native(pixels.as_flattened(), cells);
            for cell in &mut *cells {
                *cell = ColourLookupTable::cell_index(*cell);
            }
            let mut classes = [[ColourClass::OTHER; N]; BATCH];
            self.table.classify(cells, classes.as_flattened_mut());
            for ((index, pixels), classes) in batch.zip(pixels).zip(&classes) {
                let counts = ClassCounts::of(pixels, classes);
                // Without a branch, which would often be foreseen wrongly.
                places[kept] = places[index];
                kept += usize::from(keeps(counts));
            }
        }
        places.truncate(kept);
    }
}

/// Distance of two candidates, ball radii.
pub(crate) fn separation(a: &BallCandidate, b: &BallCandidate) -> f32 {
    let across = localize::frames::wrap_angle(a.azimuth - b.azimuth) / a.ball.half_width;
    let along = (a.view_angle - b.view_angle) / a.ball.half_height;
    math::hypot(across, along)
}
