//! What is the state of a run? A status line, messages on changes, and a report at the end.

use std::io::IsTerminal;

use hw::{DeviceEvent, HealthReport, HealthState};
use localize::Stamp;
use localize::estimate::Mode;
use serde::Serialize;

use super::field_half::FieldHalf;
use super::latency::{LatencyHistogram, LatencySummary};
use super::log_rotation::LogSummary;
use super::repeated_lines::RepeatedLines;
use super::stderr_writer::StderrWriter;
use super::unused_images::{Change, UnusedImages};
use crate::net::commands::CommandCounts;
#[cfg(feature = "ros2")]
use crate::ros2::Ros2Counts;
use pipeline::Cycle;
use pipeline::datagram::authentication::RejectReason;
use pipeline::datagram::{TeamClock, TeamLinkCounts};
use pipeline::result_files::mode_name;

/// Period of the status line on a terminal, seconds.
const TERMINAL_PERIOD: f64 = 0.5;
/// Period of the status lines without a terminal (in a journal), seconds.
const JOURNAL_PERIOD: f64 = 60.0;
/// Maximum number of changes in the report, against a device that reconnects all day.
const CHANGES_MAX: usize = 10_000;
/// Time of the first memory measurement, seconds after the start: by then all tables and buffers are allocated.
const MEMORY_BASELINE_TIME: f64 = 60.0;

/// What `--json` prints at the end.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct RunReport {
    /// Duration, seconds.
    pub seconds: f64,
    /// Images that vision processed.
    pub frames: u64,
    /// Cycles without a usable image.
    pub blind: u64,
    /// Of these, those with an image that could not be used.
    pub images_unused: u64,
    /// Cycles in mode tracking.
    pub tracking: u64,
    /// Cycles whose pose was found by the global search.
    pub global: u64,
    /// Cycles without a pose.
    pub lost: u64,
    /// From the image's exposure until commands use its pose, milliseconds.
    pub latency_ms: LatencySummary,
    /// From the exposure until the whole cycle was published, ball and robots included, milliseconds.
    pub cycle_latency_ms: LatencySummary,
    /// From the exposure until the pipeline received the image, milliseconds.
    pub arrival_ms: LatencySummary,
    /// Image to features, milliseconds.
    pub see_ms: LatencySummary,
    /// Features to pose, milliseconds.
    pub localize_ms: LatencySummary,
    /// Real-time priority of the run, 0 for none.
    pub realtime_priority: i32,
    /// How late a sleeping thread of this run's priority woke meanwhile: the machine's share of the latencies, milliseconds.
    pub wake_up_ms: LatencySummary,
    /// Images replaced by a newer one before they were processed.
    pub frames_replaced: u64,
    /// Samples dropped in favour of newer ones.
    pub samples_dropped: u64,
    /// Samples with values that are not finite.
    pub samples_refused: u64,
    /// Images that came after a cycle of a later time, and were not used.
    pub images_overtaken: u64,
    /// Memory of the process after its first minute, MB. None for a shorter run.
    pub memory_first_mb: Option<f64>,
    /// Maximum since then, MB.
    pub memory_max_mb: Option<f64>,
    /// At the end, MB.
    pub memory_mb: f64,
    /// The base took the stop command before the end; true without a base.
    pub wheels_stopped: bool,
    /// Counts of remote commands, if they are configured.
    pub commands: Option<CommandCounts>,
    /// Clocks of the team-mates, if there is a team.
    pub team: Option<Vec<TeamClock>>,
    /// Counts of team messages, if there is a team.
    pub team_messages: Option<TeamLinkCounts>,
    /// Counts of the node of ROS 2, if there is one.
    #[cfg(feature = "ros2")]
    pub ros2: Option<Ros2Counts>,
    /// State of every device.
    pub devices: Vec<HealthReport>,
    /// Every change of a device or the log, in order.
    pub changes: Vec<StateChange>,
    /// The log, if there was one.
    pub log: Option<LogSummary>,
    /// Why outputs do not exist; empty when all is well.
    pub outputs_lost: Vec<String>,
    /// Sentences about a doubtful set-up or an incomplete log; empty when all is well.
    pub warnings: Vec<String>,
}

