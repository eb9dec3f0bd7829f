//! What does an experiment run? An experiment file (TOML): its parts, what each runs, and the paper's values.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use localize::presets::PRESETS;
use localize::synthetic::team_ball::ROBOTS;
use localize::toml_file;
use serde::Deserialize;
use sim::fusion_experiment::{Disturbance, Estimator};

use super::air::{AirRuns, AirVariant};
use super::certainty::{CertaintyRuns, CertificateRuns};
use super::cooperative::{CooperativeRuns, CooperativeVariant};
use super::mapping::MappingRuns;
use super::metric::PaperReference;
use super::rendered_mates::RenderedMatesRuns;

/// An experiment file. Paths are relative to it.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Experiment {
    /// Heading of its page.
    pub title: String,
    /// The paper that it reproduces.
    #[serde(default)]
    pub source: String,
    /// Differences from the paper's experiment.
    #[serde(default)]
    pub differs: Vec<String>,
    /// Runs of each drive, with consecutive seeds.
    #[serde(default = "default_seeds")]
    pub seeds: u64,
    /// Its parts, in the page's order.
    pub parts: Vec<Part>,
}

fn default_seeds() -> u64 {
    5
}

/// One table and drawing of the page.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Part {
    /// Name of its files.
    pub name: String,
    /// Heading.
    pub title: String,
    /// The paper's values.
    #[serde(default)]
    pub paper: Vec<PaperReference>,
    /// What is run.
    pub run: PartRun,
}

/// What a part runs.
#[derive(Debug, Clone, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum PartRun {
    /// Simulated drives, rendered images included.
    Drives(Drives),
    /// Single images at known poses, each located without history.
    Stills(Stills),
    /// Synthetic line points at random poses, located on the whole field; no images.
    Searches(Searches),
    /// Time of each stage on one core.
    Times(Times),
    /// Matching error over all positions, and histogram peaks over headings, for one set of line points.
    Landscape(Landscape),
    /// Detection rates of vision, on recordings and simulated drives.
    #[serde(rename = "eyes")]
    Vision(VisionRuns),
    /// Fusion of wheels, IMU and vision by each estimator, on simulated drives without images.
    Fusion(FusionRuns),
    /// Error of a distant ball for each robot and for the team, without images.
    Team(TeamRuns),
    /// The same with rendered images: a scenario with several robots of ours.
    #[serde(rename = "squad")]
    MultiRobot(MultiRobotRuns),
    /// A ball in the air, for one robot and for several, without images.
    Air(AirRuns),
    /// Bounds of the exact search on what other poses explain, without images.
    Certificates(CertificateRuns),
    /// Time until a robot at an ambiguous place knows its pose, by how it moves, without images.
    Certainty(CertaintyRuns),
    /// Fields mapped from drives, without images.
    Mapping(MappingRuns),
    /// A robot without line points among team-mates that see it, without images.
    Cooperative(CooperativeRuns),
    /// The same with rendered images: the mirror of the first robot is covered.
    RenderedMates(RenderedMatesRuns),
}

/// Images for the detection rates.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct VisionRuns {
    /// Settings to compare.
    pub presets: Vec<String>,
    /// Recording folders with truth.csv.
    #[serde(default)]
    pub recordings: Vec<RecordingEntry>,
    /// Scenarios; each is run with every seed.
    #[serde(default)]
    pub variants: Vec<ScenarioVariant>,
}

/// A recording folder.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RecordingEntry {
    /// Its name in tables.
    pub name: String,
    /// Its path.
    pub folder: PathBuf,
}

/// Drives of `sim::fusion_experiment`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct FusionRuns {
    /// The robot's file, which names the field.
    pub robot: PathBuf,
    /// Disturbances of the drives; all courses if left out.
    #[serde(default)]
    pub courses: Vec<Disturbance>,
    /// Estimators to compare; all if left out.
    #[serde(default)]
    pub estimators: Vec<Estimator>,
    /// Length of a drive, seconds.
    pub duration: f64,
}

