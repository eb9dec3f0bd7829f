//! What is being looked at? One source with its stage, the moment shown, and all that was gathered of its run.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Result;
use localize::robot::BaseConfig;
use vision::labels::ColourTable;

use super::devices::Devices;
use super::layers::{Job, Painted, Wanted};
use super::series::{Sample, Series};
use super::source::live::{Inbox, Live};
use super::source::log::Player;
use super::source::recompute::Recompute;
use super::source::survey::Survey;
use super::source::worker::{Order, SimWorker};
use super::source::{Shown, Source, remote};
use super::stage::Stage;
use pipeline::cycle::{PIPELINE_FILE, PipelineConfig};
use pipeline::log::LogIndex;
use pipeline::setup::Setup;

/// What moves the moment that is shown.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Clock {
    /// The moment, seconds.
    pub(crate) at: f64,
    /// It moves on by itself; of a live source: the newest is shown.
    pub(crate) playing: bool,
    /// Seconds a second.
    pub(crate) speed: f64,
}

impl Default for Clock {
    fn default() -> Self {
        Clock {
            at: 0.0,
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
    pub(crate) name: String,
    /// Field, camera and map; none if the source does not say.
    pub(crate) stage: Option<Arc<Stage>>,
    /// The cycle that is shown.
    pub(crate) now: Option<Shown>,
    /// Numbers of the whole run, as far as it was read.
    pub(crate) series: Series,
    /// The same, computed once more with other settings.
    pub(crate) recompute: Option<Recompute>,
    /// The moment that is shown.
    pub(crate) clock: Clock,
    /// Marked moments, in order.
    pub(crate) marks: Vec<Mark>,
    /// What the source lacks, a line each.
    pub(crate) missing: Vec<String>,
    /// What went wrong last.
    pub(crate) fault: Option<String>,
    /// The settings the source runs with (a log: ran with).
    pub(crate) ran_with: PipelineConfig,
    /// Device by device.
    pub(crate) devices: Devices,
    /// Layers painted last.
    pub(crate) painted: Painted,
    /// Classes learned from painted labels.
    pub(crate) table: Option<Arc<ColourTable>>,
    /// What the robot sees of itself; false where it does.
    pub(crate) mask: Option<Arc<Vec<bool>>>,
    /// Counts changes of settings, table and mask.
    pub(crate) version: u64,
    survey: Option<Survey>,
}

impl Default for Session {
    fn default() -> Self {
        Session {
            source: Source::Nothing,
            name: String::new(),
            stage: None,
            now: None,
            series: Series::default(),
            recompute: None,
            clock: Clock::default(),
            marks: Vec::new(),
            missing: Vec::new(),
            fault: None,
            ran_with: PipelineConfig::default(),
            devices: Devices::default(),
            painted: Painted::default(),
            table: None,
            mask: None,
            version: 0,
            survey: None,
        }
    }
}

impl Session {
    /// Opens a log (`.mcap`), a scenario (`.toml`), which then plays, or the stream of a robot (`host:port`).
    pub(crate) fn open(path: &Path) -> Result<Self> {
        let text = path.to_string_lossy();
        let port = text.rsplit_once(':').map(|(_, port)| port.parse::<u16>());
        if !path.exists() && (text.starts_with("ws://") || matches!(port, Some(Ok(_)))) {
            return Session::remote(&text);
        }
        if path.extension().is_some_and(|end| end == "toml") {
            Session::simulate(path, None, PipelineConfig::default())
        } else {
            Session::log(path)
        }
    }

    /// Opens a log of any version.
    pub(crate) fn log(path: &Path) -> Result<Self> {
        let mut player = Player::new(LogIndex::open(path)?);
        let mut missing = player.index().warnings().to_vec();
        let stage = match player.setup() {
            Ok(setup) => Some(Arc::new(Stage::new(setup))),
            Err(error) => {
                missing.push(format!(
                    "the log's robot cannot be built: {error:#}; field and map are missing"
                ));
                None
            }
        };
        let ran_with = settings(
            player.index().header().files.get(PIPELINE_FILE),
            &mut missing,
        );
        let base = base_of(stage.as_deref());
        let survey = Survey::start(player.index().clone(), base)?;
        let mut session = Session {
            name: format!("log {}", path.display()),
            clock: Clock {
                at: player.span().0,
                ..Clock::default()
            },
            source: Source::Log(Box::new(player)),
            stage,
            missing,
            ran_with,
            survey: Some(survey),
            ..Session::default()
        };
        session.step(1);
        Ok(session)
    }

    /// Plays a scenario.
    pub(crate) fn simulate(path: &Path, seed: Option<u64>, config: PipelineConfig) -> Result<Self> {
        let inbox = Inbox::default();
        let (worker, setup) = SimWorker::start(path, seed, config.clone(), inbox.clone())?;
        let live = Live::new(inbox, Some(worker));
        let name = format!("simulation {}", path.display());
        Ok(Session::live(name, live, setup, config))
    }

    /// Watches a robot over the network.
    pub(crate) fn remote(address: &str) -> Result<Self> {
        let inbox = Inbox::default();
        let remote = remote::connect(address, inbox.clone())?;
        let mut missing: Vec<String> = remote.header.version_mismatch().into_iter().collect();
        let ran_with = settings(remote.header.files.get(PIPELINE_FILE), &mut missing);
        let live = Live::new(inbox, None).with_lease(remote.lease, Some(remote.folder));
        let name = format!("{address}: {}", remote.header.source);
        Ok(Session {
            missing,
            ..Session::live(name, live, remote.setup, ran_with)
        })
    }

    /// Watches something that goes on by itself.
    pub(crate) fn live(name: String, live: Live, setup: Setup, ran_with: PipelineConfig) -> Self {
        Session {
            name,
            source: Source::Live(Box::new(live)),
            stage: Some(Arc::new(Stage::new(setup))),
            clock: Clock {
                playing: true,
                ..Clock::default()
            },
            ran_with,
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
    pub(crate) fn base(&self) -> BaseConfig {
        base_of(self.stage.as_deref())
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
        let base = self.base();
        if let Some(survey) = &mut self.survey {
            for sample in survey.take() {
                self.series.push(sample);
                news = true;
            }
            if survey.done() {
                self.survey = None;
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
            if live.word.is_some() {
                self.fault.clone_from(&live.word);
            }
            for shown in &came {
                self.devices.take(&shown.cycle);
                let lost = std::mem::take(&mut dropped);
                self.series.push(Sample::of(&shown.cycle, &base, lost));
            }
            if self.clock.playing && !came.is_empty() {
                self.now = live.newest();
                self.clock.at = self.time().unwrap_or(self.clock.at);
            }
            news |= !came.is_empty();
        } else if self.clock.playing {
            self.play(passed);
            news = true;
        }
        news
    }

    /// The log's next moments, by the clock's speed.
    fn play(&mut self, passed: f64) {
        let Some((_, end)) = self.source.span() else {
            return;
        };
        let before = self.clock.at;
        let at = (before + passed * self.clock.speed).min(end);
        if at >= end {
            self.clock.playing = false;
        }
        self.clock.at = at;
        let found = self.source.seek(at);
        self.show(found);
    }

    /// Shows the moment `time`.
    pub(crate) fn seek(&mut self, time: f64) {
        if !matches!(self.source, Source::Live(_)) {
            self.devices = Devices::default();
        } else {
            self.clock.playing = false;
        }
        self.clock.at = time;
        let found = self.source.seek(time);
        self.show(found);
    }

    /// Goes so many cycles on or back, and stands there.
    pub(crate) fn step(&mut self, by: i64) {
        self.clock.playing = false;
        let at_end = self
            .source
            .span()
            .is_none_or(|(_, end)| self.time().is_none_or(|now| now >= end - 1e-9));
        if let Some(worker) = self.source.simulation()
            && by > 0
            && at_end
        {
            worker.order(Order::Step);
            // The cycle that comes is to be shown.
            self.clock.playing = true;
            return;
        }
        let found = self.source.step(by);
        if matches!(found, Ok(Some(_))) {
            self.show(found);
            self.clock.at = self.time().unwrap_or(self.clock.at);
        } else {
            self.fault = found
                .err()
                .map(|error| format!("{error:#}"))
                .or(self.fault.take());
        }
    }

    fn show(&mut self, found: Result<Option<Shown>>) {
        match found {
            Ok(Some(shown)) => {
                let same = self
                    .now
                    .as_ref()
                    .is_some_and(|now| now.cycle.stamp == shown.cycle.stamp);
                if !same && matches!(self.source, Source::Log(_)) {
                    self.devices.take(&shown.cycle);
                }
                self.fault = None;
                self.now = Some(shown);
            }
            Ok(None) => {}
            Err(error) => {
                self.clock.playing = false;
                self.fault = Some(format!("{error:#}"));
            }
        }
    }

    /// Plays or stands still; a simulation of the view's own stands still itself.
    pub(crate) fn play_or_pause(&mut self) {
        self.clock.playing = !self.clock.playing;
        let playing = self.clock.playing;
        if let Some(worker) = self.source.simulation() {
            worker.order(Order::Pause(!playing));
        } else if let Some((start, end)) = self.source.span()
            && playing
            && matches!(self.source, Source::Log(_))
            && self.clock.at >= end
        {
            self.seek(start);
        }
    }

    /// Seconds a second from now on; what somebody else drives keeps its own pace.
    pub(crate) fn pace(&mut self, speed: f64) {
        self.clock.speed = speed.clamp(0.05, 100.0);
        if let Some(worker) = self.source.simulation() {
            worker.order(Order::Pace(self.clock.speed));
        }
    }

    /// The shown cycle's time, seconds.
    pub(crate) fn time(&self) -> Option<f64> {
        self.now.as_ref().map(|now| now.cycle.stamp.seconds())
    }

    /// Marks the shown moment.
    pub(crate) fn mark(&mut self, text: &str) {
        let time = self.clock.at;
        let place = self.marks.partition_point(|mark| mark.time <= time);
        let text = text.to_owned();
        self.marks.insert(place, Mark { time, text });
    }

    /// Computes the log once more with other settings.
    pub(crate) fn compute_again(&mut self, config: &PipelineConfig) {
        let Some(path) = self.log_path() else {
            return;
        };
        match Recompute::start(&path, config.clone()) {
            Ok(recompute) => self.recompute = Some(recompute),
            Err(error) => self.fault = Some(format!("{error:#}")),
        }
    }

    /// The shown cycle as a job for the painter.
    pub(crate) fn job(&self, config: &PipelineConfig, wanted: Wanted) -> Option<Job> {
        let (stage, shown) = (self.stage.as_ref()?, self.now.as_ref()?);
        Some(Job {
            stage: stage.clone(),
            cycle: shown.cycle.clone(),
            vision: config.vision.clone(),
            table: self.table.clone(),
            mask: self.mask.clone().or_else(|| stage.mask.clone()),
            version: self.version,
            wanted,
        })
    }
}

fn base_of(stage: Option<&Stage>) -> BaseConfig {
    stage
        .and_then(|stage| stage.robot.base.clone())
        .unwrap_or_default()
}

/// The settings in a log; those of another version as far as they are known here.
fn settings(text: Option<&Vec<u8>>, missing: &mut Vec<String>) -> PipelineConfig {
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
