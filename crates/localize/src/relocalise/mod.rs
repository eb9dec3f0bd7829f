//! Where on the field, from nothing? The three papers' ways and our own behind one door, chosen by configuration.
//!
//! Each returns poses; these are then matched to the end, told apart and ranked by likelihood alike.

pub mod hough;
pub mod monte_carlo;
pub mod scan_map;

use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::distance::DistanceField;
use crate::field::Field;
use crate::frame::Pose;
use crate::heading::{HeadingConfig, heading_by_histogram};
use crate::matching::Matcher;
use crate::sample::{GoalSight, LinePoint};
use crate::search::{HeadingPrior, Hypothesis, Search};

use hough::{Hough, HoughConfig, settle};
use monte_carlo::{MonteCarlo, MonteCarloConfig};
use scan_map::{ScanMap, ScanMapConfig};

/// Who looks for the pose on the whole field.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RelocaliserKind {
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
pub struct RelocaliseConfig {
    /// Which one.
    pub by: RelocaliserKind,
    /// Settings of `hough`.
    pub hough: HoughConfig,
    /// Settings of `scan_map`.
    pub scan_map: ScanMapConfig,
    /// Settings of `monte_carlo`.
    pub monte_carlo: MonteCarloConfig,
    /// Heading by histograms, where a relocaliser needs one and no compass gives it.
    pub heading: HeadingConfig,
}

/// Cells of the scan map that are matched to the end, per heading.
const CELLS: usize = 6;

/// How far off their cells and particles may be, metres: the matcher's first reach.
const OFF: f32 = 0.4;

/// One of the four.
#[derive(Debug, Clone)]
pub enum Relocaliser {
    /// Uses the search that the localizer has anyway.
    Exact,
    /// lima2001 4, and the field for its goal test.
    Hough(Box<Hough>, Box<Field>),
    /// minho2016 IV.
    ScanMap(Arc<ScanMap>, HeadingConfig),
    /// nubot2013 4, and the cycles of a frame that stands alone.
    MonteCarlo(Box<MonteCarlo>, usize),
}

/// A frame to be located.
#[derive(Debug, Clone, Copy)]
pub struct Sight<'a> {
    /// The field's distances.
    pub distances: &'a DistanceField,
    /// Line points, all finite.
    pub points: &'a [LinePoint],
    /// The compass.
    pub prior: Option<HeadingPrior>,
    /// Goals seen by their colours.
    pub goals: &'a [GoalSight],
    /// No odometry leads from here to a next frame: what can be found must be found now.
    pub alone: bool,
}

impl Relocaliser {
    /// Builds what the configured one needs.
    pub fn new(field: &Field, distances: &DistanceField, config: &RelocaliseConfig) -> Self {
        Relocaliser::with_map(field, distances, config, None)
    }

    /// The same with a scan map that is there already.
    pub(crate) fn with_map(
        field: &Field,
        distances: &DistanceField,
        config: &RelocaliseConfig,
        scan_map: Option<&Arc<ScanMap>>,
    ) -> Self {
        match config.by {
            RelocaliserKind::Exact => Relocaliser::Exact,
            RelocaliserKind::Hough => {
                let hough = Hough::new(field, config.hough.clone());
                Relocaliser::Hough(Box::new(hough), Box::new(field.clone()))
            }
            RelocaliserKind::ScanMap => {
                let build = || Arc::new(ScanMap::new(field, distances, config.scan_map.clone()));
                let map = scan_map.cloned().unwrap_or_else(build);
                Relocaliser::ScanMap(map, config.heading.clone())
            }
            RelocaliserKind::MonteCarlo => {
                let config = config.monte_carlo.clone();
                let cycles = config.cycles_max;
                let filter = MonteCarlo::new(field, distances, config);
                Relocaliser::MonteCarlo(Box::new(filter), cycles)
            }
        }
    }

    /// Does it carry something from frame to frame?
    pub fn active(&self) -> bool {
        matches!(self, Relocaliser::MonteCarlo(filter, _) if !filter.particles().is_empty())
    }

