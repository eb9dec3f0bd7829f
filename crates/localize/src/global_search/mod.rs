//! Where on the field, from nothing? The three papers' ways and our own behind one door, chosen by configuration.
//!
//! Each returns poses; these are then matched to the end, told apart and ranked by likelihood alike.

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
use crate::global_search::branch_and_bound::{BranchAndBound, HeadingPrior, Hypothesis};
use crate::global_search::heading_histogram::{HeadingHistogramConfig, histogram_heading};
use crate::matching::Matcher;
use crate::matching::distance_field::DistanceField;
use crate::sample::{GoalObservation, LinePoint};

use hough::{Hough, HoughConfig, confirm_by_goal_colours};
use monte_carlo::{MonteCarlo, MonteCarloConfig};
use scan_map::{ScanMap, ScanMapConfig};

/// Who looks for the pose on the whole field.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum GlobalSearchMethod {
    /// Branch and bound over all poses (ours).
    #[default]
    Exact,
    /// Hough transform and correlation with the field's lines (lima2001 4).
    Hough,
    /// Distances on scan lines compared with every cell's (minho2016 IV).
    ScanMap,
    /// Particles (nubot2013 4).
    MonteCarlo,
}

/// Relocalisation.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct GlobalSearchConfig {
    /// Which one.
    pub method: GlobalSearchMethod,
    /// Settings of `hough`.
    pub hough: HoughConfig,
    /// Settings of `scan_map`.
    pub scan_map: ScanMapConfig,
    /// Settings of `monte_carlo`.
    pub monte_carlo: MonteCarloConfig,
    /// Heading by histograms, where a relocaliser needs one and no compass gives it.
    pub heading_histogram: HeadingHistogramConfig,
}

/// Cells of the scan map that are matched to the end, per heading.
const SCAN_MAP_CANDIDATES: usize = 6;

/// How far off their cells and particles may be, metres: the matcher's first reach.
const START_ERROR: f32 = 0.4;

/// One of the four.
#[derive(Debug, Clone)]
pub enum GlobalSearch {
    /// Uses the search that the localizer has anyway.
    Exact,
    /// lima2001 4, and the field for its goal test.
    Hough(Box<Hough>, Box<Field>),
    /// minho2016 IV.
    ScanMap(Arc<ScanMap>, HeadingHistogramConfig),
    /// nubot2013 4, and the cycles of a frame that stands alone.
    MonteCarlo(Box<MonteCarlo>, usize),
}

/// A frame to be located.
#[derive(Debug, Clone, Copy)]
pub struct SearchInput<'a> {
    /// The field's distances.
    pub distances: &'a DistanceField,
    /// Line points, all finite.
    pub points: &'a [LinePoint],
    /// The compass.
    pub heading_prior: Option<HeadingPrior>,
    /// Goals seen by their colours.
    pub goals: &'a [GoalObservation],
    /// No odometry leads from here to a next frame: what can be found must be found now.
    pub single_image: bool,
}

impl GlobalSearch {
    /// Builds what the configured one needs.
    pub fn new(field: &Field, distances: &DistanceField, config: &GlobalSearchConfig) -> Self {
        GlobalSearch::with_scan_map(field, distances, config, None)
    }

