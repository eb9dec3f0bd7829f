//! How would each paper's robot find its place? Every stage as that paper has it, by name.

use crate::config::{LocalizeConfig, SuspectRule, Tracker};
use crate::filter::FilterKind;
use crate::global_search::GlobalSearchMethod;
use crate::matching::Minimiser;

/// Names of the presets, the default's first.
pub const PRESETS: [&str; 4] = ["default", "lima2001", "minho2016", "nubot2013"];

impl LocalizeConfig {
    /// The configuration of that name; none if there is none.
    pub fn preset(name: &str) -> Option<Self> {
        let mut config = LocalizeConfig::default();
        match name {
            "default" => {}
            "lima2001" => {
                // 4.1 to 4.5: every image is located by itself; no odometry, no filter. Maximum after maximum of the
                // correlation, as many as the field's eleven or thirteen lines and six seen ones give.
                config.global_search.method = GlobalSearchMethod::Hough;
                config.global_search.hough.correlation_peaks_max = 30;
                config.tracker = Tracker::None;
                config.matching.tilt_std_deg = 0.0;
            }
            "minho2016" => {
                // IV and V.B: scan map, local search about the last position, heading by histograms; a Kalman filter
                // each for vision and odometry, fused by a node.
                config.filter.kind = FilterKind::Decentralised;
                config.attitude.tilt_compensation = false;
                config.global_search.method = GlobalSearchMethod::ScanMap;
                config.tracker = Tracker::ScanMap;
                config.mode.suspect_rule = SuspectRule::Thresholds;
                config.matching.tilt_std_deg = 0.0;
                config.filter.odometry_scale_std = 0.0;
                config.filter.noise_adaptation_rate = 0.0;
            }
            "nubot2013" => {
                // 4: Monte Carlo until its particles have gathered, then matching by RPROP on e(t) with one c for all
                // points, fused with odometry by its curvature; five suspect cycles restart Monte Carlo.
                config.global_search.method = GlobalSearchMethod::MonteCarlo;
                config.matching.minimiser = Minimiser::Rprop;
                config.matching.steps_max = 60;
                config.matching.map_std = 0.08;
                config.matching.tilt_std_deg = 0.0;
                config.mode.suspect_rule = SuspectRule::Thresholds;
                config.filter.odometry_scale_std = 0.0;
                config.filter.noise_adaptation_rate = 0.0;
            }
            _ => return None,
        }
        Some(config)
    }
}