    /// Begins anew.
    pub fn restart(&mut self) {
        if let Relocaliser::MonteCarlo(filter, _) = self {
            filter.restart();
        }
    }

    /// The robot moved (robot frame: metres, metres, radians).
    pub fn moved(&mut self, motion: [f32; 3]) {
        if let Relocaliser::MonteCarlo(filter, _) = self {
            filter.moved(motion);
        }
    }

    /// The particles, of the one that has some.
    pub fn particles(&self) -> &[Pose] {
        match self {
            Relocaliser::MonteCarlo(filter, _) => filter.particles(),
            _ => &[],
        }
    }

    /// Memory held, bytes; a scan map is the localizer's.
    pub fn bytes(&self) -> usize {
        match self {
            Relocaliser::Exact | Relocaliser::ScanMap(..) => 0,
            Relocaliser::Hough(hough, _) => hough.bytes(),
            Relocaliser::MonteCarlo(filter, _) => filter.bytes(),
        }
    }

    /// Poses that explain the sight, most probable first.
    pub fn find(
        &mut self,
        search: &mut Search,
        matcher: &mut Matcher,
        sight: &Sight,
    ) -> Vec<Hypothesis> {
        let Sight {
            distances,
            points,
            prior,
            goals,
            alone,
        } = *sight;
        let starts: Vec<Pose> = match self {
            Relocaliser::Exact => return search.find(distances, matcher, points, prior),
            Relocaliser::Hough(hough, field) => {
                let found = hough.find(points, prior);
                let found: Vec<Pose> = found.into_iter().map(|(_, pose)| pose).collect();
                // The paper takes the first maximum that is confirmed; several are, and the points tell them apart.
                let settled = settle(field, &found, goals);
                if settled.is_empty() { found } else { settled }
            }
            Relocaliser::ScanMap(map, heading) => by_scan_map(map, heading, points, prior),
            Relocaliser::MonteCarlo(filter, cycles) => {
                let cycles = if alone { *cycles } else { 1 };
                return by_particles(filter, cycles, search, matcher, sight);
            }
        };
        search.rank(distances, matcher, points, &starts, prior, OFF)
    }
}

/// Cycles until the particles have gathered somewhere that explains the points; elsewhere they are scattered anew.
fn by_particles(
    filter: &mut MonteCarlo,
    cycles: usize,
    search: &mut Search,
    matcher: &mut Matcher,
    sight: &Sight,
) -> Vec<Hypothesis> {
    for _ in 0..cycles {
        let Some(pose) = filter.cycle(sight.points, sight.prior) else {
            continue;
        };
        let found = search.rank(
            sight.distances,
            matcher,
            sight.points,
            &[pose],
            sight.prior,
            OFF,
        );
        if found
            .first()
            .is_some_and(|best| best.inlier_share >= filter.config().accepted_share)
        {
            return found;
        }
        filter.restart();
    }
    Vec::new()
}

/// Under the compass's heading made exact by the histograms; without a compass under all four of the histograms'.
fn by_scan_map(
    map: &ScanMap,
    config: &HeadingConfig,
    points: &[LinePoint],
    prior: Option<HeadingPrior>,
) -> Vec<Pose> {
    let (last, quarters) = prior.map_or((0.0, 4), |prior| (prior.heading, 1));
    let wide = HeadingConfig {
        turn_max_deg: if prior.is_some() {
            config.turn_max_deg
        } else {
            45.0
        },
        ..config.clone()
    };
    let Some(heading) = heading_by_histogram(points, last, &wide) else {
        return Vec::new();
    };
    let mut found: Vec<(f32, Pose)> = (0..quarters)
        .flat_map(|quarter| {
            let heading = heading + quarter as f32 * std::f32::consts::FRAC_PI_2;
            map.find(points, heading, CELLS, 0.4)
        })
        .collect();
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    found.into_iter().map(|(_, pose)| pose).collect()
}
