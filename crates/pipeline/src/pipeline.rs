//! How does a sample become a pose? The stages in order, one cycle per image, live, simulated or replayed alike.

use std::time::Instant;

use anyhow::Result;
use localize::config::LocalizeConfig;
use localize::estimate::Estimate;
use localize::localizer::{CooperativeConfig, Localizer};
use localize::map_correction::{MapCorrection, MapFit};
use localize::robot::{ExposureSetting, ImuCalibration, OdometryCalibration};
use localize::sample::LinePoint;
use localize::team::{TeamModel, TeamView};
use localize::world::{WorldModel, WorldView};
use localize::{Pose, Stamp};
use nalgebra::Matrix3;
use vision::calibrate::Rim;
use vision::exposure::AutoExposure;
use vision::image::ImageView;
use vision::image_check::ImageCheck;
use vision::process::{FoundLines, Vision};
use vision::scan::pattern::ScanLines;

use crate::config::PipelineConfig;
use crate::cycle::{Cycle, Inputs, Timings};
use crate::features::Features;
use crate::interlace::Interlace;
use crate::observations::{correct_goals, object_observations};
use crate::paths;
use crate::repeated_points::{REPEATED, RepeatedPoints};
use crate::sample::{CameraImage, ImageContent, Sample, SettingsChange};
use crate::scan_map_cache::{self, CacheStatus};
use crate::setup::Setup;
use crate::warm_start::{StampedPose, WarmStart};

/// The stages in their order, with their state from image to image.
///
/// ```
/// # fn main() -> anyhow::Result<()> {
/// use std::path::Path;
///
/// use pipeline::recording::Recording;
/// use pipeline::setup::Setup;
/// use pipeline::{Pipeline, PipelineConfig};
///
/// let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../samples/sequence");
/// let setup = Setup::load(&folder.join("robot.toml"), None)?;
/// let mut pipeline = Pipeline::new(&setup, &PipelineConfig::default())?;
/// for sample in Recording::open(&folder, 0.04)? {
///     if let Some(cycle) = pipeline.process_sample(sample) {
///         println!("{:?} {:?}", cycle.estimate.mode, cycle.estimate.pose);
///     }
/// }
/// # Ok(())
/// # }
/// ```
pub struct Pipeline {
    vision: Option<Vision>,
    interlace: Interlace,
    image_check: Option<ImageCheck>,
    repeated_points: RepeatedPoints,
    exposure: Option<AutoExposure>,
    localizer: Localizer,
    world: WorldModel,
    team: TeamModel,
    cooperative: CooperativeConfig,
    inputs: Inputs,
    last_image: Option<Stamp>,
    /// Path of the wheels so far, turns included, metres.
    path: f64,
    last_pose: Option<StampedPose>,
    notice: Option<String>,
    odometry_calibration: Option<OdometryCalibration>,
    imu_calibration: Option<ImuCalibration>,
    /// Covariance added to each pose, if the set-up is known to be wrong.
    doubt: Option<Matrix3<f32>>,
}

/// After a longer gap between images the light may have changed, and the colours are learned again, seconds.
const COLOUR_MODEL_MAX_GAP: f64 = 1.0;

