//! Health panel: state, rate, age and errors of each device, dropped cycles and stage times.

use eframe::egui::{self, Color32, Ui};

use crate::view::device_monitor::DeviceState;
use crate::view::palette;
use crate::view::session::Session;

/// Averaging window of the rates, seconds.
const WINDOW: f64 = 2.0;

/// Draws the panel.
pub(crate) fn show(ui: &mut Ui, session: &Session) {
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
                    ui.monospace(format!("{:6.0} ms", 1e3 * device.longest_gap));
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
        ui.label(format!(
            "{} cycles received, {} dropped by the view (the robot does not wait for it)",
            devices.cycles, devices.dropped
        ));
        if session.log_path().is_some() {
            ui.weak("Log: counts since the last seek, rates from the whole log.");
        }
        let faulty = session.series.samples().iter().filter(|s| s.fault);
        let count = faulty.clone().count();
        if count > 0 {
            let first = faulty.clone().next().map_or(0.0, |sample| sample.time);
            ui.colored_label(
                palette::ORANGE,
                format!("{count} images of this run could not be used, the first at {first:.2} s"),
            );
        }
        if let Some(now) = &session.shown {
            let timings = &now.cycle.timings;
            ui.label(format!(
                "this cycle: vision {:.2} ms, localization {:.2} ms",
                timings.see_ms, timings.localize_ms
            ));
        }
    });
}

fn colour(state: DeviceState) -> Color32 {
    match state {
        DeviceState::Running => palette::GREEN,
        DeviceState::NoData => palette::GREY,
        DeviceState::Silent | DeviceState::Stuck => palette::VERMILION,
    }
}
