//! State of the open source: its static scene, the shown cycle, and the metrics of its run.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Result;
use localize::map_correction::MapCorrectionEstimate;
use localize::robot::BaseConfig;
use localize::{At, FieldFrame, RobotFrame, Stamp};
use vision::colour::colour_table::ColourTable;
use vision::colour::lookup_table::{CLASS_NAMES, ColourClass};

use super::calibration_state::CalibrationState;
use super::device_monitor::DeviceMonitor;
use super::layer_worker::{LayerJob, LayerSelection, RenderedLayers};
use super::run_findings::{RunFindings, STAMP_ROUNDING};
use super::settings_state::SettingsState;
use super::setup_job::SetupCheck;
use super::source::decoded_cycle::DecodedCycle;
use super::source::inbox::CycleInbox;
use super::source::live::LiveSource;
use super::source::log::LogPlayer;
use super::source::metrics_reader::MetricsReader;
use super::source::recompute::Recompute;
use super::source::recording::log_of_recording;
use super::source::sim_worker::{SimWorker, SourceRequest};
use super::source::{Source, remote};
use super::static_scene::StaticScene;
use super::status_message::StatusMessage;
use super::time_series::{CycleMetrics, TimeSeries};
use pipeline::PipelineConfig;
use pipeline::config::PIPELINE_FILE;
use pipeline::log::LogIndex;
use pipeline::setup::Setup;

