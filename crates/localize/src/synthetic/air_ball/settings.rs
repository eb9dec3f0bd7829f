//! Which ball, how many robots, and how good are their directions?

use serde::Serialize;

/// Images per second.
pub(super) const RATE: f64 = 30.0;
/// Height of the robots' mirrors, metres.
pub(super) const HEIGHT: f64 = 0.8;
/// What one robot is shown, or how the ball moves for several.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BallMotion {
    /// It lies, rolls, or is kicked along the ground.
    Ground,
    /// It is kicked into the air and bounces.
    Flight,
    /// It rests at a height of 0.3 to 1.5 m.
    Held,
    /// It lies, then a hand lifts it and carries it away at walking pace.
    Carried,
}

/// Settings of the experiment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AirExperiment {
    /// How the ball moves.
    pub motion: BallMotion,
    /// Number of robots that see it; 1 is the filter over time.
    pub robots: usize,
    /// The first robots of this number report wrong directions.
    pub faulty_robots: usize,
    /// Standard deviation of a ray, degrees.
    pub ray_std_deg: f32,
    /// Share of rays that point anywhere.
    pub outlier_share: f32,
    /// Speed of kicks, m/s.
    pub speed: f64,
    /// Does the ball's apparent size measure its distance?
    pub sized: bool,
    /// Time for which the errors of tilt and pose last, seconds.
    pub error_time: f64,
}

impl Default for AirExperiment {
    fn default() -> Self {
        AirExperiment {
            motion: BallMotion::Flight,
            robots: 1,
            faulty_robots: 0,
            ray_std_deg: 0.25,
            outlier_share: 0.01,
            speed: 6.0,
            sized: true,
            error_time: 0.5,
        }
    }
}
