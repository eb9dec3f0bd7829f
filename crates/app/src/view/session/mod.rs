//! State of the open source: its static scene, the shown cycle, and the metrics of its run.

mod opening;
mod playing;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Result;
use localize::estimate::Estimate;
use localize::map_correction::MapCorrectionEstimate;
use localize::robot::BaseConfig;
use localize::{At, FieldFrame, RobotFrame};
use vision::colour::colour_table::ColourTable;
use vision::colour::lookup_table::{CLASS_NAMES, ColourClass};

use crate::view::calibration_state::CalibrationState;
use crate::view::curves::{Curve, CurveStore};
use crate::view::device_monitor::DeviceMonitor;
use crate::view::layer_worker::{LayerJob, LayerSelection, RenderedLayers};
use crate::view::log_damage::LogDamage;
use crate::view::run_findings::RunFindings;
use crate::view::selection::Selection;
use crate::view::setting_changes::SettingChanges;
use crate::view::settings_state::SettingsState;
use crate::view::setup_job::SetupCheck;
use crate::view::source::Source;
use crate::view::source::decoded_cycle::DecodedCycle;
use crate::view::source::metrics_reader::MetricsReader;
use crate::view::source::other_run::OtherRun;
use crate::view::source::recompute::Recompute;
use crate::view::source::sim_worker::SourceRequest;
use crate::view::static_scene::StaticScene;
use crate::view::status_message::StatusMessage;
use crate::view::time_series::TimeSeries;
use pipeline::PipelineConfig;

/// Playback state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Playback {
    /// Shown time, seconds.
    pub(crate) time: f64,
    /// True while time advances; a live source then shows its newest cycle.
    pub(crate) playing: bool,
    /// Log or simulated seconds per second.
    pub(crate) speed: f64,
}

impl Default for Playback {
    fn default() -> Self {
        Playback {
            time: 0.0,
            playing: false,
            speed: 1.0,
        }
    }
}

/// Said in place of the mode where the log holds none.
pub(crate) const NO_ESTIMATE: &str = "no estimate in the log";

/// A mark on the timeline.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Mark {
    /// Time, seconds.
    pub(crate) time: f64,
    /// Description.
    pub(crate) text: String,
}

/// Everything that the panels draw.
pub(crate) struct Session {
    /// Source of the cycles.
    pub(crate) source: Source,
    /// Title of the source.
    pub(crate) title: String,
    /// Field, camera and ground map; None if the source does not provide them.
    pub(crate) scene: Option<Arc<StaticScene>>,
    /// The shown cycle.
    pub(crate) shown: Option<DecodedCycle>,
    /// Metrics of the run, as far as it has been read.
    pub(crate) series: TimeSeries,
    /// Fields and formulas that are plotted.
    pub(crate) curves: CurveStore,
    /// The run recomputed with other settings.
    pub(crate) recompute: Option<Recompute>,
    /// Changes of the settings during the run, in time order.
    pub(crate) setting_changes: SettingChanges,
    /// Other runs on the same timeline.
    pub(crate) others: Vec<OtherRun>,
    /// The object that all panels point out.
    pub(crate) selection: Option<Selection>,
    /// Ground under the pointer in the image, robot frame.
    pub(crate) pointed_ground: Option<At<RobotFrame>>,
    /// Curves that another panel asks the plots to show.
    pub(crate) plot_request: Vec<String>,
    /// Wall-clock time at the zero of the stamps, nanoseconds; 0 if it is unknown.
    clock_offset_ns: i64,
    /// Playback state.
    pub(crate) playback: Playback,
    /// Marks, in time order.
    pub(crate) marks: Vec<Mark>,
    /// Odd moments of the run.
    pub(crate) findings: RunFindings,
    /// What the source lacks, one line each.
    pub(crate) warnings: Vec<String>,
    /// Parts of the log that cannot be read, as far as it has been read.
    pub(crate) damage: LogDamage,
    /// False if the source has neither cycles nor poses: nobody knows whether the robot was lost.
    pub(crate) holds_poses: bool,
    /// The last error.
    pub(crate) last_error: Option<String>,
    /// The settings that the source runs with, or that the log was recorded with.
    pub(crate) source_config: PipelineConfig,
    /// The settings in use.
    pub(crate) settings: SettingsState,
    /// Labels, mask and map calibration.
    pub(crate) calibration: CalibrationState,
    /// Time under the pointer in a plot, seconds.
    pub(crate) hovered_time: Option<f64>,
    /// State of the devices.
    pub(crate) devices: DeviceMonitor,
    /// The layers rendered last.
    pub(crate) rendered_layers: RenderedLayers,
    /// Colour table learned from painted labels.
    pub(crate) colour_table: Option<Arc<ColourTable>>,
    /// One entry per pixel; false where the robot sees itself.
    pub(crate) mask: Option<Arc<Vec<bool>>>,
    /// Counts changes of settings, colour table and mask.
    pub(crate) revision: u64,
    /// Check of the log's set-up.
    pub(crate) setup_check: SetupCheck,
    metrics_reader: Option<MetricsReader>,
    /// Folder of the log that was computed from a recording folder.
    _recording_log: Option<tempfile::TempDir>,
}

