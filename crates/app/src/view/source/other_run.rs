//! A second run on the timeline of the first: another log, or another robot's live stream.

use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use localize::Pose;
use localize::robot::BaseConfig;
use pipeline::config::PIPELINE_FILE;
use pipeline::log::{Header, LogIndex};
use pipeline::{Cycle, PipelineConfig};

use super::inbox::CycleInbox;
use super::live::LiveSource;
use super::log::LogPlayer;
use super::metrics_reader::MetricsReader;
use super::{Source, is_stream_address, remote};
use crate::view::time_series::{CycleMetrics, TimeSeries};

/// A run that is shown beside the first one.
pub(crate) struct OtherRun {
    /// File name or address.
    pub(crate) name: String,
    /// Metrics of its cycles, at times of the first run.
    pub(crate) series: TimeSeries,
    /// What is added to its times to get those of the first run, seconds.
    offset: f64,
    source: Source,
    base: BaseConfig,
    /// Its number in the team; None if its settings are unknown.
    robot: Option<u32>,
    metrics_reader: Option<MetricsReader>,
    /// Its cycle at the shown time, without image.
    pub(crate) cycle: Option<Arc<Cycle>>,
}

impl OtherRun {
    /// Opens a log or connects to a robot. `clock_offset_ns` is that of the first run: two runs whose clocks are known
    /// are aligned by them.
    pub(crate) fn open(path: &Path, clock_offset_ns: i64) -> Result<Self> {
        if is_stream_address(path) {
            return OtherRun::connect(&path.to_string_lossy(), clock_offset_ns);
        }
        if path.is_dir() || path.extension().is_some_and(|end| end == "toml") {
            bail!(
                "{}: only a log or a robot's stream can be shown beside another run",
                path.display()
            );
        }
        let mut player = LogPlayer::new(LogIndex::open(path)?);
        let setup = player.load_setup().ok();
        let base = setup.and_then(|setup| setup.robot.base).unwrap_or_default();
        let header = player.index().header();
        let (offset, robot) = (
            offset_between(header, clock_offset_ns),
            robot_number(header),
        );
        let reader = MetricsReader::start(player.index().clone(), base.clone())
            .context("cannot start a thread")?;
        let name = path.file_name().unwrap_or(path.as_os_str());
        Ok(OtherRun {
            name: name.to_string_lossy().into_owned(),
            series: TimeSeries::default(),
            offset,
            source: Source::Log(Box::new(player)),
            base,
            robot,
            metrics_reader: Some(reader),
            cycle: None,
        })
    }

    fn connect(address: &str, clock_offset_ns: i64) -> Result<Self> {
        let inbox = CycleInbox::default();
        let remote = remote::connect(address, inbox.clone())?;
        let offset = offset_between(&remote.header, clock_offset_ns);
        let live = LiveSource::new(inbox, None).with_guard(remote.guard, Some(remote.folder));
        Ok(OtherRun {
            name: address.to_owned(),
            series: TimeSeries::default(),
            offset,
            source: Source::Live(Box::new(live)),
            base: remote.setup.robot.base.unwrap_or_default(),
            robot: robot_number(&remote.header),
            metrics_reader: None,
            cycle: None,
        })
    }

    /// What is added to its times, seconds.
    pub(crate) fn offset(&self) -> f64 {
        self.offset
    }

    /// Moves it on the timeline.
    pub(crate) fn set_offset(&mut self, offset: f64) {
        self.series.shift(offset - self.offset);
        self.offset = offset;
    }

    /// First and last time on the timeline of the first run, seconds.
    pub(crate) fn span(&self) -> Option<(f64, f64)> {
        let (start, end) = self.source.span()?;
        Some((start + self.offset, end + self.offset))
    }

    /// Takes new data; `time` is the shown time of the first run, seconds.
    pub(crate) fn update(&mut self, time: f64, follow: bool) -> bool {
        let mut samples = Vec::new();
        if let Some(reader) = &mut self.metrics_reader {
            samples = reader.poll().samples;
            if reader.is_done() {
                self.metrics_reader = None;
            }
        }
        if let Source::Live(live) = &mut self.source {
            let (received, dropped) = live.poll();
            let metrics = received
                .iter()
                .map(|shown| CycleMetrics::from_cycle(&shown.cycle, &self.base, dropped));
            samples.extend(metrics);
        }
        let changed = !samples.is_empty();
        for mut sample in samples {
            sample.time += self.offset;
            self.series.push(sample);
        }
        let live = matches!(self.source, Source::Live(_));
        let time = if live && follow {
            f64::INFINITY
        } else {
            time - self.offset
        };
        self.cycle = self.source.cycle_at(time);
        changed
    }

    /// Is it a run of another robot than the first run (its source, and its robot's number in the team)? Otherwise their
    /// difference tells something.
    pub(crate) fn is_another_robot(&self, first: &Source, first_robot: u32) -> bool {
        let is_live = |source: &Source| matches!(source, Source::Live(_));
        // A robot has one stream: another stream at the same time is another robot's.
        is_live(&self.source) && is_live(first)
            || self.robot.is_some_and(|robot| robot != first_robot)
    }

    /// Its pose at the shown time; None while lost, and where it has no cycle.
    pub(crate) fn pose(&self) -> Option<Pose> {
        self.cycle.as_ref()?.estimate.pose
    }
}

/// The robot's number in its team, by the settings in a log.
fn robot_number(header: &Header) -> Option<u32> {
    let settings = String::from_utf8_lossy(header.files.get(PIPELINE_FILE)?);
    let config = PipelineConfig::parse(&settings).ok()?;
    Some(config.team.number)
}

/// From the stamps of a log to those of another one, seconds; 0 unless both clocks are known.
fn offset_between(header: &Header, clock_offset_ns: i64) -> f64 {
    match (header.clock_offset_ns, clock_offset_ns) {
        (0, _) | (_, 0) => 0.0,
        (other, first) => other.saturating_sub(first) as f64 * 1e-9,
    }
}