/// A change of a device or the log.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct StateChange {
    /// CLOCK_MONOTONIC, seconds.
    pub stamp_s: f64,
    /// Name of the device, or "log".
    pub device: String,
    /// New state.
    pub state: String,
    /// Reason.
    pub reason: Option<String>,
}

/// What the parts of a run report at its end.
pub(crate) struct RunOutcome {
    /// Images and samples dropped by the event queue.
    pub dropped: hw::DroppedInputs,
    /// Real-time priority of the run, 0 for none.
    pub realtime_priority: i32,
    /// Delays of a sleeping thread of the run's priority.
    pub wake_up: LatencySummary,
    /// Samples with values that are not finite.
    pub samples_refused: u64,
    /// Images that came after a cycle of a later time.
    pub images_overtaken: u64,
    /// The base took the stop command; true without a base.
    pub wheels_stopped: bool,
    /// Counts of remote commands, if they are configured.
    pub commands: Option<CommandCounts>,
    /// Clocks of the team-mates, if there is a team.
    pub team: Option<Vec<TeamClock>>,
    /// Counts of team messages, if there is a team.
    pub team_messages: Option<TeamLinkCounts>,
    /// Counts of the node of ROS 2, if there is one.
    #[cfg(feature = "ros2")]
    pub ros2: Option<Ros2Counts>,
    /// State of every device.
    pub devices: Vec<HealthReport>,
    /// The log, if there was one.
    pub log: Option<LogSummary>,
    /// Why outputs do not exist.
    pub outputs_lost: Vec<String>,
    /// Sentences about a doubtful set-up or an incomplete log.
    pub warnings: Vec<String>,
}

/// Numbers of cycles by mode.
#[derive(Default)]
struct ModeCounts {
    tracking: u64,
    global: u64,
    lost: u64,
}

/// When the parts of a cycle were done.
pub(crate) struct CycleTimes {
    /// The pipeline received the image.
    pub(crate) received: Stamp,
    /// Commands use its pose.
    pub(crate) located: Stamp,
    /// Every subscriber has the cycle, ball and robots included.
    pub(crate) published: Stamp,
}

/// Collects statistics of a run and prints its messages.
pub(crate) struct RunStatus {
    started: Stamp,
    stderr: StderrWriter,
    terminal: bool,
    next_line: Stamp,
    line_shown: bool,
    frames: u64,
    cycles_without_image: u64,
    unused_images: UnusedImages,
    field_half: FieldHalf,
    modes: ModeCounts,
    latency: LatencyHistogram,
    cycle_latency: LatencyHistogram,
    arrival: LatencyHistogram,
    vision_time: LatencyHistogram,
    localize: LatencyHistogram,
    changes: Vec<StateChange>,
    repeated: RepeatedLines,
    memory_first_mb: Option<f64>,
    memory_max_mb: Option<f64>,
    next_memory: Stamp,
}

impl RunStatus {
    /// Starts now.
    pub(crate) fn new() -> Self {
        let started = hw::now();
        RunStatus {
            started,
            stderr: StderrWriter::start(),
            terminal: std::io::stderr().is_terminal(),
            next_line: started + TERMINAL_PERIOD,
            line_shown: false,
            frames: 0,
            cycles_without_image: 0,
            unused_images: UnusedImages::default(),
            field_half: FieldHalf::default(),
            modes: ModeCounts::default(),
            latency: LatencyHistogram::default(),
            cycle_latency: LatencyHistogram::default(),
            arrival: LatencyHistogram::default(),
            vision_time: LatencyHistogram::default(),
            localize: LatencyHistogram::default(),
            changes: Vec::new(),
            repeated: RepeatedLines::default(),
            memory_first_mb: None,
            memory_max_mb: None,
            next_memory: started + MEMORY_BASELINE_TIME,
        }
    }

    /// Seconds since the start.
    pub(crate) fn elapsed(&self) -> f64 {
        hw::now() - self.started
    }

