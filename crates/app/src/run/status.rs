//! How is the robot doing? A line for people while it plays, lines when something changes, and one result at the end.

use std::io::IsTerminal;

use hw::{Event, Health, State};
use localize::Stamp;
use serde::Serialize;

use super::keeper::Kept;
use super::latency::{Quantiles, Times};
use super::teller::Teller;
use crate::net::commands::Counts;
use pipeline::cycle::Cycle;
use pipeline::result_files::mode_name;

/// Time between two looks of a terminal's status line, seconds.
const GLANCE: f64 = 0.5;
/// Time between two status lines where no terminal is (a journal), seconds.
const ENTRY: f64 = 60.0;
/// Changes that are kept for the result; a device that comes and goes all day is not kept for ever.
const CHANGES_MAX: usize = 10_000;
/// When memory is first measured, seconds after the start: every table and buffer is there by then.
const WARM: f64 = 60.0;

/// What `--json` prints at the end.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
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
    pub latency_ms: Quantiles,
    /// From the exposure until the spine took the frame, milliseconds.
    pub arrival_ms: Quantiles,
    /// Image to features, milliseconds.
    pub see_ms: Quantiles,
    /// Features and motion to a pose, milliseconds.
    pub localize_ms: Quantiles,
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
    pub commands: Option<Counts>,
    /// Every device.
    pub devices: Vec<Health>,
    /// Every change of a device, in order.
    pub changes: Vec<Change>,
    /// The log, if there was one.
    pub log: Option<Kept>,
}

/// A device, or the log, became something else.
#[derive(Debug, Clone, Serialize)]
pub struct Change {
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
pub struct Status {
    began: Stamp,
    teller: Teller,
    terminal: bool,
    next_line: Stamp,
    line_shown: bool,
    frames: u64,
    blind: u64,
    modes: [u64; 3],
    latency: Times,
    arrival: Times,
    see: Times,
    localize: Times,
    changes: Vec<Change>,
    memory_first_mb: Option<f64>,
    memory_max_mb: Option<f64>,
    next_memory: Stamp,
}

impl Status {
    /// Begins now.
    pub fn new() -> Self {
        let began = hw::now();
        Status {
            began,
            teller: Teller::start(),
            terminal: std::io::stderr().is_terminal(),
            next_line: began + GLANCE,
            line_shown: false,
            frames: 0,
            blind: 0,
            modes: [0; 3],
            latency: Times::default(),
            arrival: Times::default(),
            see: Times::default(),
            localize: Times::default(),
            changes: Vec::new(),
            memory_first_mb: None,
            memory_max_mb: None,
            next_memory: began + WARM,
        }
    }

    /// Seconds since the start.
    pub fn elapsed(&self) -> f64 {
        hw::now() - self.began
    }

    /// Counts a cycle; `taken` and `published`: when the spine took its frame, and when its pose was out.
    pub fn cycle(&mut self, cycle: &Cycle, taken: Stamp, published: Stamp) {
        self.modes[cycle.estimate.mode as usize] += 1;
        if cycle.seen.is_none() {
            self.blind += 1;
            return;
        }
        self.frames += 1;
        self.arrival.add((taken - cycle.stamp) * 1e3);
        self.latency.add((published - cycle.stamp) * 1e3);
        self.see.add(f64::from(cycle.timings.see_ms));
        self.localize.add(f64::from(cycle.timings.localize_ms));
    }

    /// A device changed; returns the words for the log.
    pub fn device(&mut self, health: &Health) -> String {
        let state = state_name(health.state);
        let text = match &health.reason {
            Some(reason) => format!("{}: {state}: {reason}", health.device),
            None => format!("{}: {state}", health.device),
        };
        self.change(&health.device, state, health.reason.clone());
        self.say(&text);
        text
    }

    /// Something happened to the log.
    pub fn log(&mut self, text: &str) {
        self.change("log", "changed", Some(text.to_owned()));
        self.say(text);
    }

    fn change(&mut self, device: &str, state: &str, reason: Option<String>) {
        if self.changes.len() < CHANGES_MAX {
            self.changes.push(Change {
                stamp_s: hw::now().seconds(),
                device: device.to_owned(),
                state: state.to_owned(),
                reason,
            });
        }
    }

