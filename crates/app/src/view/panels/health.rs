//! Health panel: state, rate, age and errors of each device, dropped cycles and stage times.

use std::path::PathBuf;
use std::time::Duration;

use eframe::egui::{self, Color32, Ui};
use localize::estimate::{Estimate, Reason};

use crate::view::device_monitor::DeviceState;
use crate::view::palette;
use crate::view::session::Session;
use crate::view::setup_job::SetupCheck;

/// Averaging window of the rates, seconds.
const WINDOW: f64 = 2.0;

/// Draws the panel.
pub(crate) fn show(ui: &mut Ui, session: &mut Session) {
    session.setup_check.poll();
    let log = session.log_path();
    let devices = &session.devices;
    let rates = session.series.rates_hz(session.playback.time, WINDOW);
    egui::ScrollArea::both().auto_shrink(false).show(ui, |ui| {
        egui::Grid::new("devices")
            .striped(true)
            .num_columns(7)
            .show(ui, |ui| {
                for name in [
                    "Device",
                    "State",
                    "Rate",
                    "Age",
                    "Longest gap",
                    "Samples",
                    "Errors",
                ] {
                    ui.strong(name);
                }
                ui.end_row();
                for (device, rate) in devices.devices.iter().zip(rates) {
                    let state = device.state(devices.stamp);
                    ui.label(device.name);
                    ui.colored_label(colour(state), state.label());
                    ui.monospace(format!("{rate:6.1} Hz"));
                    match device.age(devices.stamp) {
                        Some(age) => ui.monospace(format!("{:6.0} ms", 1e3 * age)),
                        None => ui.weak("-"),
                    };
                    ui.monospace(format!("{:6.0} ms", 1e3 * device.longest_gap))
                        .on_hover_text(format!(
                            "ended at {:.3} s",
                            device.longest_gap_end.seconds()
                        ));
                    ui.monospace(device.samples.to_string());
                    match &device.last_fault {
                        Some(fault) => {
                            let text = format!("{}: {fault}", device.fault_count);
                            ui.colored_label(palette::VERMILION, text)
                        }
                        None => ui.monospace("0"),
                    };
                    ui.end_row();
                }
            });
        ui.separator();
        if log.is_some() {
            ui.label(format!(
                "{} cycles of the log since two seconds before the last jump, drawn or not",
                devices.cycles
            ));
        } else {
            ui.label(format!(
                "{} cycles received, {} dropped by the view (the robot does not wait for it)",
                devices.cycles, devices.dropped
            ));
        }
        let faulty = session.series.samples().iter().filter(|s| s.fault);
        let count = faulty.clone().count();
        if count > 0 {
            let images = if count == 1 {
                "1 image".to_owned()
            } else {
                format!("{count} images")
            };
            let first = faulty.clone().next().map_or(0.0, |sample| sample.time);
            ui.colored_label(
                palette::ORANGE,
                format!("{images} of this run could not be used, the first at {first:.2} s"),
            );
        }
        if let Some(now) = &session.shown {
            let timings = &now.cycle.timings;
            ui.label(format!(
                "this cycle: vision {:.2} ms, localization {:.2} ms",
                timings.see_ms, timings.localize_ms
            ));
            show_fit(ui, &now.cycle.estimate);
        }
        show_setup_check(ui, &mut session.setup_check, log);
    });
}

/// How well the set-up fits the last seconds.
fn show_fit(ui: &mut Ui, estimate: &Estimate) {
    let fit = estimate.fit;
    let agreement =
        |value: Option<f32>| value.map_or("-".to_owned(), |value| format!("{value:.2}"));
    let text = format!(
        "set-up: {:.0} % of the points on markings, {:.1} cm off; {:.0} % of the markings in sight seen; agreement of wheels {}, compass {}",
        100.0 * fit.on_markings,
        100.0 * fit.inlier_rms,
        100.0 * fit.markings_seen,
        agreement(fit.wheel_agreement),
        agreement(fit.compass_agreement)
    );
    if estimate.reason == Some(Reason::DoubtfulSetup) {
        ui.colored_label(palette::VERMILION, text);
    } else {
        ui.label(text);
    }
}

/// Button that tries other set-ups on the log, and what they explain better.
fn show_setup_check(ui: &mut Ui, check: &mut SetupCheck, log: Option<PathBuf>) {
    ui.separator();
    match check {
        SetupCheck::Running(_) => {
            ui.horizontal(|ui| {
                ui.spinner();
                ui.label("trying other set-ups");
            });
            ui.ctx().request_repaint_after(Duration::from_millis(200));
            return;
        }
        SetupCheck::Done(Err(error)) => {
            ui.colored_label(palette::VERMILION, format!("{error:#}"));
        }
        SetupCheck::Done(Ok(report)) => {
            if report.suggestions.is_empty() && report.warnings.is_empty() {
                ui.label("no other set-up explains this log better");
            }
            for warning in &report.warnings {
                ui.colored_label(palette::VERMILION, warning);
            }
        }
        SetupCheck::Idle => {}
    }
    let button = ui
        .add_enabled(log.is_some(), egui::Button::new("Check the set-up"))
        .on_hover_text(
            "Tries other fields, camera mounts and units on this log, as `doctor --recording` does",
        )
        .on_disabled_hover_text("Open a log first");
    if let Some(log) = log.filter(|_| button.clicked()) {
        *check = SetupCheck::start(log);
    }
}

fn colour(state: DeviceState) -> Color32 {
    match state {
        DeviceState::Running => palette::GREEN,
        DeviceState::NoData => palette::GREY,
        DeviceState::Silent | DeviceState::Stuck => palette::VERMILION,
    }
}