    /// Counts a cycle.
    pub(crate) fn count_cycle(&mut self, cycle: &Cycle, times: &CycleTimes) {
        match cycle.estimate.mode {
            Mode::Tracking => self.modes.tracking += 1,
            Mode::Global => self.modes.global += 1,
            Mode::Lost => self.modes.lost += 1,
        }
        match self.unused_images.count_cycle(cycle) {
            Some(Change::NotUsed(reason)) => {
                self.print_line(&format!("images are not used: {reason}"));
                self.record_change("images", "not used", Some(reason));
            }
            Some(Change::UsedAgain) => {
                self.print_line("images are used again");
                self.record_change("images", "used", None);
            }
            None => {}
        }
        if let Some(change) = self.field_half.take(&cycle.estimate) {
            self.print_line(change.text());
            self.record_change("field half", change.state(), Some(change.text().to_owned()));
        }
        if cycle.detections.is_none() {
            self.cycles_without_image += 1;
            return;
        }
        self.frames += 1;
        let since_exposure_ms = |time: Stamp| (time - cycle.stamp) * 1e3;
        self.arrival.add(since_exposure_ms(times.received));
        self.latency.add(since_exposure_ms(times.located));
        self.cycle_latency.add(since_exposure_ms(times.published));
        self.vision_time.add(f64::from(cycle.timings.see_ms));
        self.localize.add(f64::from(cycle.timings.localize_ms));
    }

    /// Reports a change of a device; returns the message for the log. None for one of many equal ones.
    pub(crate) fn report_device(&mut self, health: &HealthReport) -> Option<String> {
        let state = state_name(health.state);
        let text = match &health.reason {
            Some(reason) => format!("{}: {state}: {reason}", health.device),
            None => format!("{}: {state}", health.device),
        };
        let text = self.repeated.pass(&text, self.elapsed())?;
        self.record_change(&health.device, state, health.reason.clone());
        self.print_line(&text);
        Some(text)
    }

    /// Reports a change of the log.
    pub(crate) fn report_log_change(&mut self, text: &str) {
        self.record_change("log", "changed", Some(text.to_owned()));
        self.print_line(text);
    }

    /// Reports changed settings.
    pub(crate) fn report_settings(&mut self, text: &str) {
        self.record_change("settings", "changed", Some(text.to_owned()));
        self.print_line(text);
    }

    fn record_change(&mut self, device: &str, state: &str, reason: Option<String>) {
        if self.changes.len() < CHANGES_MAX {
            self.changes.push(StateChange {
                stamp_s: hw::now().seconds(),
                device: device.to_owned(),
                state: state.to_owned(),
                reason,
            });
        }
    }

    /// Prints a line on standard error.
    pub(crate) fn print_line(&mut self, text: &str) {
        self.clear_status_line();
        let elapsed = self.elapsed();
        self.stderr.write(format!("[{elapsed:9.3}] {text}\n"));
    }

    /// Prints the status line when it is due.
    pub(crate) fn update_status_line(
        &mut self,
        last: Option<&Cycle>,
        devices: impl FnOnce() -> Vec<HealthReport>,
    ) {
        let now = hw::now();
        self.sample_memory(now);
        if now < self.next_line {
            return;
        }
        self.next_line = now
            + if self.terminal {
                TERMINAL_PERIOD
            } else {
                JOURNAL_PERIOD
            };
        let line = self.format_status_line(last, &devices());
        if self.terminal {
            self.stderr.write(format!("\r\x1b[2K{line}"));
            self.line_shown = true;
        } else {
            self.stderr.write(format!("{line}\n"));
        }
    }

