//! What is to be shown? An experiment read from TOML: its parts, what each runs, and what the paper says of it.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use localize::presets::PRESETS;
use localize::synthetic::team_ball::ROBOTS;
use serde::Deserialize;

/// An experiment file. Paths are relative to it.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Experiment {
    /// Heading of its page.
    pub title: String,
    /// The paper that it repeats.
    #[serde(default)]
    pub source: String,
    /// In what it differs from the paper's.
    #[serde(default)]
    pub differs: Vec<String>,
    /// Runs of each drive, with seeds that count up.
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
pub struct Part {
    /// Name of its files.
    pub name: String,
    /// Heading.
    pub title: String,
    /// What the paper says.
    #[serde(default)]
    pub paper: Vec<PaperReference>,
    /// What is run.
    pub run: PartRun,
}

/// A number of the paper.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PaperReference {
    /// Of which variant; of each if left out.
    pub variant: Option<String>,
    /// The figure's name, as `results.json` has it.
    pub figure: String,
    /// The value.
    pub value: f64,
    /// Its upper end, where the paper gives a range.
    pub until: Option<f64>,
    /// Where it stands: a section, table or figure.
    pub place: String,
}

/// What a part runs.
#[derive(Debug, Clone, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PartRun {
    /// Simulated drives, rendered images included.
    Drives(Drives),
    /// Single images on known spots, each located by itself.
    Stills(Stills),
    /// Single sights on random places, located on the whole field; no images.
    Searches(Searches),
    /// Time of each stage, one core.
    Times(Times),
    /// Error over all places for one sight, and over headings.
    Landscape(Landscape),
    /// What the eyes find of what is there, on recordings and simulated drives.
    Eyes(VisionRuns),
    /// Each way of fusing wheels, inertial unit and sights, on simulated drives without images.
    Fusion(FusionRuns),
    /// A ball far from everybody as each robot and the team know it, without images.
    Team(TeamRuns),
    /// The same rendered: a scenario with a squad.
    Squad(MultiRobotRuns),
}

/// What is looked at.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VisionRuns {
    /// Settings to compare.
    pub presets: Vec<String>,
    /// Recording folders with truth.csv.
    #[serde(default)]
    pub recordings: Vec<RecordingRun>,
    /// Scenarios; each is run with every seed.
    #[serde(default)]
    pub variants: Vec<Variant>,
}

/// A recording folder.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecordingRun {
    /// Its name in tables.
    pub name: String,
    /// Where it lies.
    pub folder: PathBuf,
}

/// Drives of `sim::fusion_experiment`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FusionRuns {
    /// The robot's file, which names the field.
    pub robot: PathBuf,
    /// What happens on the drives; all courses if left out.
    #[serde(default)]
    pub courses: Vec<String>,
    /// Who estimates; all estimators if left out.
    #[serde(default)]
    pub estimators: Vec<String>,
    /// Length of a drive, seconds.
    pub duration: f64,
}

/// Drawn drives of five robots around a ball.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TeamRuns {
    /// Circumstances to compare.
    pub variants: Vec<TeamVariant>,
}

/// What the network and the team do; what is left out is `localize::synthetic::team_ball::Trial`'s own.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TeamVariant {
    /// Its name in tables.
    pub name: String,
    /// Frames between two words of a robot, at 30 frames a second.
    pub frames_per_word: Option<usize>,
    /// Share of the words that are lost.
    pub loss: Option<f32>,
    /// Longest time that a word is under way, seconds.
    pub delay_max: Option<f32>,
    /// Robots that lie.
    pub liars: Option<usize>,
    /// Scored where the ball is farther than this from every honest robot, metres.
    pub beyond: Option<f32>,
    /// Seconds of each drive.
    pub seconds: Option<f32>,
}

/// Scenarios with a squad.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MultiRobotRuns {
    /// Settings to compare.
    pub presets: Vec<String>,
    /// Scenarios; each is run with every seed.
    pub variants: Vec<Variant>,
}