impl Default for Session {
    fn default() -> Self {
        Session {
            source: Source::Empty,
            title: String::new(),
            scene: None,
            shown: None,
            series: TimeSeries::default(),
            curves: CurveStore::default(),
            recompute: None,
            setting_changes: SettingChanges::default(),
            others: Vec::new(),
            selection: None,
            pointed_ground: None,
            plot_request: Vec::new(),
            clock_offset_ns: 0,
            playback: Playback::default(),
            marks: Vec::new(),
            findings: RunFindings::default(),
            warnings: Vec::new(),
            damage: LogDamage::default(),
            holds_poses: true,
            last_error: None,
            source_config: PipelineConfig::default(),
            settings: SettingsState::new(PipelineConfig::default()),
            calibration: CalibrationState::default(),
            hovered_time: None,
            devices: DeviceMonitor::default(),
            rendered_layers: RenderedLayers::default(),
            colour_table: None,
            mask: None,
            revision: 0,
            setup_check: SetupCheck::default(),
            metrics_reader: None,
            _recording_log: None,
        }
    }
}

impl Session {
    /// Why a live source delivers nothing new. None if it does.
    pub(crate) fn source_problem(&self) -> Option<String> {
        match &self.source {
            Source::Live(live) => live.problem(),
            Source::Empty | Source::Log(_) => None,
        }
    }

    /// What the source lacks, and which parts of it are damaged, one line each.
    pub(crate) fn notices(&self) -> Vec<String> {
        let mut notices = self.warnings.clone();
        notices.extend(self.damage.notice());
        notices
    }

    /// Mode of the estimate, and why it is not simply tracked.
    pub(crate) fn mode_and_reason(&self, estimate: &Estimate) -> String {
        if self.holds_poses {
            pipeline::log::mode_and_reason(estimate)
        } else {
            NO_ESTIMATE.to_owned()
        }
    }

    /// True once all of the source has been read, or it is no log.
    pub(crate) fn is_read(&self) -> bool {
        self.metrics_reader.is_none()
    }

    /// Path of the log, if the source is one.
    pub(crate) fn log_path(&self) -> Option<PathBuf> {
        match &self.source {
            Source::Log(player) => Some(player.index().path().to_owned()),
            _ => None,
        }
    }

    /// The wheel base; the default if the source does not provide one.
    pub(crate) fn base_config(&self) -> BaseConfig {
        base_config_of(self.scene.as_deref())
    }

    /// First and last time of the log or of the live run, seconds.
    pub(crate) fn span(&self) -> Option<(f64, f64)> {
        let span = self.source.span()?;
        let first = self.series.samples().first();
        Some((
            first.map_or(span.0, |sample| sample.time.min(span.0)),
            span.1,
        ))
    }