    fn format_status_line(&self, last: Option<&Cycle>, devices: &[HealthReport]) -> String {
        let pose = match last.map(|cycle| (cycle.estimate.mode, cycle.estimate.pose)) {
            Some((mode, Some(pose))) => format!(
                "{} x {:.2} y {:.2} {:.0}°",
                mode_name(mode),
                pose.x,
                pose.y,
                pose.theta.to_degrees()
            ),
            Some((mode, None)) => mode_name(mode).to_owned(),
            None => "no cycle yet".to_owned(),
        };
        let mut line = format!("{:8.1} s  {pose}", self.elapsed());
        if self.frames > 0 {
            let LatencySummary { median, p99, .. } = self.latency.summary();
            line += &format!("  latency {median:.1} ms (99 %: {p99:.1})");
        }
        for health in devices {
            let state = match health.state {
                HealthState::Running if health.rate_hz > 0.0 => {
                    format!("{:.0} Hz", health.rate_hz)
                }
                // The first second has no rate yet.
                HealthState::Running => "running".to_owned(),
                other => state_name(other).to_uppercase(),
            };
            line += &format!("  {} {state}", health.device);
        }
        line
    }

    fn clear_status_line(&mut self) {
        if std::mem::take(&mut self.line_shown) {
            self.stderr.write("\r\x1b[2K".to_owned());
        }
    }

    fn sample_memory(&mut self, now: Stamp) {
        if now < self.next_memory {
            return;
        }
        self.next_memory = now + 1.0;
        let memory = memory_mb();
        self.memory_first_mb.get_or_insert(memory);
        self.memory_max_mb = Some(
            self.memory_max_mb
                .map_or(memory, |maximum| maximum.max(memory)),
        );
    }

    /// The report of the run.
    pub(crate) fn into_report(mut self, outcome: RunOutcome) -> RunReport {
        self.clear_status_line();
        let ModeCounts {
            tracking,
            global,
            lost,
        } = self.modes;
        RunReport {
            seconds: self.elapsed(),
            frames: self.frames,
            blind: self.cycles_without_image,
            images_unused: self.unused_images.count,
            tracking,
            global,
            lost,
            latency_ms: self.latency.summary(),
            cycle_latency_ms: self.cycle_latency.summary(),
            arrival_ms: self.arrival.summary(),
            see_ms: self.vision_time.summary(),
            localize_ms: self.localize.summary(),
            realtime_priority: outcome.realtime_priority,
            wake_up_ms: outcome.wake_up,
            frames_replaced: outcome.dropped.images,
            samples_dropped: outcome.dropped.samples,
            samples_refused: outcome.samples_refused,
            images_overtaken: outcome.images_overtaken,
            memory_first_mb: self.memory_first_mb,
            memory_max_mb: self.memory_max_mb,
            memory_mb: memory_mb(),
            wheels_stopped: outcome.wheels_stopped,
            commands: outcome.commands,
            team: outcome.team,
            team_messages: outcome.team_messages,
            #[cfg(feature = "ros2")]
            ros2: outcome.ros2,
            devices: outcome.devices,
            changes: self.changes,
            log: outcome.log,
            outputs_lost: outcome.outputs_lost,
            warnings: outcome.warnings,
        }
    }
}

impl Default for RunStatus {
    fn default() -> Self {
        RunStatus::new()
    }
}

impl RunReport {
    /// The devices with their states, if there are some and none ever delivered anything.
    pub(crate) fn silent_devices(&self) -> Option<String> {
        let states = self
            .devices
            .iter()
            .map(|health| format!("{}: {}", health.device, state_name(health.state)));
        let delivered = self.frames > 0 || self.devices.iter().any(|health| health.messages > 0);
        (!delivered && !self.devices.is_empty()).then(|| states.collect::<Vec<_>>().join(", "))
    }