/// Synthetic drives of five robots around a ball.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct TeamRuns {
    /// Circumstances to compare.
    pub variants: Vec<TeamVariant>,
}

/// Properties of network and team. Missing values are those of `localize::synthetic::team_ball::TeamExperiment`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct TeamVariant {
    /// Its name in tables.
    pub name: String,
    /// Images between two team messages of a robot, at 30 images per second.
    pub frames_per_message: Option<usize>,
    /// Share of lost messages.
    pub loss: Option<f32>,
    /// Longest transmission time of a message, seconds.
    pub delay_max: Option<f32>,
    /// Robots that send wrong reports.
    pub liars: Option<usize>,
    /// Only cycles count in which the ball is farther than this from every honest robot, metres.
    pub beyond: Option<f32>,
    /// Length of each drive, seconds.
    pub seconds: Option<f32>,
}

/// Scenarios with several robots of ours.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct MultiRobotRuns {
    /// Settings to compare.
    pub presets: Vec<String>,
    /// Scenarios; each is run with every seed.
    pub variants: Vec<ScenarioVariant>,
}

/// Each variant with each preset and seed.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Drives {
    /// Scenario of the variants that name none.
    pub scenario: Option<PathBuf>,
    /// Settings to compare.
    pub presets: Vec<String>,
    /// Scenarios or changes to compare.
    pub variants: Vec<ScenarioVariant>,
    /// Seconds at the start that are not scored: the first global search is another experiment.
    #[serde(default)]
    pub settle: f64,
}

/// A scenario with changed values.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ScenarioVariant {
    /// Its name in tables.
    pub name: String,
    /// Its scenario.
    pub scenario: Option<PathBuf>,
    /// Values that override the scenario's.
    #[serde(default)]
    pub set: toml::Table,
    /// Values that override the preset's (the keys of `--config`).
    #[serde(default)]
    pub config: toml::Table,
}

/// Images at given positions.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Stills {
    /// Field, robot, light.
    pub scenario: PathBuf,
    /// Settings to compare.
    pub presets: Vec<String>,
    /// Positions on the field, metres.
    pub spots: Vec<[f32; 2]>,
    /// Headings at each position, one image each, degrees.
    pub headings_deg: Vec<f32>,
}

/// Line points at random poses of a field.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Searches {
    /// The field.
    pub field: PathBuf,
    /// Settings to compare; each preset's global search runs.
    pub presets: Vec<String>,
    /// Number of poses.
    pub count: usize,
    /// Noise of the compass, degrees. Without a compass the pose rotated by 180° counts as correct too.
    pub compass_std_deg: Option<f32>,
}

/// Cycles of each stage.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Times {
    /// The field.
    pub field: PathBuf,
    /// Cycles of each stage.
    pub cycles: usize,
    /// The stages.
    pub stages: Vec<Stage>,
}

/// A stage to measure.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Stage {
    /// Segmentation and line points of a 480 × 480 image, with the scan pattern of minho2016.
    LinePoints,
    /// One cycle of Monte Carlo localization, 600 particles, pose unknown.
    MonteCarlo,
    /// Matching by RPROP as in the paper.
    MatchingRprop,
    /// Matching by the default minimiser.
    Matching,
    /// Scan map over every cell of the field.
    ScanMapGlobal,
    /// Scan map over 4 m² around the last position.
    ScanMapLocal,
    /// Hough transform, pairs, correlation.
    Hough,
    /// Branch and bound without a prior.
    Exact,
}

/// One set of line points.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Landscape {
    /// The field.
    pub field: PathBuf,
    /// Pose of the robot: metres, metres, degrees.
    pub pose: [f32; 3],
    /// Grid step, metres.
    pub step: f32,
    /// c of the error function e = 1 − c²/(c² + d²), metres (minho2016 eq. 5).
    pub reach: f32,
}

