//! What is being looked at? One source with its stage, the moment shown, and all that was gathered of its run.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Result;
use localize::robot::BaseConfig;
use vision::colour::colour_table::ColourTable;

use super::device_monitor::DeviceMonitor;
use super::layer_worker::{LayerJob, LayerSelection, RenderedLayers};
use super::source::live::{CycleInbox, LiveSource};
use super::source::log::LogPlayer;
use super::source::metrics_reader::MetricsReader;
use super::source::recompute::Recompute;
use super::source::sim_worker::{SimWorker, SourceRequest};
use super::source::{DecodedCycle, Source, remote};
use super::static_scene::StaticScene;
use super::time_series::{CycleMetrics, TimeSeries};
use pipeline::PipelineConfig;
use pipeline::config::PIPELINE_FILE;
use pipeline::log::LogIndex;
use pipeline::setup::Setup;

/// What moves the moment that is shown.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Playback {
    /// The moment, seconds.
    pub(crate) time: f64,
    /// It moves on by itself; of a live source: the newest is shown.
    pub(crate) playing: bool,
    /// Seconds a second.
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

/// A moment that somebody marked.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Mark {
    /// Seconds.
    pub(crate) time: f64,
    /// Why.
    pub(crate) text: String,
}

/// Everything that panels draw.
pub(crate) struct Session {
    /// Where the cycles come from.
    pub(crate) source: Source,
    /// In words.
    pub(crate) title: String,
    /// Field, camera and map; none if the source does not say.
    pub(crate) scene: Option<Arc<StaticScene>>,
    /// The cycle that is shown.
    pub(crate) shown: Option<DecodedCycle>,
    /// Numbers of the whole run, as far as it was read.
    pub(crate) series: TimeSeries,
    /// The same, computed once more with other settings.
    pub(crate) recompute: Option<Recompute>,
    /// The moment that is shown.
    pub(crate) playback: Playback,
    /// Marked moments, in order.
    pub(crate) marks: Vec<Mark>,
    /// What the source lacks, a line each.
    pub(crate) warnings: Vec<String>,
    /// What went wrong last.
    pub(crate) last_error: Option<String>,
    /// The settings the source runs with (a log: ran with).
    pub(crate) source_config: PipelineConfig,
    /// Device by device.
    pub(crate) devices: DeviceMonitor,
    /// Layers painted last.
    pub(crate) rendered_layers: RenderedLayers,
    /// Classes learned from painted labels.
    pub(crate) colour_table: Option<Arc<ColourTable>>,
    /// What the robot sees of itself; false where it does.
    pub(crate) mask: Option<Arc<Vec<bool>>>,
    /// Counts changes of settings, table and mask.
    pub(crate) revision: u64,
    metrics_reader: Option<MetricsReader>,
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
            warnings: Vec::new(),
            last_error: None,
            source_config: PipelineConfig::default(),
            devices: DeviceMonitor::default(),
            rendered_layers: RenderedLayers::default(),
            colour_table: None,
            mask: None,
            revision: 0,
            metrics_reader: None,
        }
    }
}

impl Session {
    /// Opens a log (`.mcap`), a scenario (`.toml`), which then plays, or the stream of a robot (`host:port`).
    pub(crate) fn open(path: &Path) -> Result<Self> {
        let text = path.to_string_lossy();
        let port = text.rsplit_once(':').map(|(_, port)| port.parse::<u16>());
        if !path.exists() && (text.starts_with("ws://") || matches!(port, Some(Ok(_)))) {
            return Session::connect(&text);
        }
        if path.extension().is_some_and(|end| end == "toml") {
            Session::open_scenario(path, None, PipelineConfig::default())
        } else {
            Session::log(path)
        }
    }

