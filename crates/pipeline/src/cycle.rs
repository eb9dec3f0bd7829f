//! The spine: a sample comes in, vision looks, localize says where. One cycle a frame, live, simulated or replayed.

use std::path::Path;
use std::time::Instant;

use anyhow::{Context, Result, anyhow};
use localize::config::{LocalizeConfig, SettingOutOfRange};
use localize::estimate::Estimate;
use localize::field::GoalColour;
use localize::localizer::Localizer;
use localize::sample::{Compass, GoalObservation, Imu, LinePoint, Odometry, VelocityCommand};
use localize::team::{TeamConfig, TeamModel, TeamReport, TeamView};
use localize::toml_location::key_location;
use localize::world::{WorldConfig, WorldModel, WorldView};
use localize::{Pose, Stamp};
use nalgebra::Matrix3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use vision::VisionError;
use vision::config::VisionConfig;
use vision::exposure::{AutoExposure, ExposureCommand, ExposureStatus};
use vision::objects::goals::GoalKind;
use vision::process::{Detections, Vision};

use crate::paths;
use crate::sample::{CameraImage, GroundTruth, ImageContent, Sample, SourceImage};
use crate::scan_map_cache::{self, CacheStatus};
use crate::setup::Setup;

/// One turn of the spine: what came in, what each stage found, what it refused and why, how long it took.
#[derive(Debug, Clone)]
pub struct Cycle {
    /// When the frame was exposed.
    pub stamp: Stamp,
    /// What arrived since the previous cycle.
    pub inputs: Inputs,
    /// What vision found in the image; none if line points came in place of one, or nothing readable.
    pub detections: Option<Detections>,
    /// The line points that localisation worked with.
    pub line_points: Vec<LinePoint>,
    /// Where the robot is, as far as it knows.
    pub estimate: Estimate,
    /// Ball and robots around it.
    pub world: WorldView,
    /// What team-mates say, and the ball they agree on.
    pub team: TeamView,
    /// How well the frame is exposed, and what to set the camera to; none where it was not looked at.
    pub exposure: Option<ExposureStatus>,
    /// Why the frame could not be used.
    pub fault: Option<String>,
    /// How long the stages took.
    pub timings: Timings,
}

/// What arrived between two cycles, the frame included.
#[derive(Debug, Clone, Default)]
pub struct Inputs {
    /// Wheel motion, in order.
    pub odometry: Vec<Odometry>,
    /// Headings, in order.
    pub compass: Vec<Compass>,
    /// Inertial readings, in order.
    pub imu: Vec<Imu>,
    /// What the motors were told, in order.
    pub commands: Vec<VelocityCommand>,
    /// Words of team-mates, in order.
    pub reports: Vec<TeamReport>,
    /// The latest truth; no stage sees it.
    pub truth: Option<GroundTruth>,
    /// The image, if there is one.
    pub image: Option<SourceImage>,
}

impl Cycle {
    /// What to set the camera to, if it should be changed.
    pub fn camera_command(&self) -> Option<ExposureCommand> {
        self.exposure?.command
    }
}

impl Inputs {
    /// What arrived, but the frame, in the order of its stamps; of one stamp, what was wanted and felt before what came
    /// of it, and what moved before where it points.
    ///
    /// A cycle is a function of its inputs alone, so the order in which threads delivered them must not matter.
    pub fn sorted_samples(&self) -> Vec<Sample> {
        let odometry = self
            .odometry
            .iter()
            .map(|one| (one.stamp, Sample::Odometry(*one)));
        let compass = self
            .compass
            .iter()
            .map(|one| (one.stamp, Sample::Compass(*one)));
        let imu = self.imu.iter().map(|one| (one.stamp, Sample::Imu(*one)));
        let commands = self
            .commands
            .iter()
            .map(|one| (one.stamp, Sample::Command(*one)));
        let reports = self
            .reports
            .iter()
            .map(|one| (one.stamp, Sample::TeamReport(one.clone())));
        let truth = self
            .truth
            .iter()
            .map(|one| (one.stamp, Sample::GroundTruth(one.clone())));
        let mut samples: Vec<(Stamp, Sample)> = commands
            .chain(imu)
            .chain(odometry)
            .chain(compass)
            .chain(reports)
            .chain(truth)
            .collect();
        samples.sort_by_key(|(stamp, _)| *stamp);
        samples.into_iter().map(|(_, sample)| sample).collect()
    }
}

