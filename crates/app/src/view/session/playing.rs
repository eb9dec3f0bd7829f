//! Which cycle is shown? Playing, seeking and stepping; new data of the threads.

use anyhow::Result;
use localize::Stamp;

use super::{Mark, Session};
use crate::view::device_monitor::DeviceMonitor;
use crate::view::run_findings::STAMP_ROUNDING;
use crate::view::source::Source;
use crate::view::source::decoded_cycle::DecodedCycle;
use crate::view::source::sim_worker::SourceRequest;
use crate::view::time_series::CycleMetrics;

/// Longest step of a playing log over which the devices' statistics continue, seconds: a frame at the highest speed.
const MONITORED_JUMP: f64 = 10.0;
/// Time before a jump's target from which the statistics start, seconds.
const MONITORED_BEFORE: f64 = 2.0;

impl Session {
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
            for (chunk, span) in read.damaged {
                self.damage.push(chunk, span);
                changed = true;
            }
            for (time, settings) in read.setting_changes {
                let first = &self.source_config;
                self.setting_changes.push_toml(time, &settings, first);
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
        changed |= self.curves.poll();
        if let Some(recompute) = &mut self.recompute
            && !recompute.done
        {
            recompute.poll();
            changed = true;
        }
        if let Source::Live(live) = &mut self.source {
            let (received, mut dropped) = live.poll();
            self.devices.dropped += dropped;
            for shown in &received {
                self.devices.update(&shown.cycle);
                if let Some(settings) = &shown.cycle.inputs.changed_config_toml {
                    let (time, first) = (shown.cycle.stamp.seconds(), &self.source_config);
                    self.setting_changes.push_toml(time, settings, first);
                }
                self.curves.push_live(&shown.cycle);
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
        let (time, playing) = (self.playback.time, self.playback.playing);
        for other in &mut self.others {
            changed |= other.update(time, playing);
        }
        let complete = self.metrics_reader.is_none();
        self.curves.update_formulas(&self.series, complete);
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

    /// Pauses and shows the next mark (`ahead`) or the previous one, if there is one.
    pub(crate) fn next_mark(&mut self, ahead: bool) {
        let now = self.playback.time;
        let mut times = self.marks.iter().map(|mark| mark.time);
        let found = if ahead {
            times.find(|time| *time > now + STAMP_ROUNDING)
        } else {
            times.rfind(|time| *time < now - STAMP_ROUNDING)
        };
        if let Some(time) = found {
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

    /// Shows the first cycle that can be read, and states why the log's first one cannot.
    pub(super) fn show_first_readable(&mut self) {
        let damage = self.last_error.take();
        if let Source::Log(player) = &mut self.source {
            let found = player.first_readable();
            self.set_shown(found);
            self.playback.time = self.shown_time().unwrap_or(self.playback.time);
        }
        self.last_error = damage.or(self.last_error.take());
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

    /// Adds a mark at the shown time.
    pub(crate) fn add_mark(&mut self, text: &str) {
        let time = self.playback.time;
        let place = self.marks.partition_point(|mark| mark.time <= time);
        let text = text.to_owned();
        self.marks.insert(place, Mark { time, text });
    }
}
