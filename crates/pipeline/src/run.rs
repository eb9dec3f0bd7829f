//! One run from its first sample to its summary: a scenario or a recording folder. Commands and the Python package call
//! these functions, so that both give the same bits.

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use localize::input_file::{self, TEXT_BYTES_MAX};
use serde::Serialize;
use sim::scenario::Scenario;
use vision::config::ObjectDetectionConfig;

use crate::config::PipelineConfig;
use crate::corrected_map;
use crate::cycle::Cycle;
use crate::doubted_poses::DoubtedPoses;
use crate::image_faults::ImageFaults;
use crate::log::{LogConfig, LogStats, Recorder, start_log};
use crate::misplaced_images::MisplacedImages;
use crate::multi_robot::{self, MultiRobotSimulation, RobotSummary};
use crate::pipeline::Pipeline;
use crate::pose_leaps::PoseLeaps;
use crate::recording::Recording;
use crate::score;
use crate::score::detections::{DetectionStatistics, DetectionSummary, GroundTruthScene};
use crate::score::object_labels::{LabelSummary, ObjectLabels};
use crate::score::summary::{RunStatistics, Summary};
use crate::setup::Setup;
use crate::setup_check::{self, Effort, FitFigures, KeyframeCollector, SetupReport};
use crate::simulation::{Simulation, load_scenario_with_overrides};

/// Which scenario to run, and how.
pub struct ScenarioOptions {
    /// The scenario file.
    pub scenario: PathBuf,
    /// Values in place of the scenario's.
    pub changes: toml::Table,
    /// In place of the scenario's seed.
    pub seed: Option<u64>,
    /// In place of the scenario's duration, seconds.
    pub duration: Option<f64>,
    /// Settings of the pipeline.
    pub config: PipelineConfig,
    /// The log to write.
    pub record: Option<(PathBuf, LogConfig)>,
}

/// A scenario that is ready to run.
pub struct ScenarioRun {
    options: ScenarioOptions,
    scenario: Scenario,
    duration: f64,
}

/// How far a run is.
pub struct Progress<'a> {
    /// Simulated seconds.
    pub seconds: f64,
    /// The cycle that just ended; in a run of several robots the first robot's, if one ended.
    pub cycle: Option<&'a Arc<Cycle>>,
}

/// Result of a run, as `mirrorball sim --json` prints it.
#[derive(Debug, Serialize)]
pub struct RunSummary {
    /// Seed of the simulation.
    pub seed: u64,
    /// Simulated time, seconds.
    pub simulated_s: f64,
    /// Simulated seconds per second of computing.
    pub times_real_time: f64,
    /// Sentences about a doubtful set-up; empty when all is well.
    pub warnings: Vec<String>,
    /// How well the set-up fits. None for several robots.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub setup: Option<FitFigures>,
    /// Scores.
    #[serde(flatten)]
    pub scores: RunScores,
}

/// Scores of a run.
#[derive(Debug, Serialize)]
#[serde(untagged)]
pub enum RunScores {
    /// Of its only robot.
    SingleRobot(Box<Summary>),
    /// Of each robot of the team.
    MultiRobot {
        /// In the order of their numbers.
        robots: Vec<RobotSummary>,
    },
}

impl ScenarioRun {
    /// Reads and checks the scenario and its robot file.
    pub fn load(options: ScenarioOptions) -> Result<Self> {
        let (scenario, _) =
            load_scenario_with_overrides(&options.scenario, &options.changes, options.seed)?;
        let duration = options.duration.unwrap_or(scenario.duration);
        Ok(ScenarioRun {
            options,
            scenario,
            duration,
        })
    }

    /// How long it runs, simulated seconds.
    pub fn duration(&self) -> f64 {
        self.duration
    }

    /// True if the scenario has several robots of ours.
    pub fn is_multi_robot(&self) -> bool {
        !self.scenario.squad.is_empty()
    }

    /// Setup of the robot, or of the first of several.
    pub fn setup(&self) -> Result<Setup> {
        if self.is_multi_robot() {
            return multi_robot::first_setup(&self.scenario);
        }
        self.single_simulation()?.setup()
    }

    fn single_simulation(&self) -> Result<Simulation> {
        let options = &self.options;
        Simulation::with_overrides(
            &options.scenario,
            &options.changes,
            options.seed,
            options.duration,
        )
    }

