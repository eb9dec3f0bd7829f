//! Presets: the methods of each paper, stage by stage.

use crate::config::{LocalizeConfig, SuspectRule, Tracker};
use crate::filter::FilterKind;
use crate::global_search::GlobalSearchMethod;
use crate::matching::Minimiser;

/// Names of the presets, the default's first.
pub const PRESETS: [&str; 4] = ["default", "lima2001", "minho2016", "nubot2013"];

impl LocalizeConfig {
    /// The preset of that name; None if it is unknown.
    pub fn preset(name: &str) -> Option<Self> {
        let mut config = LocalizeConfig::default();
        match name {
            "default" => {}
            "lima2001" => {
                // 4.1 to 4.5: each image is located by itself, without odometry and filter. The number of maxima is that
                // of the field's eleven or thirteen lines with six detected ones.
                config.global_search.method = GlobalSearchMethod::Hough;
                config.global_search.hough.correlation_peaks_max = 30;
                config.tracker = Tracker::None;
                config.matching.tilt_std_deg = 0.0;
                config.map_correction.enabled = false;
            }
            "minho2016" => {
                // IV and V.B: scan map, local search around the last position, heading from histograms. One Kalman
                // filter each for vision and odometry, and their fusion.
                config.filter.kind = FilterKind::Decentralised;
                config.attitude.tilt_compensation = false;
                config.global_search.method = GlobalSearchMethod::ScanMap;
                config.tracker = Tracker::ScanMap;
                config.mode.suspect_rule = SuspectRule::Thresholds;
                config.matching.tilt_std_deg = 0.0;
                config.map_correction.enabled = false;
                config.filter.odometry_scale_std = 0.0;
                config.filter.noise_learning_std = 0.0;
                config.matching.spread_learning_std = 0.0;
            }
            "nubot2013" => {
                // 4: Monte Carlo localization until its particles converge, then matching by RPROP on e(t) with one c for
                // all points, fused with odometry by its curvature. Five suspect cycles restart Monte Carlo.
                config.global_search.method = GlobalSearchMethod::MonteCarlo;
                config.matching.minimiser = Minimiser::Rprop;
                config.matching.steps_max = 60;
                config.matching.map_std = 0.08;
                config.matching.tilt_std_deg = 0.0;
                config.map_correction.enabled = false;
                config.mode.suspect_rule = SuspectRule::Thresholds;
                config.matching.spread_learning_std = 0.0;
                config.filter.kind = FilterKind::Curvature;
                config.filter.odometry_scale_std = 0.0;
                config.filter.noise_learning_std = 0.0;
            }
            _ => return None,
        }
        Some(config)
    }
}