impl Pipeline {
    /// Builds all tables of the stages.
    pub fn new(setup: &Setup, config: &PipelineConfig) -> Result<Self> {
        let PipelineConfig {
            mut vision,
            mut localize,
            world,
            team,
        } = config.clone();
        // The mirror's profile gives the height exactly; the setting is for maps without a profile.
        if let Some(height) = setup.viewpoint_height {
            vision.objects.viewpoint_height = height;
            localize.matching.viewpoint_height = height;
        }
        let compass = setup.robot.compass.as_ref();
        if let Some(calibration) = compass.and_then(|compass| compass.calibration) {
            localize.compass.calibration = Some(calibration);
        }
        localize.filter.camera_latency = setup.camera_latency(&localize.filter);
        let cooperative = team.cooperative.clone();
        let team = TeamModel::new(team).with_flight(&world.flight);
        let interlace = Interlace::new(vision.scan.interlaced_points_min);
        let world = WorldModel::new(world, localize.matching.viewpoint_height);
        let mut image_check = None;
        let mut exposure = None;
        let mut detector = None;
        if let Some((camera, map)) = &setup.camera {
            let line_width = setup.field.config.line_width;
            let mask = setup.mask.as_deref();
            let (control, config) = (setup.robot.exposure, &vision.exposure);
            let check = vision.image_check.clone();
            image_check = Some(ImageCheck::new(map, camera, check));
            exposure = Some(AutoExposure::new(map, camera, mask, control, config)?);
            detector = Some(Vision::with_mask(map, camera, mask, line_width, vision)?);
        }
        if let (Some(detector), Some(colours)) = (&mut detector, &setup.colours) {
            detector.set_colour_table(colours.clone());
        }
        let basis = setup.map_basis(&localize)?;
        let origin_std = setup.map_origin_std(localize.map_correction.origin_std);
        let (mut localizer, notice) = build_localizer(setup, localize);
        localizer.set_map_basis(basis);
        localizer.set_map_mount_std(origin_std, setup.map_turn_std());
        if let Some(base) = &setup.robot.base {
            let calibration = setup.robot.odometry.map(|odometry| odometry.matrix);
            localizer.set_wheels(&base.kinematics()?, calibration.as_ref());
        }
        Ok(Pipeline {
            vision: detector,
            interlace,
            image_check,
            repeated_points: RepeatedPoints::default(),
            exposure,
            localizer,
            world,
            team,
            cooperative,
            inputs: Inputs::default(),
            last_image: None,
            path: 0.0,
            last_pose: None,
            notice,
            odometry_calibration: setup.robot.odometry,
            imu_calibration: setup.imu_calibration(),
            doubt: None,
        })
    }

    /// What a user should know about the construction: a scan map that was built, or could not be stored.
    pub fn notice(&self) -> Option<&str> {
        self.notice.as_deref()
    }

    /// Goes on with errors of the ground map that the images of the same drive told.
    ///
    /// They hold from the next cycle on, whose inputs have them: replay does the same.
    pub fn adopt_map_fit(&mut self, fit: MapFit) {
        self.inputs.map_fit = Some(Box::new(fit));
    }

    /// Marks every pose as that of a doubtful set-up and adds this covariance to its own.
    ///
    /// It holds from the next cycle on, whose inputs say so: replay does the same. A covariance of zero ends the doubt.
    pub fn mark_setup_doubtful(&mut self, covariance: Matrix3<f32>) {
        self.inputs.setup_doubt = Some(covariance);
    }

    /// Number of distinct pixels that the scan lines read, and their share of the image (minho2016: 63,378, 27.5 %).
    pub fn scan_coverage(&self) -> Option<(usize, f32)> {
        let pattern = self.vision.as_ref()?.scan_pattern();
        Some((pattern.pixel_count, pattern.coverage))
    }

    /// Starts from a known pose.
    pub fn set_pose(&mut self, stamp: Stamp, pose: Pose, covariance: &Matrix3<f32>) {
        self.localizer.set_pose(stamp, pose, covariance);
    }

    /// Takes over the pose and the pending inputs of another pipeline, so that settings can change while the robot drives.
    pub fn warm_start_from(&mut self, other: &Pipeline) {
        self.inputs = other.inputs.clone();
        self.inputs.setup_doubt = self.inputs.setup_doubt.or(other.doubt);
        self.start_from(&other.warm_start());
    }

    /// Goes on with a new pipeline from the next cycle on. The log gets the change.
    ///
    /// Replay does the same at the same cycle, so its bits are equal. It goes on from the state of the log, which it does
    /// not have itself after a gap.
    pub fn replace_by(&mut self, mut next: Pipeline, change: SettingsChange) {
        let state = change.warm_start.unwrap_or_else(|| self.warm_start());
        next.inputs = std::mem::take(&mut self.inputs);
        // Replay may start here.
        next.inputs.setup_doubt = next.inputs.setup_doubt.or(self.doubt);
        next.start_from(&state);
        next.inputs.changed_config_toml = Some(change.config_toml);
        next.inputs.warm_start = Some(state);
        *self = next;
    }

