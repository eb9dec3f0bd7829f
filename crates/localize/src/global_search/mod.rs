//! Where on the field is the robot, without a prior pose? Four methods behind one interface, chosen by configuration.
//!
//! Each method returns poses. All are then refined by matching, deduplicated and ranked by likelihood in the same way.

pub mod branch_and_bound;
pub mod heading_histogram;
pub mod hough;
pub mod monte_carlo;
pub mod scan_map;

use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::field::Field;
use crate::frames::Pose;
use crate::global_search::branch_and_bound::{
    BranchAndBound, CertifiedHypotheses, HeadingPrior, Hypothesis,
};
use crate::global_search::heading_histogram::{HeadingHistogramConfig, histogram_heading};
use crate::matching::Matcher;
use crate::matching::distance_field::DistanceField;
use crate::sample::{GoalObservation, LinePoint};

use hough::{Hough, HoughConfig, confirm_by_goal_colours};
use monte_carlo::{MonteCarlo, MonteCarloConfig};
use scan_map::{CellMatch, ScanMap, ScanMapConfig};

/// The method of global localization.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum GlobalSearchMethod {
    /// Branch and bound over all poses (own).
    #[default]
    Exact,
    /// Hough transform, correlated with the field's lines (lima2001 4).
    Hough,
    /// Distances on scan lines, compared with those of every cell (minho2016 IV).
    ScanMap,
    /// Particle filter (nubot2013 4).
    MonteCarlo,
}

/// Settings of global localization.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct GlobalSearchConfig {
    /// The method.
    pub method: GlobalSearchMethod,
    /// Settings of `hough`.
    pub hough: HoughConfig,
    /// Settings of `scan_map`.
    pub scan_map: ScanMapConfig,
    /// Settings of `monte_carlo`.
    pub monte_carlo: MonteCarloConfig,
    /// Heading from histograms, for methods that need a heading when there is no compass.
    pub heading_histogram: HeadingHistogramConfig,
}

/// Cells of the scan map that are refined by matching, per heading.
const SCAN_MAP_CANDIDATES: usize = 6;

/// Least distance between two of these cells, metres.
const SCAN_MAP_SEPARATION_MIN: f32 = 0.4;

/// Largest error of a method's poses, metres: the matcher's initial kernel scale.
const START_ERROR: f32 = 0.4;

/// Global localization by one of the four methods.
#[derive(Debug, Clone)]
pub enum GlobalSearch {
    /// Branch and bound; uses the localizer's own search.
    Exact,
    /// lima2001 4.
    Hough {
        /// The transform.
        hough: Box<Hough>,
        /// The field, for the goal colour test.
        field: Box<Field>,
    },
    /// minho2016 IV.
    ScanMap {
        /// The map, shared with the localizer.
        map: Arc<ScanMap>,
        /// For the heading.
        heading_histogram: HeadingHistogramConfig,
    },
    /// nubot2013 4.
    MonteCarlo {
        /// The particles.
        filter: Box<MonteCarlo>,
        /// Iterations on a single image, which no odometry connects to others.
        iterations_max: usize,
    },
}

/// The input of global localization: one image's measurements.
#[derive(Debug, Clone, Copy)]
pub struct SearchInput<'a> {
    /// The field's distance look-up.
    pub distances: &'a DistanceField,
    /// Line points (robot frame, metres), all finite.
    pub points: &'a [LinePoint],
    /// The compass's heading.
    pub heading_prior: Option<HeadingPrior>,
    /// Goals detected by their colours.
    pub goals: &'a [GoalObservation],
    /// No odometry connects this image to the next one, so that particles must converge on it alone.
    pub single_image: bool,
}

impl GlobalSearch {
    /// Builds the tables of the configured method.
    pub fn new(field: &Field, distances: &DistanceField, config: &GlobalSearchConfig) -> Self {
        GlobalSearch::with_scan_map(field, distances, config, None)
    }

    /// As `new`, with a scan map that exists already.
    pub(crate) fn with_scan_map(
        field: &Field,
        distances: &DistanceField,
        config: &GlobalSearchConfig,
        scan_map: Option<&Arc<ScanMap>>,
    ) -> Self {
        match config.method {
            GlobalSearchMethod::Exact => GlobalSearch::Exact,
            GlobalSearchMethod::Hough => {
                let hough = Hough::new(field, config.hough.clone());
                GlobalSearch::Hough {
                    hough: Box::new(hough),
                    field: Box::new(field.clone()),
                }
            }
            GlobalSearchMethod::ScanMap => {
                let build = || Arc::new(ScanMap::new(field, distances, config.scan_map.clone()));
                let map = scan_map.cloned().unwrap_or_else(build);
                GlobalSearch::ScanMap {
                    map,
                    heading_histogram: config.heading_histogram.clone(),
                }
            }
            GlobalSearchMethod::MonteCarlo => {
                let config = config.monte_carlo.clone();
                let iterations_max = config.iterations_max;
                let filter = Box::new(MonteCarlo::new(field, distances, config));
                GlobalSearch::MonteCarlo {
                    filter,
                    iterations_max,
                }
            }
        }
    }

