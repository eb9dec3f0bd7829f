//! How would each paper's robot find its place? Every stage as that paper has it, by name.

use crate::config::{LocalizeConfig, SuspectRule, Tracker};
use crate::filter::Fusion;
use crate::matching::Minimiser;
use crate::relocalise::RelocaliserKind;

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
                config.relocalise.by = RelocaliserKind::Hough;
                config.relocalise.hough.maxima = 30;
                config.tracker = Tracker::None;
                config.matching.lean_std_deg = 0.0;
            }
            "minho2016" => {
                // IV and V.B: scan map, local search about the last position, heading by histograms; a Kalman filter
                // each for vision and odometry, fused by a node.
                config.filter.fusion = Fusion::Decentralised;
                config.attitude.bend = false;
                config.relocalise.by = RelocaliserKind::ScanMap;
                config.tracker = Tracker::ScanMap;
                config.mode.rule = SuspectRule::Thresholds;
                config.matching.lean_std_deg = 0.0;
                config.filter.scale_std = 0.0;
                config.filter.noise_learning = 0.0;
            }
            "nubot2013" => {
                // 4: Monte Carlo until its particles have gathered, then matching by RPROP on e(t) with one c for all
                // points, fused with odometry by its curvature; five suspect cycles restart Monte Carlo.
                config.relocalise.by = RelocaliserKind::MonteCarlo;
                config.matching.minimiser = Minimiser::Rprop;
                config.matching.steps_max = 60;
                config.matching.point_std_min = 0.08;
                config.matching.lean_std_deg = 0.0;
                config.mode.rule = SuspectRule::Thresholds;
                config.filter.scale_std = 0.0;
                config.filter.noise_learning = 0.0;
            }
            _ => return None,
        }
        Some(config)
    }
}