    /// The state of this pipeline, at a given pose.
    pub fn warm_start_at(&self, stamp: Stamp, pose: Pose, covariance: &Matrix3<f32>) -> WarmStart {
        WarmStart {
            pose: Some(StampedPose::new(stamp, pose, covariance)),
            half: None,
            ..self.warm_start()
        }
    }

    /// True while several hypotheses explain the images: a new pipeline would have to search again.
    pub fn has_several_hypotheses(&self) -> bool {
        self.localizer.has_several_hypotheses()
    }

    fn warm_start(&self) -> WarmStart {
        let half = self.localizer.tracked_half();
        WarmStart {
            // The best of several hypotheses is not a pose to track.
            pose: self.last_pose.filter(|_| half.is_some()),
            half,
            exposure: self.exposure.as_ref().map(AutoExposure::state),
            map: self.localizer.map_fit(),
        }
    }

    fn start_from(&mut self, state: &WarmStart) {
        self.last_pose = state.pose;
        if let Some(fit) = &state.map {
            self.localizer.adopt_map_fit(fit);
        }
        if let Some(last) = &state.pose {
            let (stamp, pose, covariance) = last.parts();
            match state.half {
                Some(half) => self.localizer.resume_pose(stamp, pose, &covariance, half),
                None => self.localizer.set_pose(stamp, pose, &covariance),
            }
        }
        if let (Some(exposure), Some(before)) = (&mut self.exposure, state.exposure) {
            exposure.continue_from(before);
        }
    }

    /// Particles of the global search; empty if its method has none.
    pub fn particles(&self) -> &[Pose] {
        self.localizer.particles()
    }

    /// What was learned about the ground map. None if the correction is switched off.
    pub fn map_correction(&self) -> Option<&MapCorrection> {
        self.localizer.map_correction()
    }

    /// Takes a sample; an image ends a cycle.
    pub fn process_sample(&mut self, sample: Sample) -> Option<Cycle> {
        self.process_sample_with(sample, |_| {})
    }

    /// As [`Pipeline::process_sample`], and passes on an image's estimate as soon as it is known: before objects are sought.
    pub fn process_sample_with(
        &mut self,
        sample: Sample,
        on_estimate: impl FnOnce(&Estimate),
    ) -> Option<Cycle> {
        match sample {
            Sample::Odometry(odometry) => self.inputs.odometry.push(odometry),
            Sample::Compass(compass) => self.inputs.compass.push(compass),
            Sample::Imu(imu) => self.inputs.imu.push(imu),
            Sample::Command(command) => self.inputs.commands.push(command),
            Sample::TeamReport(report) => self.inputs.reports.push(report),
            Sample::GroundTruth(truth) => self.inputs.truth = Some(truth),
            Sample::Settings(change) => {
                self.inputs.changed_config_toml = Some(change.config_toml);
                self.inputs.warm_start = change.warm_start;
            }
            Sample::SetupDoubt(covariance) => self.mark_setup_doubtful(covariance),
            Sample::MapFit(fit) => self.adopt_map_fit(*fit),
            Sample::Image(image) => return Some(self.process_image(image, on_estimate)),
        }
        None
    }

    /// As an image sample whose pixels stay the caller's: the cycle's inputs have none.
    pub fn process_pixels(&mut self, stamp: Stamp, image: &ImageView<'_>) -> Cycle {
        self.process_view(stamp, image, None, |_| {})
    }

    /// As an image sample of line points alone.
    pub fn process_line_points(&mut self, stamp: Stamp, line_points: Vec<LinePoint>) -> Cycle {
        let features = self.check_points(Features::from_points(line_points));
        self.process_features(stamp, features, |_| {})
    }

    fn process_image(&mut self, image: CameraImage, on_estimate: impl FnOnce(&Estimate)) -> Cycle {
        let CameraImage {
            stamp,
            setting,
            content,
        } = image;
        self.inputs.exposure_setting = setting;
        let features = match content {
            ImageContent::Pixels(image) => {
                let cycle = self.process_view(stamp, &image.view(), setting, on_estimate);
                let inputs = Inputs {
                    image: Some(image),
                    ..cycle.inputs
                };
                return Cycle { inputs, ..cycle };
            }
            ImageContent::Features { points, goals } => self.check_points(Features {
                goals,
                ..Features::from_points(points)
            }),
            ImageContent::Detections(detections) => {
                let features = Features::from_detections(&detections);
                Features {
                    detections: Some(*detections),
                    ..features
                }
            }
            ImageContent::Unreadable(reason) => Features::from_fault(reason),
        };
        self.process_features(stamp, features, on_estimate)
    }