impl Experiment {
    /// Reads an experiment and makes its paths relative to the working folder.
    pub(crate) fn load(path: &Path) -> Result<Self> {
        let (mut experiment, _): (Experiment, _) = toml_file::read(path)?;
        let folder = path.parent().unwrap_or(Path::new(""));
        for part in &mut experiment.parts {
            part.resolve_paths(folder)
                .with_context(|| format!("{}: part {:?}", path.display(), part.name))?;
        }
        Ok(experiment)
    }
}

impl Part {
    fn resolve_paths(&mut self, folder: &Path) -> Result<()> {
        if self.name.is_empty() || self.name.contains(['/', '\\', '.']) {
            bail!(
                "invalid name: {:?} (must not be empty or contain /, \\ or a dot)",
                self.name
            );
        }
        let check_presets = |presets: &[String]| match presets
            .iter()
            .find(|name| !PRESETS.contains(&name.as_str()))
        {
            Some(name) => bail!(
                "unknown preset: {name:?} (expected one of {})",
                PRESETS.join(", ")
            ),
            None => Ok(()),
        };
        let resolve_scenarios = |variants: &mut [ScenarioVariant], common: Option<&PathBuf>| {
            for variant in variants {
                let Some(scenario) = variant.scenario.as_ref().or(common) else {
                    bail!("variant {:?} names no scenario", variant.name);
                };
                variant.scenario = Some(folder.join(scenario));
            }
            Ok(())
        };
        match &mut self.run {
            PartRun::Drives(drives) => {
                check_presets(&drives.presets)?;
                resolve_scenarios(&mut drives.variants, drives.scenario.as_ref())?;
            }
            PartRun::Vision(vision) => {
                check_presets(&vision.presets)?;
                resolve_scenarios(&mut vision.variants, None)?;
                for recording in &mut vision.recordings {
                    recording.folder = folder.join(&recording.folder);
                }
            }
            PartRun::MultiRobot(robots) => {
                check_presets(&robots.presets)?;
                resolve_scenarios(&mut robots.variants, None)?;
            }
            PartRun::RenderedMates(runs) => {
                for variant in &mut runs.variants {
                    variant.scenario = folder.join(&variant.scenario);
                }
            }
            PartRun::Certificates(runs) => runs.field = folder.join(&runs.field),
            PartRun::Certainty(runs) => runs.field = folder.join(&runs.field),
            PartRun::Mapping(runs) => {
                for variant in &mut runs.variants {
                    variant.field = folder.join(&variant.field);
                }
            }
            PartRun::Fusion(fusion) => fusion.robot = folder.join(&fusion.robot),
            PartRun::Team(team) => {
                let honest_missing = |variant: &&TeamVariant| variant.liars >= Some(ROBOTS);
                if let Some(variant) = team.variants.iter().find(honest_missing) {
                    bail!(
                        "variant {:?}: too many liars: {} (expected fewer than {ROBOTS})",
                        variant.name,
                        variant.liars.unwrap_or_default()
                    );
                }
            }
            PartRun::Cooperative(runs) => {
                let honest_missing = |variant: &&CooperativeVariant| {
                    variant.liars > Some(variant.mates.unwrap_or(2))
                };
                if let Some(variant) = runs.variants.iter().find(honest_missing) {
                    bail!("variant {:?}: more liars than mates", variant.name);
                }
                runs.field = folder.join(&runs.field);
            }
            PartRun::Air(air) => {
                let honest_missing = |variant: &&AirVariant| variant.liars >= variant.robots;
                if let Some(variant) = air.variants.iter().find(honest_missing) {
                    bail!(
                        "variant {:?}: too many liars: {} (expected fewer than robots = {})",
                        variant.name,
                        variant.liars,
                        variant.robots
                    );
                }
            }
            PartRun::Stills(stills) => {
                check_presets(&stills.presets)?;
                stills.scenario = folder.join(&stills.scenario);
            }
            PartRun::Searches(searches) => {
                check_presets(&searches.presets)?;
                searches.field = folder.join(&searches.field);
            }
            PartRun::Times(times) => times.field = folder.join(&times.field),
            PartRun::Landscape(landscape) => landscape.field = folder.join(&landscape.field),
        }
        Ok(())
    }
}