    /// A line of its own on standard error.
    pub fn say(&mut self, text: &str) {
        self.wipe();
        let elapsed = self.elapsed();
        self.teller.tell(format!("[{elapsed:9.3}] {text}\n"));
    }

    /// Shows the status line when its time has come.
    pub fn glance(&mut self, last: Option<&Cycle>, devices: impl FnOnce() -> Vec<Health>) {
        let now = hw::now();
        self.watch_memory(now);
        if now < self.next_line {
            return;
        }
        self.next_line = now + if self.terminal { GLANCE } else { ENTRY };
        let line = self.line(last, &devices());
        if self.terminal {
            self.teller.tell(format!("\r\x1b[2K{line}"));
            self.line_shown = true;
        } else {
            self.teller.tell(format!("{line}\n"));
        }
    }

    fn line(&self, last: Option<&Cycle>, devices: &[Health]) -> String {
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
            self.latency.quantiles().median,
            self.latency.quantiles().p99
        );
        for health in devices {
            let state = match health.state {
                State::Running => format!("{:.0} Hz", health.rate_hz),
                other => state_name(other).to_uppercase(),
            };
            line += &format!("  {} {state}", health.device);
        }
        line
    }

    fn wipe(&mut self) {
        if std::mem::take(&mut self.line_shown) {
            self.teller.tell("\r\x1b[2K".to_owned());
        }
    }

    fn watch_memory(&mut self, now: Stamp) {
        if now < self.next_memory {
            return;
        }
        self.next_memory = now + 1.0;
        let memory = memory_mb();
        self.memory_first_mb.get_or_insert(memory);
        self.memory_max_mb = Some(self.memory_max_mb.map_or(memory, |most| most.max(memory)));
    }

    /// The result; with what was lost (given way, and no numbers), and what became of wheels and commands.
    pub fn report(
        mut self,
        (inbox, samples_refused): (hw::Dropped, u64),
        (wheels_stopped, commands): (bool, Option<Counts>),
        devices: Vec<Health>,
        log: Option<Kept>,
    ) -> Report {
        self.wipe();
        let [tracking, global, lost] = self.modes;
        Report {
            seconds: self.elapsed(),
            frames: self.frames,
            blind: self.blind,
            tracking,
            global,
            lost,
            latency_ms: self.latency.quantiles(),
            arrival_ms: self.arrival.quantiles(),
            see_ms: self.see.quantiles(),
            localize_ms: self.localize.quantiles(),
            frames_replaced: inbox.frames,
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

impl Default for Status {
    fn default() -> Self {
        Status::new()
    }
}

impl Report {
    /// The result in a few lines for people.
    pub fn print(&self) {
        println!(
            "{:.1} s: {} frames ({} tracked, {} found anew, {} lost; {} cycles without a frame)",
            self.seconds, self.frames, self.tracking, self.global, self.lost, self.blind
        );
        let times = |name: &str, times: Quantiles| {
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
pub fn state_name(state: State) -> &'static str {
    match state {
        State::Absent => "absent",
        State::Running => "running",
        State::Stalled => "stalled",
        State::Garbage => "garbage",
        State::Stuck => "stuck",
        State::Range => "range",
        State::Clock => "clock",
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
pub struct Remarks {
    emergency_stop: bool,
    kicker_broken: bool,
    motor_fault: [u8; 4],
}

impl Remarks {
    /// What is new in an event.
    pub fn of(&mut self, event: &Event) -> Option<String> {
        match event {
            Event::Switches(said) if said.emergency_stop != self.emergency_stop => {
                self.emergency_stop = said.emergency_stop;
                let verb = if said.emergency_stop {
                    "pressed"
                } else {
                    "released"
                };
                Some(format!("the emergency stop was {verb}"))
            }
            Event::Kicker(said) if said.broken != self.kicker_broken => {
                self.kicker_broken = said.broken;
                let verb = if said.broken { "cannot" } else { "can" };
                Some(format!("the kicker {verb} charge"))
            }
            Event::Power(said) if said.fault != self.motor_fault => {
                self.motor_fault = said.fault;
                Some(format!(
                    "fault codes of the motors' drivers: {:?}",
                    said.fault
                ))
            }
            _ => None,
        }
    }
}