    /// Runs to the end or until `on_progress` breaks off; either way the log is complete.
    ///
    /// `on_progress` is called after each cycle, and each simulated hundredth of a second in a run of several robots.
    pub fn run(
        self,
        on_progress: impl FnMut(Progress<'_>) -> Result<ControlFlow<()>>,
    ) -> Result<RunSummary> {
        let (seed, simulated_s) = (self.scenario.seed, self.duration);
        let summary = |started: Instant, scores| RunSummary {
            seed,
            simulated_s,
            times_real_time: simulated_s / started.elapsed().as_secs_f64(),
            warnings: Vec::new(),
            setup: None,
            scores,
        };
        if self.is_multi_robot() {
            let simulation = self.multi_robot_simulation()?;
            let started = Instant::now();
            return Ok(summary(started, run_robots(simulation, on_progress)?));
        }
        let single = SingleRobotRun::new(self)?;
        let started = Instant::now();
        let SingleRobotOutcome {
            scores,
            setup,
            config,
            keyframes,
            doubted,
        } = single.run(on_progress)?;
        let summary = summary(started, scores);
        let report = setup_check::check(&setup, &config, &keyframes.keyframes(), Effort::Brief);
        let mut warnings = report.warnings;
        warnings.extend(doubted.warning());
        Ok(RunSummary {
            warnings,
            setup: report.figures,
            ..summary
        })
    }

    fn multi_robot_simulation(&self) -> Result<MultiRobotSimulation> {
        let options = &self.options;
        let record = options.record.as_ref();
        MultiRobotSimulation::new(
            (&options.scenario, &self.scenario),
            &options.config,
            self.duration,
            record.map(|(path, config)| (path.as_path(), config)),
        )
    }
}

struct SingleRobotRun {
    simulation: Simulation,
    setup: Setup,
    config: PipelineConfig,
    pipeline: Pipeline,
    recorder: Option<Recorder>,
}

/// Scores, and what the check of the set-up needs.
struct SingleRobotOutcome {
    scores: RunScores,
    setup: Setup,
    config: PipelineConfig,
    keyframes: KeyframeCollector,
    doubted: DoubtedPoses,
}

impl SingleRobotRun {
    fn new(run: ScenarioRun) -> Result<Self> {
        let simulation = run.single_simulation()?;
        let options = run.options;
        let setup = simulation.setup()?;
        let pipeline = Pipeline::new(&setup, &options.config)?;
        let source = format!("sim {}", options.scenario.display());
        let seed = Some(simulation.sim().scenario().seed);
        let start = |(path, log_config): &(PathBuf, LogConfig)| {
            start_log(path, &source, seed, (&setup, &options.config), log_config)
        };
        let recorder = options.record.as_ref().map(start).transpose()?;
        Ok(SingleRobotRun {
            simulation,
            setup,
            config: options.config,
            pipeline,
            recorder,
        })
    }