    /// Prints the report.
    pub(crate) fn print(&self) {
        println!(
            "{:.1} s: {} images; {} cycles tracking, {} from global search, {} lost, {} without an image, {} with one that could not be used",
            self.seconds,
            self.frames,
            self.tracking,
            self.global,
            self.lost,
            self.blind.saturating_sub(self.images_unused),
            self.images_unused
        );
        let times = |name: &str, times: LatencySummary| {
            println!(
                "{name}: median {:.2} ms, 99 % below {:.2} ms, longest {:.2} ms",
                times.median, times.p99, times.max
            );
        };
        if self.frames > 0 {
            times("exposure to pose", self.latency_ms);
            times("  image arrival", self.arrival_ms);
            times("  vision", self.see_ms);
            times("  localization", self.localize_ms);
            times("exposure to ball and robots", self.cycle_latency_ms);
        }
        times("a sleeping thread woke late by", self.wake_up_ms);
        println!("{:.1} MB of memory", self.memory_mb);
        for warning in &self.warnings {
            stderr_line!("warning: {warning}");
        }
        for health in &self.devices {
            println!(
                "{}: {}, {} messages, {} damaged, {} faults, reopened {} times",
                health.device,
                state_name(health.state),
                health.messages,
                health.damaged,
                health.faults,
                health.reopened
            );
        }
        if let Some(commands) = &self.commands {
            let refused: u64 = commands.refused.values().sum();
            println!(
                "remote commands: {} accepted, {} sent, {} confirmed by the base, {} overruled, {refused} rejected",
                commands.accepted, commands.sent, commands.obeyed, commands.overruled
            );
        }
        if let Some(messages) = &self.team_messages {
            let refused = messages.refused.iter();
            let refused = refused.filter(|(reason, _)| **reason != RejectReason::Own);
            let refused: u64 = refused.map(|(_, count)| count).sum();
            println!(
                "team messages: {} received, {refused} rejected",
                messages.received
            );
        }
        for file in self.log.iter().flat_map(|log| &log.files) {
            println!("log: {}", file.display());
        }
        if let Some(gap) = self.log.as_ref().and_then(LogSummary::gap) {
            println!("{gap}");
        }
        if !self.wheels_stopped {
            println!("the base did not take the stop command");
        }
    }
}

/// The state's name in JSON.
pub(crate) fn state_name(state: HealthState) -> &'static str {
    match state {
        HealthState::Absent => "absent",
        HealthState::Running => "running",
        HealthState::Stalled => "stalled",
        HealthState::Garbage => "garbage",
        HealthState::Stuck => "stuck",
        HealthState::Range => "range",
        HealthState::Clock => "clock",
    }
}

/// Resident memory of this process, MB.
fn memory_mb() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let kilobytes =
        line.and_then(|line| line.trim().strip_suffix("kB")?.trim().parse::<f64>().ok());
    kilobytes.unwrap_or(0.0) / 1024.0
}

/// Messages about battery, kicker and switches, one when a condition begins and one when it ends.
#[derive(Debug, Default)]
pub(crate) struct OperatorNotices {
    emergency_stop: bool,
    kicker_broken: bool,
    motor_fault: [u8; 4],
}

impl OperatorNotices {
    /// The message of an event, if it changes a condition.
    pub(crate) fn update(&mut self, event: &DeviceEvent) -> Option<String> {
        match event {
            DeviceEvent::Switches(report) if report.emergency_stop != self.emergency_stop => {
                self.emergency_stop = report.emergency_stop;
                let action = if report.emergency_stop {
                    "pressed"
                } else {
                    "released"
                };
                Some(format!("the emergency stop was {action}"))
            }
            DeviceEvent::Kicker(report) if report.charge_fault != self.kicker_broken => {
                self.kicker_broken = report.charge_fault;
                let verb = if report.charge_fault { "cannot" } else { "can" };
                Some(format!("the kicker {verb} charge"))
            }
            DeviceEvent::Power(report) if report.motor_fault != self.motor_fault => {
                self.motor_fault = report.motor_fault;
                Some(format!(
                    "motor driver fault codes: {:?}",
                    report.motor_fault
                ))
            }
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn status_line_states_no_rate_and_no_latency_before_they_are_known() {
        let mut camera = HealthReport {
            device: "camera".to_owned(),
            state: HealthState::Running,
            reason: None,
            rate_hz: 0.0,
            last: None,
            messages: 1,
            garbage_bytes: 0,
            damaged: 0,
            reopened: 0,
            faults: 0,
        };
        let mut status = RunStatus::new();
        let line = status.format_status_line(None, std::slice::from_ref(&camera));
        assert!(line.ends_with("s  no cycle yet  camera running"), "{line}");
        camera.rate_hz = 30.2;
        status.frames = 1;
        let line = status.format_status_line(None, &[camera]);
        assert!(line.contains("latency") && line.ends_with("camera 30 Hz"));
    }
}