    /// Line points of another vision system, or the reason why they are not used.
    fn check_points(&mut self, features: Features) -> Features {
        let rows = self.inputs.odometry.iter();
        let path = self.path + rows.map(|row| f64::from(row.path())).sum::<f64>();
        match self.repeated_points.add(&features.line_points, path) {
            true => Features::from_fault(REPEATED.to_owned()),
            false => features,
        }
    }

    /// Pose first, then objects.
    fn process_view(
        &mut self,
        stamp: Stamp,
        image: &ImageView<'_>,
        setting: Option<ExposureSetting>,
        on_estimate: impl FnOnce(&Estimate),
    ) -> Cycle {
        let started = Instant::now();
        let control = self.exposure.as_mut();
        let exposure = control.and_then(|control| control.process(image, setting));
        let light_jumped = exposure.is_some_and(|status| status.setting_changed_brightness);
        let found = self.find_lines(stamp, image, light_jumped);
        let (features, found) = match found {
            Ok(found) => (Features::from_detections(&found.detections), Some(found)),
            Err(fault) => (Features::from_fault(fault), None),
        };
        let lines_ms = elapsed_ms(started);
        let mut cycle = self.estimate_pose(stamp, features);
        on_estimate(&cycle.estimate);
        let started = Instant::now();
        if let (Some(found), Some(vision)) = (found, &mut self.vision) {
            cycle.detections = Some(vision.find_objects(image, found));
        }
        if let Some(check) = &mut self.image_check {
            let heading = cycle.estimate.pose.map(|pose| pose.theta);
            check.check_mounting(image, heading);
        }
        cycle.exposure = exposure;
        cycle.timings.see_ms = lines_ms + elapsed_ms(started);
        self.update_world(&mut cycle);
        cycle
    }

    /// The mirror's rim in the last images. None where it is not seen about where the camera's set-up says.
    pub fn visible_rim(&self) -> Option<Rim> {
        self.image_check.as_ref()?.visible_rim()
    }

    fn process_features(
        &mut self,
        stamp: Stamp,
        features: Features,
        on_estimate: impl FnOnce(&Estimate),
    ) -> Cycle {
        let mut cycle = self.estimate_pose(stamp, features);
        on_estimate(&cycle.estimate);
        self.update_world(&mut cycle);
        cycle
    }

    /// Starts a cycle: everything up to the robot's pose.
    fn estimate_pose(&mut self, stamp: Stamp, features: Features) -> Cycle {
        let started = Instant::now();
        let inputs = std::mem::take(&mut self.inputs);
        if let Some(fit) = &inputs.map_fit {
            self.localizer.adopt_map_fit(fit);
        }
        self.add_inputs(&inputs);
        if let Some(covariance) = inputs.setup_doubt {
            self.doubt = (covariance != Matrix3::zeros()).then_some(covariance);
            self.localizer.doubt_setup(self.doubt.is_some());
        }
        let goals = correct_goals(features.goals, self.localizer.map_correction());
        self.localizer.add_goals(stamp, &goals);
        let mut estimate = self.localizer.process_points(stamp, &features.line_points);
        if let Some(covariance) = &self.doubt {
            estimate.mark_setup_doubtful(covariance);
        }
        self.interlace.update(&estimate);
        self.last_pose = estimate
            .pose
            .map(|pose| StampedPose::new(stamp, pose, &estimate.covariance));
        Cycle {
            stamp,
            inputs,
            detections: features.detections,
            line_points: features.line_points,
            estimate,
            world: WorldView::default(),
            team: TeamView::default(),
            exposure: None,
            image_fault: features.fault,
            timings: Timings {
                see_ms: 0.0,
                localize_ms: elapsed_ms(started),
            },
        }
    }