    fn run(
        self,
        mut on_progress: impl FnMut(Progress<'_>) -> Result<ControlFlow<()>>,
    ) -> Result<SingleRobotOutcome> {
        let SingleRobotRun {
            simulation,
            setup,
            config,
            mut pipeline,
            mut recorder,
        } = self;
        let mut statistics = RunStatistics::new(&setup);
        let mut keyframes = KeyframeCollector::new(&setup, &config.localize.filter);
        let mut doubted = DoubtedPoses::default();
        let mut finish: fn(Recorder) -> Result<LogStats> = Recorder::finish;
        simulation.run(&mut pipeline, |cycle| {
            let cycle = Arc::new(cycle);
            statistics.add_cycle(&cycle, score::cycle_error(&cycle));
            keyframes.add_cycle(&cycle);
            doubted.add(&cycle);
            let flow = on_progress(Progress {
                seconds: cycle.stamp.seconds(),
                cycle: Some(&cycle),
            })?;
            if let Some(recorder) = &mut recorder {
                recorder.record_cycle(cycle)?;
            }
            if flow.is_break() {
                finish = Recorder::finish_broken_off;
            }
            Ok(flow)
        })?;
        recorder.map(finish).transpose()?;
        Ok(SingleRobotOutcome {
            scores: RunScores::SingleRobot(Box::new(statistics.summary())),
            setup,
            config,
            keyframes,
            doubted,
        })
    }
}

fn run_robots(
    simulation: MultiRobotSimulation,
    mut on_progress: impl FnMut(Progress<'_>) -> Result<ControlFlow<()>>,
) -> Result<RunScores> {
    // Cycles of the first robot since the last progress.
    let cycles = RefCell::new(Vec::new());
    let robots = simulation.run_observed(
        |seconds| {
            let new = cycles.take();
            let new = new.iter().map(Some);
            for cycle in new.chain([None]) {
                if on_progress(Progress { seconds, cycle })?.is_break() {
                    return Ok(ControlFlow::Break(()));
                }
            }
            Ok(ControlFlow::Continue(()))
        },
        |robot, cycle| {
            if robot == 0 {
                cycles.borrow_mut().push(cycle.clone());
            }
        },
    )?;
    Ok(RunScores::MultiRobot { robots })
}

/// Files that a scenario needs, itself first: robot, field, mirror profile, map, mask, colours, labels and their images.
pub fn scenario_files(scenario: &Path) -> Result<Vec<PathBuf>> {
    let (loaded, robot) = Scenario::load(scenario)?;
    let mut files = vec![scenario.to_owned(), loaded.robot.clone()];
    files.extend(loaded.field);
    files.push(robot.field);
    files.extend(robot.mirror.map(|mirror| mirror.profile));
    files.extend(robot.map.map(|map| map.file));
    files.extend(robot.mask);
    files.extend(robot.colours);
    let beside = loaded.robot.with_file_name("labels.csv");
    let labels = robot.labels.or_else(|| beside.exists().then_some(beside));
    if let Some(labels) = labels {
        files.extend(labelled_images(&labels)?);
        files.push(labels);
    }
    let mut known = BTreeSet::new();
    files.retain(|file| known.insert(file.clone()));
    Ok(files)
}

/// The images that a list of labelled pixels names in its first column.
fn labelled_images(labels: &Path) -> Result<Vec<PathBuf>> {
    let place = || format!("cannot read {}", labels.display());
    let text = input_file::read(labels, TEXT_BYTES_MAX).with_context(place)?;
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .from_reader(text.as_slice());
    let folder = labels.parent().unwrap_or(Path::new(""));
    let mut images = BTreeSet::new();
    for record in reader.records() {
        images.extend(
            record
                .with_context(place)?
                .get(0)
                .map(|file| folder.join(file)),
        );
    }
    Ok(images.into_iter().collect())
}

/// Which recording folder to locate the robot in, and how.
pub struct RecordingOptions {
    /// The folder.
    pub folder: PathBuf,
    /// A calibrated map in place of the robot's own.
    pub map: Option<PathBuf>,
    /// File for the ground map with what was learned about its errors.
    pub save_map: Option<PathBuf>,
    /// Settings of the pipeline.
    pub config: PipelineConfig,
    /// Standard deviation of line points that come without one, metres.
    pub external_point_std: f32,
}

/// Result of a recording, as `mirrorball locate --json` prints it.
#[derive(Debug, Serialize)]
pub struct RecordingSummary {
    /// Scores of the poses.
    #[serde(flatten)]
    pub summary: Summary,
    /// Sentences about a doubtful set-up, and about a recording without a pose; empty when all is well.
    pub warnings: Vec<String>,
    /// Those of the warnings that the path of the poses betrays.
    #[serde(skip)]
    pub path_warnings: Vec<String>,
    /// Images that could not be used.
    pub image_faults: ImageFaults,
    /// How well the set-up fits. None for too few frames.
    pub setup: Option<FitFigures>,
    /// Distinct pixels that the scan lines read.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scan_pixels: Option<usize>,
    /// Their fraction of the image.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scan_share: Option<f32>,
    /// Scores of the detections, where objects.csv and truth.csv say what was there.
    #[serde(rename = "eyes", skip_serializing_if = "Option::is_none")]
    pub detections: Option<DetectionSummary>,
    /// Labelled objects found and missed, where object_labels.csv exists.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub labelled_objects: Option<LabelSummary>,
}

/// A recording folder that is ready to be processed.
pub struct RecordingRun {
    setup: Setup,
    recording: Recording,
    pipeline: Pipeline,
    report: SetupReport,
    /// Line points that a pose needs.
    points_min: usize,
    save_map: Option<PathBuf>,
    labels: Option<ObjectLabels>,
}

impl RecordingRun {
    /// Reads the folder's robot file and tables, and checks whether the set-up explains the measurements.
    ///
    /// Tables in a wrong unit are left out. Poses of a set-up that another one beats are marked and made uncertain.
    pub fn open(options: &RecordingOptions) -> Result<Self> {
        let robot_file = options.folder.join("robot.toml");
        let setup = Setup::load(&robot_file, options.map.as_deref())?;
        let mut recording = Recording::open(&options.folder, options.external_point_std)?;
        let mut pipeline = Pipeline::new(&setup, &options.config)?;
        let report =
            setup_check::check_recording(&recording, &setup, &options.config, Effort::Brief)?;
        for table in &report.unusable {
            recording.leave_out(*table);
        }
        if let Some(fit) = &report.map_fit {
            pipeline.adopt_map_fit(fit.map_fit());
        }
        if let Some(covariance) = report.added_pose_covariance {
            pipeline.mark_setup_doubtful(covariance);
        }
        Ok(RecordingRun {
            setup,
            recording,
            pipeline,
            report,
            points_min: options.config.localize.mode.points_min,
            save_map: options.save_map.clone(),
            labels: ObjectLabels::read(&options.folder)?,
        })
    }

    /// What the check of the set-up found.
    pub fn setup_report(&self) -> &SetupReport {
        &self.report
    }

    /// Which table of the folder is used where another one is not.
    pub fn notice(&self) -> Option<&str> {
        self.recording.notice()
    }

    /// Frames in the folder.
    pub fn frames(&self) -> usize {
        self.recording.frames()
    }

    /// Processes every frame; an error of `on_cycle` ends the run.
    pub fn run(self, mut on_cycle: impl FnMut(&Cycle) -> Result<()>) -> Result<RecordingSummary> {
        let RecordingRun {
            setup,
            recording,
            mut pipeline,
            report,
            points_min,
            save_map,
            labels,
        } = self;
        let mut labelled_objects = labels.is_some().then(LabelSummary::default);
        let mut image_faults = ImageFaults::default();
        let mut misplaced = MisplacedImages::default();
        let mut leaps = PoseLeaps::new(setup.robot.odometry);
        let mut doubted = DoubtedPoses::default();
        let files = recording.image_files();
        let truth = recording.truth.clone();
        let objects = recording.objects.clone();
        let mut statistics = RunStatistics::new(&setup);
        let mut detections = DetectionStatistics::default();
        let viewpoint_height = setup
            .viewpoint_height
            .unwrap_or(ObjectDetectionConfig::default().viewpoint_height);
        for cycle in recording.filter_map(|sample| pipeline.process_sample(sample)) {
            on_cycle(&cycle)?;
            let file = files.get(&cycle.stamp).map(PathBuf::as_path);
            image_faults.add_cycle(&cycle, file);
            misplaced.add(&cycle.estimate);
            leaps.add(&cycle);
            doubted.add(&cycle);
            let pose = cycle.estimate.pose;
            let error = pose.and_then(|pose| score::pose_error(&truth, cycle.stamp, pose));
            statistics.add_cycle(&cycle, error);
            if let (Some(labels), Some(summary)) = (&labels, &mut labelled_objects)
                && let (Some(found), Some((camera, _))) = (&cycle.detections, &setup.camera)
            {
                summary.add_image(labels, cycle.stamp, camera.width_px, found);
            }
            if let (Some(found), Some((_, map))) = (&cycle.detections, &setup.camera)
                && let Some(pose) = score::true_pose_at(&truth, cycle.stamp)
            {
                let scene = GroundTruthScene {
                    pose,
                    tilt: cycle.estimate.tilt,
                    viewpoint_height,
                    field: &setup.field,
                    map,
                    occluded_sectors: &[],
                    objects: objects.get(&cycle.stamp).map(Vec::as_slice),
                };
                detections.add_image(found, &scene);
            }
        }
        if let Some(path) = save_map {
            corrected_map::save(&setup, &pipeline, &path)?;
        }
        let summary = statistics.summary();
        let mut warnings = report.warnings;
        warnings.extend(few_located(&summary, points_min));
        let path_warnings = [
            misplaced.warning(&files),
            leaps.warning(),
            doubted.warning(),
        ];
        let path_warnings: Vec<String> = path_warnings.into_iter().flatten().collect();
        warnings.extend(path_warnings.iter().cloned());
        let coverage = pipeline.scan_coverage();
        Ok(RecordingSummary {
            scan_pixels: coverage.map(|(pixels, _)| pixels),
            scan_share: coverage.map(|(_, share)| share),
            detections: detections.summary(),
            warnings,
            path_warnings,
            image_faults,
            setup: report.figures,
            labelled_objects,
            summary,
        })
    }
}

/// A warning if frames could be used and less than half of them have a pose. `points_min`: line points that a pose needs.
fn few_located(summary: &Summary, points_min: usize) -> Option<String> {
    let usable = summary.frames - summary.unreadable.min(summary.frames);
    let located = summary.tracking + summary.predicted + summary.global;
    let line_points = summary.line_points.unwrap_or_default();
    let reason = if line_points < points_min as f64 {
        format!(
            "half of them show at most {line_points:.0} line points, where a pose needs {points_min}. The carpet's colours may not be recognised \
             (`labels` and `colours` of robot.toml name them), or light, field lines or map are wrong"
        )
    } else {
        "the column reason of the poses says why. The field, the camera's mount or the map may be wrong".to_owned()
    };
    let share = match located {
        0 => format!("no pose in any of {usable} frames"),
        _ => format!("a pose in only {located} of {usable} frames"),
    };
    (2 * located < usable).then(|| format!("{share}: {reason}"))
}

/// Fails if no frame of a recording could be used.
pub fn ensure_usable(summary: &Summary, folder: &Path) -> Result<()> {
    ensure!(
        summary.unreadable < summary.frames,
        "{}: no frame could be used",
        folder.display()
    );
    Ok(())
}
