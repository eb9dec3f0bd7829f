//! Settings of the experiment with team-mates that correct a blind robot.

use crate::localizer::CooperativeConfig;

/// What the robots of a team do, and what is wrong with them.
#[derive(Debug, Clone, PartialEq)]
pub struct CooperativeExperiment {
    /// Team-mates within sight of the blind robot.
    pub mates: usize,
    /// Are they blind too? Their poses drift, and they say so.
    pub mates_blind: bool,
    /// How many of them believe to be elsewhere, with a small covariance.
    pub liars: usize,
    /// How far from their true place, metres.
    pub lie: f32,
    /// Opponents. The first two stay close to the blind robot, the others walk about.
    pub opponents: usize,
    /// Time for which the errors of the mates' poses and of tilts last, seconds.
    pub error_time: f32,
    /// Standard deviation of the mates' poses, metres, and radians.
    pub pose_std: [f32; 2],
    /// True over stated standard deviation of the mates' poses.
    pub pose_std_factor: f32,
    /// Delays of messages, seconds. Each mate has its own mean between these.
    pub delays: [f32; 2],
    /// Largest error of a mate's clock, seconds.
    pub clock_error: f32,
    /// Share of the messages that are lost.
    pub loss: f32,
    /// Images between two messages, at 30 images per second.
    pub images_per_message: usize,
    /// Speed up to which the blind robot drives, m/s.
    pub speed_max: f64,
    /// Does the blind robot see other robots?
    pub sees_robots: bool,
    /// Seconds without line points.
    pub blind: f64,
    /// Settings of the blind robot.
    pub config: CooperativeConfig,
}

impl Default for CooperativeExperiment {
    fn default() -> Self {
        CooperativeExperiment {
            mates: 2,
            mates_blind: false,
            liars: 0,
            lie: 0.5,
            opponents: 0,
            error_time: 2.0,
            pose_std: [0.03, 0.01],
            pose_std_factor: 1.0,
            delays: [0.01, 0.08],
            clock_error: 0.01,
            loss: 0.2,
            images_per_message: 2,
            speed_max: 3.0,
            sees_robots: true,
            blind: 10.0,
            config: CooperativeConfig {
                enabled: true,
                ..CooperativeConfig::default()
            },
        }
    }
}
