//! How did the robots of the papers work? Every stage as that paper has it, by name.

use anyhow::{Context, Result};
use localize::config::LocalizeConfig;
use vision::config::VisionConfig;

use crate::config::PipelineConfig;

impl PipelineConfig {
    /// The settings of that name: `default`, or those of a paper (`localize::presets::PRESETS`).
    pub fn preset(name: &str) -> Result<Self> {
        let localize = LocalizeConfig::preset(name).with_context(|| {
            let names = localize::presets::PRESETS.join(", ");
            format!("unknown preset: {name:?} (expected one of {names})")
        })?;
        let mut vision = VisionConfig::default();
        let scan = &mut vision.scan;
        if name != "default" {
            // The papers read every line in every image.
            scan.interlaced_points_min = 0;
        }
        match name {
            // lima2001 4.4: 36 circles about the robot.
            "lima2001" => {
                (scan.radial_lines, scan.spirals_each_way, scan.circles) = (0, 0, 36);
                // The isometric part of the mirror, bases of walls included.
                scan.range_max = 6.0;
                vision.lines.detect_wall_bases = true;
                // Its ball was orange, and one of the goals yellow.
                vision.objects.ball_hue_deg = [8.0, 45.0];
            }
            // minho2016 III: 72 radial lines and 36 spirals each way.
            "minho2016" => (scan.radial_lines, scan.spirals_each_way, scan.circles) = (72, 36, 0),
            // nubot2013 4: 72 radial lines.
            "nubot2013" => (scan.radial_lines, scan.spirals_each_way, scan.circles) = (72, 0, 0),
            _ => {}
        }
        Ok(PipelineConfig {
            vision,
            localize,
            ..PipelineConfig::default()
        })
    }
}