/// Each variant with each preset and seed.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Drives {
    /// Scenario of variants that name none.
    pub scenario: Option<PathBuf>,
    /// Settings to compare.
    pub presets: Vec<String>,
    /// Scenarios or changes to compare.
    pub variants: Vec<Variant>,
    /// Seconds at the start that are not scored: the first search of the field is another experiment.
    #[serde(default)]
    pub settle: f64,
}

/// A drive under other circumstances.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Variant {
    /// Its name in tables.
    pub name: String,
    /// Its scenario.
    pub scenario: Option<PathBuf>,
    /// Values in place of the scenario's, table by table.
    #[serde(default)]
    pub set: toml::Table,
    /// Values in place of the preset's (the keys of `--config`).
    #[serde(default)]
    pub config: toml::Table,
}

/// Images on spots.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stills {
    /// Field, robot, light.
    pub scenario: PathBuf,
    /// Settings to compare.
    pub presets: Vec<String>,
    /// Places, metres.
    pub spots: Vec<[f32; 2]>,
    /// Images at each, one heading each, degrees.
    pub headings_deg: Vec<f32>,
}

/// Sights on random places of a field.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Searches {
    /// The field.
    pub field: PathBuf,
    /// Settings to compare; each preset's relocaliser is asked.
    pub presets: Vec<String>,
    /// How many sights.
    pub count: usize,
    /// Noise of the compass, degrees; without one, a pose counts up to the half turn.
    pub compass_std_deg: Option<f32>,
}

/// Cycles of each stage.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Times {
    /// The field.
    pub field: PathBuf,
    /// How many cycles of each.
    pub cycles: usize,
    /// Which stages, by their names in the table.
    pub stages: Vec<super::times::Stage>,
}

/// One sight.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Landscape {
    /// The field.
    pub field: PathBuf,
    /// Where the robot stands: metres, metres, degrees.
    pub pose: [f32; 3],
    /// Between two places, metres.
    pub step: f32,
    /// c of the error function e = 1 − c²/(c² + d²), metres (minho2016 eq. 5).
    pub reach: f32,
}

impl Experiment {
    /// Reads an experiment; its paths come back relative to the working folder.
    pub fn load(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path)
            .with_context(|| format!("cannot read {}", path.display()))?;
        let mut experiment: Experiment =
            toml::from_str(&text).with_context(|| path.display().to_string())?;
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
            bail!("its name must do as a file's name");
        }
        let known = |presets: &[String]| match presets
            .iter()
            .find(|name| !PRESETS.contains(&name.as_str()))
        {
            Some(name) => bail!("there is no preset {name:?}"),
            None => Ok(()),
        };
        let found = |variants: &mut [Variant], common: Option<&PathBuf>| {
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
                known(&drives.presets)?;
                found(&mut drives.variants, drives.scenario.as_ref())?;
            }
            PartRun::Eyes(eyes) => {
                known(&eyes.presets)?;
                found(&mut eyes.variants, None)?;
                for one in &mut eyes.recordings {
                    one.folder = folder.join(&one.folder);
                }
            }
            PartRun::Squad(squad) => {
                known(&squad.presets)?;
                found(&mut squad.variants, None)?;
            }
            PartRun::Fusion(fusion) => {
                fusion.robot = folder.join(&fusion.robot);
                super::fusion::check(fusion)?;
            }
            PartRun::Team(team) => {
                if let Some(one) = team.variants.iter().find(|one| one.liars >= Some(ROBOTS)) {
                    bail!(
                        "variant {:?}: a team of {ROBOTS} needs an honest robot",
                        one.name
                    );
                }
            }
            PartRun::Stills(stills) => {
                known(&stills.presets)?;
                stills.scenario = folder.join(&stills.scenario);
            }
            PartRun::Searches(searches) => {
                known(&searches.presets)?;
                searches.field = folder.join(&searches.field);
            }
            PartRun::Times(times) => times.field = folder.join(&times.field),
            PartRun::Landscape(landscape) => landscape.field = folder.join(&landscape.field),
        }
        Ok(())
    }
}