    /// Opens a log of any version.
    pub(crate) fn log(path: &Path) -> Result<Self> {
        let mut player = LogPlayer::new(LogIndex::open(path)?);
        let mut missing = player.index().warnings().to_vec();
        let stage = match player.load_setup() {
            Ok(setup) => Some(Arc::new(StaticScene::new(setup))),
            Err(error) => {
                missing.push(format!(
                    "the log's robot cannot be built: {error:#}; field and map are missing"
                ));
                None
            }
        };
        let ran_with = parse_config(
            player.index().header().files.get(PIPELINE_FILE),
            &mut missing,
        );
        let base = base_config_of(stage.as_deref());
        let survey = MetricsReader::start(player.index().clone(), base)?;
        let mut session = Session {
            title: format!("log {}", path.display()),
            playback: Playback {
                time: player.span().0,
                ..Playback::default()
            },
            source: Source::Log(Box::new(player)),
            scene: stage,
            warnings: missing,
            source_config: ran_with,
            metrics_reader: Some(survey),
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

    /// Watches a robot over the network.
    pub(crate) fn connect(address: &str) -> Result<Self> {
        let inbox = CycleInbox::default();
        let remote = remote::connect(address, inbox.clone())?;
        let mut missing: Vec<String> = remote.header.version_mismatch().into_iter().collect();
        let ran_with = parse_config(remote.header.files.get(PIPELINE_FILE), &mut missing);
        let live = LiveSource::new(inbox, None).with_guard(remote.guard, Some(remote.folder));
        let name = format!("{address}: {}", remote.header.source);
        Ok(Session {
            warnings: missing,
            ..Session::from_live(name, live, remote.setup, ran_with)
        })
    }

    /// Watches something that goes on by itself.
    pub(crate) fn from_live(
        name: String,
        live: LiveSource,
        setup: Setup,
        ran_with: PipelineConfig,
    ) -> Self {
        Session {
            title: name,
            source: Source::Live(Box::new(live)),
            scene: Some(Arc::new(StaticScene::new(setup))),
            playback: Playback {
                playing: true,
                ..Playback::default()
            },
            source_config: ran_with,
            ..Session::default()
        }
    }

    /// The log's file.
    pub(crate) fn log_path(&self) -> Option<PathBuf> {
        match &self.source {
            Source::Log(player) => Some(player.index().path().to_owned()),
            _ => None,
        }
    }

    /// The wheels, as far as the source says.
    pub(crate) fn base_config(&self) -> BaseConfig {
        base_config_of(self.scene.as_deref())
    }

    /// First and last moment, seconds: of the log, or of all that was seen live.
    pub(crate) fn span(&self) -> Option<(f64, f64)> {
        let held = self.source.span()?;
        let first = self.series.samples().first();
        Some((
            first.map_or(held.0, |sample| sample.time.min(held.0)),
            held.1,
        ))
    }

    /// Takes what came, and moves the clock by `passed` seconds; true if there is something new to draw.
    pub(crate) fn update(&mut self, passed: f64) -> bool {
        let mut news = false;
        let base = self.base_config();
        if let Some(survey) = &mut self.metrics_reader {
            for sample in survey.poll() {
                self.series.push(sample);
                news = true;
            }
            if survey.is_done() {
                self.metrics_reader = None;
            }
        }
        if let Some(recompute) = &mut self.recompute
            && !recompute.done
        {
            recompute.poll();
            news = true;
        }
        if let Source::Live(live) = &mut self.source {
            let (came, mut dropped) = live.poll();
            self.devices.dropped += dropped;
            if live.status.is_some() {
                self.last_error.clone_from(&live.status);
            }
            for shown in &came {
                self.devices.update(&shown.cycle);
                let lost = std::mem::take(&mut dropped);
                self.series
                    .push(CycleMetrics::from_cycle(&shown.cycle, &base, lost));
            }
            if self.playback.playing && !came.is_empty() {
                self.shown = live.newest();
                self.playback.time = self.shown_time().unwrap_or(self.playback.time);
            }
            news |= !came.is_empty();
        } else if self.playback.playing {
            self.advance(passed);
            news = true;
        }
        news
    }

    /// The log's next moments, by the clock's speed.
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
        let found = self.source.seek(at);
        self.set_shown(found);
    }

    /// Shows the moment `time`.
    pub(crate) fn seek(&mut self, time: f64) {
        if !matches!(self.source, Source::Live(_)) {
            self.devices = DeviceMonitor::default();
        } else {
            self.playback.playing = false;
        }
        self.playback.time = time;
        let found = self.source.seek(time);
        self.set_shown(found);
    }

    /// Goes so many cycles on or back, and stands there.
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
            // The cycle that comes is to be shown.
            self.playback.playing = true;
            return;
        }
        let found = self.source.step(by);
        if matches!(found, Ok(Some(_))) {
            self.set_shown(found);
            self.playback.time = self.shown_time().unwrap_or(self.playback.time);
        } else {
            self.last_error = found
                .err()
                .map(|error| format!("{error:#}"))
                .or(self.last_error.take());
        }
    }

    fn set_shown(&mut self, found: Result<Option<DecodedCycle>>) {
        match found {
            Ok(Some(shown)) => {
                let same = self
                    .shown
                    .as_ref()
                    .is_some_and(|now| now.cycle.stamp == shown.cycle.stamp);
                if !same && matches!(self.source, Source::Log(_)) {
                    self.devices.update(&shown.cycle);
                }
                self.last_error = None;
                self.shown = Some(shown);
            }
            Ok(None) => {}
            Err(error) => {
                self.playback.playing = false;
                self.last_error = Some(format!("{error:#}"));
            }
        }
    }

    /// Plays or stands still; a simulation of the view's own stands still itself.
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

    /// Seconds a second from now on; what somebody else drives keeps its own pace.
    pub(crate) fn set_speed(&mut self, speed: f64) {
        self.playback.speed = speed.clamp(0.05, 100.0);
        if let Some(worker) = self.source.simulation() {
            worker.request(SourceRequest::SetSpeed(self.playback.speed));
        }
    }

    /// The shown cycle's time, seconds.
    pub(crate) fn shown_time(&self) -> Option<f64> {
        self.shown.as_ref().map(|now| now.cycle.stamp.seconds())
    }

    /// Marks the shown moment.
    pub(crate) fn add_mark(&mut self, text: &str) {
        let time = self.playback.time;
        let place = self.marks.partition_point(|mark| mark.time <= time);
        let text = text.to_owned();
        self.marks.insert(place, Mark { time, text });
    }

    /// Computes the log once more with other settings.
    pub(crate) fn start_recompute(&mut self, config: &PipelineConfig) {
        let Some(path) = self.log_path() else {
            return;
        };
        match Recompute::start(&path, config.clone()) {
            Ok(recompute) => self.recompute = Some(recompute),
            Err(error) => self.last_error = Some(format!("{error:#}")),
        }
    }

    /// The shown cycle as a job for the painter.
    pub(crate) fn layer_job(
        &self,
        config: &PipelineConfig,
        wanted: LayerSelection,
    ) -> Option<LayerJob> {
        let (stage, shown) = (self.scene.as_ref()?, self.shown.as_ref()?);
        Some(LayerJob {
            scene: stage.clone(),
            cycle: shown.cycle.clone(),
            vision: config.vision.clone(),
            colour_table: self.colour_table.clone(),
            mask: self.mask.clone().or_else(|| stage.mask.clone()),
            revision: self.revision,
            selection: wanted,
        })
    }
}

fn base_config_of(stage: Option<&StaticScene>) -> BaseConfig {
    stage
        .and_then(|stage| stage.robot.base.clone())
        .unwrap_or_default()
}

/// The settings in a log; those of another version as far as they are known here.
fn parse_config(text: Option<&Vec<u8>>, missing: &mut Vec<String>) -> PipelineConfig {
    let Some(text) = text else {
        return PipelineConfig::default();
    };
    let text = String::from_utf8_lossy(text);
    toml::from_str(&text).unwrap_or_else(|error: toml::de::Error| {
        missing.push(format!(
            "its settings are another version's ({}): the defaults are shown",
            error.message()
        ));
        PipelineConfig::default()
    })
}