    /// The same with a scan map that is there already.
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
                GlobalSearch::Hough(Box::new(hough), Box::new(field.clone()))
            }
            GlobalSearchMethod::ScanMap => {
                let build = || Arc::new(ScanMap::new(field, distances, config.scan_map.clone()));
                let map = scan_map.cloned().unwrap_or_else(build);
                GlobalSearch::ScanMap(map, config.heading_histogram.clone())
            }
            GlobalSearchMethod::MonteCarlo => {
                let config = config.monte_carlo.clone();
                let cycles = config.iterations_max;
                let filter = MonteCarlo::new(field, distances, config);
                GlobalSearch::MonteCarlo(Box::new(filter), cycles)
            }
        }
    }

    /// Does it carry something from frame to frame?
    pub fn is_in_progress(&self) -> bool {
        matches!(self, GlobalSearch::MonteCarlo(filter, _) if !filter.particles().is_empty())
    }

    /// Begins anew.
    pub fn reset(&mut self) {
        if let GlobalSearch::MonteCarlo(filter, _) = self {
            filter.reset();
        }
    }

    /// The robot moved (robot frame: metres, metres, radians).
    pub fn predict(&mut self, motion: [f32; 3]) {
        if let GlobalSearch::MonteCarlo(filter, _) = self {
            filter.predict(motion);
        }
    }

    /// The particles, of the one that has some.
    pub fn particles(&self) -> &[Pose] {
        match self {
            GlobalSearch::MonteCarlo(filter, _) => filter.particles(),
            _ => &[],
        }
    }

    /// Memory held, bytes; a scan map is the localizer's.
    pub fn memory_bytes(&self) -> usize {
        match self {
            GlobalSearch::Exact | GlobalSearch::ScanMap(..) => 0,
            GlobalSearch::Hough(hough, _) => hough.memory_bytes(),
            GlobalSearch::MonteCarlo(filter, _) => filter.memory_bytes(),
        }
    }

    /// Poses that explain the sight, most probable first.
    pub fn find_hypotheses(
        &mut self,
        search: &mut BranchAndBound,
        matcher: &mut Matcher,
        sight: &SearchInput,
    ) -> Vec<Hypothesis> {
        let SearchInput {
            distances,
            points,
            heading_prior: prior,
            goals,
            single_image: alone,
        } = *sight;
        let starts: Vec<Pose> = match self {
            GlobalSearch::Exact => {
                return search.find_hypotheses(distances, matcher, points, prior);
            }
            GlobalSearch::Hough(hough, field) => {
                let found = hough.find_poses(points, prior);
                let found: Vec<Pose> = found.into_iter().map(|(_, pose)| pose).collect();
                // The paper takes the first maximum that is confirmed; several are, and the points tell them apart.
                let settled = confirm_by_goal_colours(field, &found, goals);
                if settled.is_empty() { found } else { settled }
            }
            GlobalSearch::ScanMap(map, heading) => search_scan_map(map, heading, points, prior),
            GlobalSearch::MonteCarlo(filter, cycles) => {
                let cycles = if alone { *cycles } else { 1 };
                return search_monte_carlo(filter, cycles, search, matcher, sight);
            }
        };
        search.rank(distances, matcher, points, &starts, prior, START_ERROR)
    }
}

/// Cycles until the particles have gathered somewhere that explains the points; elsewhere they are scattered anew.
fn search_monte_carlo(
    filter: &mut MonteCarlo,
    cycles: usize,
    search: &mut BranchAndBound,
    matcher: &mut Matcher,
    sight: &SearchInput,
) -> Vec<Hypothesis> {
    for _ in 0..cycles {
        let Some(pose) = filter.update(sight.points, sight.heading_prior) else {
            continue;
        };
        let found = search.rank(
            sight.distances,
            matcher,
            sight.points,
            &[pose],
            sight.heading_prior,
            START_ERROR,
        );
        if found
            .first()
            .is_some_and(|best| best.inlier_share >= filter.config().inlier_share_min)
        {
            return found;
        }
        filter.reset();
    }
    Vec::new()
}

/// Under the compass's heading made exact by the histograms; without a compass under all four of the histograms'.
fn search_scan_map(
    map: &ScanMap,
    config: &HeadingHistogramConfig,
    points: &[LinePoint],
    prior: Option<HeadingPrior>,
) -> Vec<Pose> {
    let (last, quarters) = prior.map_or((0.0, 4), |prior| (prior.heading, 1));
    let wide = HeadingHistogramConfig {
        search_range_deg: if prior.is_some() {
            config.search_range_deg
        } else {
            45.0
        },
        ..config.clone()
    };
    let Some(heading) = histogram_heading(points, last, &wide) else {
        return Vec::new();
    };
    let mut found: Vec<(f32, Pose)> = (0..quarters)
        .flat_map(|quarter| {
            let heading = heading + quarter as f32 * std::f32::consts::FRAC_PI_2;
            map.find_poses(points, heading, SCAN_MAP_CANDIDATES, 0.4)
        })
        .collect();
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    found.into_iter().map(|(_, pose)| pose).collect()
}