/// Longest step of a playing log over which the devices' statistics continue, seconds: a frame at the highest speed.
const MONITORED_JUMP: f64 = 10.0;
/// Time before a jump's target from which the statistics start, seconds.
const MONITORED_BEFORE: f64 = 2.0;

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
    /// The run recomputed with other settings.
    pub(crate) recompute: Option<Recompute>,
    /// Playback state.
    pub(crate) playback: Playback,
    /// Marks, in time order.
    pub(crate) marks: Vec<Mark>,
    /// Odd moments of the run.
    pub(crate) findings: RunFindings,
    /// What the source lacks, one line each.
    pub(crate) warnings: Vec<String>,
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
            recompute: None,
            playback: Playback::default(),
            marks: Vec::new(),
            findings: RunFindings::default(),
            warnings: Vec::new(),
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
    /// Opens a log (`.mcap`) or a recording folder, plays a scenario (`.toml`), or connects to a robot's stream (`host:port`).
    pub(crate) fn open(path: &Path) -> Result<Self> {
        let text = path.to_string_lossy();
        let port = text.rsplit_once(':').map(|(_, port)| port.parse::<u16>());
        if !path.exists() && (text.starts_with("ws://") || matches!(port, Some(Ok(_)))) {
            return Session::connect(&text);
        }
        if path.is_dir() {
            Session::recording(path)
        } else if path.extension().is_some_and(|end| end == "toml") {
            Session::open_scenario(path, None, PipelineConfig::default())
        } else {
            Session::log(path)
        }
    }

    /// Computes and opens the poses of a recording folder.
    fn recording(folder: &Path) -> Result<Self> {
        let (place, log) = log_of_recording(folder)?;
        Ok(Session {
            title: format!("recording {}", folder.display()),
            _recording_log: Some(place),
            ..Session::log(&log)?
        })
    }

    /// Opens a log of any version.
    pub(crate) fn log(path: &Path) -> Result<Self> {
        let mut player = LogPlayer::new(LogIndex::open(path)?);
        let mut warnings = player.index().warnings().to_vec();
        let scene = match player.load_setup() {
            Ok(setup) => Some(Arc::new(StaticScene::new(setup))),
            Err(error) => {
                warnings.push(format!(
                    "cannot load the log's robot: {error:#}. Field and ground map are not shown"
                ));
                None
            }
        };
        let recorded_config = parse_config(
            player.index().header().files.get(PIPELINE_FILE),
            &mut warnings,
        );
        let base = base_config_of(scene.as_deref());
        let metrics_reader = MetricsReader::start(player.index().clone(), base)?;
        let mut session = Session {
            title: format!("log {}", path.display()),
            playback: Playback {
                time: player.span().0,
                ..Playback::default()
            },
            source: Source::Log(Box::new(player)),
            scene,
            warnings,
            settings: SettingsState::new(recorded_config.clone()),
            source_config: recorded_config,
            metrics_reader: Some(metrics_reader),
            ..Session::default()
        };
        session.step(1);
        Ok(session)
    }

    /// Plays a scenario.
    pub(crate) fn open_scenario(
        path: &Path,
        seed: Option<u64>,
        config: PipelineConfig,
    ) -> Result<Self> {
        let inbox = CycleInbox::default();
        let (worker, setup) = SimWorker::start(path, seed, config.clone(), inbox.clone())?;
        let live = LiveSource::new(inbox, Some(worker));
        let name = format!("simulation {}", path.display());
        Ok(Session::from_live(name, live, setup, config))
    }

    /// Connects to a robot over the network.
    pub(crate) fn connect(address: &str) -> Result<Self> {
        let inbox = CycleInbox::default();
        let remote = remote::connect(address, inbox.clone())?;
        let mut warnings: Vec<String> = remote.header.version_mismatch().into_iter().collect();
        let recorded_config = parse_config(remote.header.files.get(PIPELINE_FILE), &mut warnings);
        let mut live = LiveSource::new(inbox, None).with_guard(remote.guard, Some(remote.folder));
        live.remote_settings = Some(remote.settings);
        let name = format!("{address}: {}", remote.header.source);
        Ok(Session {
            warnings,
            ..Session::from_live(name, live, remote.setup, recorded_config)
        })
    }

    /// Creates a session of a live source.
    pub(crate) fn from_live(
        name: String,
        live: LiveSource,
        setup: Setup,
        recorded_config: PipelineConfig,
    ) -> Self {
        Session {
            title: name,
            source: Source::Live(Box::new(live)),
            scene: Some(Arc::new(StaticScene::new(setup))),
            playback: Playback {
                playing: true,
                ..Playback::default()
            },
            settings: SettingsState::new(recorded_config.clone()),
            source_config: recorded_config,
            ..Session::default()
        }
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

    /// Takes new data of all threads, and advances the playback by `passed` seconds; true if there is new data to draw.
    pub(crate) fn update(&mut self, passed: f64) -> bool {
        self.update_calibration();
        let mut changed = false;
        let base = self.base_config();
        if let Some(metrics_reader) = &mut self.metrics_reader {
            let read = metrics_reader.poll();
            for sample in read.samples {
                self.series.push(sample);
                changed = true;
            }
            if let Some(found) = read.findings {
                self.findings.set(found);
                changed = true;
            }
            if metrics_reader.is_done() {
                self.findings.complete = true;
                self.metrics_reader = None;
            }
        }
        if let Some(recompute) = &mut self.recompute
            && !recompute.done
        {
            recompute.poll();
            changed = true;
        }
        if let Source::Live(live) = &mut self.source {
            let (received, mut dropped) = live.poll();
            self.devices.dropped += dropped;
            if live.status.is_some() {
                self.last_error.clone_from(&live.status);
            }
            for shown in &received {
                self.devices.update(&shown.cycle);
                let lost = std::mem::take(&mut dropped);
                self.findings.push_live(&shown.cycle, lost);
                self.series
                    .push(CycleMetrics::from_cycle(&shown.cycle, &base, lost));
            }
            if self.playback.playing && !received.is_empty() {
                self.shown = live.newest();
                self.playback.time = self.shown_time().unwrap_or(self.playback.time);
            }
            changed |= !received.is_empty();
        } else if self.playback.playing {
            self.advance(passed);
            changed = true;
        }
        changed
    }

    /// Advances the log by `passed` seconds times the playback speed.
    fn advance(&mut self, passed: f64) {
        let Some((_, end)) = self.source.span() else {
            return;
        };
        let before = self.playback.time;
        let at = (before + passed * self.playback.speed).min(end);
        if at >= end {
            self.playback.playing = false;
        }
        self.playback.time = at;
        let result = self.source.seek(at);
        self.set_shown(result);
    }

    /// Shows the cycle at `time`.
    pub(crate) fn seek(&mut self, time: f64) {
        if matches!(self.source, Source::Live(_)) {
            self.playback.playing = false;
        }
        self.playback.time = time;
        let result = self.source.seek(time);
        self.set_shown(result);
    }

    /// Pauses and shows the next odd moment (`ahead`) or the previous one, if there is one.
    pub(crate) fn next_finding(&mut self, ahead: bool) {
        if let Some(time) = self.findings.next(self.playback.time, ahead) {
            self.playback.playing = false;
            self.seek(time);
        }
    }

    /// Pauses and shows the cycle of a stamp, seconds.
    pub(crate) fn seek_stamp(&mut self, stamp: f64) {
        self.playback.playing = false;
        self.seek(stamp + STAMP_ROUNDING);
    }

    /// Steps `by` cycles (negative: back) and pauses.
    pub(crate) fn step(&mut self, by: i64) {
        self.playback.playing = false;
        let at_end = self
            .source
            .span()
            .is_none_or(|(_, end)| self.shown_time().is_none_or(|now| now >= end - 1e-9));
        if let Some(worker) = self.source.simulation()
            && by > 0
            && at_end
        {
            worker.request(SourceRequest::Step);
            // Playing shows the new cycle as soon as it arrives.
            self.playback.playing = true;
            return;
        }
        let result = self.source.step(by);
        if matches!(result, Ok(Some(_))) {
            self.set_shown(result);
            self.playback.time = self.shown_time().unwrap_or(self.playback.time);
        } else {
            self.last_error = result
                .err()
                .map(|error| format!("{error:#}"))
                .or(self.last_error.take());
        }
    }

    fn set_shown(&mut self, result: Result<Option<DecodedCycle>>) {
        match result {
            Ok(Some(shown)) => {
                self.last_error = self.monitor_logged_devices(shown.cycle.stamp).err();
                self.shown = Some(shown);
            }
            Ok(None) => {}
            Err(error) => {
                self.playback.playing = false;
                self.last_error = Some(format!("{error:#}"));
            }
        }
    }

    /// Updates the devices' statistics with every logged cycle up to the shown one, drawn or not.
    ///
    /// They start anew, two seconds earlier, after a jump by more than some chunks of the log.
    fn monitor_logged_devices(&mut self, shown: Stamp) -> Result<(), String> {
        let Source::Log(player) = &mut self.source else {
            return Ok(());
        };
        let seen = self.devices.stamp;
        let continues = self.devices.cycles > 0 && shown >= seen && shown - seen < MONITORED_JUMP;
        if !continues {
            self.devices = DeviceMonitor::default();
        }
        let from = if continues {
            seen
        } else {
            Stamp::from_seconds(shown.seconds() - MONITORED_BEFORE)
        };
        let devices = &mut self.devices;
        player
            .visit_cycles(from, shown, |cycle| devices.update(cycle))
            .map_err(|error| format!("{error:#}"))
    }

    /// Toggles between playing and pause; the view's own simulation pauses too.
    pub(crate) fn toggle_playback(&mut self) {
        self.playback.playing = !self.playback.playing;
        let playing = self.playback.playing;
        if let Some(worker) = self.source.simulation() {
            worker.request(SourceRequest::Pause(!playing));
        } else if let Some((start, end)) = self.source.span()
            && playing
            && matches!(self.source, Source::Log(_))
            && self.playback.time >= end
        {
            self.seek(start);
        }
    }

    /// Sets the playback speed. Runs that the view does not own keep their speed.
    pub(crate) fn set_speed(&mut self, speed: f64) {
        self.playback.speed = speed.clamp(0.05, 100.0);
        if let Some(worker) = self.source.simulation() {
            worker.request(SourceRequest::SetSpeed(self.playback.speed));
        }
    }

    /// What localization had learned about the ground map in the shown cycle.
    pub(crate) fn map_correction(&self) -> Option<&MapCorrectionEstimate> {
        self.shown.as_ref()?.cycle.estimate.map_correction.as_ref()
    }

    /// The shown cycle's time, seconds.
    pub(crate) fn shown_time(&self) -> Option<f64> {
        self.shown.as_ref().map(|now| now.cycle.stamp.seconds())
    }

    /// Adds a mark at the shown time.
    pub(crate) fn add_mark(&mut self, text: &str) {
        let time = self.playback.time;
        let place = self.marks.partition_point(|mark| mark.time <= time);
        let text = text.to_owned();
        self.marks.insert(place, Mark { time, text });
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

/// Parses the settings of a log. Settings of an incompatible version become the defaults, with a warning.
fn parse_config(text: Option<&Vec<u8>>, warnings: &mut Vec<String>) -> PipelineConfig {
    let Some(text) = text else {
        return PipelineConfig::default();
    };
    let text = String::from_utf8_lossy(text);
    PipelineConfig::parse(&text).unwrap_or_else(|error| {
        warnings.push(format!(
            "cannot read the settings ({}): defaults are shown",
            error.message()
        ));
        PipelineConfig::default()
    })
}
