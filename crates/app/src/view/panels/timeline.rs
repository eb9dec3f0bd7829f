//! Timeline panel: playback, marks, and the modes and errors of the whole run.

use eframe::egui::{self, Color32, Ui};

use super::timeline_bar::TimelineBar;
use crate::view::accessibility::AccessibleLabel;
use crate::view::palette;
use crate::view::panel_command::PanelCommand;
use crate::view::session::Session;
use crate::view::source::Source;

/// Selectable playback speeds.
const SPEEDS: [f64; 8] = [0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 10.0, 50.0];

/// State of the panel.
#[derive(Default)]
pub(crate) struct TimelinePanel {
    /// Text of the next mark.
    mark_text: String,
    bar: TimelineBar,
}

impl TimelinePanel {
    /// Does what keys ask for.
    pub(super) fn apply(&mut self, command: PanelCommand, session: &Session) {
        self.bar.apply(command, session);
    }

    /// The visible time, unless it is the whole run.
    #[cfg(test)]
    pub(crate) fn range(&self) -> Option<(f64, f64)> {
        self.bar.range
    }

    /// Draws the panel.
    pub(crate) fn show(&mut self, ui: &mut Ui, session: &mut Session) {
        self.buttons(ui, session);
        self.bar.show(ui, session);
        for error in session.last_error.iter().chain(&session.source_problem()) {
            ui.colored_label(palette::VERMILION, error);
        }
        show_recompute_summary(ui, session);
        show_other_runs(ui, session);
        egui::ScrollArea::vertical()
            .auto_shrink(false)
            .show(ui, |ui| {
                for line in session.notices() {
                    ui.colored_label(palette::ORANGE, line);
                }
                marks(ui, session);
            });
    }

    fn buttons(&mut self, ui: &mut Ui, session: &mut Session) {
        ui.horizontal_wrapped(|ui| {
            let live = matches!(session.source, Source::Live(_));
            let playing = session.playback.playing;
            if ui
                .button("|<")
                .on_hover_text("Go to the start (Home)")
                .clicked()
                && let Some((start, _)) = session.source.span()
            {
                session.seek(start);
            }
            if ui
                .button("<")
                .on_hover_text("Previous cycle (Left)")
                .clicked()
            {
                session.step(-1);
            }
            let name = if playing { "Pause" } else { "Play" };
            if ui.button(name).on_hover_text("Space").clicked() {
                session.toggle_playback();
            }
            if ui.button(">").on_hover_text("Next cycle (Right)").clicked() {
                session.step(1);
            }
            let to_end = if live { "Now" } else { ">|" };
            if ui
                .button(to_end)
                .on_hover_text("Go to the end (End)")
                .clicked()
            {
                if live {
                    session.playback.playing = true;
                } else if let Some((_, end)) = session.source.span() {
                    session.seek(end);
                }
            }
            speed(ui, session);
            if let (Some((start, end)), at) = (session.span(), session.playback.time) {
                ui.monospace(format!("{at:.3} s  ({start:.1} to {end:.1} s)"));
            }
            ui.add(
                egui::TextEdit::singleline(&mut self.mark_text)
                    .hint_text("mark")
                    .desired_width(90.0),
            )
            .with_accessible_label("text of the mark");
            if ui.button("Mark").on_hover_text("M").clicked() {
                session.add_mark(&std::mem::take(&mut self.mark_text));
            }
        });
    }
}

fn speed(ui: &mut Ui, session: &mut Session) {
    let before = session.playback.speed;
    let owned = session.source.simulation().is_some();
    let external = matches!(session.source, Source::Live(_)) && !owned;
    // The view cannot change the speed of a run that it does not own.
    ui.add_enabled_ui(!external, |ui| {
        egui::ComboBox::from_id_salt("speed")
            .width(60.0)
            .selected_text(format!("{before} x"))
            .show_ui(ui, |ui| {
                for speed in SPEEDS {
                    let text = format!("{speed} x");
                    ui.selectable_value(&mut session.playback.speed, speed, text);
                }
            })
            .response
            .with_accessible_label("speed");
    });
    if session.playback.speed != before {
        session.set_speed(session.playback.speed);
    }
}

/// Shows how the recomputed run compares with the recorded one.
fn show_recompute_summary(ui: &mut Ui, session: &mut Session) {
    let Some(recompute) = &session.recompute else {
        return;
    };
    let mut discard = false;
    ui.horizontal_wrapped(|ui| {
        let cm = |error: Option<f32>| {
            error.map_or("unknown".to_owned(), |e| format!("{:.2} cm", 100.0 * e))
        };
        let state = if recompute.done { "" } else { "recomputing: " };
        ui.colored_label(
            palette::PURPLE,
            format!(
                "{state}{} cycles, {} poses differ; mean error recorded {}, recomputed {}{}",
                recompute.cycles,
                recompute.changed_poses,
                cm(session.series.mean_error()),
                cm(recompute.series.mean_error()),
                if recompute.vision_recomputed {
                    ""
                } else {
                    " (from the recorded line points: the log has no lossless images)"
                }
            ),
        );
        if let Some(error) = &recompute.error {
            ui.colored_label(palette::VERMILION, error);
        }
        discard = ui.button("Discard").clicked();
    });
    if discard {
        session.recompute = None;
    }
}

/// Lists the other runs with their place on the timeline.
fn show_other_runs(ui: &mut Ui, session: &mut Session) {
    let mut remove = None;
    for (number, other) in session.others.iter_mut().enumerate() {
        ui.horizontal_wrapped(|ui| {
            ui.colored_label(palette::run_colour(number), &other.name);
            if let Some((start, end)) = other.span() {
                ui.monospace(format!("{start:.1} to {end:.1} s"));
            }
            let mut offset = other.offset();
            let drag = egui::DragValue::new(&mut offset)
                .speed(0.01)
                .max_decimals(3)
                .prefix("moved by ")
                .suffix(" s");
            if ui.add(drag).changed() {
                other.set_offset(offset);
            }
            if let Some(error) = other.series.mean_error() {
                ui.label(format!("mean error {:.1} cm", 100.0 * error));
            }
            if ui.small_button("Close").clicked() {
                remove = Some(number);
            }
        });
    }
    if let Some(number) = remove {
        session.others.remove(number);
    }
}

fn marks(ui: &mut Ui, session: &mut Session) {
    let (mut seek_to, mut remove) = (None, None);
    for (number, mark) in session.marks.iter().enumerate() {
        ui.horizontal(|ui| {
            if ui.link(format!("{:.3} s", mark.time)).clicked() {
                seek_to = Some(mark.time);
            }
            ui.label(&mark.text);
            if ui.small_button("Remove").clicked() {
                remove = Some(number);
            }
        });
    }
    if let Some(time) = seek_to {
        session.seek(time);
    }
    if let Some(number) = remove {
        session.marks.remove(number);
    }
    if session.marks.is_empty() {
        ui.colored_label(Color32::GRAY, "No marks.");
    }
}