    /// True if particles are carried from image to image.
    pub fn is_in_progress(&self) -> bool {
        matches!(self, GlobalSearch::MonteCarlo { filter, .. } if !filter.particles().is_empty())
    }

    /// Removes all particles.
    pub fn reset(&mut self) {
        if let GlobalSearch::MonteCarlo { filter, .. } = self {
            filter.reset();
        }
    }

    /// Moves the particles by odometry (robot frame: metres, metres, radians).
    pub fn predict(&mut self, motion: [f32; 3]) {
        if let GlobalSearch::MonteCarlo { filter, .. } = self {
            filter.predict(motion);
        }
    }

    /// The particles; empty for the other methods.
    pub fn particles(&self) -> &[Pose] {
        match self {
            GlobalSearch::MonteCarlo { filter, .. } => filter.particles(),
            _ => &[],
        }
    }

    /// Memory held, bytes, without the scan map, which the localizer counts.
    pub fn memory_bytes(&self) -> usize {
        match self {
            GlobalSearch::Exact | GlobalSearch::ScanMap { .. } => 0,
            GlobalSearch::Hough { hough, .. } => hough.memory_bytes(),
            GlobalSearch::MonteCarlo { filter, .. } => filter.memory_bytes(),
        }
    }

    /// Poses that explain the measurements, most probable first. Only the exact search bounds all others.
    pub fn find_hypotheses(
        &mut self,
        search: &mut BranchAndBound,
        matcher: &mut Matcher,
        input: &SearchInput,
    ) -> CertifiedHypotheses {
        let uncertified = |hypotheses| CertifiedHypotheses {
            hypotheses,
            certificate: None,
        };
        let SearchInput {
            distances,
            points,
            heading_prior: prior,
            goals,
            single_image,
        } = *input;
        let starts: Vec<Pose> = match self {
            GlobalSearch::Exact => {
                return search.find_certified(distances, matcher, points, prior);
            }
            GlobalSearch::Hough { hough, field } => {
                let scored = hough.find_poses(points, prior);
                let poses: Vec<Pose> = scored.into_iter().map(|scored| scored.pose).collect();
                // The paper takes the first confirmed maximum. Several are confirmed; ranking by the points decides.
                let confirmed = confirm_by_goal_colours(field, &poses, goals);
                if confirmed.is_empty() {
                    poses
                } else {
                    confirmed
                }
            }
            GlobalSearch::ScanMap {
                map,
                heading_histogram,
            } => search_scan_map(map, heading_histogram, points, prior),
            GlobalSearch::MonteCarlo {
                filter,
                iterations_max,
            } => {
                let iterations = if single_image { *iterations_max } else { 1 };
                return uncertified(search_monte_carlo(
                    filter, iterations, search, matcher, input,
                ));
            }
        };
        uncertified(search.rank(distances, matcher, points, &starts, prior, START_ERROR))
    }
}

/// Iterates until the particles converge on a pose that explains the points; on any other pose they are redrawn.
fn search_monte_carlo(
    filter: &mut MonteCarlo,
    iterations: usize,
    search: &mut BranchAndBound,
    matcher: &mut Matcher,
    input: &SearchInput,
) -> Vec<Hypothesis> {
    for _ in 0..iterations {
        let Some(pose) = filter.update(input.points, input.heading_prior) else {
            continue;
        };
        let ranked = search.rank(
            input.distances,
            matcher,
            input.points,
            &[pose],
            input.heading_prior,
            START_ERROR,
        );
        if ranked
            .first()
            .is_some_and(|best| best.inlier_share >= filter.config().inlier_share_min)
        {
            return ranked;
        }
        filter.reset();
    }
    Vec::new()
}

/// Searches under the compass's heading, refined by histograms; without a compass under all four headings of the
/// histograms.
fn search_scan_map(
    map: &ScanMap,
    config: &HeadingHistogramConfig,
    points: &[LinePoint],
    prior: Option<HeadingPrior>,
) -> Vec<Pose> {
    let (start, quarters) = prior.map_or((0.0, 4), |prior| (prior.heading, 1));
    let histogram = HeadingHistogramConfig {
        search_range_deg: if prior.is_some() {
            config.search_range_deg
        } else {
            45.0
        },
        ..config.clone()
    };
    let Some(heading) = histogram_heading(points, start, &histogram) else {
        return Vec::new();
    };
    let mut matches: Vec<CellMatch> = (0..quarters)
        .flat_map(|quarter| {
            let heading = heading + quarter as f32 * std::f32::consts::FRAC_PI_2;
            map.find_poses(
                points,
                heading,
                SCAN_MAP_CANDIDATES,
                SCAN_MAP_SEPARATION_MIN,
            )
        })
        .collect();
    matches.sort_by(|a, b| a.error.total_cmp(&b.error));
    matches.into_iter().map(|found| found.pose).collect()
}
