//! How is the robot doing? A line for people while it plays, lines when something changes, and one result at the end.

use std::io::IsTerminal;

use hw::{DeviceEvent, HealthReport, HealthState};
use localize::Stamp;
use serde::Serialize;

use super::latency::{LatencyHistogram, LatencySummary};
use super::log_rotation::LogSummary;
use super::stderr_writer::StderrWriter;
use crate::net::commands::CommandCounts;
use pipeline::Cycle;
use pipeline::result_files::mode_name;

/// Time between two looks of a terminal's status line, seconds.
const TERMINAL_PERIOD: f64 = 0.5;
/// Time between two status lines where no terminal is (a journal), seconds.
const JOURNAL_PERIOD: f64 = 60.0;
/// Changes that are kept for the result; a device that comes and goes all day is not kept for ever.
const CHANGES_MAX: usize = 10_000;
/// When memory is first measured, seconds after the start: every table and buffer is there by then.
const MEMORY_BASELINE_TIME: f64 = 60.0;

/// What `--json` prints at the end.
#[derive(Debug, Clone, Serialize)]
pub struct RunReport {
    /// How long it played, seconds.
    pub seconds: f64,
    /// Frames that were looked at.
    pub frames: u64,
    /// Cycles without a usable frame.
    pub blind: u64,
    /// Cycles whose pose was carried on.
    pub tracking: u64,
    /// Cycles whose pose was found on the whole field.
    pub global: u64,
    /// Cycles without a pose.
    pub lost: u64,
    /// From the frame's exposure until its pose was published, milliseconds.
    pub latency_ms: LatencySummary,
    /// From the exposure until the spine took the frame, milliseconds.
    pub arrival_ms: LatencySummary,
    /// Image to features, milliseconds.
    pub see_ms: LatencySummary,
    /// Features and motion to a pose, milliseconds.
    pub localize_ms: LatencySummary,
    /// Frames that a newer one replaced before they were looked at.
    pub frames_replaced: u64,
    /// Samples that gave way to newer ones.
    pub samples_dropped: u64,
    /// Samples that were no numbers.
    pub samples_refused: u64,
    /// Memory of the process after its first minute, MB; none of a shorter run.
    pub memory_first_mb: Option<f64>,
    /// The most since then, MB.
    pub memory_max_mb: Option<f64>,
    /// At the end, MB.
    pub memory_mb: f64,
    /// The wheels were told to stop before the end; true without a base.
    pub wheels_stopped: bool,
    /// Commands of other programs, if they may command.
    pub commands: Option<CommandCounts>,
    /// Every device.
    pub devices: Vec<HealthReport>,
    /// Every change of a device, in order.
    pub changes: Vec<StateChange>,
    /// The log, if there was one.
    pub log: Option<LogSummary>,
}

/// A device, or the log, became something else.
#[derive(Debug, Clone, Serialize)]
pub struct StateChange {
    /// CLOCK_MONOTONIC, seconds.
    pub stamp_s: f64,
    /// Which.
    pub device: String,
    /// What it is now.
    pub state: String,
    /// Why.
    pub reason: Option<String>,
}

/// Watches a run and tells about it.
pub struct RunStatus {
    began: Stamp,
    stderr: StderrWriter,
    terminal: bool,
    next_line: Stamp,
    line_shown: bool,
    frames: u64,
    cycles_without_image: u64,
    modes: [u64; 3],
    latency: LatencyHistogram,
    arrival: LatencyHistogram,
    vision_time: LatencyHistogram,
    localize: LatencyHistogram,
    changes: Vec<StateChange>,
    memory_first_mb: Option<f64>,
    memory_max_mb: Option<f64>,
    next_memory: Stamp,
}

impl RunStatus {
    /// Begins now.
    pub fn new() -> Self {
        let began = hw::now();
        RunStatus {
            began,
            stderr: StderrWriter::start(),
            terminal: std::io::stderr().is_terminal(),
            next_line: began + TERMINAL_PERIOD,
            line_shown: false,
            frames: 0,
            cycles_without_image: 0,
            modes: [0; 3],
            latency: LatencyHistogram::default(),
            arrival: LatencyHistogram::default(),
            vision_time: LatencyHistogram::default(),
            localize: LatencyHistogram::default(),
            changes: Vec::new(),
            memory_first_mb: None,
            memory_max_mb: None,
            next_memory: began + MEMORY_BASELINE_TIME,
        }
    }

    /// Seconds since the start.
    pub fn elapsed(&self) -> f64 {
        hw::now() - self.began
    }

    /// Counts a cycle; `taken` and `published`: when the spine took its frame, and when its pose was out.
    pub fn count_cycle(&mut self, cycle: &Cycle, taken: Stamp, published: Stamp) {
        self.modes[cycle.estimate.mode as usize] += 1;
        if cycle.detections.is_none() {
            self.cycles_without_image += 1;
            return;
        }
        self.frames += 1;
        self.arrival.add((taken - cycle.stamp) * 1e3);
        self.latency.add((published - cycle.stamp) * 1e3);
        self.vision_time.add(f64::from(cycle.timings.see_ms));
        self.localize.add(f64::from(cycle.timings.localize_ms));
    }