    /// The curve of a name; None if it is unknown or invalid.
    pub(crate) fn curve(&self, name: &str) -> Option<Curve<'_>> {
        self.curves.curve(name, &self.series)
    }

    /// Runs that are drawn beside this one, with their names.
    pub(crate) fn other_runs(&self) -> impl Iterator<Item = (&str, &TimeSeries)> {
        let recompute = self.recompute.iter();
        let others = self.others.iter();
        recompute
            .map(|recompute| ("recomputed", &recompute.series))
            .chain(others.map(|other| (&*other.name, &other.series)))
    }

    /// Selects what is near a place on the field, within `radius` metres; nothing if it is empty.
    pub(crate) fn select_at(&mut self, at: At<FieldFrame>, radius: f32) {
        let cycle = self.shown.as_ref().map(|now| &now.cycle);
        let height = self.viewpoint_height();
        self.selection = cycle.and_then(|cycle| Selection::nearest(cycle, height, at, radius));
    }

    /// Selects the next (`ahead`) or the previous object of the shown cycle.
    pub(crate) fn select_next(&mut self, ahead: bool) {
        if let Some(now) = &self.shown {
            self.selection = Selection::next(self.selection, &now.cycle, ahead);
        }
    }

    /// Place of the selected object on the field.
    pub(crate) fn selected_place(&self) -> Option<At<FieldFrame>> {
        let cycle = &self.shown.as_ref()?.cycle;
        self.selection?.place(cycle, self.viewpoint_height())
    }

    /// Height of the camera's viewpoint, metres; None without a camera.
    pub(crate) fn viewpoint_height(&self) -> Option<f32> {
        let camera = self.scene.as_ref()?.camera.as_ref()?;
        Some(camera.viewpoint_height)
    }

    /// Shows another log, or another robot's stream, beside this run.
    pub(crate) fn open_beside(&mut self, path: &Path) -> Result<()> {
        self.others
            .push(OtherRun::open(path, self.clock_offset_ns)?);
        Ok(())
    }

    /// What localization had learned about the ground map in the shown cycle.
    pub(crate) fn map_correction(&self) -> Option<&MapCorrectionEstimate> {
        self.shown.as_ref()?.cycle.estimate.map_correction.as_ref()
    }

    /// The shown cycle's time, seconds.
    pub(crate) fn shown_time(&self) -> Option<f64> {
        self.shown.as_ref().map(|now| now.cycle.stamp.seconds())
    }

    /// Takes over painted labels and mask once a stroke has ended, and polls the running calibration.
    fn update_calibration(&mut self) {
        if let Some(shown) = &self.shown {
            self.calibration.collect_mask_image(&shown.cycle);
        }
        self.calibration.poll_job();
        let brush = &mut self.calibration.brush;
        // Learning a colour table is slow: wait until the stroke ends.
        if brush.dirty && !brush.painting {
            brush.dirty = false;
            self.colour_table = brush.learn_colour_table().map(Arc::new);
            self.mask = brush.mask.clone().map(Arc::new);
            self.revision += 1;
        }
    }

    /// Finds the mask of the robot's own parts in the collected images.
    pub(crate) fn compute_mask(&mut self) {
        self.calibration.compute_mask(self.scene.as_deref());
    }

    /// Uses other settings: in the simulation, which takes them between two cycles, and in the rendered layers.
    pub(crate) fn apply_config(&mut self, config: PipelineConfig) {
        self.settings.set_config(config);
        self.revision += 1;
        let config = Box::new(self.settings.config().clone());
        if let Some(worker) = self.source.simulation() {
            // The simulation takes it before its next cycle.
            let time = self.source.span().map_or(0.0, |(_, end)| end);
            self.setting_changes
                .push(time, &config, &self.source_config);
            worker.request(SourceRequest::Configure(config));
        }
    }

    /// Changes the settings if the result is valid; otherwise keeps them and states the error.
    pub(crate) fn edit_config(&mut self, change: impl FnOnce(&mut PipelineConfig)) {
        let mut config = self.settings.config().clone();
        change(&mut config);
        let checked = config.check().map(|()| config).map_err(Into::into);
        self.apply_checked(checked);
    }

    /// Changes one setting if the value is valid; otherwise keeps the settings in use and states the error.
    pub(crate) fn edit_setting(&mut self, path: &[String], value: toml::Value) {
        let checked = self.settings.edit_value(path, value);
        self.apply_checked(checked);
    }

    fn apply_checked(&mut self, checked: Result<PipelineConfig>) {
        match checked {
            Ok(config) => {
                self.apply_config(config);
                self.settings.message = None;
            }
            Err(error) => self.settings.message = Some(StatusMessage::from_result(Err(error))),
        }
    }

    /// Uses the settings of a preset, with the overlay in a file.
    pub(crate) fn load_config(&mut self, preset: &str, overlay: Option<&Path>) {
        let loaded = PipelineConfig::load(preset, overlay).map(|config| {
            self.apply_config(config);
            match overlay {
                Some(path) => format!("loaded {}", path.display()),
                None => format!("loaded the preset {preset}"),
            }
        });
        self.settings.message = Some(StatusMessage::from_result(loaded));
    }

    /// Writes the settings that differ from the defaults.
    pub(crate) fn save_overlay(&mut self, path: &Path) {
        let saved = self.settings.save_overlay(path);
        self.settings.message = Some(StatusMessage::from_result(saved));
    }

    /// A ground point in the robot frame, metres, at the shown pose on the field.
    pub(crate) fn to_field(&self, ground: Option<At<RobotFrame>>) -> Option<At<FieldFrame>> {
        let pose = self.shown.as_ref()?.cycle.estimate.pose?;
        Some(pose * ground?)
    }

    /// Starts to recompute the log with the settings in use.
    pub(crate) fn start_recompute(&mut self) {
        let Some(path) = self.log_path() else {
            return;
        };
        match Recompute::start(&path, self.settings.config().clone()) {
            Ok(recompute) => self.recompute = Some(recompute),
            Err(error) => self.last_error = Some(format!("{error:#}")),
        }
    }

    /// Name of the colour class rendered at a pixel; None if the class layer is not rendered.
    pub(crate) fn class_at(&self, u: usize, v: usize) -> Option<&str> {
        let layers = &self.rendered_layers;
        let width = layers.classes.as_ref()?.size[0];
        let class = ColourClass(*layers.class_indices.as_ref()?.get(v * width + u)?);
        let robot_table = self.scene.as_ref().and_then(|s| s.colour_table.as_ref());
        let table = self.colour_table.as_deref().or(robot_table);
        table
            .and_then(|table| table.name(class))
            .or_else(|| CLASS_NAMES.get(usize::from(class.0)).copied())
    }

    /// The shown cycle as a job for the layer worker.
    pub(crate) fn layer_job(&self, selection: LayerSelection) -> Option<LayerJob> {
        let (scene, shown) = (self.scene.as_ref()?, self.shown.as_ref()?);
        Some(LayerJob {
            scene: scene.clone(),
            cycle: shown.cycle.clone(),
            vision: self.settings.config().vision.clone(),
            colour_table: self.colour_table.clone(),
            mask: self.mask.clone().or_else(|| scene.mask.clone()),
            revision: self.revision,
            selection,
        })
    }
}

fn base_config_of(scene: Option<&StaticScene>) -> BaseConfig {
    scene
        .and_then(|scene| scene.robot.base.clone())
        .unwrap_or_default()
}