    /// Ends a cycle: ball, robots and team, from its detections and its pose.
    fn update_world(&mut self, cycle: &mut Cycle) {
        let started = Instant::now();
        let (stamp, estimate) = (cycle.stamp, &cycle.estimate);
        let observations = cycle
            .detections
            .as_ref()
            .map(|detections| object_observations(detections, self.localizer.map_correction()));
        let motion = self.localizer.image_motion();
        let world = self
            .world
            .update(stamp, observations.as_ref(), estimate, motion);
        let mut team = self.team.update(stamp, &world, estimate);
        // For the next image: this image's estimate is final already.
        self.localizer.add_half_log_odds(team.half_log_odds);
        let sightings = self.team.take_sightings(estimate);
        let outcomes = self
            .localizer
            .apply_team_sightings(&sightings, &self.cooperative);
        team.sightings = self.team.judge_sightings(&sightings, &outcomes);
        cycle.world = world;
        cycle.team = team;
        cycle.timings.localize_ms += elapsed_ms(started);
    }

    fn add_inputs(&mut self, inputs: &Inputs) {
        for sample in inputs.sorted_samples() {
            match sample {
                Sample::Odometry(odometry) => {
                    let odometry = self
                        .odometry_calibration
                        .map_or(odometry, |calibration| calibration.apply(&odometry));
                    self.path += f64::from(odometry.path());
                    self.localizer.add_odometry(&odometry);
                    self.world.add_odometry(&odometry);
                }
                Sample::Compass(compass) => self.localizer.add_compass(&compass),
                Sample::TeamReport(report) => self.team.receive(&report),
                Sample::Imu(imu) => {
                    let imu = self
                        .imu_calibration
                        .map_or(imu, |calibration| calibration.apply(&imu));
                    self.localizer.add_imu(&imu);
                }
                Sample::Command(command) => self.localizer.add_command(&command),
                Sample::GroundTruth(_)
                | Sample::Settings(_)
                | Sample::SetupDoubt(_)
                | Sample::MapFit(_)
                | Sample::Image(_) => {}
            }
        }
    }

    /// What localization needs of an image. `light_jumped`: the exposure differs strongly from that of the previous image.
    fn find_lines(
        &mut self,
        stamp: Stamp,
        image: &ImageView<'_>,
        light_jumped: bool,
    ) -> Result<FoundLines, String> {
        let Some(vision) = &mut self.vision else {
            return Err("an image, but robot.toml has no [camera]".to_owned());
        };
        let check = self.image_check.as_mut();
        if let Some(fault) = check.and_then(|check| check.check(stamp, image, self.path)) {
            return Err(fault.to_string());
        }
        let last = self.last_image.replace(stamp);
        let gap = last.map(|last| stamp - last);
        if light_jumped || gap.is_some_and(|gap| gap > COLOUR_MODEL_MAX_GAP) {
            vision.reset_colour_model();
        }
        let lines = self.interlace.lines(gap);
        let found = vision
            .find_lines(image, lines)
            .map_err(|error| error.to_string())?;
        self.interlace
            .set_read(match found.detections.colours_learned {
                true => ScanLines::All,
                false => lines,
            });
        Ok(found)
    }
}

/// A localizer on the setup's field, and a notice about its scan map, which comes from the cache folder if possible.
fn build_localizer(setup: &Setup, config: LocalizeConfig) -> (Localizer, Option<String>) {
    let Some(folder) = paths::cache_folder() else {
        return (Localizer::new(&setup.field, config), None);
    };
    let (localizer, status) = scan_map_cache::build_localizer(&setup.field, config, &folder);
    let megabytes = localizer.memory_bytes() as f64 / 1e6;
    let folder = folder.display();
    let notice = match status {
        None | Some(CacheStatus::Loaded) => None,
        Some(CacheStatus::Built) => Some(format!(
            "built the field's scan map and stored it in {folder} ({megabytes:.0} MB of tables in all)"
        )),
        Some(CacheStatus::Rebuilt) => Some(format!(
            "rebuilt the field's scan map: the file in {folder} was damaged or of another version"
        )),
        Some(CacheStatus::NotStored(reason)) => Some(format!(
            "built the field's scan map, but could not store it: {reason}"
        )),
    };
    (localizer, notice)
}

fn elapsed_ms(since: Instant) -> f32 {
    since.elapsed().as_secs_f32() * 1e3
}