/// Time taken by each stage; the one part of a cycle that differs from run to run.
#[derive(Debug, Clone, Copy, Default)]
pub struct Timings {
    /// Image to features, milliseconds.
    pub see_ms: f32,
    /// Features and motion to a pose, milliseconds.
    pub localize_ms: f32,
}

/// How the stages work; a preset or an overlay file changes single values.
#[derive(Debug, Clone, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct PipelineConfig {
    /// From an image to features.
    pub vision: VisionConfig,
    /// From features and motion to a pose.
    pub localize: LocalizeConfig,
    /// Following ball and robots.
    pub world: WorldConfig,
    /// Sharing among team-mates.
    pub team: TeamConfig,
}

/// The name under which a log keeps these settings.
pub const PIPELINE_FILE: &str = "spine.toml";

impl PipelineConfig {
    /// Every stage as that paper has it, or the default.
    pub fn preset(name: &str) -> Result<Self> {
        let localize =
            LocalizeConfig::preset(name).with_context(|| format!("there is no preset {name:?}"))?;
        let mut vision = VisionConfig::default();
        let scan = &mut vision.scan;
        match name {
            // lima2001 4.4: 36 circles about the robot.
            "lima2001" => {
                (scan.radial_lines, scan.spirals_each_way, scan.circles) = (0, 0, 36);
                // The isometric part, feet of walls included.
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

    /// A preset, with what an overlay file says instead.
    pub fn load(preset: &str, overlay: Option<&Path>) -> Result<Self> {
        let base = PipelineConfig::preset(preset)?;
        let Some(path) = overlay else {
            return Ok(base);
        };
        let text = std::fs::read_to_string(path)
            .with_context(|| format!("cannot read {}", path.display()))?;
        // Alone first: an unknown key or a wrong type is named with its line.
        toml::from_str::<PipelineConfig>(&text).with_context(|| path.display().to_string())?;
        apply_overlay(&base, toml::from_str(&text)?).map_err(|error| {
            anyhow!(
                "{}: {error:#}",
                key_location(path, &text, &invalid_key(&error))
            )
        })
    }
}

/// The key that a check refused; none of other errors.
fn invalid_key(error: &anyhow::Error) -> String {
    match (error.downcast_ref(), error.downcast_ref()) {
        (Some(VisionError::Config { key, .. }), _) => format!("vision.{key}"),
        (_, Some(SettingOutOfRange { key, .. })) => format!("localize.{key}"),
        _ => String::new(),
    }
}

/// Settings with what an overlay says instead, checked.
pub fn apply_overlay(base: &PipelineConfig, over: toml::Table) -> Result<PipelineConfig> {
    let mut merged = toml::Table::try_from(base)?;
    merge_tables(&mut merged, over);
    let config: PipelineConfig = merged.try_into()?;
    config.vision.check()?;
    config.localize.check()?;
    let around = config.world.check().and_then(|()| config.team.check());
    around.map_err(anyhow::Error::msg)?;
    Ok(config)
}

/// Puts every value of `over` in the place of `base`'s, table by table.
pub fn merge_tables(base: &mut toml::Table, over: toml::Table) {
    for (key, value) in over {
        match (base.get_mut(&key), value) {
            (Some(toml::Value::Table(base)), toml::Value::Table(over)) => merge_tables(base, over),
            (_, value) => drop(base.insert(key, value)),
        }
    }
}

/// The stages in their order, with what they remember from frame to frame.
pub struct Pipeline {
    vision: Option<Vision>,
    exposure: Option<AutoExposure>,
    localizer: Localizer,
    world: WorldModel,
    team: TeamModel,
    inputs: Inputs,
    last_image: Option<Stamp>,
    /// What the last frame said of the place.
    last_pose: Option<StampedPose>,
}

/// A pose to go on from.
#[derive(Clone, Copy)]
struct StampedPose {
    stamp: Stamp,
    pose: Pose,
    covariance: Matrix3<f32>,
}

/// After a gap of this many seconds between frames the light may be quite another; its colours are learned anew.
const COLOUR_MODEL_MAX_GAP: f64 = 1.0;

impl Pipeline {
    /// Builds every table that the stages need.
    pub fn new(setup: &Setup, config: &PipelineConfig) -> Result<Self> {
        let PipelineConfig {
            mut vision,
            mut localize,
            world,
            team,
        } = config.clone();
        // A profile knows better than a setting how high the mirror hangs.
        if let Some(height) = setup.viewpoint_height {
            vision.objects.viewpoint_height = height;
            localize.matching.viewpoint_height = height;
        }
        let compass = setup.robot.compass.as_ref();
        if let Some(calibration) = compass.and_then(|compass| compass.calibration) {
            localize.compass.calibration = Some(calibration);
        }
        let mut exposure = None;
        let mut eyes = match &setup.camera {
            Some((camera, map)) => {
                let line_width = setup.field.config.line_width;
                let mask = setup.mask.as_deref();
                let (control, config) = (setup.robot.exposure, &vision.exposure);
                exposure = Some(AutoExposure::new(map, camera, mask, control, config)?);
                Some(Vision::with_mask(map, camera, mask, line_width, vision)?)
            }
            None => None,
        };
        if let (Some(eyes), Some(colours)) = (&mut eyes, &setup.colours) {
            eyes.set_colour_table(colours.clone());
        }
        Ok(Pipeline {
            vision: eyes,
            world: WorldModel::new(world, localize.matching.viewpoint_height),
            team: TeamModel::new(team),
            exposure,
            localizer: build_localizer(setup, localize),
            inputs: Inputs::default(),
            last_image: None,
            last_pose: None,
        })
    }

    /// Different pixels that the scan lines read, and their share of the image (minho2016: 63,378, 27.5 %).
    pub fn scan_coverage(&self) -> Option<(usize, f32)> {
        let pattern = self.vision.as_ref()?.scan_pattern();
        Some((pattern.pixel_count, pattern.coverage))
    }

    /// Takes over where another spine stood, so that settings can change while it drives: its pose, and what it had
    /// taken since its last frame.
    pub fn warm_start_from(&mut self, other: &Pipeline) {
        self.inputs = other.inputs.clone();
        self.last_pose = other.last_pose;
        if let Some(known) = self.last_pose {
            self.localizer
                .set_pose(known.stamp, known.pose, &known.covariance);
        }
    }

    /// Particles of the relocaliser, if it has some.
    pub fn particles(&self) -> &[Pose] {
        self.localizer.particles()
    }

    /// Takes a sample; a frame ends a cycle.
    pub fn process_sample(&mut self, sample: Sample) -> Option<Cycle> {
        match sample {
            Sample::Odometry(odometry) => self.inputs.odometry.push(odometry),
            Sample::Compass(compass) => self.inputs.compass.push(compass),
            Sample::Imu(imu) => self.inputs.imu.push(imu),
            Sample::Command(command) => self.inputs.commands.push(command),
            Sample::TeamReport(report) => self.inputs.reports.push(report),
            Sample::GroundTruth(truth) => self.inputs.truth = Some(truth),
            Sample::Image(frame) => return Some(self.process_frame(frame)),
        }
        None
    }

    fn process_frame(&mut self, frame: CameraImage) -> Cycle {
        let stamp = frame.stamp;
        let started = Instant::now();
        let mut inputs = std::mem::take(&mut self.inputs);
        let mut goals = Vec::new();
        let mut exposure = None;
        let (seen, points, fault) = match frame.content {
            ImageContent::Pixels(image) => {
                let control = self.exposure.as_mut();
                exposure = control.and_then(|control| control.process(&image.view()));
                let jumped = exposure.is_some_and(|reading| reading.light_jumped);
                let looked = self.run_vision(stamp, &image, jumped);
                inputs.image = Some(image);
                match looked {
                    Ok(seen) => {
                        let points = seen.line_points.iter().map(|seen| seen.point).collect();
                        goals = goal_observations(&seen);
                        (Some(seen), points, None)
                    }
                    Err(error) => (None, Vec::new(), Some(error)),
                }
            }
            ImageContent::Features {
                points,
                goals: found,
            } => {
                goals = found;
                (None, points, None)
            }
            ImageContent::Detections(seen) => {
                let points = seen.line_points.iter().map(|seen| seen.point).collect();
                goals = goal_observations(&seen);
                (Some(*seen), points, None)
            }
            ImageContent::Unreadable(reason) => (None, Vec::new(), Some(reason)),
        };
        let see_ms = elapsed_ms(started);
        let started = Instant::now();
        for sample in inputs.sorted_samples() {
            match sample {
                Sample::Odometry(odometry) => {
                    self.localizer.add_odometry(&odometry);
                    self.world.add_odometry(&odometry);
                }
                Sample::Compass(compass) => self.localizer.add_compass(&compass),
                Sample::TeamReport(report) => self.team.receive(&report),
                Sample::Imu(imu) => self.localizer.add_imu(&imu),
                Sample::Command(command) => self.localizer.add_command(&command),
                Sample::GroundTruth(_) | Sample::Image(_) => {}
            }
        }
        self.localizer.add_goals(stamp, &goals);
        let estimate = self.localizer.process_points(stamp, &points);
        let sight = seen.as_ref().map(crate::observations::object_observations);
        let world = self.world.update(stamp, sight.as_ref(), &estimate);
        let team = self.team.update(stamp, &world, &estimate);
        // For the next frame: this one's estimate is told already.
        self.localizer.add_half_log_odds(team.half_log_odds);
        self.last_pose = estimate.pose.map(|pose| StampedPose {
            stamp,
            pose,
            covariance: estimate.covariance,
        });
        let timings = Timings {
            see_ms,
            localize_ms: elapsed_ms(started),
        };
        Cycle {
            stamp,
            inputs,
            detections: seen,
            line_points: points,
            estimate,
            world,
            team,
            exposure,
            fault,
            timings,
        }
    }

    /// `light_jumped`: this frame was taken with quite another exposure than the one before.
    fn run_vision(
        &mut self,
        stamp: Stamp,
        image: &SourceImage,
        light_jumped: bool,
    ) -> Result<Detections, String> {
        let Some(eyes) = &mut self.vision else {
            return Err("an image, but robot.toml has no [camera]".to_owned());
        };
        let last = self.last_image.replace(stamp);
        if light_jumped || last.is_some_and(|last| stamp - last > COLOUR_MODEL_MAX_GAP) {
            eyes.reset_colour_model();
        }
        eyes.process(&image.view())
            .map_err(|error| error.to_string())
    }
}

/// A localizer on the setup's field, its scan map from the cache if it needs one.
fn build_localizer(setup: &Setup, config: LocalizeConfig) -> Localizer {
    let Some(folder) = paths::cache_folder() else {
        return Localizer::new(&setup.field, config);
    };
    let (localizer, origin) = scan_map_cache::build_localizer(&setup.field, config, &folder);
    let megabytes = localizer.memory_bytes() as f64 / 1e6;
    let folder = folder.display();
    match origin {
        None | Some(CacheStatus::Loaded) => {}
        Some(CacheStatus::Built) => {
            eprintln!(
                "built the field's scan map and kept it in {folder} ({megabytes:.0} MB of tables in all)"
            );
        }
        Some(CacheStatus::Rebuilt) => {
            eprintln!(
                "the field's scan map in {folder} is damaged or of another version: built it anew"
            );
        }
        Some(CacheStatus::NotStored(reason)) => {
            eprintln!("built the field's scan map, but it is not kept: {reason}");
        }
    }
    localizer
}

/// The goals that tell the halves of the field apart, as localisation wants them.
pub fn goal_observations(seen: &Detections) -> Vec<GoalObservation> {
    seen.goals
        .iter()
        .filter_map(|goal| {
            let colour = match goal.kind {
                GoalKind::Blue => GoalColour::Blue,
                GoalKind::Yellow => GoalColour::Yellow,
                GoalKind::Post => return None,
            };
            let [var_xx, _, var_yy] = goal.covariance;
            Some(GoalObservation {
                colour,
                at: goal.at,
                std: (var_xx + var_yy).sqrt(),
                width: goal.width,
            })
        })
        .collect()
}

fn elapsed_ms(since: Instant) -> f32 {
    since.elapsed().as_secs_f32() * 1e3
}