    /// A device changed; returns the words for the log.
    pub fn report_device(&mut self, health: &HealthReport) -> String {
        let state = state_name(health.state);
        let text = match &health.reason {
            Some(reason) => format!("{}: {state}: {reason}", health.device),
            None => format!("{}: {state}", health.device),
        };
        self.record_change(&health.device, state, health.reason.clone());
        self.print_line(&text);
        text
    }

    /// Something happened to the log.
    pub fn report_log_change(&mut self, text: &str) {
        self.record_change("log", "changed", Some(text.to_owned()));
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

    /// A line of its own on standard error.
    pub fn print_line(&mut self, text: &str) {
        self.clear_status_line();
        let elapsed = self.elapsed();
        self.stderr.write(format!("[{elapsed:9.3}] {text}\n"));
    }

    /// Shows the status line when its time has come.
    pub fn update_status_line(
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
        let place = match last.map(|cycle| (cycle.estimate.mode, cycle.estimate.pose)) {
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
        let mut line = format!(
            "{:8.1} s  {place}  latency {:.1} ms (99 %: {:.1})",
            self.elapsed(),
            self.latency.summary().median,
            self.latency.summary().p99
        );
        for health in devices {
            let state = match health.state {
                HealthState::Running => format!("{:.0} Hz", health.rate_hz),
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
        self.memory_max_mb = Some(self.memory_max_mb.map_or(memory, |most| most.max(memory)));
    }

    /// The result; with what was lost (given way, and no numbers), and what became of wheels and commands.
    pub fn into_report(
        mut self,
        (inbox, samples_refused): (hw::DroppedInputs, u64),
        (wheels_stopped, commands): (bool, Option<CommandCounts>),
        devices: Vec<HealthReport>,
        log: Option<LogSummary>,
    ) -> RunReport {
        self.clear_status_line();
        let [tracking, global, lost] = self.modes;
        RunReport {
            seconds: self.elapsed(),
            frames: self.frames,
            blind: self.cycles_without_image,
            tracking,
            global,
            lost,
            latency_ms: self.latency.summary(),
            arrival_ms: self.arrival.summary(),
            see_ms: self.vision_time.summary(),
            localize_ms: self.localize.summary(),
            frames_replaced: inbox.images,
            samples_dropped: inbox.samples,
            samples_refused,
            memory_first_mb: self.memory_first_mb,
            memory_max_mb: self.memory_max_mb,
            memory_mb: memory_mb(),
            wheels_stopped,
            commands,
            devices,
            changes: self.changes,
            log,
        }
    }
}

impl Default for RunStatus {
    fn default() -> Self {
        RunStatus::new()
    }
}

impl RunReport {
    /// The result in a few lines for people.
    pub fn print(&self) {
        println!(
            "{:.1} s: {} frames ({} tracked, {} found anew, {} lost; {} cycles without a frame)",
            self.seconds, self.frames, self.tracking, self.global, self.lost, self.blind
        );
        let times = |name: &str, times: LatencySummary| {
            println!(
                "{name}: median {:.2} ms, 99 % below {:.2} ms, longest {:.2} ms",
                times.median, times.p99, times.max
            );
        };
        times("exposure to pose", self.latency_ms);
        times("  frame's arrival", self.arrival_ms);
        times("  vision", self.see_ms);
        times("  localisation", self.localize_ms);
        println!("{:.1} MB of memory", self.memory_mb);
        for health in &self.devices {
            println!(
                "{}: {}, {} messages, {} damaged, {} faults, opened again {} times",
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
                "commands of other programs: {} carried out, {} overruled, {refused} refused",
                commands.obeyed, commands.overruled
            );
        }
        for file in self.log.iter().flat_map(|log| &log.files) {
            println!("log: {}", file.display());
        }
        if !self.wheels_stopped {
            println!("the base could not be told to stop");
        }
    }
}

/// The state's name, as JSON has it.
pub fn state_name(state: HealthState) -> &'static str {
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

/// What battery, kicker and switches say that a person must know, told once each time it begins and ends.
#[derive(Debug, Default)]
pub struct OperatorNotices {
    emergency_stop: bool,
    kicker_broken: bool,
    motor_fault: [u8; 4],
}

impl OperatorNotices {
    /// What is new in an event.
    pub fn update(&mut self, event: &DeviceEvent) -> Option<String> {
        match event {
            DeviceEvent::Switches(said) if said.emergency_stop != self.emergency_stop => {
                self.emergency_stop = said.emergency_stop;
                let verb = if said.emergency_stop {
                    "pressed"
                } else {
                    "released"
                };
                Some(format!("the emergency stop was {verb}"))
            }
            DeviceEvent::Kicker(said) if said.charge_fault != self.kicker_broken => {
                self.kicker_broken = said.charge_fault;
                let verb = if said.charge_fault { "cannot" } else { "can" };
                Some(format!("the kicker {verb} charge"))
            }
            DeviceEvent::Power(said) if said.motor_fault != self.motor_fault => {
                self.motor_fault = said.motor_fault;
                Some(format!(
                    "fault codes of the motors' drivers: {:?}",
                    said.motor_fault
                ))
            }
            _ => None,
        }
    }
}
